"""Spectra and coherence of gusts; `_gusts` has the formulae and where they come from."""

import numpy as np

from .._typing import Float

RESOLVED = 0.5
"""Of the frequency that rows resolve at all: gusts quicker than four rows are left out."""

DECAY = 12.0
"""Of the coherence of gusts over distances, in IEC 61400-1."""

# Of slow gusts, whose coherence ends after some length scales, in IEC 61400-1.
_SLOW = 0.12

_LAMBDA = 2 * np.pi * 1.339


def gusts_left_out(speed: float, *, length_scale: float, interval: float) -> tuple[float, float]:
    """How much of the variance of gusts is quicker than their rows can say, and left out.

    Arguments:
        speed: of the mean flow, m/s.
        length_scale: longitudinal length scale, m.
        interval: between two rows, s.

    Returns:
        Shares of the variance, along the mean flow and across it. At the other end of the
        spectrum about 1 % is left out, too.
    """
    highest = RESOLVED / (2 * interval)
    frequencies = np.geomspace(highest, 1e4 * max(highest, speed / length_scale), 4001)
    along, across = (
        gust_spectrum(frequencies, speed=speed, deviation=1.0, length_scale=length_scale, along=so)
        for so in (True, False)
    )
    # Beyond that the spectra fall by the power -5/3.
    beyond = 1.5 * frequencies[-1]
    return (
        float(np.trapezoid(along, frequencies) + beyond * along[-1]),
        float(np.trapezoid(across, frequencies) + beyond * across[-1]),
    )


def gust_spectrum(
    frequencies: Float[np.ndarray, " frequency"],
    *,
    speed: float,
    deviation: float,
    length_scale: float,
    along: bool,
) -> Float[np.ndarray, " frequency"]:
    """Von Karman's one-sided spectrum of one component of isotropic turbulence.

    Arguments:
        frequencies: Hz.
        speed: of the mean flow, m/s.
        deviation: standard deviation of the component, m/s.
        length_scale: longitudinal length scale, m.
        along: of the component along the mean flow, or of one across it.

    Returns:
        Its density, m^2/s^2 per Hz; its integral from 0 is the variance.
    """
    lasting = length_scale / speed
    square = (_LAMBDA * lasting * frequencies) ** 2
    if along:
        return 4 * deviation**2 * lasting / (1 + square) ** (5 / 6)
    return 2 * deviation**2 * lasting * (1 + 8 / 3 * square) / (1 + square) ** (11 / 6)


def gust_coherence(
    places: Float[np.ndarray, "place 3"],
    frequency: float,
    *,
    along: Float[np.ndarray, "3"],
    speed: float,
    length_scale: float,
    decay: float = DECAY,
) -> Float[np.ndarray, "place place"]:
    """How much of a gust two places have in common, but for its lag along the mean flow.

    Arguments:
        places: m.
        frequency: Hz.
        along: direction of the mean flow, of length 1.
        speed: of the mean flow, m/s.
        length_scale: longitudinal length scale, m.
        decay: over distances across the mean flow.

    Returns:
        Root coherences, 1 on the diagonal.
    """
    apart = places[:, None] - places[None]
    across = np.linalg.norm(apart - (apart @ along)[..., None] * along, axis=-1)
    root: np.ndarray = np.exp(-decay * across * np.hypot(frequency / speed, _SLOW / length_scale))
    return root


def wind_frame(along: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the mean flow, and two directions across it, the first as level as can be."""
    upwards = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = np.cross(upwards, along)
    level = level / np.linalg.norm(level)
    return along, level, np.cross(along, level)
