"""White and correlated noise of one channel, and its estimate from differences of samples."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Self

import numpy as np

from ..runtime.arrays import Float


@dataclasses.dataclass(frozen=True)
class ChannelNoise:
    """Noise of the cells of a channel: a white part and a correlated part.

    The correlated part is an Ornstein-Uhlenbeck process, which is an AR(1) process in continuous
    time. It is a normal variable whose correlation between two instants is exp(-|dt| / time_s), so
    uneven samples and gaps are treated exactly.

    Attributes:
        white: standard deviation of the part that is independent from cell to cell, SI units.
        correlated: standard deviation of the correlated part, SI units.
        time_s: correlation time of the correlated part, s, 0 if there is no such part.
    """

    white: float
    correlated: float = 0.0
    time_s: float = 0.0

    @classmethod
    def of_cell(cls, deviation: float, correlated: float, time_s: float) -> Self:
        """Return the noise whose parts together have the given standard deviation, SI units."""
        white = math.sqrt(max(deviation**2 - correlated**2, 0.0))
        return cls(white, correlated, time_s if correlated else 0.0)

    @property
    def deviation(self) -> float:
        """Standard deviation of a cell, both parts together, SI units."""
        return math.hypot(self.white, self.correlated)

    @property
    def is_white(self) -> bool:
        """Whether the noise has no correlated part."""
        return self.correlated == 0

    def times(self, factor: float) -> Self:
        """Return the noise multiplied by a factor."""
        return type(self)(self.white * factor, self.correlated * factor, self.time_s)


@dataclasses.dataclass(frozen=True)
class Stated:
    """Noise of a key that is known before a fit.

    Attributes:
        deviation: standard deviation of a cell, SI units, or None if it is unknown.
        correlated: standard deviation of the correlated part, or None if it is unknown.
        time_s: correlation time of that part, s.
    """

    deviation: float | None = None
    correlated: float | None = None
    time_s: float = 0.0

    @property
    def noise(self) -> ChannelNoise | None:
        """Specified noise, or None if its size is not specified."""
        return self.noise_of(correlated=True)

    def noise_of(self, *, correlated: bool) -> ChannelNoise | None:
        """Return the specified noise, or white noise of the same size, or None if unknown."""
        if self.deviation is None:
            return None
        part = self.correlated if correlated else None
        return ChannelNoise.of_cell(self.deviation, part or 0.0, self.time_s)


def gains(
    noise: ChannelNoise,
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, " sample"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the gains of a forward pass over the samples that whitens noise (a Kalman filter).

    Let m be the part of a cell's noise that the earlier cells predict. The cell minus m has the
    returned standard deviation and is independent of all earlier cells, and m is updated by

        m <- keep m + gain (cell - m).

    The returned standard deviations are those of the innovations. The product of their squares is
    |V|.

    Arguments:
        noise: noise of the channel.
        times: times of all samples, s, increasing, or None if they have no times.
        weights: weights of the cells, 0 where a cell is not measured.

    Returns:
        keep, gain and standard deviation, each of shape (sample,).
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
    """Whiten columns over the cells of a channel, in its unit, to unit variance."""
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


# Smallest weight of a cell, such as an outlier: its white noise is at most 10 times wider.
_LEAST_WEIGHT = 1e-2


def drawn(
    noises: Sequence[ChannelNoise],
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, "sample channel"],
    random: np.random.Generator,
) -> Float[np.ndarray, "sample channel"]:
    """Draw noise of some channels of a run: white noise, and noise that is correlated across gaps.

    The correlated part is exact for any spacing of the samples.

    Arguments:
        noises: noise of each channel.
        times: times of all samples, s, or None. Noise without times is white.
        weights: weights of the cells, less than 1 for outliers, whose white part is divided by the
            square root. A cell that is not measured has noise, too.
        random: random number generator.

    Returns:
        Noise, SI units.
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
_FEWEST_DIFFERENCES = 8  # smaller numbers of second differences give no estimate


def by_second_differences(values: np.ndarray) -> float | None:
    """Return the white noise of a smooth signal, from the median of its second differences.

    NaN is not measured. The result is None for too few differences.
    """
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    return None if len(second) < _FEWEST_DIFFERENCES else _deviation(second)


def from_differences(values: np.ndarray) -> float:
    """Return the noise of a recorded channel from its second differences, without a model.

    For a motion that is smooth over three samples, x[i-1] - 2 x[i] + x[i+1] contains only noise,
    with a standard deviation of sqrt(6) times that of white noise. The median is robust to
    outliers, and NaN is not measured. A channel without visible noise gets one thousandth of its
    range.
    """
    measured = values[~np.isnan(values)]
    estimate = by_second_differences(values)
    if estimate is None:
        estimate = _deviation(np.diff(measured, 2))
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # excludes outliers from the range
    return max(estimate, 1e-3 * span) or 1.0


def _deviation(second: np.ndarray) -> float:
    return MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
