"""White noise plus correlated noise of one channel, and what differences of samples show of it."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from ..runtime.arrays import Float


@dataclasses.dataclass(frozen=True)
class ChannelNoise:
    """What each cell of a channel is off by: a part of its own, and one that it shares.

    The second part is an Ornstein-Uhlenbeck process, the continuous-time AR(1): a normal variable
    whose correlation between two instants is exp(-|dt| / time_s), so that uneven samples and gaps
    are treated as they are.

    Attributes:
        white: standard deviation of the part that differs from cell to cell, SI.
        correlated: standard deviation of the correlated part, SI.
        time_s: its correlation time, s; 0 where there is no such part.
    """

    white: float
    correlated: float = 0.0
    time_s: float = 0.0

    @classmethod
    def of_cell(cls, deviation: float, correlated: float, time_s: float) -> Self:
        """The noise whose two parts together have the deviation of a cell, SI."""
        white = math.sqrt(max(deviation**2 - correlated**2, 0.0))
        return cls(white, correlated, time_s if correlated else 0.0)

    @property
    def deviation(self) -> float:
        """Standard deviation of a cell, both parts together, SI."""
        return math.hypot(self.white, self.correlated)

    @property
    def is_white(self) -> bool:
        """Whether no part is correlated."""
        return self.correlated == 0

    def times(self, factor: float) -> Self:
        """The same noise, a number of times as large."""
        return type(self)(self.white * factor, self.correlated * factor, self.time_s)


@dataclasses.dataclass(frozen=True)
class Stated:
    """What is known of the noise of a key beforehand.

    Attributes:
        deviation: of a cell, SI; None where nothing is.
        correlated: of the correlated part; None where nothing is.
        time_s: its correlation time, s.
    """

    deviation: float | None = None
    correlated: float | None = None
    time_s: float = 0.0

    @property
    def noise(self) -> ChannelNoise | None:
        """The noise as it is stated; None where its size is not."""
        return self.noise_of(correlated=True)

    def noise_of(self, *, correlated: bool) -> ChannelNoise | None:
        """The noise as it is stated, or as white as it is large; None where its size is not."""
        if self.deviation is None:
            return None
        part = self.correlated if correlated else None
        return ChannelNoise.of_cell(self.deviation, part or 0.0, self.time_s)


def gains(
    noise: ChannelNoise,
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, " sample"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a pass forward over the samples needs to make the noise white (a Kalman filter).

    With m the part of a cell's noise that the cells before it predict, the cell less m has the
    deviation that is returned, independent of all before, and m goes on by

        m <- keep m + gain (cell - m).

    The deviations are those of the innovations: the product of their squares is |V|.

    Arguments:
        noise: of the channel.
        times: of all samples, s, increasing; None where they have no time.
        weights: of the cells; 0 where a cell is not measured.

    Returns:
        keep, gain and deviation, each of shape (sample,).
    """
    count = len(weights)
    measured = weights > 0
    white = noise.white**2 / np.where(measured, weights, 1.0)
    if times is None or noise.is_white:
        zeros = np.zeros(count)
        return zeros, zeros.copy(), np.sqrt(white + noise.correlated**2)
    power = noise.correlated**2
    decay = np.append(np.exp(-np.diff(times) / noise.time_s), 0.0)
    share, innovation = np.zeros(count), np.empty(count)
    variance = power
    for i in range(count):
        total = variance + white[i]
        innovation[i] = total
        if measured[i]:
            share[i] = variance / total
            variance *= white[i] / total
        variance = decay[i] ** 2 * variance + (1 - decay[i] ** 2) * power
    return decay, decay * share, np.sqrt(innovation)


def whitened(
    noise: ChannelNoise,
    times: Float[np.ndarray, " cell"] | None,
    columns: Float[np.ndarray, "cell column"],
    weights: Float[np.ndarray, " cell"] | None = None,
) -> Float[np.ndarray, "cell column"]:
    """Columns over the cells of a channel, in its unit, made independent and of unit variance."""
    weights = np.ones(len(columns)) if weights is None else weights
    keep, gain, deviation = gains(noise, times, weights)
    if not np.any(gain):
        return columns / deviation[:, None]
    result = np.empty_like(columns)
    kept = np.zeros(columns.shape[1])
    for i, row in enumerate(columns):
        fresh = row - kept
        result[i] = fresh / deviation[i]
        kept = keep[i] * kept + gain[i] * fresh
    return result


# Cells that robust statistics left no weight, or hardly any, are this many deviations wide.
_LEAST_WEIGHT = 1e-2


def drawn(
    noises: Sequence[ChannelNoise],
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, "sample channel"],
    random: np.random.Generator,
) -> Float[np.ndarray, "sample channel"]:
    """Noise of some channels of a run: white, and correlated across gaps.

    The correlated part is exact for any spacing of the samples.

    Arguments:
        noises: of the channels.
        times: of all samples, s; None where they have none: the noise is then white.
        weights: of the cells, 1 but for outliers, whose white part is wider by their root; a cell
            that is not measured has noise, too.
        random: draws it.

    Returns:
        SI.
    """
    count = len(weights)
    white = np.asarray([noise.white for noise in noises])
    noise = white * random.standard_normal((count, len(noises)))
    noise /= np.sqrt(np.clip(weights, _LEAST_WEIGHT, 1.0))
    correlated = np.asarray([noise.correlated for noise in noises])
    if not np.any(correlated):
        return noise
    kicks = random.standard_normal((count, len(noises)))
    if times is None:
        return noise + correlated * kicks
    lengths = np.asarray([noise.time_s or 1.0 for noise in noises])
    keep = np.exp(-np.diff(times)[:, None] / lengths)
    fresh = np.sqrt(-np.expm1(-2 * np.diff(times)[:, None] / lengths))
    slow = kicks
    for row in range(1, count):
        slow[row] = keep[row - 1] * slow[row - 1] + fresh[row - 1] * kicks[row]
    return noise + correlated * slow


MAD = 1.4826  # 1.4826 median(|x|) estimates the standard deviation of a normal variable
_FEWEST_DIFFERENCES = 8  # fewer second differences know no deviation


def by_second_differences(values: np.ndarray) -> float | None:
    """Deviation of white noise on something smooth, from the median of second differences.

    NaN is not measured; there is none from too few.
    """
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    return None if len(second) < _FEWEST_DIFFERENCES else _deviation(second)


def from_differences(values: np.ndarray) -> float:
    """Noise of a recorded channel from its second differences, before any model is known.

    A motion that is smooth over three samples leaves only noise in x[i-1] - 2 x[i] + x[i+1],
    whose standard deviation is sqrt(6) times that of white noise. The median keeps outliers
    out, and NaN is not measured. A channel without visible noise gets a thousandth of its range.
    """
    measured = values[~np.isnan(values)]
    estimate = by_second_differences(values)
    if estimate is None:
        estimate = _deviation(np.diff(measured, 2))
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # an outlier is no range
    return max(estimate, 1e-3 * span) or 1.0


def _deviation(second: np.ndarray) -> float:
    return MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
