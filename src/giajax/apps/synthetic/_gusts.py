"""Gusts: a wind that changes in time, as rows that a run records.

The spectra are von Karman's (Progress in the statistical theory of turbulence, PNAS 34, 1948,
p. 530) for isotropic turbulence of standard deviation sigma and longitudinal length scale L that a
mean flow U carries past the arm, with a = 1.339 and n = f L / U:

    along the mean:   S(f) = 4 sigma^2 L/U / (1 + (2 pi a n)^2)^(5/6),
    across it:        S(f) = 2 sigma^2 L/U (1 + 8/3 (2 pi a n)^2) / (1 + (2 pi a n)^2)^(11/6).

The gusts are sums of cosines with random phases (Shinozuka and Deodatis, Simulation of stochastic
processes by spectral representation, Applied Mechanics Reviews 44, 1991, p. 191). They have no
frequency that their rows would not resolve, so they are smooth, as added mass needs them.

They are the same along the whole arm, unless its places are given. Then they are coherent over
distances: two places at r across the mean flow have the coherence

    exp(-a sqrt((f r / U)^2 + (0.12 r / L)^2)),    a = 12,

of IEC 61400-1 (Wind energy generation systems, design requirements, annex of turbulence models),
which is Davenport's exponential (The spectrum of horizontal gustiness near the ground in high
winds, Quarterly Journal of the Royal Meteorological Society 87, 1961, p. 194) but for the second
term: that one makes slow gusts end after some length scales, too. It is the root of the coherence
of power, and used for all components. Along the mean flow gusts come later, by the distance over
its speed (Taylor's frozen turbulence). At each frequency its matrix is factored (Shinozuka and Jan,
Digital simulation of random processes and its applications, Journal of Sound and Vibration 25,
1972, p. 111; Deodatis, Simulation of ergodic multivariate stochastic processes, Journal of
Engineering Mechanics 122, 1996, p. 778). All factors have the same frequencies here, so that
variances and coherences of places are right in the mean over seeds, and not of each run.
"""

import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Float
from ...runtime.text import InputError
from ._drive import Drive

RESOLVED = 0.5
"""Highest frequency of gusts, as a share of the Nyquist frequency: the gusts contain no periods
shorter than four samples.
"""

DECAY = 12.0
"""Default decay of the coherence of gusts with distance, from IEC 61400-1."""

_SLOW = 0.12  # of slow gusts, whose coherence ends after some length scales, in IEC 61400-1
_LAMBDA = 2 * np.pi * 1.339


def gusts_left_out(speed: float, *, length_scale: float, interval: float) -> tuple[float, float]:
    """Shares of the variance of gusts that are quicker than their rows can say, and left out.

    One is along the mean flow (m/s) and one across it; the length scale is in m, the interval
    between two rows in s. At the other end of the spectrum about 1 % is left out, too.
    """
    highest = RESOLVED / (2 * interval)
    frequencies = np.geomspace(highest, 1e4 * max(highest, speed / length_scale), 4001)
    carried = {"speed": speed, "length_scale": length_scale}
    along, across = (
        gust_spectrum(frequencies, deviation=1.0, along=so, **carried) for so in (True, False)
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
    """Von Karman's one-sided spectrum of one component of isotropic turbulence, m^2/s^2 per Hz.

    Its integral from 0 is the variance.

    Arguments:
        frequencies: Hz.
        speed, deviation: of the mean flow, and standard deviation of the component, m/s.
        length_scale: longitudinal length scale, m.
        along: of the component along the mean flow, or of one across it.
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
    """Root coherences of gusts at places (m) and frequencies (Hz); 1 on the diagonal.

    The lag along the mean flow, a direction of length 1, is left out. Speed is in m/s, the length
    scale in m; the decay is over distances across the mean flow.
    """
    apart = places[:, None] - places[None]
    across = np.linalg.norm(apart - (apart @ along)[..., None] * along, axis=-1)
    rates = np.hypot(np.asarray(frequency) / speed, _SLOW / length_scale)
    root: np.ndarray = np.exp(-decay * across * rates[..., None, None])
    return root


def wind_frame(along: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Along the mean flow, and two directions across it, the first as level as can be."""
    upwards = np.array([0.0, 0.0, 1.0]) if abs(along[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    level = np.cross(upwards, along)
    level = level / np.linalg.norm(level)
    return along, level, np.cross(along, level)


# Below the lowest frequency, a period of 400 times L/U, there is 1 % of the variance.
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
    """An unsteady wind, the same along the whole arm or coherent from link to link.

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
        places: of the links where the arm rests, m, shape (link, 3); None for one wind.
        decay: of the coherence over distances, a above; 0 for one wind but for its lag.
        lines: number of frequencies, evenly spaced in their logarithm. In a long record bins of a
            spectrum are narrower than lines are apart, and some have none, unless there are more.

    Returns:
        The wind at its rows, linear between them: `wind_x`, `wind_y`, `wind_z`, or with places
        `link01_wind_x` and on.

    Raises:
        InputError: no mean flow, numbers that are not positive, or places of another shape.

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
            raise InputError(f"the decay of gusts is {decay:g}: give a number of at least 0")
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
        # One after the other: a table of all would be hundreds of times as large as the run.
        for frequency, size, phase in zip(frequencies, sizes, phases, strict=True):
            turned = 2 * np.pi * frequency * (times - start)
            if where is None:
                gust += size * np.cos(turned[:, None] + phase)
                continue
            coherence = gust_coherence(where, frequency, along=along, decay=decay, **carried)
            # Places that are one have the same wind.
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
