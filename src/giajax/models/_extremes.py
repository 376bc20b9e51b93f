"""Turning points of an input: whether it has any, and what a fit of earlier ones starts from."""

from collections.abc import Sequence

import numpy as np

from ..runs import Run
from ._hysteresis_definition import HysteresisSettings

# Where turning points before the run are looked for first, as a part of the reach of the input.
_FIRST_EXTREME = 0.75


def turns(values: np.ndarray) -> bool:
    """Whether an input, shape (sample,), ever turns back."""
    steps = np.diff(values)
    steps = steps[steps != 0]
    return bool(np.any(steps[1:] * steps[:-1] < 0))


def first_extremes(
    settings: HysteresisSettings, now: np.ndarray, free: Sequence[str]
) -> list[np.ndarray]:
    """Turning points to start from, one list for each direction that the latest one came from.

    Arguments:
        settings: of the model.
        now: its turning points before the run, of the input, SI, shape (extreme,).
        free: paths of the elements to fit that have no start.

    Returns:
        Turning points of the shape of `now`; no list where none of them is to be moved.
    """
    count = len(now)
    paths = [f"previous_extremes[{index}]" for index in range(count)]
    moved = np.asarray([path in free for path in paths], dtype=bool) & (now == 0)
    if isinstance(settings.previous_extremes, tuple) or not np.any(moved):
        return []
    low, high = settings.input_range
    # Within each other, so that a later one does not wipe out an earlier one.
    sizes = _FIRST_EXTREME * settings.reach * np.arange(count, 0, -1) / count
    signs = (-1.0) ** np.arange(count)
    return [np.where(moved, (low + high) / 2 + sign * signs * sizes, now) for sign in (1.0, -1.0)]


def unexplained(response: np.ndarray, run: Run) -> float:
    """Sum of the squares that the best scale and offset of a response leave of a run, SI.

    Arguments:
        response: at the samples of the run, shape (sample,).
        run: whose measured channels it is compared with.

    Returns:
        The sum; infinite where the response is not finite.
    """
    if not np.all(np.isfinite(response)):
        return np.inf
    total = 0.0
    for values in run.observations.values():
        there = ~np.isnan(values)
        columns = np.stack([response[there], np.ones(there.sum())], axis=-1)
        scale = np.linalg.lstsq(columns, values[there])[0]
        total += float(np.sum((values[there] - columns @ scale) ** 2))
    return total
