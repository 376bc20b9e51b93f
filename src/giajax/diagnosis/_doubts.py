"""Held numbers that may be a little wrong: those whose uncertainty is stated, and all others."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..fitting import Direction
from ..models import AbstractModel
from ..parameters import elements, get, switched_on
from ._candidates import Candidate, Inquiry, inquiry

FRACTION = 0.01
"""Of a held number, where its uncertainty is not stated."""


@dataclasses.dataclass(frozen=True)
class Doubt:
    """One held number, or several that move together, and by how much it may be wrong."""

    path: str
    unit: str
    value: float | list[float]
    uncertainty: float
    stated: bool
    direction: Direction


def check_uncertainty(
    model: AbstractModel,
    free: Sequence[str],
    uncertainty: Mapping[str, npt.ArrayLike],
    ties: Mapping[str, str] | None = None,
) -> None:
    """Refuse uncertainties that `systematic_errors` would refuse, before anything is fitted.

    Arguments:
        model: to be fitted.
        free: paths of the parameters to fit.
        uncertainty: standard deviations of held numbers, SI, by path.
        ties: expressions by the paths of what follows from them.

    Raises:
        InputError: an unknown path, one that is fitted or tied, or an uncertainty that is not
            positive.
    """
    if uncertainty:
        stated_doubts(free, inquiry(model, free, ties=ties), uncertainty)


def is_doubtful(one: Candidate, known: set[str]) -> bool:
    return one.value != 0 and one.direction.path not in known


def one_percent(one: Candidate) -> Doubt:
    size = FRACTION * abs(one.value)
    return Doubt(one.path, one.unit, one.value, size, False, one.direction)


def stated_doubts(
    paths: Sequence[str], asked: Inquiry, uncertainty: Mapping[str, npt.ArrayLike]
) -> list[Doubt]:
    doubts = []
    free = set(paths)
    for path, deviation in uncertainty.items():
        model = switched_on(asked.model, [path])
        parts = elements(model, path)
        about = parts[0].declaration
        numbers = np.asarray(deviation, dtype=float)
        if numbers.size not in (1, len(parts)):
            raise InputError(
                f"the uncertainty of {path} has {numbers.size} values, and it has {len(parts)}: "
                "give one, or one for each"
            )
        if not np.all(np.isfinite(numbers)) or not np.all(numbers > 0):
            raise InputError(f"the uncertainty of {path} is not positive: give a positive number")
        fitted = [part.path for part in parts if part.path in free]
        if fitted:
            raise InputError(
                f"{fitted[0]} is fitted, and its uncertainty is what the fit finds: hold it, or "
                "leave its uncertainty out"
            )
        if asked.following.issuperset(part.path for part in parts):
            raise InputError(
                f"{path} is tied to others, and as uncertain as they are: state how uncertain "
                "those are"
            )
        name = path.partition("[")[0]
        whole = np.asarray(get(model, name), dtype=float)
        each = np.broadcast_to(numbers, (len(parts),))
        alone = bool(about.shape) or len(parts) == 1
        for index, part in enumerate(parts):
            step = np.zeros(whole.shape)
            if alone:
                step[... if part.index is None else part.index] = 1.0
                value, size = float(part.value(model)), float(each[index])
                along = Direction(name, step)
                doubts.append(Doubt(part.path, about.unit, value, size, True, along))
        if not alone:
            size = float(np.max(each))
            same = np.all(whole == whole[0])
            shown = float(whole[0]) if same else [float(number) for number in whole]
            step = each / size
            doubts.append(Doubt(name, about.unit, shown, size, True, Direction(name, step)))
    return [_shared(doubt, asked) for doubt in doubts]


def _shared(doubt: Doubt, asked: Inquiry) -> Doubt:
    """With the direction of a candidate, where one is the same."""
    for one in asked.candidates:
        same = one.direction.path == doubt.direction.path
        if same and np.array_equal(one.direction.step, doubt.direction.step):
            return dataclasses.replace(doubt, direction=one.direction)
    return doubt
