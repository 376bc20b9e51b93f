"""Gusts: a wind that changes in time, as rows that a run records.

The spectra are von Karman's (Progress in the statistical theory of turbulence, PNAS 34, 1948,
p. 530) for isotropic turbulence of standard deviation sigma and longitudinal length scale L that a
mean flow U carries past the arm, with a = 1.339 and n = f L / U:

    along the mean:   S(f) = 4 sigma^2 L/U / (1 + (2 pi a n)^2)^(5/6),
    across it:        S(f) = 2 sigma^2 L/U (1 + 8/3 (2 pi a n)^2) / (1 + (2 pi a n)^2)^(11/6).

The gusts are sums of cosines with random phases (Shinozuka and Deodatis, Simulation of stochastic
processes by spectral representation, Applied Mechanics Reviews 44, 1991, p. 191). They have no
frequency that their rows would not resolve, so they are smooth, as added mass needs them.

They are the same along the whole arm: one velocity of the air at a time.
"""

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._typing import Float
from ._drive import Drive

# Bands of frequency, evenly spaced in their logarithm. Below the lowest, a period of 400 times L/U,
# there is 1 % of the variance.
_BANDS = 400
_LOWEST = 0.0025
# Of the frequency that rows resolve at all.
_RESOLVED = 0.5

_LAMBDA = 2 * np.pi * 1.339


def gusts(
    mean: npt.ArrayLike,
    *,
    intensity: npt.ArrayLike,
    length_scale: float,
    duration: float,
    start: float = 0.0,
    interval: float = 0.1,
    seed: int = 0,
) -> Drive:
    """An unsteady wind, the same along the whole arm.

    Arguments:
        mean: velocity of the mean flow in the base frame, m/s, shape (3,); not 0, because it is
            what carries the gusts past the arm.
        intensity: of the turbulence: standard deviations over the mean speed, one number, or one
            along the mean flow, one across it on the level and one across both.
        length_scale: longitudinal length scale L, m; a gust lasts about L over the mean speed.
        duration: of the wind, s.
        start: first time, s.
        interval: between two rows, s; gusts quicker than four of them are left out
            (`gusts_left_out` says how much of the variance that is).
        seed: of the phases. A component has its own, whatever the others are.

    Returns:
        The wind `wind_x`, `wind_y`, `wind_z` at its rows, linear between them.

    Raises:
        InputError: no mean flow, or numbers that are not positive.

    Example:
        >>> import giajax
        >>> wind = giajax.gusts([0.0, 0.2, 0.0], intensity=0.3, length_scale=5.0, duration=25.0)
        >>> sorted(wind.values)
        ['wind_x', 'wind_y', 'wind_z']
    """
    mean = np.asarray(mean, dtype=float)
    if mean.shape != (3,) or not np.all(np.isfinite(mean)) or not np.any(mean):
        raise InputError(
            f"the mean wind is {np.array2string(mean)}: give three numbers in m/s that are not all "
            "0, because the mean flow carries the gusts past the arm"
        )
    parts = np.asarray(intensity, dtype=float)
    if seed < 0:
        raise InputError(f"the seed of gusts is {seed}: give a whole number of at least 0")
    sound = np.all((parts >= 0) & (parts < np.inf)) and np.any(parts)
    if parts.shape not in ((), (3,)) or not sound:
        raise InputError(
            f"the intensity of gusts is {np.array2string(parts)}: give one number or three, none "
            "of them negative and not all of them 0"
        )
    for name, value in {
        "length_scale": length_scale,
        "duration": duration,
        "interval": interval,
    }.items():
        if not 0 < value < np.inf:
            raise InputError(f"the {name} of gusts is {value:g}: give a positive number")
    speed = float(np.linalg.norm(mean))
    rows = max(round(duration / interval), 1)
    times = start + np.linspace(0.0, duration, rows + 1)
    highest = _RESOLVED * rows / (2 * duration)
    edges = np.geomspace(min(_LOWEST * speed / length_scale, highest / 10), highest, _BANDS + 1)
    frequencies = np.sqrt(edges[1:] * edges[:-1])
    velocity = np.tile(mean, (len(times), 1))
    deviations = speed * np.broadcast_to(parts, 3)
    for component, axis in enumerate(_frame(mean / speed)):
        spectrum = gust_spectrum(
            frequencies,
            speed=speed,
            deviation=float(deviations[component]),
            length_scale=length_scale,
            along=component == 0,
        )
        sizes = np.sqrt(2 * spectrum * np.diff(edges))
        phases = 2 * np.pi * np.random.default_rng([seed, component]).uniform(size=_BANDS)
        gust = np.zeros(len(times))
        # One after the other: a table of all would be hundreds of times as large as the run.
        for frequency, size, phase in zip(frequencies, sizes, phases, strict=True):
            gust += size * np.cos(2 * np.pi * frequency * (times - start) + phase)
        velocity += np.outer(gust, axis)
    columns = {f"wind_{axis}": velocity[:, at] for at, axis in enumerate("xyz")}
    return Drive(times, columns, "linear")


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
    highest = _RESOLVED / (2 * interval)
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


def _frame(along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the mean flow, and two directions across it, the first as level as can be."""
    upwards = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = np.cross(upwards, along)
    level = level / np.linalg.norm(level)
    return along, level, np.cross(along, level)
