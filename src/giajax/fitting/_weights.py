"""Weights of residuals: noise, whitening, and priors as additional rows."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..noise import ChannelNoise, Stated, from_differences, gains
from ..recordings import NoiseModel, Run
from ..runtime.arrays import Array, Float, on_device
from ..runtime.text import InputError
from ..schema import Prior
from ._coordinates import Bijector


@dataclasses.dataclass(frozen=True)
class Noise:
    """Noise of each channel of each run, in SI units.

    Attributes:
        stated: noise that the sidecar of each run specifies, by channel.
        values: noise with which the channels are weighted.
        keys: key of each channel of each run. Channels with the same key have the same noise.
        correlated: whether noise may be correlated.
        weights: weight of each sample from robust statistics, by channel, or None if outliers are
            not weighted in this way.
        estimated: whether noise that the sidecars do not specify was estimated from residuals.
    """

    stated: tuple[Mapping[str, Stated], ...]
    values: tuple[Mapping[str, ChannelNoise], ...]
    keys: tuple[Mapping[str, str], ...]
    correlated: bool
    weights: tuple[Mapping[str, np.ndarray], ...] | None = None
    estimated: bool = False

    @classmethod
    def of(cls, runs: Sequence[Run], model: NoiseModel = "correlated", *, per_run: bool) -> Self:
        """Return the specified noise, or white noise from differences of neighbouring samples.

        A channel has the same noise in all runs, or separate noise in each run (`per_run`).
        """
        stated = tuple({name: _stated(run, name) for name in run.observations} for run in runs)
        several = len({run.model for run in runs}) > 1
        keys = tuple(
            {
                # A load cell of a joint test bench differs from that of a muscle test stand.
                name: _key(f"{run.model} {name}" if several else name, number, known, per_run)
                for name, known in of_run.items()
            }
            for number, (run, of_run) in enumerate(zip(runs, stated, strict=True))
        )
        guesses: dict[str, list[float]] = {}
        for run, names in zip(runs, keys, strict=True):
            for name, key in names.items():
                guesses.setdefault(key, []).append(from_differences(run.observations[name]))
        values = tuple(
            {
                name: known.noise_of(correlated=model == "correlated")
                or ChannelNoise(float(np.median(guesses[names[name]])))
                for name, known in of_run.items()
            }
            for of_run, names in zip(stated, keys, strict=True)
        )
        return cls(stated, values, keys, correlated=model == "correlated")

    @property
    def complete(self) -> bool:
        """Whether the sidecars specify the size of all noise."""
        return all(s.deviation is not None for of_run in self.stated for s in of_run.values())

    @property
    def is_white(self) -> bool:
        """Whether the noise of every channel is uncorrelated."""
        return not any(noise.correlated for of_run in self.values for noise in of_run.values())

    def by_key(self) -> dict[str, ChannelNoise]:
        """Return the noise of each key."""
        pairs = zip(self.keys, self.values, strict=True)
        return {keys[name]: noise for keys, of_run in pairs for name, noise in of_run.items()}

    def stated_by_key(self) -> dict[str, Stated]:
        """Return the specified noise of each key."""
        pairs = zip(self.keys, self.stated, strict=True)
        return {keys[name]: known for keys, of_run in pairs for name, known in of_run.items()}

    def with_values(
        self,
        by_key: Mapping[str, ChannelNoise],
        weights: tuple[Mapping[str, np.ndarray], ...] | None = None,
    ) -> Self:
        """Return this noise with the values estimated by a fit."""
        values = tuple({name: by_key[key] for name, key in names.items()} for names in self.keys)
        return dataclasses.replace(self, values=values, weights=weights, estimated=True)

    def kept(self) -> "KeptNoise":
        """Return the part of the noise that a fit changes."""
        weights = self.weights
        return KeptNoise(
            estimated=self.estimated,
            values=tuple(map(dict, self.values)),
            weights=None
            if weights is None
            else tuple({name: w.tolist() for name, w in of_run.items()} for of_run in weights),
        )

    def again(self, kept: "KeptNoise") -> Self:
        """Return the noise with a stored part restored."""
        weights = kept.weights
        return dataclasses.replace(
            self,
            values=kept.values,
            weights=None
            if weights is None
            else tuple({name: np.asarray(w) for name, w in of_run.items()} for of_run in weights),
            estimated=kept.estimated,
        )


@dataclasses.dataclass(frozen=True)
class KeptNoise:
    """Part of the noise that a fit changes, as stored in its journal: attributes of `Noise`."""

    estimated: bool
    values: tuple[dict[str, ChannelNoise], ...]
    weights: tuple[dict[str, list[float]], ...] | None


def _stated(run: Run, name: str) -> Stated:
    return Stated(run.noise(name), *(run.correlated_noise(name) or ()))


def _key(name: str, number: int, stated: Stated, per_run: bool) -> str:
    """Return a key. Runs with different specifications do not share unspecified noise either."""
    said = (
        ""
        if stated.deviation is None
        else f" {stated.deviation!r} {stated.correlated!r} {stated.time_s!r}"
    )
    return f"{name}{said}" + (f" of run {number}" if per_run else "")


# Correlated residuals are whitened by one pass over the samples of each run.
#
# The pass is a Kalman filter whose gains depend only on the noise, so it is a linear map of the
# residuals. Least squares of whitened residuals, with a whitened Jacobian, are generalised least
# squares.


class Whitening(eqx.Module):
    """Whitening gains of one run, or of several along a first axis, for normalised residuals.

    Attributes:
        keep: part of the correlated noise that is passed on to the next sample.
        gain: part of the cell that is passed on to the next sample.
        scale: standard deviation of a cell, divided by its standard deviation given the earlier
            cells. It is 0 where a cell is not measured.
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
        """Return the gains of a run.

        Arguments:
            noise: noise of each channel.
            times: times of the samples, s.
            weights: weights of the cells, 0 where not measured.
            length: number of samples. Additional samples have zero gains.
        """
        parts = []
        for name, of_channel in noise.items():
            keep, gain, deviation = gains(of_channel, times, weights[name])
            scale = np.where(weights[name] > 0, of_channel.deviation / deviation, 0.0)
            parts.append((keep, gain, scale))
        more = 0 if length is None else length - len(times)
        # NumPy is used, because with JAX each shape would be a program to compile before the fit
        # begins.
        leaves = [
            on_device(np.pad(np.stack(part, axis=-1), ((0, more), (0, 0))))
            for part in zip(*parts, strict=True)
        ]
        return cls(*leaves)

    def of_run(self, row: int) -> Self:
        """Return the gains of one of several runs."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[row], self)

    def apply(self, rows: Float[Array, "residual column"]) -> Float[Array, "residual column"]:
        """Whiten columns over the cells of a run, sample by sample."""
        samples, channels = self.keep.shape
        cells = rows.reshape(samples, channels, -1)

        def step(kept: Array, each: tuple[Array, ...]) -> tuple[Array, Array]:
            cell, keep, gain, scale = each
            fresh = cell - kept
            return keep[:, None] * kept + gain[:, None] * fresh, scale[:, None] * fresh

        def through(cells: Array) -> Array:
            start = jnp.zeros(cells.shape[1:], cells.dtype)
            return jax.lax.scan(step, start, (cells, self.keep, self.gain, self.scale))[1]

        # White noise passes nothing on.
        idle = jnp.all((self.gain == 0) & ((self.scale == 0) | (self.scale == 1)))
        white = jax.lax.cond(idle, lambda cells: cells, through, cells)
        return white.reshape(rows.shape)

    def undone(self, rows: Float[np.ndarray, "residual column"]) -> np.ndarray:
        """Return the columns before `apply`. Cells that are not measured are zero."""
        keep, gain, scale = (np.asarray(leaf) for leaf in (self.keep, self.gain, self.scale))
        cells = np.asarray(rows).reshape(*keep.shape, -1)
        result = np.empty_like(cells)
        kept = np.zeros(cells.shape[1:])
        for i, row in enumerate(cells):
            fresh = row / np.where(scale[i] > 0, scale[i], 1.0)[:, None]
            result[i] = np.where(scale[i][:, None] > 0, kept + fresh, 0.0)
            kept = keep[i][:, None] * kept + gain[i][:, None] * fresh
        return result.reshape(np.shape(rows))


Rows = Float[Array, " prior"]


class Priors(eqx.Module):
    """Priors of some free coordinates, as one row of the residual each.

    A row is (p - centre) / spread for a parameter p, or for its logarithm if the prior is
    `logarithmic`. It is not whitened, no loss transforms it, and no noise is estimated from it. The
    columns are positions in the free coordinate.
    """

    centre: Rows
    spread: Rows
    columns: tuple[int, ...] = eqx.field(static=True, default=())
    logarithmic: tuple[bool, ...] = eqx.field(static=True, default=())

    @classmethod
    def of(cls, priors: Mapping[str, Prior], paths: Sequence[str]) -> Self:
        """Return the rows of priors for the paths at the positions of the free coordinate."""
        known = [prior_of(priors, path) for path in paths]
        rows = [(column, prior) for column, prior in enumerate(known) if prior is not None]
        dtype = jnp.result_type(float)
        return cls(
            centre=on_device([prior.centre for _, prior in rows], dtype),
            spread=on_device([prior.spread for _, prior in rows], dtype),
            columns=tuple(column for column, _ in rows),
            logarithmic=tuple(prior.logarithmic for _, prior in rows),
        )

    def rows(self, coordinate: Float[Array, " parameter"], bijector: Bijector) -> tuple[Rows, Rows]:
        """Return the rows of the residual, and their derivatives by their own free coordinates."""
        columns = np.asarray(self.columns, dtype=int)
        bounds = bijector.at(columns)
        logarithmic = np.asarray(self.logarithmic, dtype=bool)

        def row(part: Array) -> Array:
            values = bounds.forward(part)
            # A finite substitute keeps NaN out of the branch that is not taken.
            logarithms = jnp.log(jnp.where(logarithmic, values, 1))
            return (jnp.where(logarithmic, logarithms, values) - self.centre) / self.spread

        part = coordinate[columns]
        return jax.jvp(row, (part,), (jnp.ones_like(part),))


def prior_of(priors: Mapping[str, Prior], path: str) -> Prior | None:
    """Return the prior of a scalar parameter, given for itself or for its array."""
    return priors.get(path, priors.get(path.partition("[")[0]))


def prior_row(prior: Prior, value: float) -> tuple[float, float]:
    """Return the residual row of a prior, and its derivative with respect to the parameter."""
    if prior.logarithmic:
        return (math.log(value) - prior.centre) / prior.spread, 1 / (value * prior.spread)
    return (value - prior.centre) / prior.spread, 1 / prior.spread


def checked_priors(priors: Mapping[str, Any]) -> dict[str, Prior]:
    """Return the priors. They may be given as `{"value": ..., "deviation": ...}`.

    Raises:
        InputError: an entry is not a prior.
    """
    checked = {}
    for path, prior in priors.items():
        try:
            checked[path] = prior if isinstance(prior, Prior) else Prior(**prior)
        except InputError as error:
            raise InputError(f"the prior of '{path}' is not valid, because {error}") from None
        except TypeError:
            raise InputError(
                f"the prior of '{path}' is not a prior: give giajax.Prior(value, deviation=...)"
            ) from None
    return checked
