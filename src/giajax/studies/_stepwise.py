"""Stepwise selection: what the residuals suggest is fitted in turn, from where the last ended."""

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
        suspect: what was added to the fit before; None for the first.
        removed: whether it was taken out again: with what came later, it is not significant.
        chi_square: sum of what the loss makes of residuals in units of white noise, the same for
            all steps, and of the squares of the priors.
        parameters: number of fitted parameters.
        values: number of measured values.
        held_out: root mean square error of the runs that were held out, in units of their noise
            or, where none is stated, of the white noise of the fitted ones; None without any.
        result: the fit.
        suspects: what its residuals suggest; None where that was not asked.
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
        """What was changed: a path, `without` one, or nothing for the first."""
        if self.suspect is None:
            return "-"
        if self.suspect.kind == "prior":
            return f"{self.suspect.path} without its prior"
        return f"without {self.suspect.path}" if self.removed else self.suspect.path

    @property
    def aic(self) -> float:
        """Akaike's criterion, with known noise: chi-square + 2 k."""
        return self.chi_square + 2 * self.parameters

    @property
    def bic(self) -> float:
        """Schwarz' criterion, with known noise: chi-square + k log n."""
        return self.chi_square + self.parameters * float(np.log(self.values))


@dataclasses.dataclass(frozen=True)
class StepwiseSelection:
    """The fits, from the first to the last that was better, and why there is no other.

    Attributes:
        steps: the first is the fit that was asked about.
        ending: one sentence.
    """

    steps: tuple[Step, ...]
    ending: str

    @property
    def result(self) -> FitResult:
        """The last fit."""
        return self.steps[-1].result

    @property
    def rungs(self) -> tuple[Step, ...]:
        """The steps by their earlier name."""
        warn_of_name("StepwiseSelection.rungs", "steps")
        return self.steps


Noise = Sequence[Mapping[str, float]]
"""Standard deviation of white noise (SI) of each run, by channel."""


@dataclasses.dataclass(frozen=True)
class Measured:
    """A fit and what it leaves over, to be compared with others under the same noise.

    Minus twice the logarithm of the likelihood is, up to a constant, the sum of what the loss
    makes of each residual over its noise, which must be that of all fits that are compared: what
    each fit would take for noise, or for an outlier, is larger where it describes less.

    It has what the fit predicts for each run (`at`), white noise as stated or as its residuals show
    it, and of each channel that was held out (`apart`) the name, the noise stated, and the errors.
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
        """A fit of some runs, and what it makes of those that were held out."""
        at = responses_of(result, runs, result.model)
        noise = white_noise(result, runs, at)
        errors = []
        for run in apart:
            for name, predicted in result.predict(with_fitted_state(result, run)).items():
                rest = predicted - run.observations[name]
                errors.append((name, run.noise(name), rest[~np.isnan(rest)]))
        return cls(suspect, removed, result, at, noise, Coordinates.of(result), errors)

    def step(self, noise: Noise) -> Step:
        """The fit under a noise that may be another one's."""
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
            # Where none is stated, that of a fitted run with the channel, else the first one's.
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
    """That of a channel; of one that had another name, or was not fitted, the mean of its kind."""
    if known := deviations.get(name):
        return known
    kind = name.rpartition("_")[0]
    alike = [one for other, one in deviations.items() if other.rpartition("_")[0] == kind]
    return float(np.mean(alike or list(deviations.values())))


@dataclasses.dataclass(frozen=True)
class Change:
    """A fit to be made again: what of it is changed, as of `refit`, and the runs as it sees them.

    Its name is told. `apart` are those held out as it sees them.
    """

    name: str
    runs: Sequence[Run]
    changed: Mapping[str, Any]
    apart: Sequence[Run] = ()


class AbstractFits(abc.ABC):
    """What a selection computes, by names that are told and, of a journal, kept."""

    @abc.abstractmethod
    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """What the residuals of a fit suggest."""

    @abc.abstractmethod
    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """Fits again, side by side, or why one cannot be; white noise is the same for all.

        Raises:
            KeyboardInterrupt: Ctrl-C came before all of them had ended.
        """

    def refit(self, name: str, result: FitResult, runs: Sequence[Run], **changed: Any) -> FitResult:
        """The one fit of a change.

        Raises:
            InputError: it cannot be evaluated so.
        """
        (found,) = self.refits(result, [Change(name, runs, changed)])
        if isinstance(found, InputError):
            raise found
        return found

    def measured(self, *of: Any, removed: bool = False) -> Measured:
        """What a fit leaves over, as `Measured.of`."""
        return Measured.of(*of, removed=removed)


class Fits(AbstractFits):
    """Each of them computed when it is asked for."""

    def suspects(self, result: FitResult, runs: Sequence[Run]) -> Suspects:
        """As of `suspects`."""
        forget_programs_if_many()
        return suspects(result, runs)

    def refits(
        self, result: FitResult, changes: Sequence[Change]
    ) -> Sequence[FitResult | InputError]:
        """As of `refit`."""
        ended, stopped = side_by_side(result, changes)
        if stopped:
            raise KeyboardInterrupt
        return ended


def side_by_side(
    result: FitResult, changes: Sequence[Change], budget: Budget | None = None, **limits: Any
) -> tuple[list[FitResult | InputError], bool]:
    """Fits again on as many cores as there are, with white noise, and whether Ctrl-C came.

    They are those that came to their end, or why one cannot be, before the first that did not: for
    that the budget was used up, or it was stopped.
    """
    forget_programs_if_many()
    stop = threading.Event()

    def fitted(change: Change, tell: Tell) -> FitResult | InputError | None:
        asked = {"progress": functools.partial(tell, stop_if_asked), "budget": budget, **limits}
        found = None
        try:
            # The other one may have taken all of the time, if there is one core.
            if budget is None or budget.left() > 0:
                found = refit(
                    result, change.runs, **{"noise_model": "white", **asked, **change.changed}
                )
            tell(stop_if_asked)  # Ctrl-C may have come meanwhile.
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
"""A fit, and the runs and those held out as it sees them."""


def tried_steps(
    result: FitResult,
    runs: Sequence[Run],
    apart: Sequence[Run],
    promising: Sequence[Suspect],
    tries: int,
    fits: AbstractFits,
    last: Measured | None = None,
) -> list[Tried]:
    """The fits of the first so many suspects that can be fitted, each by itself.

    With the `last` fit that was taken, none whose test promises far less than another has brought.
    """
    made: list[Tried] = []
    gained = 0.0

    def promised() -> Iterator[tuple[Suspect, Change]]:
        for suspect in promising:
            if is_one(result.model, suspect) and _FAR * (suspect.chi_square_drop or 0.0) >= gained:
                with contextlib.suppress(InputError):  # It cannot be freed; the next one may be.
                    yield suspect, _freeing(result, runs, apart, suspect)

    following = promised()
    while asked := list(itertools.islice(following, min(_SIDE_BY_SIDE, tries - len(made)))):
        found = fits.refits(result, [change for _, change in asked])
        for (suspect, change), fitted in zip(asked, found, strict=True):
            if isinstance(fitted, InputError):
                continue
            try:
                one = fits.measured(fitted, change.runs, change.apart, suspect)
            except InputError:  # Nor can it be evaluated.
                continue
            made.append((one, list(change.runs), list(change.apart)))
            if last is not None:
                gained = max(gained, last.step(one.noise).bic - one.step(one.noise).bic)
    return made


# So that what is tried does not depend on the machine, on one core as on many.
_SIDE_BY_SIDE = 2

# A fit takes more of chi-square than its test promises, but hardly so many times as much.
_FAR = 3.0


def best_of(made: Sequence[Tried]) -> Tried:
    """The one of the lowest BIC."""
    noise = max((fit for fit, _, _ in made), key=lambda fit: fit.coordinates.size).noise
    return min(made, key=lambda one: one[0].step(noise).bic)


def best_step(
    result: FitResult,
    runs: Sequence[Run],
    apart: Sequence[Run],
    promising: Sequence[Suspect],
    tries: int,
) -> Tried | None:
    """Of the first so many suspects that can be fitted, the fit of the lowest BIC, or None."""
    made = tried_steps(result, runs, apart, promising, tries, Fits())
    return best_of(made) if made else None


def is_one(model: AbstractModel, suspect: Suspect) -> bool:
    """Whether a suspect is what a fit can free as it was tested."""
    if suspect.kind in ("switch", "axes", "columns", "prior", "scatter"):
        return bool(suspect.testable)
    try:
        parts = elements(_neutrally(model, suspect.path), suspect.path)
    except InputError:  # It is of another choice than this model's.
        return False
    return suspect.kind != "factor" and len(parts) == suspect.degrees_of_freedom


def _freeing(
    result: FitResult, runs: Sequence[Run], apart: Sequence[Run], suspect: Suspect
) -> Change:
    """The change of a fit that a suspect suggests."""

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
        # Each element for itself, held together by how far they scatter.
        model = in_full(model, declared(model)[suspect.path])
        size = float(np.max(np.asarray(suspect.estimate)))
        known = {each.path: float(each.value(model)) for each in elements(model, suspect.path)}
        priors = {path: PriorEntry(value=one, deviation=size) for path, one in known.items()}
        return change(model=model, free=list(priors), priors=priors, start=begin)
    assert suspect.estimate is not None
    begin[suspect.path] = suspect.estimate
    return change(model=model, free=[suspect.path], start=begin)


def _switched_on(result: FitResult, other: AbstractModel, suspect: Suspect) -> list[str]:
    """What a switch frees: the number that switches a part on, and what is a guess of that part.

    A guess that was held would let others make up for it. What the fit says of one is kept.
    """
    by = suspect.path.partition(" = ")[0]
    if by not in declared(other):
        return []
    said = {*result.free, *result.config.get("ties", {}), *result.config.get("fix", {})}
    guesses = capabilities.freed_with(other).get(by, ())
    return [by, *(path for path in guesses if path not in said)]


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """The model with a part on that it leaves out, which changes nothing yet.

    What has one number for all elements has one for each where a path is of an element.
    """
    name, _, element = path.partition("[")
    absent = left_out(model).get(name)
    if absent is not None:
        model = absent.set(model, absent.declaration.neutral)
    parts = declared(model)
    return in_full(model, parts[name]) if element and name in parts else model


MOST = 6
"""Steps of a selection."""

TRIES = 3
"""Suspects that are fitted at each of them."""

_NEAR = 4.0  # Standard errors. BIC decides; what is further away need not be tried


def ladder(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    most: int = MOST,
    tries: int = TRIES,
    progress: Callable[[Step], None] | None = None,
) -> StepwiseSelection:
    """Fit the most promising suspect, ask again, and so on.

    A parameter is freed, a choice of the model is made the other way (what of a part is a guess is
    freed with what switches it on), and recorded axes are exchanged; each fit begins where the last
    one ended, or began, if its suspects are of there.
    What was freed before and has come back to the value that it was held at is held again, and of a
    drive that was freed alone it is asked whether all are as that one. It ends
    where no suspect is significant, or where what is tried makes BIC larger. A suspect that is one
    number for many elements (the mass of all links) is not a single parameter of a fit, and is
    passed over.

    What a test promises is the first step of a fit. So many of the first suspects as `tries` says
    are fitted at each step, each by itself, and the one whose fit has the lowest BIC is taken; with
    1 the step takes a fraction of the time, and trusts the test.

    All fits are made and compared by one likelihood: that of the loss of the fit, with white noise
    that is the same for both. Correlated noise would take what is missing for noise, each fit
    as much as it leaves over. The white noise is what the runs state, or else what second
    differences of the residuals show, those of the fit with more in it; and where the samples do
    not follow each other, what that fit took for noise. The table that comes out has the noise of
    its last row, which is fitted once more with correlated noise if the first fit had looked for
    it: its parameters and errors are those of that fit.

    Arguments:
        result, runs: of `giajax.fit` or `giajax.load_result`, and what was fitted, in their order.
        held_out: further runs, or what was held out of the fitted ones; no step is fitted to it.
        most: how many steps.
        tries: how many suspects are fitted at each step, 1 at least.
        progress: called with each step as soon as it is there.

    Raises:
        InputError: as `giajax.suspects`, or `tries` is below 1.
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
    """A selection under way: the runs as its last fit sees them, and what was fitted so far.

    Each of the fits that were `taken` has beside it what its residuals suggest, once that is
    `asked`; `passed` are those that were tried and not taken.
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
        """Where it is."""
        return self.taken[-1]

    def take(self, fit: Measured) -> None:
        """One more fit is taken."""
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
        """Ask, fit, take the best and drop what it makes superfluous; whether this is the end.

        What is fitted is the first of the significant suspects, or of what is `chosen`, from where
        the last fit ended, or where another of the same parameters, of its own runs, did; from
        where it began, if the suspects are of there.
        """
        result, runs = begin or (self.last.result, self.runs)
        self.asked[-1] = found = self.fits.suspects(result, runs)
        promising = found.significant if chosen is None else chosen(result, found)
        last = None if chosen is None else self.last
        made = tried_steps(result, self.runs, self.apart, promising, tries, self.fits, last)
        if not made:
            self.ending = "no suspect that could be freed is significant"
            return True
        # Each time with the noise that the fit with more in it shows.
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
        """Fit the last model with something changed, and take that if BIC is lower."""
        try:
            again = self.fits.refit(name, self.last.result, self.runs, **changed)
            other = self.fits.measured(again, self.runs, self.apart, suspect, removed=removed)
        except InputError:  # It cannot be fitted so.
            return
        noise = self.last.noise
        if other.step(noise).bic < self.last.step(noise).bic:
            self.take(other)
        elif not removed:
            self.passed.append(other)

    def steps(self) -> list[Step]:
        """What was taken, with the white noise of the last."""
        return [
            dataclasses.replace(fit.step(self.last.noise), suspects=found)
            for fit, found in zip(self.taken, self.asked, strict=True)
        ]


def as_asked(result: FitResult, steps: Sequence[Step], runs: Sequence[Run]) -> FitResult:
    """The last fit, with the noise that the first one was asked for with."""
    if len(steps) == 1:
        return result
    model, last = result.config.get("noise_model", "correlated"), steps[-1].result
    if model == "white":
        return last
    try:
        again = refit(last, runs, noise_model=model)
    except InputError:  # It cannot be evaluated a little inside of its bounds.
        return last
    return again if again.status == "converged" else last


def _spare(steps: Sequence[Step | Measured]) -> list[Suspect]:
    """What was freed before the last step, and is near the value that it was held at again."""
    last = steps[-1].result.free
    taken = {step.suspect.path for step in steps if step.removed and step.suspect is not None}
    spare = []
    for before, step in itertools.pairwise(steps[:-1]):
        suspect = step.suspect
        if suspect is None or suspect.path in taken:
            continue
        if suspect.kind == "scatter":
            # As they were, or as if they were not there.
            whole = get(_neutrally(before.result.model, suspect.path), suspect.path)
            held = np.ravel(np.asarray(whole)).tolist()
            suspect = dataclasses.replace(suspect, value=held if len(held) > 1 else held[0])
        elif suspect.kind not in ("parameter", "group"):
            continue
        paths = [p for p in last if suspect.path in (p, p.partition("[")[0])]
        values = np.ravel(np.asarray(suspect.value, dtype=float))
        if len(values) not in (1, len(paths)):  # Some are held, or follow others, since.
            continue
        values = np.broadcast_to(values, (len(paths),))
        if paths and all(
            abs(last[path].value - value) < _NEAR * (last[path].standard_error or np.inf)
            for path, value in zip(paths, values, strict=True)
        ):
            spare.append(suspect)
    return spare


def _standing_for_all(steps: Sequence[Step | Measured]) -> list[Suspect]:
    """Elements freed one by one, such as a drive that seemed to be weak: all may be as that one.

    While something else is missing, the one that moves most of the arm may look as if it were
    alone.
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
