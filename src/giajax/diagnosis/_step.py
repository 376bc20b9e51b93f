"""One step of a ladder: what the first few suspects are worth once they are fitted."""

from collections.abc import Sequence

from .._errors import InputError
from ..fitting import FitResult, Suspect
from ..models import AbstractModel
from ..parameters import declared, elements, left_out, switched_on
from ..runs import Run
from ..study import refit
from ._axes import all_axes, name_of, turned_back
from ._measured import Measured


def best_step(
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
        return refit(result, runs, model=other, free=free, noise_model="white"), *same
    if suspect.kind == "axes":
        way = next(way for way in all_axes() if name_of(way) == suspect.path)
        turned = [turned_back(run, way) for run in runs]
        start = result.history[0].parameters
        fit = refit(result, turned, start=start, noise_model="white")
        return fit, turned, [turned_back(run, way) for run in apart]
    model = _neutrally(result.model, suspect.path)
    assert suspect.estimate is not None
    begin = {suspect.path: suspect.estimate}
    fit = refit(result, runs, model=model, free=[suspect.path], start=begin, noise_model="white")
    return fit, *same


def _neutrally(model: AbstractModel, path: str) -> AbstractModel:
    """The model with a part on that it leaves out, which changes nothing yet."""
    absent = left_out(model).get(path.partition("[")[0])
    if absent is None:
        return switched_on(model, [path])
    return absent.set(model, absent.declaration.neutral)
