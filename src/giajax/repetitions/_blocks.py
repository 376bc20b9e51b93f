"""Data of the fitted model with blocks of the residuals in place of noise from a model.

Circular moving blocks (Politis and Romano 1992): rows of residuals are taken in blocks that begin
anywhere and go on at the first row after the last one, so that every row is as likely as another.
A row is one of all channels at an instant, whose residuals stay together.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from .._typing import Float
from ..noise import ChannelNoise
from ..runs import Run

# Of a run: shorter ones would be as many blocks as nobody can shuffle.
_LARGEST_SHARE = 1 / 3


@dataclasses.dataclass(frozen=True)
class Residuals:
    """Residuals of a run, ready to be taken in blocks.

    Attributes:
        channels: names.
        predicted: what the fitted model predicts, SI, shape (sample, channel).
        residuals: recorded minus predicted, with mean 0, as large as the noise; NaN where nothing
            was measured, of the same shape.
        length: of a block, in samples.
    """

    channels: tuple[str, ...]
    predicted: Float[np.ndarray, "sample channel"]
    residuals: Float[np.ndarray, "sample channel"]
    length: int

    @classmethod
    def of(
        cls,
        run: Run,
        predicted: Mapping[str, np.ndarray],
        noise: Mapping[str, ChannelNoise],
        inflation: float,
    ) -> Self:
        """The residuals of a run.

        Arguments:
            run: as it was recorded.
            predicted: by channel, SI.
            noise: that was fitted, by channel.
            inflation: how much smaller residuals are than the noise, because parameters follow it.
        """
        channels = tuple(run.observations)
        table = np.stack([predicted[name] for name in channels], axis=-1)
        recorded = np.stack([run.observations[name] for name in channels], axis=-1)
        rest = recorded - table
        measured = ~np.isnan(rest)
        count = np.maximum(measured.sum(axis=0), 1)
        # Else a channel that the model misses would miss it twice.
        rest = (rest - np.nansum(rest, axis=0) / count) * inflation
        return cls(channels, table, rest, block_length(run, rest, [noise[c] for c in channels]))

    def again(self, random: np.random.Generator) -> dict[str, np.ndarray]:
        """What another experiment would have recorded, by channel, SI; NaN where this one has none.

        A cell that was measured, and gets a row in which its channel was not, gets any residual of
        the channel.
        """
        count = len(self.residuals)
        starts = random.integers(count, size=-(-count // self.length))
        rows = (starts[:, None] + np.arange(self.length)).ravel()[:count] % count
        taken = self.residuals[rows]
        for column, own in enumerate(self.residuals.T):
            missing = np.isnan(taken[:, column])
            known = own[~np.isnan(own)]
            if len(known):
                taken[missing, column] = random.choice(known, int(missing.sum()))
        taken[np.isnan(self.residuals)] = np.nan
        table = self.predicted + taken
        return {name: table[:, column] for column, name in enumerate(self.channels)}


def block_length(
    run: Run, residuals: Float[np.ndarray, "sample channel"], noises: Sequence[ChannelNoise]
) -> int:
    """Samples of a block: n^(1/3), or more where residuals have a memory.

    For noise with autocovariances R(k) the best length is (3/2 (G/g)^2 n)^(1/3), with G the sum of
    |k| R(k) and g that of R(k) (Politis and White 2004, "Automatic block-length selection", for
    circular blocks); here of the channel that remembers longest, by its fitted noise, or as an
    AR(1) of its residuals where that is white.

    Arguments:
        run: gives the times of the samples.
        residuals: of the channels, NaN where nothing was measured.
        noises: that were fitted, of the channels.
    """
    count = len(residuals)
    step = 1.0 if run.times is None else float(np.median(np.diff(run.times)))
    longest = 0.0
    for noise, column in zip(noises, residuals.T, strict=True):
        if noise.correlated and run.times is not None:
            rho = float(np.exp(-step / noise.time_s))
            power, white = noise.correlated**2, noise.white**2
        else:
            rho, power, white = _lag_one(column), 1.0, 0.0
        moment = 2 * power * rho / (1 - rho) ** 2
        whole = white + power * (1 + rho) / (1 - rho)
        longest = max(longest, moment / whole if whole else 0.0)
    best = max((1.5 * longest**2 * count) ** (1 / 3), count ** (1 / 3))
    return max(min(int(np.ceil(best)), int(count * _LARGEST_SHARE)), 1)


def _lag_one(values: Float[np.ndarray, " sample"]) -> float:
    """Correlation of neighbours, 0 where it is within that of white noise, and below 0.99."""
    both = ~np.isnan(values[1:]) & ~np.isnan(values[:-1])
    power = np.nansum(values**2) / max(int(np.sum(~np.isnan(values))), 1)
    if both.sum() < 3 or power == 0:
        return 0.0
    rho = float(np.mean(values[1:][both] * values[:-1][both]) / power)
    return min(rho, 0.99) if rho > 2 / np.sqrt(both.sum()) else 0.0
