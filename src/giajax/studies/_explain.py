"""What runs need beyond a model: it grows until its residuals suggest nothing, with a journal."""

import dataclasses
import functools
import json
import re
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..fitting import (
    Budget,
    FitResult,
    HeldChannel,
    HeldOut,
    Suspect,
    errors_of,
    load_result,
    matching_runs,
    prediction_errors,
)
from ..models import capabilities
from ..recordings import (
    FitSettings,
    Run,
    hold_out,
    make_folder,
    read_run,
    unique_names,
    write_files,
    write_run,
)
from ..runtime.files import parse_json, read_bytes
from ..runtime.limits import JOURNAL_BYTES
from ..runtime.process import stop_if_asked
from ..runtime.records import from_plain, plain_data
from ..runtime.text import InputError, time_in_words
from ._columns import mistakes_of
from ._explain_records import (
    ALL,
    Ended,
    ExplainedParameter,
    ExplainedStep,
    Explanation,
    behind,
)
from ._refit import fit_key, refit, with_fitted_state
from ._stepwise import (
    TRIES,
    AbstractFits,
    Change,
    Climb,
    Fits,
    Measured,
    Step,
    Tried,
    best_of,
    is_one,
    side_by_side,
)
from ._suspects import Suspects, outlying, significant
from ._systematic import with_suspects

NEARNESS = 6.0
"""A model whose BIC is not higher by more than this fits nearly as well: odds of 1 to 20."""

ROBUST = "huber"
"""The loss where outliers are seen: with others a wrong model takes its misfit for outliers."""

_STEPS = 10  # what five omissions take, and three that were taken for others at first
_ITERATIONS = 30  # of a step
_MEMBERS = 2  # of a group, beside the first
_AGAINST = 3.0  # standard deviations of a prior that a nuisance is off by


@dataclasses.dataclass(frozen=True)
class Explained:
    """An explanation, its final fit, and the runs as that sees them."""

    record: Explanation
    result: FitResult
    runs: list[Run]


class _Stopped(Exception):  # noqa: N818
    """Time is up, or Ctrl-C came."""


JOURNAL = "explain.jsonl"
FITS = "fits"
"""In the folder of an explanation, a result for each fit that it made."""


class Kept(AbstractFits):
    """Fits that end with a budget, are told, and are kept in a folder, if there is one.

    The journal has a line for each thing that was computed, in order; where it holds what is asked
    for next, that is taken. The same steps follow, because each depends on those before alone. One
    with another head is of something else, and begins again; `asked` may differ, and is that of the
    journal where it is None.
    """

    def __init__(
        self,
        folder: Path | None,
        head: dict[str, Any],
        asked: dict[str, int | None],
        budget: Budget | None,
        say: Any,
    ) -> None:
        self.folder, self.budget, self.say = folder, budget, say or (lambda sentence: None)
        self.lines: list[dict[str, Any]] = []
        self.at = 1
        first = plain_data({"giajax_explain": 1, **head})
        if folder is not None:
            make_folder(folder / FITS)
            self.lines = _read(folder / JOURNAL)
        if not (self.lines and {**self.lines[0], **first} == self.lines[0]):
            self.lines = [first]
        self.lines[0] |= {name: value for name, value in asked.items() if value is not None}
        damaged = f"{JOURNAL if folder is None else folder / JOURNAL} is damaged"
        for line in self.lines[1:]:
            from_plain(_Line, line, damaged, _REMEDY)
        before = {name: self.lines[0].get(name) for name in asked}
        self.asked = from_plain(_Asked, before, damaged, _REMEDY)

    def _next(self, name: str) -> dict[str, Any] | None:
        if self.at < len(self.lines) and self.lines[self.at].get("name") == name:
            self.at += 1
            return self.lines[self.at - 1]
        del self.lines[self.at :]
        stop_if_asked()
        if self.is_late:
            raise _Stopped
        return None

    @property
    def is_late(self) -> bool:
        """Whether its budget is used up."""
        return self.budget is not None and self.budget.left() <= 0

    def _keep(self, line: dict[str, Any]) -> None:
        if self.folder is not None:
            self.lines.append(plain_data(line))
            text = "".join(f"{json.dumps(each)}\n" for each in self.lines)
            write_files({self.folder / JOURNAL: text.encode()}, force=True)
            self.at += 1

    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """As of `Fits`, or of the journal."""
        if (line := self._next("suspects")) is not None:
            return from_plain(Suspects, line["suspects"])
        self.say("testing fixed and omitted parameters ...")
        found = Fits().suspects(result, runs)
        self._keep({"name": "suspects", "suspects": found})
        return found

    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """As of `Fits`, or of the journal."""
        before = [self._next(change.name) for change in changes]
        found = [self._recorded(line) for line in before if line is not None]
        missing = changes[len(found) :]
        if not missing:
            return found
        for change in missing:
            self.say(f"fitting {change.name} ...")
        # What is not there by then goes on in the fits that follow.
        ended, stopped = side_by_side(result, missing, self.budget, max_iterations=_ITERATIONS)
        for change, fitted in zip(missing, ended, strict=False):
            kept, file = self._kept(fitted)
            line = {"refused": str(kept)} if isinstance(kept, InputError) else {"fit": file}
            self._keep({"name": change.name, **line})
            found.append(kept)
        if stopped:
            raise KeyboardInterrupt
        if len(ended) < len(missing):
            raise _Stopped
        return found

    def _kept(self, fitted: FitResult | InputError) -> tuple[FitResult | InputError, str]:
        """A fit as its file has it, so that what follows is the same when the journal is read."""
        if self.folder is None or isinstance(fitted, InputError):
            return fitted, ""
        file = f"{len(list((self.folder / FITS).glob('*.json'))):03d}.json"
        path = self.folder / FITS / file
        write_files({path: fitted.to_json().encode()}, force=True)
        try:
            return load_result(path), file
        except InputError as error:  # It ended where no file may have its parameters.
            return error, file

    def _recorded(self, line: dict[str, Any]) -> FitResult | InputError:
        """A fit of the journal, or why there is none."""
        if line.get("refused") is not None:
            return InputError(line["refused"])
        assert self.folder is not None
        return load_result(self.folder / FITS / line["fit"])


_REMEDY = "remove it, and run giajax explain again"


@dataclasses.dataclass(frozen=True)
class _Asked:
    tries: int | None
    max_steps: int | None

    def __post_init__(self) -> None:
        if self.tries is not None and self.tries < 1:
            raise ValueError("states fewer than 1 suspect to try at each step")


@dataclasses.dataclass(frozen=True)
class _Line:
    """What was computed: the suspects, or a fit by the name of its file, or why there is none."""

    name: str
    suspects: Suspects | None = None
    fit: str | None = None
    refused: str | None = None

    def __post_init__(self) -> None:
        said = [self.suspects is not None, self.fit is not None, self.refused is not None]
        if sum(said) != 1 or said[0] != (self.name == "suspects"):
            raise ValueError("is not a valid line of this journal")
        if self.fit is not None and re.fullmatch(r"[0-9]+\.json", self.fit) is None:
            raise ValueError("does not name the file of a fit")


def _read(path: Path) -> list[dict[str, Any]]:
    """The whole lines of a journal; none where there is none."""
    try:
        data = read_bytes(path, JOURNAL_BYTES)
    except FileNotFoundError:
        return []
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): make it readable") from None
    try:
        lines = [parse_json(line.decode(), path) for line in data.splitlines()]
    except InputError:
        raise
    except ValueError:
        raise InputError(f"{path} is damaged (it is not JSON): {_REMEDY}") from None
    return from_plain(list[dict[str, Any]], lines, f"{path} is damaged", _REMEDY)


def explain(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    validation: Sequence[Run] = (),
    held_out: Sequence[Run] = (),
    max_steps: int | None = None,
    tries: int | None = None,
    budget_s: float | None = None,
    folder: str | Path | None = None,
    say: Callable[[str], None] | None = None,
) -> Explained:
    """Grow the model of a fit until its residuals suggest nothing more that it could have.

    Step by step as `giajax.ladder`: parameters that were held or left out are freed, choices of the
    model and of recorded axes are made the other way, and what later steps make superfluous is
    taken out again. Beyond that,

    - where outliers are seen, residuals count by Huber's loss from the first step on;
    - suspects that the data can hardly distinguish are one try, and each of them is fitted;
    - where a model says that one part is to be believed rather than another (the memory of a joint
      rather than friction by rate), that one is taken if it fits nearly as well;
    - a nuisance that the data move far from what is usual is tried without its prior;
    - without validation or `held_out` the last fifth of each run is kept from all steps, to judge
      them by, where that leaves a part of each to fit. The final model is fitted to all of it, with
      the noise that the first one looked for, and where that suggests more, steps go on so.

    The errors of the final fit are conditional on its model, which these data selected. What the
    models that fit nearly as well (`NEARNESS`) say otherwise is added as the `selection_error`.

    Arguments:
        result, runs: of `giajax.fit` or `giajax.load_result`, and what was fitted, in their order.
        validation: further runs to judge the steps by.
        held_out: what was held out of the fitted runs, likewise.
        max_steps: steps at most (10, or what it was in the folder).
        tries: suspects that are fitted at each of them (3, likewise).
        budget_s: wall time after which it ends with what it has reached, s.
        folder: keep a journal and the fits there; what is there of the same explanation is not done
            again.
        say: called with a sentence on what is done next, and on each step.

    Returns:
        The record, with the final fit and its runs. After Ctrl-C it is that of the steps so far.

    Raises:
        InputError: other runs than those of the result, `tries` below 1, or a folder that cannot be
            written or has a damaged journal.
    """
    if tries is not None and tries < 1:
        raise InputError(f"the number of suspects to try at each step is {tries}: give at least 1")
    whole = matching_runs(result.runs, runs)
    apart = [*validation, *held_out]
    fitted, partly = (whole, result) if apart else _without_last(whole, result, apart)
    home = None if folder is None else Path(folder)
    head = {
        "giajax": version("giajax"),
        "fit": fit_key(result),
        "apart": [run.sha256 for run in apart],
    }
    said = {"tries": tries, "max_steps": max_steps}
    kept = Kept(home, head, said, None if budget_s is None else Budget(budget_s), say)
    tries = TRIES if kept.asked.tries is None else kept.asked.tries
    max_steps = _STEPS if kept.asked.max_steps is None else kept.asked.max_steps
    climb = Climb(fitted, apart, kept)
    climb.progress = _Told(climb, kept.say, max_steps).step
    chosen = functools.partial(_chosen, tries)
    outliers, left = 0, max_steps

    def grow(begin: tuple[FitResult, Sequence[Run]] | None = None) -> Ended:
        nonlocal left
        while left:
            end = climb.step(tries + _MEMBERS, chosen, _preferred, begin)
            if end and begin is not None:
                end = climb.step(tries + _MEMBERS, chosen, _preferred)
            if end:
                return "selected"
            begin, left = None, left - 1
        climb.ending = f"the limit of {max_steps} steps was reached"
        return "steps"

    def first() -> Ended:
        nonlocal outliers
        if result.status == "interrupted":
            raise KeyboardInterrupt
        try:
            begun = kept.refit("the first model", partly, fitted)
        except InputError:  # It cannot be evaluated where the fit ended.
            if not result.history:
                raise
            start = result.history[0].parameters
            begun = kept.refit("the first model from its start", partly, fitted, start=start)
        one = Measured.of(begun, fitted, apart)
        outliers = sum(int(np.sum(found)) for found in outlying(one.at))
        if outliers and result.loss.is_linear:
            kept.say(f"{outliers} outliers were found: the loss is now {ROBUST}")
            begun = kept.refit(
                f"the first model with the loss {ROBUST}", begun, fitted, loss=ROBUST
            )
            one = Measured.of(begun, fitted, apart)
        climb.take(one)
        # White noise may lead a wrong model astray, to where what is missing acts no more.
        moved = _moved(result, one.result) and not outliers
        return grow((partly, whole) if moved else None)

    ended = _ended(climb, first)
    if not climb.taken:
        climb.take(Measured.of(result, fitted, apart))
    judges = len(validation), len(held_out)

    def finished(ended: Ended) -> tuple[_Final, Ended]:
        final = _final(result, climb, whole, kept, judges, ended == "interrupted")
        if ended == "selected" and final.stopped is not None:
            # All of the data may have asked for more.
            ended, climb.ending = final.stopped, _STOPPED[final.stopped]
        return final, ended

    final, ended = finished(ended)
    if ended == "selected" and partly is not result and _asks(final.result):

        def further() -> Ended:
            # Without what was kept from the steps before.
            config = {**final.result.config, "runs": result.config.get("runs", [])}
            by_all = dataclasses.replace(final.result, config=config)
            begun = kept.refit("the selected model with white noise", by_all, final.runs)
            climb.runs, climb.apart = final.runs, []
            climb.take(Measured.of(begun, final.runs, []))
            return grow()

        before = dataclasses.replace(
            climb, taken=[*climb.taken], asked=[*climb.asked], passed=[*climb.passed]
        )
        grown = _ended(climb, further)
        if len(climb.taken) > len(before.taken) + 1:
            final, ended = finished(grown)
        else:  # Nothing made it better.
            if grown in (*_STOPPED, "steps"):
                ended, before.ending = grown, climb.ending
            climb = before
    if not apart:
        climb.ending += "; no data could be held out to validate the steps"
    last = final.result
    record = _record(result, climb, last, ended, outliers)
    if len(record.steps) > 1 or last.loss != result.loss:
        sentence = (
            "the model was selected with these data: standard errors are conditional on it, and "
            "explain.json adds the spread over models that fit nearly as well (selection_error)"
        )
        last = dataclasses.replace(last, conditions=(*last.conditions, sentence))
    return Explained(record, last, final.runs)


def _ended(climb: Climb, grow: Callable[[], Ended]) -> Ended:
    """How growing ended, of which the climb has the sentence."""
    try:
        return grow()
    except KeyboardInterrupt:
        climb.ending = _STOPPED["interrupted"]
        return "interrupted"
    except _Stopped:
        climb.ending = _STOPPED["budget"]
        return "budget"
    except InputError as error:
        climb.ending = str(error)
        return "failed"


_STOPPED: dict[Ended, str] = {
    "interrupted": "interrupted: this is the result so far",
    "budget": "the time budget was exhausted: this is the result so far",
}


def _asks(final: FitResult) -> bool:
    """Whether the final fit is not adequate for something that could be fitted."""
    return final.verdict.status != "adequate" and any(
        is_one(final.model, row) for row in significant(final.suspects)
    )


def _without_last(
    whole: list[Run], result: FitResult, apart: list[Run]
) -> tuple[list[Run], FitResult]:
    """The runs without their last fifth, which comes `apart`, and the result as of these.

    As they are where a run has no value in one of its parts, as a window has, or is called `last`.
    """
    try:
        parts = hold_out(whole, ["last"])
    except InputError:
        return whole, result
    fitted = [part.fitted for part in parts if part.fitted is not None]
    if len(fitted) < len(parts):
        return whole, result
    several = [
        {**about, "held_from": {**about.get("held_from", {}), **part.held_from}}
        for part, about in zip(parts, result.config.get("runs", [{}] * len(parts)), strict=True)
    ]
    apart += [part.held for part in parts if part.held is not None]
    return fitted, dataclasses.replace(result, config={**result.config, "runs": several})


def _moved(result: FitResult, other: FitResult) -> bool:
    """Whether a parameter that was asked for is elsewhere, by more than its standard error."""
    return any(
        abs(float(one.value) - float(other.free[path].value)) > (one.standard_error or 0.0)
        for path, one in result.free.items()
        if path in result.asked
    )


class _Told:
    """Sentences on steps, and on how long the others may take."""

    def __init__(self, climb: Climb, say: Callable[[str], None], most: int) -> None:
        self.climb, self.say, self.most, self.clock = climb, say, most, Budget(0.0)

    def step(self, step: Step) -> None:
        """A fit was taken."""
        done = sum(fit.suspect is not None for fit in self.climb.taken)
        taken = -self.clock.left()
        self.clock = Budget(0.0)
        name = f"step {done}: {step.change}"
        if step.suspect is None:
            done, name = 0, ALL if len(self.climb.taken) > 1 else "the first model"
        reduced = step.chi_square / max(step.values - step.parameters, 1)
        left = time_in_words(taken * max(self.most - done, 0))
        more = (
            f"; at most about {left} remaining, less if no suspect is significant" if done else ""
        )
        self.say(f"{name}: chi-square {step.chi_square:.5g} ({reduced:.3g} per value){more}")


def _chosen(tries: int, result: FitResult, found: Suspects) -> list[Suspect]:
    """What is fitted next: so many suspects, each with those that are alike."""
    rows = {row.path: row for row in reversed(found.rows) if is_one(result.model, row)}
    rather = capabilities.rather(result.model)
    # The first of each group, with what is likelier than it, before those that are alike.
    first: list[str] = []
    alike: list[str] = []
    groups = 0
    for suspect in found.significant:
        path = suspect.path
        if groups == tries or path not in rows or path in (*first, *alike):
            continue
        groups += 1
        likelier = rather.get(path.partition("[")[0])
        first += [path, *([likelier] if likelier in rows else [])]
        alike += [one for one in (*suspect.together, *suspect.alike) if one in rows][:_MEMBERS]
    # What is usual of a camera is given up last: it may make up for anything.
    return [rows[path] for path in dict.fromkeys((*first, *alike))] or _against_priors(result)


def _against_priors(result: FitResult) -> list[Suspect]:
    """Nuisances that the data move far from what is known of them before."""
    priors = FitSettings.shared_with(result.config).priors
    far = []
    for path in result.nuisances:
        prior, estimate = priors.get(path), result.free.get(path)
        if prior is None or prior.deviation is None or estimate is None:
            continue
        pull = abs(float(estimate.value) - prior.value) / prior.deviation
        if pull > _AGAINST:
            row = Suspect(
                path, "prior", estimate.unit, prior.value, None, None, pull**2, 1, None, True
            )
            far.append(row)
    return far


def _preferred(made: Sequence[Tried]) -> Tried:
    """The fit of the lowest BIC, or one nearly as low of what is rather to be believed."""
    best, _, _ = of_best = best_of(made)
    assert best.suspect is not None
    name = capabilities.rather(best.result.model).get(best.suspect.path.partition("[")[0])
    limit = best.step(best.noise).bic + NEARNESS
    rather = [each for each in made if each[0].suspect is not None and each[0].suspect.path == name]
    return next((each for each in rather if each[0].step(best.noise).bic < limit), of_best)


class _Final(NamedTuple):
    """A last fit with its runs, and what kept it from its end, if anything did."""

    result: FitResult
    runs: list[Run]
    stopped: Ended | None


def _final(
    result: FitResult,
    climb: Climb,
    whole: list[Run],
    kept: Kept,
    judges: tuple[int, int],
    interrupted: bool,
) -> _Final:
    """The last fit, of the whole runs and with the noise asked for.

    Where that cannot be, it is the fit of the last step, and says so.
    """
    changes = [fit.suspect.path for fit in climb.taken if fit.suspect is not None]
    seen = whole
    for change in changes:
        for mistake in [each for each in mistakes_of(result.model, seen) if each.name == change]:
            seen = [mistake.undone(run) for run in seen]
    if seen is not whole and kept.folder is not None:
        # Other commands read them again.
        seen = _written(seen, kept.folder / FITS / "runs")
    last, runs = climb.last.result, seen
    stopped: Ended | None = "interrupted" if interrupted else None
    if not changes and last.loss == result.loss:
        last = result
    else:
        # Axes may have made files of their own.
        records = tuple(
            dataclasses.replace(record, path=_file(run), sha256=run.sha256)
            for record, run in zip(last.runs, seen, strict=True)
        )
        last = dataclasses.replace(last, runs=records)
        again = None
        if stopped is None and kept.is_late:
            stopped = "budget"
        if stopped is None:
            # Without what was kept from the steps alone.
            config = {**last.config, "runs": result.config.get("runs", [])}
            try:
                kept.say("fitting the selected model to all of the data ...")
                again = refit(
                    dataclasses.replace(last, config=config),
                    seen,
                    noise_model=result.config.get("noise_model", "correlated"),
                    budget=kept.budget,
                    progress=stop_if_asked,
                    check=True,
                )
                stopped = next((one for one in _STOPPED if one == again.reason), None)
            except InputError:  # It cannot be evaluated a little inside of its bounds.
                pass
            except KeyboardInterrupt:
                stopped = "interrupted"
        if again is not None and again.status == "converged":
            last = again
        else:
            runs = [
                dataclasses.replace(part, path=run.path, sha256=run.sha256)
                for part, run in zip(climb.runs, seen, strict=True)
            ]
            sentence = (
                "this is the fit of the last step, with white noise and without the held-out data: "
                "the final fit did not finish"
            )
            last = dataclasses.replace(last, conditions=(*last.conditions, sentence))
        last = _judged(last, result, climb.apart, *judges)
    known = climb.asked[-1]
    # What was asked already is not asked again where no time is left.
    if stopped != "interrupted" and not (kept.is_late and known is not None):
        try:
            kept.say("testing fixed and omitted parameters of the selected model ...")
            return _Final(with_suspects(last, runs), seen, stopped)
        except KeyboardInterrupt:
            stopped = "interrupted"
        except Exception as error:  # A test that fails loses no fit.
            kept.say(
                f"fixed and omitted parameters of the selected model could not be tested ({error})"
            )
    if known is not None:
        last = dataclasses.replace(last, suspects=known.rows, verdict=known.judge(last))
    return _Final(last, seen, stopped)


def _judged(
    final: FitResult, result: FitResult, apart: Sequence[Run], validation: int, held: int
) -> FitResult:
    """With how well it predicts what the first fit was judged by, and doubts that this stated."""
    config, records = dict(final.config), []
    for run in apart[validation : validation + held]:
        errors = errors_of(run, final.predict(with_fitted_state(final, run))).channels
        channels = {name: HeldChannel(e.unit, e.rmse, e.n, None) for name, e in errors.items()}
        records.append(HeldOut(run.name, _file(run), run.sha256, channels))
    if records and "hold_out" in result.config:
        config["hold_out"] = result.config["hold_out"]
    free = {path.partition("[")[0] for path in final.free}
    doubts = result.config.get("uncertainty", {}).items()
    if held_still := {path: one for path, one in doubts if path.partition("[")[0] not in free}:
        config["uncertainty"] = held_still
    return dataclasses.replace(
        final,
        config=config,
        held_out=tuple(records),
        validation=tuple(prediction_errors(final.model, run) for run in apart[:validation]),
    )


def _file(run: Run) -> str | None:
    return None if run.path is None else str(run.path)


def _written(runs: Sequence[Run], folder: Path) -> list[Run]:
    """The runs, each read from a file of its own in a folder that no other process writes to."""
    make_folder(folder)
    read = []
    for run, name in zip(runs, unique_names(runs), strict=True):
        path = folder / f"{name}.csv"
        write_run(path, run.times, run.values, definition=run.definition, digits=17, force=True)
        read.append(dataclasses.replace(read_run(path), name=run.name, observed=run.observed))
    return read


def _record(
    result: FitResult, climb: Climb, final: FitResult, ended: Any, outliers: int
) -> Explanation:
    noise = climb.last.noise

    def row(step: Step, taken: bool) -> ExplainedStep:
        suspect = step.suspect
        further = suspect is None and step.result is not climb.taken[0].result
        return ExplainedStep(
            change=ALL if further else step.change,
            kind="data" if further else "start" if suspect is None else suspect.kind,
            taken=taken,
            p_value=None if suspect is None or step.removed else suspect.p_value,
            chi_square=step.chi_square,
            parameters=step.parameters,
            values=step.values,
            bic=step.bic,
            held_out=step.held_out,
            estimates={
                path: (float(one.value), one.standard_error)
                for path, one in step.result.free.items()
                if path in result.asked
            },
        )

    steps = [row(step, True) for step in climb.steps()]
    tried = [row(fit.step(noise), False) for fit in climb.passed]
    near = [i for i, one in enumerate(tried) if behind(steps, one)[0] < NEARNESS]
    models = [(0.0, steps[-1], steps[-1]), *((*behind(steps, tried[i]), tried[i]) for i in near)]
    parameters = []
    for path in steps[-1].estimates:
        having = [each for each in models if all(path in one.estimates for one in each[1:])]
        weights = np.exp(-np.maximum([each[0] for each in having], 0.0) / 2)
        apart = np.array([b.estimates[path][0] - a.estimates[path][0] for _, a, b in having])
        selection = float(np.sqrt(np.sum(weights * apart**2) / np.sum(weights)))
        one = final.parameters[path]
        error = one.standard_error
        parameters.append(
            ExplainedParameter(
                path=path,
                unit=one.unit,
                value=float(one.value),
                standard_error=error,
                selection_error=selection,
                spread=float(np.ptp(apart)),
                total_error=None if error is None else float(np.hypot(error, selection)),
            )
        )
    return Explanation(
        fit=fit_key(final),
        ended=ended,
        ending=climb.ending,
        status=final.status,
        verdict=final.verdict.status,
        sentences=tuple(reason.sentence for reason in final.verdict.reasons),
        loss=str(final.config.get("loss", "linear")),
        outliers=outliers,
        steps=tuple(steps),
        tried=tuple(tried),
        near=tuple(near),
        nearness=NEARNESS,
        parameters=tuple(parameters),
        axes=any(step.kind in ("axes", "columns") for step in steps),
    )
