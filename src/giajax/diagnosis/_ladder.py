"""The ladder: what the residuals ask for is fitted in turn, from where the last fit ended."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Suspect, matching_runs
from ..models import AbstractModel
from ..parameters import declared, elements, left_out, switched_on
from ..runs import Run
from ..study import refit
from ._axes import all_axes, name_of, turned_back
from ._measured import Measured, Noise
from ._records import Suspects
from ._rung import Ladder, Rung
from ._suspects import suspects

MOST = 6
"""Steps of a ladder."""

# Standard errors. BIC decides; what is further away need not be tried.
_NEAR = 4.0


def ladder(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    most: int = MOST,
    tries: int = 1,
    progress: Callable[[Rung], None] | None = None,
) -> Ladder:
    """Fit the most promising suspect, ask again, and so on.

    A parameter is freed, a choice of the model is made the other way, and recorded axes are
    exchanged; each fit begins where the last one ended. What was freed before and has come
    back to the value that it was held at is held again. It ends where no suspect is significant,
    or where what is tried makes BIC larger. A suspect that is one number for many elements
    (the mass of all links) is no single parameter of a fit, and is passed over.

    What a test promises is the first step of a fit. With `tries` above 1 so many of the first
    suspects are fitted at each step, each by itself, and the one whose fit has the lowest BIC is
    taken; the step takes so many times as long.

    All fits are compared by one likelihood: that of the loss of the fit, with white noise that is
    the same for both. It is what the runs state, or else what second differences of the residuals
    show, those of the fit with more in it; and where the samples do not follow each other, what
    that fit took for noise. The table that comes out has the noise of its last row.

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        held_out: further runs, or what was held out of the fitted ones; no rung is fitted to it.
        most: how many steps.
        tries: how many suspects are fitted at each step.
        progress: called with each rung as soon as it is there.

    Returns:
        The rungs, side by side.

    Raises:
        InputError: as `giajax.suspects`, or `tries` is below 1.
    """
    if tries < 1:
        raise InputError(f"{tries} suspects cannot be tried at each step: give 1 or more")
    several, apart = matching_runs(result.runs, runs), list(held_out)
    fits: list[Measured] = []
    asked: list[Suspects | None] = []

    def climb(fit: Measured) -> None:
        fits.append(fit)
        asked.append(None)
        if progress is not None:
            progress(fit.rung(fit.noise))

    climb(Measured.of(result, several, apart))
    ending = f"{most} steps were allowed"
    for _ in range(most):
        asked[-1] = found = suspects(fits[-1].result, several)
        step = _best_step(fits[-1].result, several, apart, found.significant, tries)
        if step is None:
            ending = "no suspect that could be freed is significant"
            break
        tried, fitted_to, held = step
        if not _is_better(tried, fits[-1], tried.noise):
            ending = f"{tried.rung(tried.noise).change} was tried, and makes BIC larger"
            break
        several, apart = fitted_to, held
        climb(tried)
        for spare in _spare(fits):
            assert spare.value is not None
            try:
                again = refit(fits[-1].result, several, fix={spare.path: spare.value})
                fewer = Measured.of(again, several, apart, spare, removed=True)
            except InputError:  # It cannot do without.
                continue
            if _is_better(fewer, fits[-1], fits[-1].noise):
                climb(fewer)
    noise = fits[-1].noise
    rungs = [
        dataclasses.replace(fit.rung(noise), suspects=found)
        for fit, found in zip(fits, asked, strict=True)
    ]
    return Ladder(tuple(rungs), ending)


def _best_step(
    result: FitResult,
    runs: Sequence[Run],
    apart: Sequence[Run],
    promising: Sequence[Suspect],
    tries: int,
) -> tuple[Measured, list[Run], list[Run]] | None:
    """Of the first so many suspects that can be fitted, the fit of the lowest BIC.

    It comes with the runs and those held out as it sees them; None where none can be fitted.
    """
    fits: list[tuple[Measured, list[Run], list[Run]]] = []
    for suspect in promising:
        if len(fits) == tries:
            break
        if not _is_one(result.model, suspect):
            continue
        try:
            step = _with(result, runs, apart, suspect)
            fits.append((Measured.of(*step, suspect), step[1], step[2]))
        except InputError:  # It cannot be evaluated so; the next one may be.
            continue
    if not fits:
        return None
    noise = max((fit for fit, _, _ in fits), key=lambda fit: fit.moved.size).noise
    return min(fits, key=lambda one: one[0].rung(noise).bic)


def _is_better(one: Measured, other: Measured, noise: Noise) -> bool:
    """Whether BIC prefers one of two fits, with the noise that the one with more in it shows."""
    return one.rung(noise).bic < other.rung(noise).bic


def _spare(rungs: Sequence[Rung | Measured]) -> list[Suspect]:
    """What was freed before the last rung, and is near the value that it was held at again."""
    last = rungs[-1].result.free
    taken = {rung.suspect.path for rung in rungs if rung.removed and rung.suspect is not None}
    spare = []
    for rung in rungs[1:-1]:
        suspect = rung.suspect
        if suspect is None or suspect.path in taken or suspect.kind not in ("parameter", "group"):
            continue
        paths = [p for p in last if suspect.path in (p, p.partition("[")[0])]
        values = np.broadcast_to(np.asarray(suspect.value, dtype=float), (len(paths),))
        if paths and all(
            abs(last[path].value - value) < _NEAR * (last[path].standard_error or np.inf)
            for path, value in zip(paths, values, strict=True)
        ):
            spare.append(suspect)
    return spare


def _is_one(model: AbstractModel, suspect: Suspect) -> bool:
    """Whether a suspect is what a fit can free as it was tested."""
    if suspect.kind in ("switch", "axes"):
        return True
    parts = elements(_neutrally(model, suspect.path), suspect.path)
    return suspect.kind != "factor" and len(parts) == suspect.degrees_of_freedom


def _with(
    result: FitResult, runs: Sequence[Run], apart: Sequence[Run], suspect: Suspect
) -> tuple[FitResult, list[Run], list[Run]]:
    """A fit with what a suspect asks for, and the runs and those held out as it sees them."""
    same = list(runs), list(apart)
    if suspect.kind == "switch":
        other = result.model.variants()[suspect.path]
        # What a number switches on, as its strength does memory, has that number free.
        by = suspect.path.partition(" = ")[0]
        free = [by] if by in declared(other) else []
        return refit(result, runs, model=other, free=free), *same
    if suspect.kind == "axes":
        way = next(way for way in all_axes() if name_of(way) == suspect.path)
        turned = [turned_back(run, way) for run in runs]
        start = result.history[0].parameters
        return refit(result, turned, start=start), turned, [turned_back(run, way) for run in apart]
    model = _neutrally(result.model, suspect.path)
    assert suspect.estimate is not None
    begin = {suspect.path: suspect.estimate}
    return refit(result, runs, model=model, free=[suspect.path], start=begin), *same


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """The model with a part on that it leaves out, which changes nothing yet."""
    absent = left_out(model).get(path.partition("[")[0])
    if absent is None:
        return switched_on(model, [path])
    return absent.set(model, absent.declaration.neutral)
