"""What residuals are weighted with: noise and whitening; and priors as rows of their own."""

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
    """Noise of each channel of each run, SI.

    Attributes:
        stated: what the sidecar of each run says, by channel.
        values: what the channels are weighted with.
        keys: of each channel of each run: those of the same key have the same noise.
        correlated: whether noise may be correlated.
        weights: what robust statistics leave of each sample, by channel; None where outliers
            are not weighted that way.
        estimated: whether what the sidecars leave out comes from the residuals of a fit.
    """

    stated: tuple[Mapping[str, Stated], ...]
    values: tuple[Mapping[str, ChannelNoise], ...]
    keys: tuple[Mapping[str, str], ...]
    correlated: bool
    weights: tuple[Mapping[str, np.ndarray], ...] | None = None
    estimated: bool = False

    @classmethod
    def of(cls, runs: Sequence[Run], model: NoiseModel = "correlated", *, per_run: bool) -> Self:
        """What the sidecars say; else white, from the differences of neighbouring samples.

        A channel has the same noise in all runs, or one in each (`per_run`).
        """
        stated = tuple({name: _stated(run, name) for name in run.observations} for run in runs)
        several = len({run.model for run in runs}) > 1
        keys = tuple(
            {
                # A load cell of a joint's bench is not that of a stand for muscles.
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
        """Whether the sidecars say the size of all of it."""
        return all(s.deviation is not None for of_run in self.stated for s in of_run.values())

    @property
    def is_white(self) -> bool:
        """Whether no channel's noise is correlated."""
        return not any(noise.correlated for of_run in self.values for noise in of_run.values())

    def by_key(self) -> dict[str, ChannelNoise]:
        """The noise of each key."""
        pairs = zip(self.keys, self.values, strict=True)
        return {keys[name]: noise for keys, of_run in pairs for name, noise in of_run.items()}

    def stated_by_key(self) -> dict[str, Stated]:
        """What is known beforehand of each key."""
        pairs = zip(self.keys, self.stated, strict=True)
        return {keys[name]: known for keys, of_run in pairs for name, known in of_run.items()}

    def with_values(
        self,
        by_key: Mapping[str, ChannelNoise],
        weights: tuple[Mapping[str, np.ndarray], ...] | None = None,
    ) -> Self:
        """With the noise that a fit showed."""
        values = tuple({name: by_key[key] for name, key in names.items()} for names in self.keys)
        return dataclasses.replace(self, values=values, weights=weights, estimated=True)

    def kept(self) -> "KeptNoise":
        """What a fit changes of it."""
        weights = self.weights
        return KeptNoise(
            estimated=self.estimated,
            values=tuple(map(dict, self.values)),
            weights=None
            if weights is None
            else tuple({name: w.tolist() for name, w in of_run.items()} for of_run in weights),
        )

    def again(self, kept: "KeptNoise") -> Self:
        """The noise that was kept."""
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
    """What a fit changes of its noise, as its journal has it: attributes of `Noise`."""

    estimated: bool
    values: tuple[dict[str, ChannelNoise], ...]
    weights: tuple[dict[str, list[float]], ...] | None


def _stated(run: Run, name: str) -> Stated:
    return Stated(run.noise(name), *(run.correlated_noise(name) or ()))


def _key(name: str, number: int, stated: Stated, per_run: bool) -> str:
    """Runs that state different noise, or none, do not share what is not stated either."""
    said = (
        ""
        if stated.deviation is None
        else f" {stated.deviation!r} {stated.correlated!r} {stated.time_s!r}"
    )
    return f"{name}{said}" + (f" of run {number}" if per_run else "")


# Correlated residuals made independent, by a pass over the samples of each run.
#
# It is a Kalman filter whose gains depend on the noise alone, and so a linear map of the
# residuals: whitened residuals and a whitened Jacobian make generalised least squares of least
# squares.


class Whitening(eqx.Module):
    """The gains of a run, or of several along a first axis, for residuals over their deviation.

    `keep` and `gain` are what of the correlated part and of the cell goes on to the next sample;
    `scale` the deviation of a cell over that of what the cells before it do not predict; 0 where a
    cell is not measured.
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
        """The gains of a run, by the weights of its cells, 0 where not measured.

        And zeros for further samples, up to a `length`.
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

        def step(kept: Array, each: tuple[Array, ...]) -> tuple[Array, Array]:
            cell, keep, gain, scale = each
            fresh = cell - kept
            return keep[:, None] * kept + gain[:, None] * fresh, scale[:, None] * fresh

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
        kept = np.zeros(cells.shape[1:])
        for i, row in enumerate(cells):
            fresh = row / np.where(scale[i] > 0, scale[i], 1.0)[:, None]
            result[i] = np.where(scale[i][:, None] > 0, kept + fresh, 0.0)
            kept = keep[i][:, None] * kept + gain[i][:, None] * fresh
        return result.reshape(np.shape(rows))


Rows = Float[Array, " prior"]


class Priors(eqx.Module):
    """What is known of some free coordinates before the fit, a row of the residual each.

    A row is (p - centre) / spread, of the parameter p or, where it is `logarithmic`, of its
    logarithm. It is not whitened, no loss transforms it, and no noise is estimated from it. The
    columns are positions in the free coordinate.
    """

    centre: Rows
    spread: Rows
    columns: tuple[int, ...] = eqx.field(static=True, default=())
    logarithmic: tuple[bool, ...] = eqx.field(static=True, default=())

    @classmethod
    def of(cls, priors: Mapping[str, Prior], paths: Sequence[str]) -> Self:
        """The rows of some priors, for the paths at the positions of the free coordinate."""
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
        """Rows of the residual, and the derivative of each by its own free coordinate."""
        columns = np.asarray(self.columns, dtype=int)
        bounds = bijector.at(columns)
        logarithmic = np.asarray(self.logarithmic, dtype=bool)

        def row(part: Array) -> Array:
            values = bounds.forward(part)
            # A stand-in that keeps the branch which is not taken free of NaN.
            logarithms = jnp.log(jnp.where(logarithmic, values, 1))
            return (jnp.where(logarithmic, logarithms, values) - self.centre) / self.spread

        part = coordinate[columns]
        return jax.jvp(row, (part,), (jnp.ones_like(part),))


def prior_of(priors: Mapping[str, Prior], path: str) -> Prior | None:
    """What is known of a scalar parameter: by itself, or as an element of its array."""
    return priors.get(path, priors.get(path.partition("[")[0]))


def prior_row(prior: Prior, value: float) -> tuple[float, float]:
    """The row of the residual that a prior is, and its derivative by the parameter itself."""
    if prior.logarithmic:
        return (math.log(value) - prior.centre) / prior.spread, 1 / (value * prior.spread)
    return (value - prior.centre) / prior.spread, 1 / prior.spread


def checked_priors(priors: Mapping[str, Any]) -> dict[str, Prior]:
    """The priors, also where they are given as `{"value": ..., "deviation": ...}`.

    Raises:
        InputError: what is not a prior.
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
