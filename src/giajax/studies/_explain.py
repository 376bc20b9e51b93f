"""Automatic extension of a model until its residuals suggest no further effect, with a journal."""

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
    fitted_parts,
    held_parts,
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
"""Largest BIC difference from the selected model for a model that fits nearly as well as it.

This difference corresponds to odds of 1 to 20.
"""

ROBUST = "huber"
"""Loss used if outliers are found.

Other losses would treat the misfit of a wrong model as outliers.
"""

# Maximum number of steps. Five omitted effects, three of which are at first mistaken for others,
# require this many.
_STEPS = 10
_ITERATIONS = 30  # maximum number of iterations of a step
_MEMBERS = 2  # members of a group that are tried in addition to the first
# Difference between a nuisance and its prior value, in standard deviations of the prior, above
# which the prior is dropped.
_AGAINST = 3.0


@dataclasses.dataclass(frozen=True)
class Explained:
    """An explanation, its final fit, and the runs as the final fit uses them."""

    record: Explanation
    result: FitResult
    runs: list[Run]


class _Stopped(Exception):  # noqa: N818
    """The time budget is exhausted, or Ctrl-C was pressed."""


JOURNAL = "explain.jsonl"
FITS = "fits"
"""Subfolder of an explanation that contains the result of each of its fits."""


class Kept(AbstractFits):
    """Fits that observe a time budget, are reported, and are stored in a folder, if one is given.

    The journal has one line per computed item, in order. If the next line of the journal contains
    the requested item, it is used instead of a new computation. The steps are reproduced, because
    each step depends only on the steps before it. A journal with a different head belongs to
    another explanation and is started again. `asked` may differ from the journal; values that are
    None are taken from the journal.
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
        """Whether the time budget is exhausted."""
        return self.budget is not None and self.budget.left() <= 0

    def _keep(self, line: dict[str, Any]) -> None:
        if self.folder is not None:
            self.lines.append(plain_data(line))
            text = "".join(f"{json.dumps(each)}\n" for each in self.lines)
            write_files({self.folder / JOURNAL: text.encode()}, force=True)
            self.at += 1

    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """Return the suspects, as for `Fits`, or from the journal."""
        if (line := self._next("suspects")) is not None:
            return from_plain(Suspects, line["suspects"])
        self.say("testing fixed and omitted parameters ...")
        found = Fits().suspects(result, runs)
        self._keep({"name": "suspects", "suspects": found})
        return found

    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """Return the fits, as for `Fits`, or from the journal."""
        before = [self._next(change.name) for change in changes]
        found = [self._recorded(line) for line in before if line is not None]
        missing = changes[len(found) :]
        if not missing:
            return found
        for change in missing:
            self.say(f"fitting {change.name} ...")
        # Changes that are not in the journal are fitted.
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
        """Return a fit as its file contains it.

        The steps are then the same when the journal is read.
        """
        if self.folder is None or isinstance(fitted, InputError):
            return fitted, ""
        file = f"{len(list((self.folder / FITS).glob('*.json'))):03d}.json"
        path = self.folder / FITS / file
        write_files({path: fitted.to_json().encode()}, force=True)
        try:
            return load_result(path), file
        except InputError as error:  # It ended at parameters that no file may contain.
            return error, file

    def _recorded(self, line: dict[str, Any]) -> FitResult | InputError:
        """Return a fit from the journal, or the reason why it failed."""
        if line.get("refused") is not None:
            return InputError(line["refused"])
        assert self.folder is not None
        return load_result(self.folder / FITS / line["fit"])


_REMEDY = "remove it, and run 'giajax explain' again"


@dataclasses.dataclass(frozen=True)
class _Asked:
    tries: int | None
    max_steps: int | None

    def __post_init__(self) -> None:
        if self.tries is not None and self.tries < 1:
            raise ValueError("specifies fewer than 1 suspect to try at each step")


@dataclasses.dataclass(frozen=True)
class _Line:
    """One computed item: the suspects, the file name of a fit, or the reason why a fit failed."""

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
    """Return the lines of a journal; an empty list if there is no journal."""
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
    """Extend the model of a fit until its residuals suggest no further effect.

    The model is extended step by step as in `giajax.ladder`: fixed or omitted parameters are freed,
    choices of the model and of the recorded axes are changed, and parameters that later steps make
    superfluous are removed again. In addition,

    - if outliers are found, Huber's loss is used from the first step on;
    - suspects that the data can hardly distinguish count as one try, and each of them is fitted;
    - if a model states that one part is more plausible than another (for example the hysteresis of
      a joint rather than viscous friction), the more plausible one is selected if it fits nearly as
      well;
    - a nuisance parameter that the data move far from its usual value is tried without its prior;
    - without `validation` or `held_out`, the last fifth of each run is held out from all steps for
      validation, if this leaves data of each run to fit. The final model is fitted to all data,
      with the noise model of the first fit. If the residuals of this fit suggest more, further
      steps use all data.

    The standard errors of the final fit are conditional on its model, which was selected with these
    data. The spread of the estimates over models that fit nearly as well (`NEARNESS`) is added as
    the `selection_error`.

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        validation: further runs for validation of the steps.
        held_out: held-out parts of the fitted runs, also for validation.
        max_steps: maximum number of steps; defaults to 10, or to the value in the folder.
        tries: number of suspects that are fitted at each step; defaults to 3, or to the value in
            the folder.
        budget_s: wall time after which the result so far is returned, s.
        folder: folder for a journal and the fits; items of the same explanation that are already
            there are not computed again.
        say: function that is called with a sentence on the next computation and on each step.

    Returns:
        The record, the final fit and its runs. After Ctrl-C, the record of the steps so far.

    Raises:
        InputError: the runs do not match the result; `tries` is below 1; or the folder cannot
            be written or contains a damaged journal.
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
        except InputError:  # The model cannot be evaluated at the end of the fit.
            if not result.history:
                raise
            start = result.history[0].parameters
            begun = kept.refit("the first model from its start", partly, fitted, start=start)
        one = Measured.of(begun, fitted, apart)
        outliers = sum(int(np.sum(found)) for found in outlying(one.at))
        if outliers and result.loss.is_linear:
            kept.say(
                f"{outliers} outliers were found, so the fit is repeated with the loss {ROBUST}"
            )
            begun = kept.refit(
                f"the first model with the loss {ROBUST}", begun, fitted, loss=ROBUST
            )
            one = Measured.of(begun, fitted, apart)
        climb.take(one)
        # With white noise, a wrong model may move to parameters at which the omitted effect has no
        # influence.
        moved = _moved(result, one.result) and not outliers
        return grow((partly, whole) if moved else None)

    ended = _ended(climb, first)
    if not climb.taken:
        climb.take(Measured.of(result, fitted, apart))
    judges = len(validation), len(held_out)

    def finished(ended: Ended) -> tuple[_Final, Ended]:
        final = _final(result, climb, whole, kept, judges, ended == "interrupted")
        if ended == "selected" and final.stopped is not None:
            # The fit to all of the data may suggest more.
            ended, climb.ending = final.stopped, _STOPPED[final.stopped]
        return final, ended

    final, ended = finished(ended)
    if ended == "selected" and partly is not result and _asks(final.result):

        def further() -> Ended:
            # The data that were held out from the earlier steps are included.
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
        else:  # No further step improved the fit.
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
            "explain.json also contains the spread over models that fit nearly as well as this one "
            "(selection_error)"
        )
        last = dataclasses.replace(last, conditions=(*last.conditions, sentence))
    return Explained(record, last, final.runs)


def _ended(climb: Climb, grow: Callable[[], Ended]) -> Ended:
    """Run the selection and return how it ended; the climb receives the corresponding sentence."""
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
    """Return whether the final fit is not adequate but a suspect could still be fitted."""
    return final.verdict.status != "adequate" and any(
        is_one(final.model, row) for row in significant(final.suspects)
    )


def _without_last(
    whole: list[Run], result: FitResult, apart: list[Run]
) -> tuple[list[Run], FitResult]:
    """Return the runs without their last fifth, and the result with the times of the cuts.

    The last fifths are appended to `apart`. The runs are returned unchanged if a run has no values
    in one of its parts, for example because of a window, or if a run is named `last`.
    """
    try:
        parts = hold_out(whole, ["last"])
    except InputError:
        return whole, result
    fitted = fitted_parts(parts)
    if len(fitted) < len(parts):
        return whole, result
    several = [
        {**about, "held_from": {**about.get("held_from", {}), **part.held_from}}
        for part, about in zip(parts, result.config.get("runs", [{}] * len(parts)), strict=True)
    ]
    apart += held_parts(parts)
    return fitted, dataclasses.replace(result, config={**result.config, "runs": several})


def _moved(result: FitResult, other: FitResult) -> bool:
    """Return whether a requested parameter differs by more than its standard error."""
    return any(
        abs(float(one.value) - float(other.free[path].value)) > (one.standard_error or 0.0)
        for path, one in result.free.items()
        if path in result.asked
    )


class _Told:
    """Reports on the steps and on the remaining time."""

    def __init__(self, climb: Climb, say: Callable[[str], None], most: int) -> None:
        self.climb, self.say, self.most, self.clock = climb, say, most, Budget(0.0)

    def step(self, step: Step) -> None:
        """Report a fit that was accepted."""
        done = sum(fit.suspect is not None for fit in self.climb.taken)
        taken = -self.clock.left()
        self.clock = Budget(0.0)
        name = f"step {done}: {step.change}"
        if step.suspect is None:
            done, name = 0, ALL if len(self.climb.taken) > 1 else "the first model"
        reduced = step.chi_square / max(step.values - step.parameters, 1)
        left = time_in_words(taken * max(self.most - done, 0))
        more = (
            f"; about {left} remaining, or less if no further suspect is significant"
            if done
            else ""
        )
        self.say(f"{name}: chi-square {step.chi_square:.5g} ({reduced:.3g} per value){more}")


def _chosen(tries: int, result: FitResult, found: Suspects) -> list[Suspect]:
    """Return the suspects to be fitted next: the first `tries`, each with similar ones."""
    rows = {row.path: row for row in reversed(found.rows) if is_one(result.model, row)}
    rather = capabilities.rather(result.model)
    # The first suspect of each group and its more plausible alternative come before the
    # indistinguishable ones.
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
    # Priors, for example of a camera, are dropped last, because a free nuisance may compensate for
    # any effect.
    return [rows[path] for path in dict.fromkeys((*first, *alike))] or _against_priors(result)


def _against_priors(result: FitResult) -> list[Suspect]:
    """Return the nuisance parameters that the data move far from their prior values."""
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
    """Return the fit with the lowest BIC, or a more plausible one whose BIC is nearly as low."""
    best, _, _ = of_best = best_of(made)
    assert best.suspect is not None
    name = capabilities.rather(best.result.model).get(best.suspect.path.partition("[")[0])
    limit = best.step(best.noise).bic + NEARNESS
    rather = [each for each in made if each[0].suspect is not None and each[0].suspect.path == name]
    return next((each for each in rather if each[0].step(best.noise).bic < limit), of_best)


class _Final(NamedTuple):
    """Final fit with its runs, and the reason why it did not finish, if any."""

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
    """Return the final fit, to the whole runs and with the requested noise model.

    If this fit fails, the fit of the last step is returned with a sentence that says so.
    """
    changes = [fit.suspect.path for fit in climb.taken if fit.suspect is not None]
    seen = whole
    for change in changes:
        for mistake in [each for each in mistakes_of(result.model, seen) if each.name == change]:
            seen = [mistake.undone(run) for run in seen]
    if seen is not whole and kept.folder is not None:
        # The runs are written to files because other commands read them again.
        seen = _written(seen, kept.folder / FITS / "runs")
    last, runs = climb.last.result, seen
    stopped: Ended | None = "interrupted" if interrupted else None
    if not changes and last.loss == result.loss:
        last = result
    else:
        # Runs whose axes were corrected have files of their own.
        records = tuple(
            dataclasses.replace(record, path=_file(run), sha256=run.sha256)
            for record, run in zip(last.runs, seen, strict=True)
        )
        last = dataclasses.replace(last, runs=records)
        again = None
        if stopped is None and kept.is_late:
            stopped = "budget"
        if stopped is None:
            # The data that were held out only from the steps are included.
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
            except InputError:  # It cannot be evaluated just inside its bounds.
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
    # Without time for another test, the results of an earlier test are used.
    if stopped != "interrupted" and not (kept.is_late and known is not None):
        try:
            kept.say("testing fixed and omitted parameters of the selected model ...")
            return _Final(with_suspects(last, runs), seen, stopped)
        except KeyboardInterrupt:
            stopped = "interrupted"
        except Exception as error:  # A failed test must not lose the fit.
            kept.say(
                f"fixed and omitted parameters of the selected model could not be tested ({error})"
            )
    if known is not None:
        last = dataclasses.replace(last, suspects=known.rows, verdict=known.judge(last))
    return _Final(last, seen, stopped)


def _judged(
    final: FitResult, result: FitResult, apart: Sequence[Run], validation: int, held: int
) -> FitResult:
    """Add the prediction errors on validation data, and given uncertainties of fixed values."""
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
    """Write each run to a file in a folder used only by this process, and read it from there."""
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
