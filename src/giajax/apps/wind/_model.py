"""Expected spectra and means of the record of an arm, as a function of the numbers of a wind."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from ...models import ArmModel
from ...runtime.text import InputError
from ._record import TAPERS, Resting, bands
from ._response import Linear, Turbulence, at_rest, channel_spectra, motion_covariances

NUMBERS = ("speed", "deviation", "length_scale", "decay", "heading", "climb")
"""Names of the numbers that describe a wind, in the order of a result."""

UNITS = {"speed": "m/s", "deviation": "m/s", "length_scale": "m", "decay": ""}
UNITS |= {"heading": "rad", "climb": "rad"}
USUALLY = ("speed", "deviation", "length_scale")
TURNS = ("heading", "climb")


class Numbers:
    """Free numbers of a wind and of the noise, as the coordinates of a fit.

    The fit starts at the given wind. The noise of each quantity is free if the record does not give
    it.
    """

    def __init__(self, wind: Turbulence, free: Sequence[str], record: Resting) -> None:
        self.wind = wind
        self.free = tuple(name for name in NUMBERS if name in free)
        stated = record.noise
        self.white = np.array([0.0 if one is None else one[0] for one in stated])
        pairs = zip(record.quantities, stated, strict=True)
        unstated = [quantity if one is None else "" for quantity, one in pairs]
        self.open = tuple(dict.fromkeys(filter(None, unstated)))
        self.which = [np.array([each == name for each in unstated]) for name in self.open]
        # Names of the coordinates.
        self.names = (*self.free, *(f"noise of {name.replace('_', ' ')}" for name in self.open))

    def start(self, deviations: np.ndarray) -> np.ndarray:
        """Return the initial coordinates, for standard deviations of each channel's noise, SI."""
        turns = dict(zip(TURNS, _turns(self.wind.mean), strict=True))
        wind = [turns[n] if n in TURNS else np.log(getattr(self.wind, n)) for n in self.free]
        return np.array(wind + [np.log(np.median(deviations[which])) for which in self.which])

    def at(self, coordinates: np.ndarray) -> tuple[Turbulence, np.ndarray]:
        """Return the wind, and the standard deviation of the white noise of each channel, SI."""
        split = len(self.free)
        value = dict(zip(self.free, coordinates[:split], strict=True))
        heading, climb = (
            value.get(name, turn) for name, turn in zip(TURNS, _turns(self.wind.mean), strict=True)
        )
        flat = np.cos(climb)
        along = np.array([flat * np.cos(heading), flat * np.sin(heading), np.sin(climb)])
        speed, deviation, length_scale, decay = (
            float(np.exp(value[name])) if name in value else float(getattr(self.wind, name))
            for name in ("speed", "deviation", "length_scale", "decay")
        )
        white = self.white.copy()
        for which, level in zip(self.which, coordinates[split:], strict=True):
            white[which] = np.exp(level)
        wind = Turbulence(along * speed, deviation, length_scale, decay, self.wind.shares)
        return wind, white

    def value(self, name: str, wind: Turbulence) -> float:
        """Return a number of a wind by its name."""
        if name in TURNS:
            return float(_turns(wind.mean)[TURNS.index(name)])
        return float(getattr(wind, name))


def first_guess(
    mean: Sequence[float] | np.ndarray | None,
    intensity: float | Sequence[float],
    length_scale: float,
    decay: float,
) -> Turbulence:
    """Return the initial wind of a fit; the arguments are as in `fit_wind`."""
    flow = np.zeros(3) if mean is None else np.asarray(mean, float)
    if flow.shape != (3,) or not np.all(np.isfinite(flow)) or not np.any(flow):
        raise InputError(
            "the initial mean wind is missing or 0, where the drag cannot be linearised: give "
            "an approximate velocity, three numbers in m/s"
        )
    parts = np.asarray(intensity, float)
    sound = np.all(np.isfinite(parts) & (parts >= 0))
    if parts.shape not in ((), (3,)) or not sound or not parts.flat[0] > 0:
        raise InputError(
            f"the initial intensity is {np.array2string(parts)}: give one number or three, "
            "the first of them positive"
        )
    if not (0 < length_scale < np.inf and 0 <= decay < np.inf):
        raise InputError(
            f"the initial length scale is {length_scale:g} m, and the initial decay is {decay:g}: "
            "give a positive length scale, and a decay of at least 0"
        )
    along, level, up = np.broadcast_to(parts / parts.flat[0], 3).tolist()
    deviation = float(parts.flat[0] * np.linalg.norm(flow))
    return Turbulence(flow, deviation, length_scale, decay, (along, level, up))


def _turns(mean: np.ndarray) -> tuple[float, float]:
    """Return the heading, from x towards y, and the climb of a mean flow, rad."""
    return float(np.arctan2(mean[1], mean[0])), float(np.arctan2(mean[2], np.hypot(*mean[:2])))


# Whittle's likelihood of the spectra and the mean of a record, with its gradient and information.
#
# The tapered transforms of a stationary record in separate bands are independent complex normal
# variables (Whittle, Estimation and information in stationary time series, Arkiv for Matematik 2,
# 1953, p. 423). Their covariance is the spectrum, averaged by the tapers. The mean of the record is
# normal, and its covariance follows from the spectrum near zero frequency.


class Expected(NamedTuple):
    """Prediction of a model for a record.

    Attributes:
        spectra: one-sided spectra, averaged by the tapers, SI units squared per Hz, shape
            (band, channel, channel).
        mean: means of the channels, shape (channel,); None if they are not predicted.
        covariance: covariance of these means, shape (channel, channel); None if they are not
            predicted.
    """

    spectra: np.ndarray
    mean: np.ndarray | None
    covariance: np.ndarray | None


class Recorded(NamedTuple):
    """Transforms, shape (band, taper, channel), and means, shape (channel,), of a record."""

    transforms: np.ndarray
    mean: np.ndarray


Model = Callable[[np.ndarray], Expected]

# Step of the finite differences, for logarithms and for angles in rad.
_STEP = 1e-3
_REFUSED = 8  # rejected steps in a row, each a quarter of the previous one, that end the fit
_OPTIONS = {"initial_trust_radius": 0.3, "max_trust_radius": 0.7, "gtol": 0.1, "maxiter": 40}


def log_likelihood(expected: Expected, recorded: Recorded) -> float:
    """Return the logarithm of the likelihood, up to a constant."""
    sizes = np.linalg.slogdet(expected.spectra)[1]
    total = -TAPERS * np.sum(sizes) - np.sum(np.abs(whitened(expected, recorded)) ** 2)
    if expected.mean is not None and expected.covariance is not None:
        off = recorded.mean - expected.mean
        total -= 0.5 * off @ np.linalg.solve(expected.covariance, off)
        total -= 0.5 * np.linalg.slogdet(expected.covariance)[1]
    return float(total)


def whitened(expected: Expected, recorded: Recorded) -> np.ndarray:
    """Return transforms as independent variables of variance 1, shape (band, channel, taper)."""
    lower = np.linalg.cholesky(expected.spectra)
    return np.linalg.solve(lower, recorded.transforms.swapaxes(1, 2))


def slopes(model: Model, at: np.ndarray) -> list[Expected]:
    """Return the derivatives of a prediction for each coordinate, by central differences."""
    found = []
    for index in range(len(at)):
        step = np.zeros(len(at))
        step[index] = _STEP
        up, down = model(at + step), model(at - step)
        parts: Any = [
            None if a is None or b is None else (a - b) / (2 * _STEP)
            for a, b in zip(up, down, strict=True)
        ]
        found.append(Expected(*parts))
    return found


def gradient_and_information(
    expected: Expected, by: list[Expected], recorded: Recorded
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradient of the log-likelihood and the Fisher information.

    `by` contains the derivatives of the expected spectra and means for each coordinate.
    """
    count = len(by)
    inverse = np.linalg.inv(expected.spectra)
    shares = [inverse @ part.spectra for part in by]
    seen = recorded.transforms @ inverse.swapaxes(1, 2)  # rows are S^-1 y
    gradient = np.array(
        [
            -TAPERS * np.trace(share, axis1=1, axis2=2).real.sum()
            + np.einsum("bkc,bcd,bkd->", seen.conj(), part.spectra, seen).real
            for share, part in zip(shares, by, strict=True)
        ]
    )
    information = np.array(
        [[TAPERS * np.einsum("bij,bji->", one, other).real for one in shares] for other in shares]
    ).reshape(count, count)
    if expected.mean is None or expected.covariance is None:
        return gradient, information
    precision = np.linalg.inv(expected.covariance)
    pull = precision @ (recorded.mean - expected.mean)
    moves = np.array([part.mean for part in by])
    widths = [precision @ np.asarray(part.covariance) for part in by]
    gradient += moves @ pull
    gradient += [
        0.5 * pull @ np.asarray(part.covariance) @ pull - 0.5 * np.trace(width)
        for part, width in zip(by, widths, strict=True)
    ]
    information += moves @ precision @ moves.T
    information += [[0.5 * np.trace(one @ other) for one in widths] for other in widths]
    return gradient, information


def most_likely(
    model: Model,
    start: np.ndarray,
    recorded: Recorded,
    progress: Callable[[str], object] | None = None,
) -> OptimizeResult:
    """Return the maximum-likelihood coordinates, with the exact trust-region method of SciPy.

    The Fisher information is used instead of the second derivatives. In the result, `x` are the
    coordinates, `fun` is the negative log-likelihood, and `hess` is the information.
    """
    model(start)
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def cost(at: np.ndarray) -> float:
        try:
            return -log_likelihood(model(at), recorded)
        except (InputError, np.linalg.LinAlgError):
            return np.inf  # the step was too long; a shorter one follows

    def slopes_at(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = at.tobytes()
        if key not in known:
            known.clear()
            known[key] = gradient_and_information(model(at), slopes(model, at), recorded)
        return known[key]

    costs: list[float] = []

    def said(intermediate_result: OptimizeResult) -> None:
        costs.append(intermediate_result.fun)
        if progress is not None:
            progress(f"log-likelihood {-costs[-1]:.6g}")
        if len(costs) > _REFUSED and costs[-1] == costs[-1 - _REFUSED]:
            raise StopIteration

    return minimize(
        cost,
        start,
        callback=said,
        jac=lambda at: -slopes_at(at)[0],
        hess=lambda at: slopes_at(at)[1],
        method="trust-exact",
        options=_OPTIONS,
    )


# Tolerance of the iteration for the spread of the relative velocities, relative to the wind speed,
# and largest number of iterations.
_CLOSE = 1e-7
_ROUNDS = 40

# Frequencies at which the spectrum is integrated for the covariance of the mean, in bins.
_ABOUT_ZERO = np.linspace(0.0, 20.0, 161)


@dataclasses.dataclass
class WindModel:
    """Expected spectra and means of a record, as functions of a wind.

    The search for the equilibrium starts from that of the previous wind.
    """

    model: ArmModel
    record: Resting
    use_mean: bool
    places: np.ndarray | None = None
    _angles: np.ndarray | None = None
    _spread: np.ndarray | None = None

    def __post_init__(self) -> None:
        samples = len(self.record.values)
        self.bands = bands(samples, self.record.interval, self.record.highest)
        self.lasts = samples * self.record.interval

    def about(self, wind: Turbulence) -> tuple[Linear, np.ndarray, np.ndarray]:
        """Return the linearised arm, the covariance of its angles, and the places of its links."""
        spread = self._spread
        if spread is None:
            spread = np.tile(np.linalg.cholesky(wind.covariance()), (self.model.arm.count, 1, 1))
        angles = self.record.command if self._angles is None else self._angles
        given = (self.model, self.record.names, self.record.command)
        for _ in range(_ROUNDS):
            angles, here = at_rest(*given, angles, wind.mean, spread)
            places = np.asarray(here.places) if self.places is None else self.places
            covariance, relative = motion_covariances(here, wind, places)
            before, spread = spread, np.linalg.cholesky(relative)
            if np.max(np.abs(spread - before)) < _CLOSE * wind.speed:
                break
        else:
            raise InputError(
                "the gusts are too strong for the arm's motion to be linearised about its rest "
                "position: start from a weaker wind"
            )
        self._angles, self._spread = angles, spread
        return here, covariance, places

    def expected(self, wind: Turbulence, noise: np.ndarray) -> Expected:
        """Return the taper-averaged spectra and the means.

        Arguments:
            wind: wind that acts on the arm.
            noise: standard deviation of the white noise of each channel, SI units.
        """
        here, covariance, places = self.about(wind)

        def spectra(frequencies: np.ndarray) -> np.ndarray:
            total = channel_spectra(here, wind, places, frequencies, self.record.delays)
            return total + self.noise(frequencies, noise)

        seen = spectra(self.bands.frequencies)[self.bands.members].mean(axis=1)
        if not self.use_mean:
            return Expected(seen, None, None)
        # Add the second-order term of the mean of a nonlinear channel.
        mean = here.rest + 0.5 * np.einsum("cij,ij->c", here.bend, covariance)
        slow = spectra(np.maximum(_ABOUT_ZERO, 1e-6) / self.lasts).real
        window = np.sinc(_ABOUT_ZERO) ** 2 / self.lasts
        return Expected(seen, mean, np.trapezoid(window[:, None, None] * slow, _ABOUT_ZERO, axis=0))

    def noise(self, frequencies: np.ndarray, white: np.ndarray) -> np.ndarray:
        """Return one-sided diagonal spectra of the noise, shape (frequency, channel, channel)."""
        levels = np.tile(2 * white**2 * self.record.interval, (len(frequencies), 1))
        for index, stated in enumerate(self.record.noise):
            if stated is not None and stated[1]:
                _, deviation, lasts = stated
                turn = 2 * np.pi * frequencies * lasts
                levels[:, index] += 4 * deviation**2 * lasts / (1 + turn**2)
        return levels[:, :, None] * np.eye(levels.shape[1])

    def bent(self, wind: Turbulence) -> np.ndarray:
        """Return the standard deviation of the quadratic response over that of the linear one."""
        here, covariance, _ = self.about(wind)
        straight = np.einsum("ci,ij,cj->c", here.shows_angle, covariance, here.shows_angle)
        curved = here.bend @ covariance
        bent = 0.5 * np.einsum("cij,cji->c", curved, curved)
        moving = np.any(here.shows_rate, axis=1)
        return np.where(moving, 0.0, np.sqrt(bent / np.maximum(straight, 1e-300)))
