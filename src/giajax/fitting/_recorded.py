"""Recorded values as arrays, with what the noise makes of them: weights, and a whitening."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from .._typing import Array
from ..runs import Run
from ._noise import Noise
from ._whitening import Whitening

Recorded = Sequence[Mapping[str, np.ndarray]]
"""Of each run, values by channel, SI; NaN where a cell does not count."""


def recorded_cells(
    runs: Sequence[Run],
    noise: Noise,
    indices: Sequence[int],
    channels: Sequence[str],
    recorded: Recorded,
) -> tuple[Array, Array, Whitening | None]:
    """What the runs of a group recorded, padded to the longest of them.

    Arguments:
        runs: all that is fitted to.
        noise: of their channels.
        indices: positions of the runs of the group.
        channels: of the group.
        recorded: of each of all runs, values by channel.

    Returns:
        Values, 0 where none counts; weights, 0 there, too; the whitening of correlated noise.
    """
    observed = [np.stack([recorded[i][c] for c in channels], -1) for i in indices]
    weight = [
        np.where(np.isnan(cells), 0.0, 1 / np.asarray(_deviations(noise, i, channels)))
        * _root_weights(noise, runs[i], i, channels)
        for i, cells in zip(indices, observed, strict=True)
    ]
    length = max(len(cells) for cells in observed)
    return (
        _padded([np.nan_to_num(cells) for cells in observed], length),
        _padded(weight, length),
        _whitening(runs, noise, indices, channels, length, recorded),
    )


def _deviations(noise: Noise, index: int, channels: Sequence[str]) -> list[float]:
    return [noise.values[index][channel].deviation for channel in channels]


def _root_weights(noise: Noise, run: Run, index: int, channels: Sequence[str]) -> np.ndarray:
    """Roots of the cells' weights, where no whitening has them: in a run without time."""
    if noise.weights is None or run.times is not None:
        return np.ones(())
    return np.sqrt(np.stack([noise.weights[index][name] for name in channels], axis=-1))


def _whitening(
    runs: Sequence[Run],
    noise: Noise,
    indices: Sequence[int],
    channels: Sequence[str],
    length: int,
    recorded: Recorded,
) -> Whitening | None:
    """That of the runs of a group, stacked; None where noise has no memory for sure."""
    if not noise.memory:
        return None
    parts = []
    for i in indices:
        times = runs[i].times
        if times is None:
            return None
        measured = {
            name: np.where(np.isnan(values), 0.0, 1.0) for name, values in recorded[i].items()
        }
        weights = {
            name: cells if noise.weights is None else cells * noise.weights[i][name]
            for name, cells in measured.items()
        }
        of_run = {name: noise.values[i][name] for name in channels}
        parts.append(Whitening.of(of_run, times, weights, length))
    dtype = jnp.result_type(float)
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves), dtype=dtype), *parts)


def _padded(arrays: Sequence[np.ndarray], length: int) -> Array:
    rows = [np.pad(a, ((0, length - len(a)), (0, 0))) for a in arrays]
    return on_device(np.stack(rows), jnp.result_type(float))
