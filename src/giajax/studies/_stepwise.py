"""Stepwise selection: refit with the effects that the residuals suggest, one at a time."""

import abc
import contextlib
import dataclasses
import functools
import itertools
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Self

import numpy as np

from ..fitting import Budget, FitResult, Response, Suspect, in_full, matching_runs
from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, PriorEntry, Run
from ..runtime.aliases import warn_of_name
from ..runtime.parallel import Tell, run_in_threads
from ..runtime.process import cores, stop_if_asked
from ..runtime.programs import forget_programs_if_many
from ..runtime.text import InputError
from ..schema.parameters import declared, elements, get, left_out
from ._columns import mistakes_of
from ._refit import refit, with_fitted_state
from ._score import Coordinates, responses_of, white_noise
from ._suspects import Suspects, suspects


@dataclasses.dataclass(frozen=True)
class Step:
    """One fit of a stepwise selection.

    Attributes:
        suspect: effect that was added to the previous fit; None for the first fit.
        chi_square: sum of the loss of the residuals divided by the white noise, which is the same
            for all steps, plus the squares of the priors.
        parameters: number of fitted parameters.
        values: number of measured values.
        held_out: root mean square error of the held-out runs, divided by their noise or, if none is
            stated, by the white noise of the fitted runs; None without held-out runs.
        result: result of the fit.
        suspects: effects that the residuals of the fit suggest; None if they were not tested.
        removed: whether the suspect was removed again because it is not significant together with
            later ones.
    """

    suspect: Suspect | None
    chi_square: float
    parameters: int
    values: int
    held_out: float | None
    result: FitResult
    suspects: Suspects | None = None
    removed: bool = False

    @property
    def change(self) -> str:
        """The change: a path, `without` a path, or "-" for the first fit."""
        if self.suspect is None:
            return "-"
        if self.suspect.kind == "prior":
            return f"{self.suspect.path} without its prior"
        return f"without {self.suspect.path}" if self.removed else self.suspect.path

    @property
    def aic(self) -> float:
        """Akaike's information criterion with known noise: chi-square + 2 k."""
        return self.chi_square + 2 * self.parameters

    @property
    def bic(self) -> float:
        """Schwarz's (Bayesian) information criterion with known noise: chi-square + k log n."""
        return self.chi_square + self.parameters * float(np.log(self.values))


@dataclasses.dataclass(frozen=True)
class StepwiseSelection:
    """The accepted fits of a selection, and the reason why it ended.

    Attributes:
        steps: accepted fits; the first is the initial fit.
        ending: one sentence on the reason.
    """

    steps: tuple[Step, ...]
    ending: str

    @property
    def result(self) -> FitResult:
        """Result of the last fit."""
        return self.steps[-1].result

    @property
    def rungs(self) -> tuple[Step, ...]:
        """The steps, under their earlier name."""
        warn_of_name("StepwiseSelection.rungs", "steps")
        return self.steps


Noise = Sequence[Mapping[str, float]]
"""Standard deviation of white noise (SI) of each run, by channel."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """A fit and its residuals, for a comparison with other fits under the same noise.

    Minus twice the log-likelihood is, up to a constant, the sum of the loss of each residual
    divided by its noise. This noise must be the same for all compared fits, because a fit that
    describes less of the data attributes more of it to noise or outliers.

    Attributes:
        suspect: effect that was added or removed; None for the first fit.
        removed: whether the effect was removed.
        result: result of the fit.
        at: predictions of the fit for each run.
        noise: white noise, as stated or as estimated from the residuals.
        coordinates: coordinates of the fit.
        apart: name, stated noise and errors of each held-out channel.
    """

    suspect: Suspect | None
    removed: bool
    result: FitResult
    at: list[Response]
    noise: Noise
    coordinates: Coordinates
    apart: list[tuple[str, float | None, np.ndarray]]

    @classmethod
    def of(
        cls,
        result: FitResult,
        runs: Sequence[Run],
        apart: Sequence[Run],
        suspect: Suspect | None = None,
        *,
        removed: bool = False,
    ) -> Self:
        """Evaluate a fit on its runs and on the held-out runs."""
        at = responses_of(result, runs, result.model)
        noise = white_noise(result, runs, at)
        errors = []
        for run in apart:
            for name, predicted in result.predict(with_fitted_state(result, run)).items():
                rest = predicted - run.observations[name]
                errors.append((name, run.noise(name), rest[~np.isnan(rest)]))
        return cls(suspect, removed, result, at, noise, Coordinates.of(result), errors)

    def step(self, noise: Noise) -> Step:
        """Return the fit as a step, under a noise that may have been estimated by another fit."""
        chi_square, values = self.coordinates.squares, 0
        loss = self.result.loss
        for response, deviations in zip(self.at, noise, strict=True):
            sigma = [_deviation(deviations, name) for name in response.channels]
            rest = (response.predicted - response.observed) / np.asarray(sigma)
            rest = rest[~np.isnan(response.observed)]
            chi_square += float(np.sum(loss.scores(rest).rho))
            values += len(rest)
        squares = []
        for name, stated, rest in self.apart:
            # Without a stated noise, the noise of a fitted run with this channel is used, otherwise
            # the noise of the first run.
            nearest = next((of_run for of_run in noise if name in of_run), noise[0])
            squares.append((rest / (stated or _deviation(nearest, name))) ** 2)
        return Step(
            suspect=self.suspect,
            chi_square=chi_square,
            parameters=self.coordinates.size,
            values=values,
            held_out=float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None,
            result=self.result,
            removed=self.removed,
        )


def _deviation(deviations: Mapping[str, float], name: str) -> float:
    """Return the noise of a channel; for a channel with another name, the mean over its kind."""
    if known := deviations.get(name):
        return known
    kind = name.rpartition("_")[0]
    alike = [one for other, one in deviations.items() if other.rpartition("_")[0] == kind]
    return float(np.mean(alike or list(deviations.values())))


@dataclasses.dataclass(frozen=True)
class Change:
    """Changes for a refit, as for `refit`, and the runs after a correction of their columns.

    Attributes:
        name: name that is reported.
        runs: runs to be fitted.
        changed: changed arguments of `refit`.
        apart: held-out runs, with the same corrections.
    """

    name: str
    runs: Sequence[Run]
    changed: Mapping[str, Any]
    apart: Sequence[Run] = ()


class AbstractFits(abc.ABC):
    """Computations of a selection, under names that are reported and stored in a journal."""

    @abc.abstractmethod
    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """Return the effects that the residuals of a fit suggest."""

    @abc.abstractmethod
    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """Return refits, computed in parallel with white noise, or the reason why one failed.

        Raises:
            KeyboardInterrupt: Ctrl-C was pressed before all of them had ended.
        """

    def refit(self, name: str, result: FitResult, runs: Sequence[Run], **changed: Any) -> FitResult:
        """Return the refit of one change.

        Raises:
            InputError: the changed model cannot be evaluated.
        """
        (found,) = self.refits(result, [Change(name, runs, changed)])
        if isinstance(found, InputError):
            raise found
        return found

    def measured(self, *of: Any, removed: bool = False) -> Measured:
        """Evaluate a fit, as `Measured.of` does."""
        return Measured.of(*of, removed=removed)


class Fits(AbstractFits):
    """Computations without a journal."""

    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """Return the suspects, as from `giajax.suspects`."""
        forget_programs_if_many()
        return suspects(result, runs)

    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """Return the refits, as from `refit`."""
        ended, stopped = side_by_side(result, changes)
        if stopped:
            raise KeyboardInterrupt
        return ended


def side_by_side(
    result: FitResult, changes: Sequence[Change], budget: Budget | None = None, **limits: Any
) -> tuple[list[FitResult | InputError], bool]:
    """Refit with white noise on all cores; also return whether Ctrl-C was pressed.

    The list ends before the first refit that did not finish, because the time budget was exhausted
    or it was stopped. It contains the reason of a refit that failed.
    """
    forget_programs_if_many()
    stop = threading.Event()

    def fitted(change: Change, tell: Tell) -> FitResult | InputError | None:
        asked = {"progress": functools.partial(tell, stop_if_asked), "budget": budget, **limits}
        found = None
        try:
            # On a single core, the preceding refit may have used up the time.
            if budget is None or budget.left() > 0:
                found = refit(
                    result, change.runs, **{"noise_model": "white", **asked, **change.changed}
                )
            tell(stop_if_asked)  # Ctrl-C may have been pressed meanwhile.
        except InputError as error:
            return error
        except KeyboardInterrupt:
            stop.set()
        if found is not None and found.reason in ("interrupted", "budget"):
            if found.reason == "interrupted":
                stop.set()
            return None
        return found

    jobs = [functools.partial(fitted, change) for change in changes]
    found = run_in_threads(jobs, min(cores(), len(jobs)), until=lambda _: stop.is_set())
    ended = itertools.takewhile(lambda each: each is not None, found)
    return [each for each in ended if each is not None], stop.is_set()


Tried = tuple[Measured, list[Run], list[Run]]
"""A fit with its runs and its held-out runs."""


def tried_steps(
    result: FitResult,
    runs: Sequence[Run],
    apart: Sequence[Run],
    promising: Sequence[Suspect],
    tries: int,
    fits: AbstractFits,
    last: Measured | None = None,
) -> list[Tried]:
    """Return separate fits of the first suspects, `tries` in number, that can be fitted.

    If `last`, the last accepted fit, is given, suspects whose test promises far less than another
    fit has gained are skipped.
    """
    made: list[Tried] = []
    gained = 0.0

    def promised() -> Iterator[tuple[Suspect, Change]]:
        for suspect in promising:
            if is_one(result.model, suspect) and _FAR * (suspect.chi_square_drop or 0.0) >= gained:
                with contextlib.suppress(InputError):  # A suspect that cannot be freed is skipped.
                    yield suspect, _freeing(result, runs, apart, suspect)

    following = promised()
    while asked := list(itertools.islice(following, min(_SIDE_BY_SIDE, tries - len(made)))):
        found = fits.refits(result, [change for _, change in asked])
        for (suspect, change), fitted in zip(asked, found, strict=True):
            if isinstance(fitted, InputError):
                continue
            try:
                one = fits.measured(fitted, change.runs, change.apart, suspect)
            except InputError:  # A fit that cannot be evaluated is skipped.
                continue
            made.append((one, list(change.runs), list(change.apart)))
            if last is not None:
                gained = max(gained, last.step(one.noise).bic - one.step(one.noise).bic)
    return made


# A fixed number, so that the tried suspects do not depend on the number of cores.
_SIDE_BY_SIDE = 2

# A fit lowers chi-square more than its test promises, but rarely by more than this factor.
_FAR = 3.0


def best_of(made: Sequence[Tried]) -> Tried:
    """Return the fit with the lowest BIC."""
    noise = max((fit for fit, _, _ in made), key=lambda fit: fit.coordinates.size).noise
    return min(made, key=lambda one: one[0].step(noise).bic)


def best_step(
    result: FitResult,
    runs: Sequence[Run],
    apart: Sequence[Run],
    promising: Sequence[Suspect],
    tries: int,
) -> Tried | None:
    """Return the fit with the lowest BIC among the first suspects that can be fitted, or None."""
    made = tried_steps(result, runs, apart, promising, tries, Fits())
    return best_of(made) if made else None


def is_one(model: AbstractModel, suspect: Suspect) -> bool:
    """Return whether a fit can free a suspect in the same form as it was tested."""
    if suspect.kind in ("switch", "axes", "columns", "prior", "scatter"):
        return bool(suspect.testable)
    try:
        parts = elements(_neutrally(model, suspect.path), suspect.path)
    except InputError:  # It belongs to another choice of the model.
        return False
    return suspect.kind != "factor" and len(parts) == suspect.degrees_of_freedom


def _freeing(
    result: FitResult, runs: Sequence[Run], apart: Sequence[Run], suspect: Suspect
) -> Change:
    """Return the change of a fit that a suspect suggests."""

    def change(**changed: Any) -> Change:
        return Change(suspect.path, runs, changed, apart)

    begin: dict[str, Any] = dict(result.history[0].parameters) if suspect.begun else {}
    if suspect.kind == "prior":
        return change(priors={suspect.path: None})
    if suspect.kind == "switch":
        other = capabilities.variants(result.model)[suspect.path]
        return change(model=other, free=_switched_on(result, other, suspect), start=begin)
    if suspect.kind in ("axes", "columns"):
        mistake = next(
            each for each in mistakes_of(result.model, runs) if each.name == suspect.path
        )
        right, judges = ([mistake.undone(run) for run in each] for each in (runs, apart))
        return Change(suspect.path, right, {"start": result.history[0].parameters}, judges)
    model = _neutrally(result.model, suspect.path)
    if suspect.kind == "scatter":
        # Each element is free, with a prior whose standard deviation is the estimated scatter.
        model = in_full(model, declared(model)[suspect.path])
        size = float(np.max(np.asarray(suspect.estimate)))
        known = {each.path: float(each.value(model)) for each in elements(model, suspect.path)}
        priors = {path: PriorEntry(value=one, deviation=size) for path, one in known.items()}
        return change(model=model, free=list(priors), priors=priors, start=begin)
    assert suspect.estimate is not None
    begin[suspect.path] = suspect.estimate
    return change(model=model, free=[suspect.path], start=begin)


def _switched_on(result: FitResult, other: AbstractModel, suspect: Suspect) -> list[str]:
    """Return the parameters that a choice frees: the one that enables a part, and its guesses.

    If a guessed parameter remained fixed, other parameters could compensate for its error.
    Parameters that are specified in the fit are not changed.
    """
    by = suspect.path.partition(" = ")[0]
    if by not in declared(other):
        return []
    said = {*result.free, *result.config.get("ties", {}), *result.config.get("fix", {})}
    guesses = capabilities.freed_with(other).get(by, ())
    return [by, *(path for path in guesses if path not in said)]


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """Return the model with an omitted part switched on at its neutral value.

    If the path refers to an element, a parameter with one value for all elements is replaced by one
    value for each.
    """
    name, _, element = path.partition("[")
    absent = left_out(model).get(name)
    if absent is not None:
        model = absent.set(model, absent.declaration.neutral)
    parts = declared(model)
    return in_full(model, parts[name]) if element and name in parts else model


MOST = 6
"""Default maximum number of steps of a selection."""

TRIES = 3
"""Default number of suspects that are fitted at each step."""

# Distance, in standard errors, up to which fixing a parameter again is tried. BIC then decides.
_NEAR = 4.0


def ladder(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    most: int = MOST,
    tries: int = TRIES,
    progress: Callable[[Step], None] | None = None,
) -> StepwiseSelection:
    """Fit the most promising suspect, test the residuals again, and repeat.

    A step frees a parameter, changes a choice of the model (guessed parameters of a part are freed
    when the part is switched on) or exchanges recorded axes. Each fit starts from the end of the
    last fit, or from its initial guess if the suspects were tested there. A parameter that was
    freed before and has returned to its fixed value is fixed again. If a single drive was freed, a
    model in which all drives have the same value is also tested. The selection ends when no suspect
    is significant, or when the tried fits increase BIC. A suspect that is one value for many
    elements (for example the mass of all links) is not a single parameter of a fit and is skipped.

    The decrease of chi-square promised by a test is the decrease in the first step of a fit.
    Therefore the first `tries` suspects are fitted separately in each step, and the fit with the
    lowest BIC is accepted. With 1, a step takes a fraction of the time and relies on the test.

    All fits are compared under one likelihood: the loss of the fit, with the same white noise for
    both. Correlated noise would absorb a missing effect, to a different extent in each fit. The
    white noise is the stated noise of the runs. If none is stated, it is estimated from second
    differences of the residuals of the fit with more parameters, or, if the samples are not a time
    series, taken from the estimate of that fit. The steps are returned with the noise of the last
    one. If the first fit used correlated noise, the last fit is repeated with correlated noise, and
    its parameters and errors are reported.

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        held_out: further runs, or held-out parts of the fitted runs; no step is fitted to them.
        most: maximum number of steps.
        tries: number of suspects that are fitted at each step, at least 1.
        progress: function that is called with each step when it is complete.

    Raises:
        InputError: as for `giajax.suspects`, or `tries` is below 1.
    """
    if tries < 1:
        raise InputError(f"the number of suspects to try at each step is {tries}: give at least 1")
    climb = Climb(matching_runs(result.runs, runs), list(held_out), progress=progress)
    correlated = result.noise is None or result.noise.widening
    white = refit(result, climb.runs, noise_model="white") if correlated else result
    climb.take(Measured.of(white, climb.runs, climb.apart))
    for _ in range(most):
        if climb.step(tries):
            break
    else:
        climb.ending = f"the limit of {most} steps was reached"
    steps = climb.steps()
    steps[-1] = dataclasses.replace(steps[-1], result=as_asked(result, steps, climb.runs))
    return StepwiseSelection(tuple(steps), climb.ending)


@dataclasses.dataclass
class Climb:
    """State of a selection: the runs used by its last fit, and the fits so far.

    Attributes:
        runs: runs of the last fit.
        apart: held-out runs.
        fits: computations, with or without a journal.
        progress: function that is called with each accepted step.
        taken: accepted fits.
        asked: suspects of each accepted fit; None if they were not tested.
        passed: fits that were tried but not accepted.
        ending: one sentence on the reason why the selection ended.
    """

    runs: list[Run]
    apart: list[Run]
    fits: AbstractFits = dataclasses.field(default_factory=Fits)
    progress: Callable[[Step], None] | None = None
    taken: list[Measured] = dataclasses.field(default_factory=list)
    asked: list[Suspects | None] = dataclasses.field(default_factory=list)
    passed: list[Measured] = dataclasses.field(default_factory=list)
    ending: str = ""

    @property
    def last(self) -> Measured:
        """The last accepted fit."""
        return self.taken[-1]

    def take(self, fit: Measured) -> None:
        """Accept a fit."""
        self.taken.append(fit)
        self.asked.append(None)
        if self.progress is not None:
            self.progress(fit.step(fit.noise))

    def step(
        self,
        tries: int,
        chosen: Callable[[FitResult, Suspects], Sequence[Suspect]] | None = None,
        best: Callable[[Sequence[Tried]], Tried] = best_of,
        begin: tuple[FitResult, Sequence[Run]] | None = None,
    ) -> bool:
        """Perform one step of the selection; return whether the selection ended.

        The best fit is accepted, and parameters that it makes superfluous are removed. The suspects
        to be fitted are the first significant ones, or those returned by `chosen`. The fits start
        from the end of the last fit, or from the end of the fit in `begin`, which has the same
        parameters. If the suspects were tested at the initial guess, the fits start there.
        """
        result, runs = begin or (self.last.result, self.runs)
        self.asked[-1] = found = self.fits.suspects(result, runs)
        promising = found.significant if chosen is None else chosen(result, found)
        last = None if chosen is None else self.last
        made = tried_steps(result, self.runs, self.apart, promising, tries, self.fits, last)
        if not made:
            self.ending = "no suspect that could be freed is significant"
            return True
        # Each comparison uses the noise of the fit with more parameters.
        for one in (best(made), best_of(made)):
            noise = one[0].noise
            if lower := one[0].step(noise).bic < self.last.step(noise).bic:
                break
        self.passed += [fit for fit, _, _ in made if not (lower and fit is one[0])]
        if not lower:
            self.ending = f"{one[0].step(noise).change} was tried and increases BIC"
            return True
        _, self.runs, self.apart = one
        self.take(one[0])
        for spare in _spare(self.taken):
            held = {spare.path: spare.value}
            self._take_if_better(f"without {spare.path}", spare, removed=True, fix=held)
        for alone in _standing_for_all(self.taken):
            path, of = alone.path.split(" = ")
            self._take_if_better(alone.path, alone, ties={path: of})
        return False

    def _take_if_better(
        self, name: str, suspect: Suspect, *, removed: bool = False, **changed: Any
    ) -> None:
        """Fit the last model with a change, and accept the fit if its BIC is lower."""
        try:
            again = self.fits.refit(name, self.last.result, self.runs, **changed)
            other = self.fits.measured(again, self.runs, self.apart, suspect, removed=removed)
        except InputError:  # The changed model cannot be fitted.
            return
        noise = self.last.noise
        if other.step(noise).bic < self.last.step(noise).bic:
            self.take(other)
        elif not removed:
            self.passed.append(other)

    def steps(self) -> list[Step]:
        """Return the accepted steps, with the white noise of the last one."""
        return [
            dataclasses.replace(fit.step(self.last.noise), suspects=found)
            for fit, found in zip(self.taken, self.asked, strict=True)
        ]


def as_asked(result: FitResult, steps: Sequence[Step], runs: Sequence[Run]) -> FitResult:
    """Return the last fit, repeated with the noise model requested for the first one."""
    if len(steps) == 1:
        return result
    model, last = result.config.get("noise_model", "correlated"), steps[-1].result
    if model == "white":
        return last
    try:
        again = refit(last, runs, noise_model=model)
    except InputError:  # It cannot be evaluated just inside its bounds.
        return last
    return again if again.status == "converged" else last


def _spare(steps: Sequence[Step | Measured]) -> list[Suspect]:
    """Return the suspects freed before the last step that are near their fixed value again."""
    last = steps[-1].result.free
    taken = {step.suspect.path for step in steps if step.removed and step.suspect is not None}
    spare = []
    for before, step in itertools.pairwise(steps[:-1]):
        suspect = step.suspect
        if suspect is None or suspect.path in taken:
            continue
        if suspect.kind == "scatter":
            # The elements are fixed at their earlier values, or at their neutral values.
            whole = get(_neutrally(before.result.model, suspect.path), suspect.path)
            held = np.ravel(np.asarray(whole)).tolist()
            suspect = dataclasses.replace(suspect, value=held if len(held) > 1 else held[0])
        elif suspect.kind not in ("parameter", "group"):
            continue
        paths = [p for p in last if suspect.path in (p, p.partition("[")[0])]
        values = np.ravel(np.asarray(suspect.value, dtype=float))
        if len(values) not in (1, len(paths)):  # Some elements have been fixed or tied since.
            continue
        values = np.broadcast_to(values, (len(paths),))
        if paths and all(
            abs(last[path].value - value) < _NEAR * (last[path].standard_error or np.inf)
            for path, value in zip(paths, values, strict=True)
        ):
            spare.append(suspect)
    return spare


def _standing_for_all(steps: Sequence[Step | Measured]) -> list[Suspect]:
    """Return suspects that tie all elements to a single freed element, such as a weak drive.

    While another effect is missing, the element that moves most of the arm may appear to be the
    only one that is affected.
    """
    last = steps[-1].result
    single = capabilities.one_by_one(last.model)
    freed: dict[str, dict[str, Suspect]] = {}
    for step in steps:
        path = "" if step.suspect is None else step.suspect.path
        name, _, index = path.partition("[")
        if index and name in single and path in last.free and step.suspect is not None:
            freed.setdefault(name, {})[path] = step.suspect
    ties = FitSettings.shared_with(last.config).ties
    return [
        dataclasses.replace(one, path=f"{name} = {one.path}", kind="switch", p_value=None)
        for name, (one, *others) in ((name, each.values()) for name, each in freed.items())
        if not others and name not in ties
    ]
