"""Spectra of a record by sine tapers, in bands that share no frequency.

The tapers are Riedel and Sidorenko's (Minimum bias multiple taper spectral estimation, IEEE
Transactions on Signal Processing 43, 1995, p. 188). The k-th is a window at half a bin's distance
k / 2T on either side, so that K of them see a band of (K + 1) / T, and that far apart bands are
all but independent of each other.
"""

from typing import NamedTuple

import numpy as np

from .._typing import Float

TAPERS = 5

# Bands of a long record that are quick compared with its length: a choice of them says as much of
# what is smooth there.
_ALL, _MORE = 150, 150


class Bands(NamedTuple):
    """Bands of a record.

    Attributes:
        middles: Hz, shape (band,).
        frequencies: where a model's spectra are needed, Hz, shape (frequency,).
        members: for each band the frequencies that its tapers see, alike, shape (band, 2 TAPERS).
    """

    middles: Float[np.ndarray, " band"]
    frequencies: Float[np.ndarray, " frequency"]
    members: np.ndarray


def bands(samples: int, interval: float, highest: float) -> Bands:
    """The bands of a record from just above zero up to a frequency.

    Arguments:
        samples: number of them.
        interval: between two, s.
        highest: Hz.
    """
    half = 1 / (2 * (samples + 1) * interval)
    apart = 2 * (TAPERS + 1)
    # The mean is taken off, which empties the first bin.
    steps = np.arange(apart // 2 + 2, int(highest / half) - TAPERS, apart)
    if len(steps) > _ALL + _MORE:
        chosen = np.geomspace(_ALL, len(steps) - 1, _MORE).astype(int)
        steps = np.concatenate([steps[:_ALL], steps[np.unique(chosen)]])
    seen = np.concatenate([np.arange(-TAPERS, 0), np.arange(1, TAPERS + 1)])
    needed, members = np.unique(steps[:, None] + seen, return_inverse=True)
    return Bands(steps * half, needed * half, members.reshape(len(steps), len(seen)))


def tapered(
    values: Float[np.ndarray, "sample channel"], interval: float, middles: np.ndarray
) -> np.ndarray:
    """Transforms of a record through each taper, whose products are one-sided spectra.

    Arguments:
        values: evenly sampled; their mean is taken off.
        interval: between two samples, s.
        middles: of bands, Hz; multiples of half a bin.

    Returns:
        Complex, shape (band, taper, channel), in units per root of Hz.
    """
    samples = len(values)
    about = values - values.mean(axis=0)
    order = np.arange(1, TAPERS + 1)
    turns = np.pi * np.outer(np.arange(1, samples + 1), order) / (samples + 1)
    tapers = np.sqrt(2 / (samples + 1)) * np.sin(turns)
    # Padded to twice its length plus two, a transform has half bins.
    length = 2 * (samples + 1)
    at = np.rint(middles * length * interval).astype(int)
    transformed = np.fft.rfft(tapers[:, :, None] * about[:, None, :], length, axis=0)
    return np.sqrt(2 * interval) * transformed[at]
