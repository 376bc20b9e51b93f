"""The ladder: what the residuals ask for is fitted in turn, from where the last fit ended."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Suspect, predict, responses
from ..models import AbstractModel
from ..parameters import elements, left_out, switched_on
from ..runs import Run
from ..study import begun_as_fitted, refit
from ._axes import all_axes, name_of, turned_back
from ._rung import Ladder, Rung
from ._suspects import suspects
from ._weights import Weighing, matching_runs, own_values, robust_weights, white_noise

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
    progress: Callable[[Rung], None] | None = None,
) -> Ladder:
    """Fit the most promising suspect, ask again, and so on.

    A parameter is freed, a choice of the model is made the other way, and recorded axes are
    exchanged; each fit begins where the last one ended. What was freed before and has come
    back to the value that it was held at is held again. It ends where no suspect is significant,
    or where what is tried makes BIC larger. A suspect that is one number for many elements
    (the mass of all links) is no single parameter of a fit, and is passed over.

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        held_out: further runs, or what was held out of the fitted ones; no rung is fitted to it.
        most: how many steps.
        progress: called with each rung as soon as it is there.

    Returns:
        The rungs, side by side.

    Raises:
        InputError: as `giajax.suspects`.
    """
    now, several = result, matching_runs(result, runs)
    at = responses(now.model, several, (), own_values(now))
    noise = white_noise(now, several, at)
    rungs: list[Rung] = []

    apart = list(held_out)

    def added(
        one: FitResult, own: Sequence[Run], apart: Sequence[Run], suspect: Suspect | None
    ) -> Rung:
        near = responses(one.model, own, (), own_values(one))
        weighing = Weighing.of(near, noise, robust_weights(one, own, near))
        values = sum(int(np.sum(~np.isnan(each.observed))) for each in near)
        return Rung(
            suspect=suspect,
            chi_square=weighing.chi_square(near, [each.predicted for each in near]),
            parameters=len(one.free) + sum(len(record.parameters) for record in one.runs),
            values=values,
            held_out=_error_of(one, apart, noise[0]),
            result=one,
        )

    def climb(rung: Rung) -> None:
        rungs.append(rung)
        if progress is not None:
            progress(rung)

    climb(added(now, several, apart, None))
    ending = f"{most} steps were allowed"
    for _ in range(most):
        asked = suspects(now, several)
        rungs[-1] = dataclasses.replace(rungs[-1], suspects=asked)
        step: tuple[FitResult, list[Run], list[Run], Suspect] | None = None
        for suspect in asked.significant:
            if not _is_one(now.model, suspect):
                continue
            try:
                step = (*_with(now, several, apart, suspect), suspect)
                break
            except InputError:  # It cannot be evaluated so; the next one may be.
                continue
        if step is None:
            ending = "no suspect that could be freed is significant"
            break
        rung = added(*step)
        if not rung.bic < rungs[-1].bic:
            ending = f"{step[3].path} was tried, and makes BIC larger"
            break
        now, several, apart = step[:3]
        climb(rung)
        for spare in _spare(rungs):
            assert spare.value is not None
            again = refit(now, several, fix={spare.path: spare.value})
            fewer = dataclasses.replace(added(again, several, apart, spare), removed=True)
            if fewer.bic < rungs[-1].bic:
                now = fewer.result
                climb(fewer)
    return Ladder(tuple(rungs), ending)


def _spare(rungs: Sequence[Rung]) -> list[Suspect]:
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
        return refit(result, runs, model=result.model.variants()[suspect.path]), *same
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


def _error_of(result: FitResult, runs: Sequence[Run], noise: dict[str, float]) -> float | None:
    squares = []
    for run in runs:
        for name, predicted in predict(result.model, begun_as_fitted(result, run)).items():
            sigma = run.noise(name) or noise.get(name) or float(np.mean(list(noise.values())))
            rest = (predicted - run.observations[name]) / sigma
            squares.append(rest[~np.isnan(rest)] ** 2)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None
