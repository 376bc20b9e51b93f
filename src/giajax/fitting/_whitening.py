"""Correlated residuals made independent, by a pass over the samples of each run.

It is a Kalman filter whose gains depend on the noise alone, and so a linear map of the residuals:
whitened residuals and a whitened Jacobian make generalised least squares of least squares.
"""

from collections.abc import Mapping
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from .._typing import Array, Float
from ..noise import ChannelNoise, gains


class Whitening(eqx.Module):
    """The gains of a run, or of several along a first axis, for residuals over their deviation.

    Attributes:
        keep, gain: what goes on from one sample to the next, of the memory and of the cell.
        scale: deviation of a cell over that of what the cells before it do not foretell; 0 where
            a cell is not measured.
    """

    keep: Float[Array, "*run sample channel"]
    gain: Float[Array, "*run sample channel"]
    scale: Float[Array, "*run sample channel"]

    @classmethod
    def of(
        cls,
        noise: Mapping[str, ChannelNoise],
        times: Float[np.ndarray, " sample"],
        weights: Mapping[str, Float[np.ndarray, " sample"]],
        length: int | None = None,
    ) -> Self:
        """The gains of a run.

        Arguments:
            noise: of its channels.
            times: of the samples, s.
            weights: of the cells of each channel, 0 where not measured.
            length: number of samples with further ones, which are not measured; none by default.
        """
        parts = []
        for name, of_channel in noise.items():
            keep, gain, deviation = gains(of_channel, times, weights[name])
            scale = np.where(weights[name] > 0, of_channel.deviation / deviation, 0.0)
            parts.append((keep, gain, scale))
        more = 0 if length is None else length - len(times)
        # By numpy: each shape would be a program of its own, compiled before the fit begins.
        leaves = [
            on_device(np.pad(np.stack(part, axis=-1), ((0, more), (0, 0))))
            for part in zip(*parts, strict=True)
        ]
        return cls(*leaves)

    def of_run(self, row: int) -> Self:
        """The gains of one of several runs."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[row], self)

    def apply(self, rows: Float[Array, "residual column"]) -> Float[Array, "residual column"]:
        """Columns over the cells of a run, sample by sample, made independent."""
        samples, channels = self.keep.shape
        cells = rows.reshape(samples, channels, -1)

        def step(memory: Array, each: tuple[Array, ...]) -> tuple[Array, Array]:
            cell, keep, gain, scale = each
            fresh = cell - memory
            return keep[:, None] * memory + gain[:, None] * fresh, scale[:, None] * fresh

        def through(cells: Array) -> Array:
            start = jnp.zeros(cells.shape[1:], cells.dtype)
            return jax.lax.scan(step, start, (cells, self.keep, self.gain, self.scale))[1]

        # White noise has nothing to pass on.
        idle = jnp.all((self.gain == 0) & ((self.scale == 0) | (self.scale == 1)))
        white = jax.lax.cond(idle, lambda cells: cells, through, cells)
        return white.reshape(rows.shape)

    def undone(self, rows: Float[np.ndarray, "residual column"]) -> np.ndarray:
        """The columns before `apply`; cells that are not measured are zero."""
        keep, gain, scale = (np.asarray(leaf) for leaf in (self.keep, self.gain, self.scale))
        cells = np.asarray(rows).reshape(*keep.shape, -1)
        result = np.empty_like(cells)
        memory = np.zeros(cells.shape[1:])
        for i, row in enumerate(cells):
            fresh = row / np.where(scale[i] > 0, scale[i], 1.0)[:, None]
            result[i] = np.where(scale[i][:, None] > 0, memory + fresh, 0.0)
            memory = keep[i][:, None] * memory + gain[i][:, None] * fresh
        return result.reshape(np.shape(rows))
