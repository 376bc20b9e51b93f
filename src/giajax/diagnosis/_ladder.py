"""The ladder: what the residuals ask for is fitted in turn, from where the last fit ended."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Suspect, matching_runs
from ..runs import Run
from ..study import refit
from ._measured import Measured, Noise
from ._records import Suspects
from ._rung import Ladder, Rung
from ._step import best_step
from ._suspects import suspects

MOST = 6
"""Steps of a ladder."""

TRIES = 3
"""Suspects that are fitted at each of them."""

# Standard errors. BIC decides; what is further away need not be tried.
_NEAR = 4.0


def ladder(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    most: int = MOST,
    tries: int = TRIES,
    progress: Callable[[Rung], None] | None = None,
) -> Ladder:
    """Fit the most promising suspect, ask again, and so on.

    A parameter is freed, a choice of the model is made the other way, and recorded axes are
    exchanged; each fit begins where the last one ended. What was freed before and has come
    back to the value that it was held at is held again. It ends where no suspect is significant,
    or where what is tried makes BIC larger. A suspect that is one number for many elements
    (the mass of all links) is no single parameter of a fit, and is passed over.

    What a test promises is the first step of a fit. So many of the first suspects as `tries` says
    are fitted at each step, each by itself, and the one whose fit has the lowest BIC is taken; with
    1 the step takes a fraction of the time, and trusts the test.

    All fits are made and compared by one likelihood: that of the loss of the fit, with white noise
    that is the same for both. Noise with a memory would take what is missing for noise, each fit
    as much as it leaves over. The white noise is what the runs state, or else what second
    differences of the residuals show, those of the fit with more in it; and where the samples do
    not follow each other, what that fit took for noise. The table that comes out has the noise of
    its last row, which is fitted once more with a memory if the first fit had looked for it: its
    parameters and errors are those of that fit.

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

    climb(Measured.of(_by_white_noise(result, several), several, apart))
    ending = f"{most} steps were allowed"
    for _ in range(most):
        asked[-1] = found = suspects(fits[-1].result, several)
        step = best_step(fits[-1].result, several, apart, found.significant, tries)
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
                again = refit(
                    fits[-1].result, several, fix={spare.path: spare.value}, noise_model="white"
                )
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
    rungs[-1] = dataclasses.replace(rungs[-1], result=_as_asked(result, rungs, several))
    return Ladder(tuple(rungs), ending)


def _by_white_noise(result: FitResult, runs: Sequence[Run]) -> FitResult:
    """The fit, or where its noise has a memory, that by white noise."""
    if result.noise is not None and not result.noise.widening:
        return result
    return refit(result, runs, noise_model="white")


def _as_asked(result: FitResult, rungs: Sequence[Rung], runs: Sequence[Run]) -> FitResult:
    """The last fit of a ladder, with the noise that the first one was asked for with."""
    if len(rungs) == 1:
        return result
    model = result.config.get("noise_model", "correlated")
    last = rungs[-1].result
    if model == "white":
        return last
    try:
        again = refit(last, runs, noise_model=model)
    except InputError:  # It cannot be evaluated a little inside of its bounds.
        return last
    return again if again.status == "converged" else last


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
