"""Gusts: an unsteady wind in the form of recorded rows.

The spectra are von Karman's (Progress in the statistical theory of turbulence, PNAS 34, 1948,
p. 530) for isotropic turbulence of standard deviation sigma and longitudinal length scale L that a
mean flow U carries past the arm, with a = 1.339 and n = f L / U:

    along the mean:   S(f) = 4 sigma^2 L/U / (1 + (2 pi a n)^2)^(5/6),
    across it:        S(f) = 2 sigma^2 L/U (1 + 8/3 (2 pi a n)^2) / (1 + (2 pi a n)^2)^(11/6).

The gusts are sums of cosines with random phases (Shinozuka and Deodatis, Simulation of stochastic
processes by spectral representation, Applied Mechanics Reviews 44, 1991, p. 191). They contain only
frequencies that their rows resolve. They are therefore smooth, as the added mass requires.

By default they are the same along the whole arm. If the positions of the links are given, the gusts
are coherent over distances: two positions at a distance r across the mean flow have the coherence

    exp(-a sqrt((f r / U)^2 + (0.12 r / L)^2)),    a = 12,

of IEC 61400-1 (Wind energy generation systems, design requirements, annex of turbulence models).
This is Davenport's exponential (The spectrum of horizontal gustiness near the ground in high winds,
Quarterly Journal of the Royal Meteorological Society 87, 1961, p. 194) with a second term, which
limits the extent of slow gusts to some length scales. It is the square root of the coherence of
power, and is used for all components. Along the mean flow gusts are delayed by the distance divided
by its speed (Taylor's frozen turbulence). The coherence matrix of each frequency is factored
(Shinozuka and Jan, Digital simulation of random processes and its applications, Journal of Sound
and Vibration 25, 1972, p. 111; Deodatis, Simulation of ergodic multivariate stochastic processes,
Journal of Engineering Mechanics 122, 1996, p. 778). All factors have the same frequencies here.
Variances and coherences are therefore exact in the mean over seeds, but not in each run.
"""

import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Float
from ...runtime.text import InputError
from ._drive import Drive

RESOLVED = 0.5
"""Highest frequency of gusts, as a fraction of the Nyquist frequency: the gusts contain no periods
shorter than four samples.
"""

DECAY = 12.0
"""Default decay of the coherence of gusts with distance, from IEC 61400-1."""

_SLOW = 0.12  # Coefficient that limits the extent of slow gusts, from IEC 61400-1.
_LAMBDA = 2 * np.pi * 1.339


def gusts_left_out(speed: float, *, length_scale: float, interval: float) -> tuple[float, float]:
    """Return the shares of the gust variance at frequencies that the rows cannot resolve.

    These frequencies are left out. The first share is along the mean flow (m/s), the second across
    it. The length scale is in m, and the interval between two rows in s. At the low end of the
    spectrum about 1 % is left out in addition.
    """
    highest = RESOLVED / (2 * interval)
    frequencies = np.geomspace(highest, 1e4 * max(highest, speed / length_scale), 4001)
    carried = {"speed": speed, "length_scale": length_scale}
    along, across = (
        gust_spectrum(frequencies, deviation=1.0, along=so, **carried) for so in (True, False)
    )
    # Above the last frequency the spectra decrease with the power -5/3.
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
    """Return von Karman's one-sided spectrum of one component of turbulence, m^2/s^2 per Hz.

    The integral of the spectrum from 0 is the variance.

    Arguments:
        frequencies: frequencies, Hz.
        speed, deviation: speed of the mean flow and standard deviation of the component, m/s.
        length_scale: longitudinal length scale, m.
        along: whether the component is along the mean flow, or across it.
    """
    lasting = length_scale / speed
    square = (_LAMBDA * lasting * frequencies) ** 2
    if along:
        return 4 * deviation**2 * lasting / (1 + square) ** (5 / 6)
    return 2 * deviation**2 * lasting * (1 + 8 / 3 * square) / (1 + square) ** (11 / 6)


def gust_coherence(
    places: Float[np.ndarray, "place 3"],
    frequency: npt.ArrayLike,
    *,
    along: Float[np.ndarray, "3"],
    speed: float,
    length_scale: float,
    decay: float = DECAY,
) -> Float[np.ndarray, "*frequency place place"]:
    """Return the root coherences of gusts at places (m) and frequencies (Hz); 1 on the diagonal.

    The lag along the mean flow is not included. `along` is the direction of the mean flow, of
    length 1. The speed is in m/s, the length scale in m. The decay applies to distances across the
    mean flow.
    """
    apart = places[:, None] - places[None]
    across = np.linalg.norm(apart - (apart @ along)[..., None] * along, axis=-1)
    rates = np.hypot(np.asarray(frequency) / speed, _SLOW / length_scale)
    root: np.ndarray = np.exp(-decay * across * rates[..., None, None])
    return root


def wind_frame(along: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the mean flow direction and two directions across it, the first one horizontal."""
    upwards = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = np.cross(upwards, along)
    level = level / np.linalg.norm(level)
    return along, level, np.cross(along, level)


# The lowest frequency has a period of 400 L/U. About 1 % of the variance is below it.
_LINES = 400
_LOWEST = 0.0025


def gusts(
    mean: npt.ArrayLike,
    *,
    intensity: npt.ArrayLike,
    length_scale: float,
    duration: float,
    start: float = 0.0,
    interval: float = 0.1,
    seed: int = 0,
    places: npt.ArrayLike | None = None,
    decay: float = DECAY,
    lines: int = _LINES,
) -> Drive:
    """Return an unsteady wind, either the same along the whole arm or coherent from link to link.

    Arguments:
        mean: velocity of the mean flow in the base frame, m/s, shape (3,). It must not be 0,
            because the mean flow carries the gusts past the arm.
        intensity: turbulence intensity: standard deviations divided by the mean speed. Either one
            number, or three: along the mean flow, horizontally across it, and across both.
        length_scale: longitudinal length scale L, m; a gust lasts about L divided by the mean
            speed.
        duration: duration of the wind, s.
        start: first time, s.
        interval: interval between two rows, s. Gusts with periods below four intervals are left out
            (`gusts_left_out` returns their share of the variance).
        seed: seed of the phases. Each component has its own phases, independent of the others.
        places: positions of the links of the resting arm, m, shape (link, 3); None for a uniform
            wind.
        decay: decay of the coherence with distance, a above. With 0 the wind is uniform except for
            its lag.
        lines: number of frequencies, evenly spaced in their logarithm. In a long record, the bins
            of a spectrum may be narrower than the spacing of the lines, so that some bins are
            empty.

    Returns:
        The rows of the wind, with linear interpolation: `wind_x`, `wind_y` and `wind_z`, or with
        places `link01_wind_x` and so on.

    Raises:
        InputError: no mean flow, a number that is not positive, or places of a wrong shape.

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
    if lines < 1:
        raise InputError(
            f"the number of spectral lines of the gusts is {lines}: give a whole number of at "
            "least 1"
        )
    if seed < 0:
        raise InputError(f"the seed of gusts is {seed}: give a whole number of at least 0")
    sound = np.all((parts >= 0) & (parts < np.inf)) and np.any(parts)
    if parts.shape not in ((), (3,)) or not sound:
        raise InputError(
            f"the intensity of gusts is {np.array2string(parts)}: give one or three numbers, none "
            "of them negative and not all of them 0"
        )
    given = {"length_scale": length_scale, "duration": duration, "interval": interval}
    for name, value in given.items():
        if not 0 < value < np.inf:
            raise InputError(f"the {name} of gusts is {value:g}: give a positive number")
    speed = float(np.linalg.norm(mean))
    rows = max(round(duration / interval), 1)
    times = start + np.linspace(0.0, duration, rows + 1)
    highest = RESOLVED * rows / (2 * duration)
    edges = np.geomspace(min(_LOWEST * speed / length_scale, highest / 10), highest, lines + 1)
    frequencies = np.sqrt(edges[1:] * edges[:-1])
    where = None if places is None else np.asarray(places, dtype=float)
    if where is not None:
        if where.ndim != 2 or where.shape[1:] != (3,) or not np.all(np.isfinite(where)):
            raise InputError(
                f"the positions for the gusts have the shape {where.shape}: give x, y and z of "
                "each link in m"
            )
        if not 0 <= decay < np.inf:
            raise InputError(
                f"the decay coefficient of the gust coherence is {decay:g}: give a number of "
                "at least 0"
            )
    count = 1 if where is None else len(where)
    velocity = np.tile(mean, (len(times), count, 1))
    deviations = speed * np.broadcast_to(parts, 3)
    along = mean / speed
    carried = {"speed": speed, "length_scale": length_scale}
    for component, (axis, deviation) in enumerate(
        zip(wind_frame(along), deviations.tolist(), strict=True)
    ):
        if deviation == 0:
            continue
        spectrum = gust_spectrum(frequencies, deviation=deviation, along=component == 0, **carried)
        sizes = np.sqrt(2 * spectrum * np.diff(edges))
        phases = 2 * np.pi * np.random.default_rng([seed, component]).uniform(size=(lines, count))
        gust = np.zeros((len(times), count))
        # Add the frequencies one by one: a table of all would be hundreds of times as large as the
        # run.
        for frequency, size, phase in zip(frequencies, sizes, phases, strict=True):
            turned = 2 * np.pi * frequency * (times - start)
            if where is None:
                gust += size * np.cos(turned[:, None] + phase)
                continue
            coherence = gust_coherence(where, frequency, along=along, decay=decay, **carried)
            # The small diagonal term is needed because coincident places make the matrix singular.
            root = np.linalg.cholesky(coherence + 1e-9 * np.eye(count))
            late = np.exp(-2j * np.pi * frequency * (where @ along) / speed)
            here = root @ np.exp(1j * phase) * late
            gust += size * np.real(np.exp(1j * turned)[:, None] * here)
        velocity += gust[:, :, None] * axis
    columns = {
        f"{'' if where is None else f'link{link + 1:02d}_'}wind_{axis}": velocity[:, link, at]
        for link in range(count)
        for at, axis in enumerate("xyz")
    }
    return Drive(times, columns, "linear")
