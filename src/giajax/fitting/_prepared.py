"""Runs as a model prepares them, with values that a fit found for each."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from ..models import AbstractModel
from ..parameters import get, replace
from ..runs import Run


def sharing_a_program(model: AbstractModel, runs: Sequence[Run]) -> list[list[int]]:
    """Positions of the runs that share a program: of the same channels, and prepared alike."""
    groups: dict[Any, list[int]] = {}
    for index, run in enumerate(runs):
        structure = jax.tree.structure(model.prepare(run))
        key = tuple(run.observations), structure, model.free_inputs(run)
        groups.setdefault(key, []).append(index)
    return list(groups.values())


def in_a_share(count: int) -> int:
    """How many of some runs that share a program a core takes at once.

    Several of many, because to begin costs half a millisecond; a divisor, so that none is left
    over; few, so that no core waits for another's last ones: there are at least 16 shares, or as
    many as runs. It does not depend on the machine, so that programs are the same everywhere.
    """
    return next(n for n in (4, 3, 2, 1) if n == 1 or (count % n == 0 and count >= 16 * n))


def in_a_sample(count: int) -> int:
    """How many of some runs that share a program say whether its derivatives are right."""
    return min(4, max(1, count // 8))


def prepared_with(model: AbstractModel, run: Run, own: Mapping[str, float]) -> Any:
    """A prepared run with the values of what is free in it alone.

    Arguments:
        model: prepares the run.
        run: what was recorded.
        own: values by label (`initial.angle[0]`); the others are as the run was prepared.
    """
    inputs = model.prepare(run)
    for path in model.free_inputs(run):
        values = np.array(get(inputs, path), dtype=float)
        for index in range(values.size):
            label = f"{path}[{index}]" if values.size > 1 else path
            values.reshape(-1)[index] = own.get(label, values.reshape(-1)[index])
        inputs = replace(inputs, {path: values})
    return inputs
