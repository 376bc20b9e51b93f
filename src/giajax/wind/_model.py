"""What an arm's record should be like in a wind, by the wind's numbers."""

import dataclasses

import numpy as np

from .._errors import InputError
from ..models import ArmModel
from ._linear import Linear, at_rest
from ._multitaper import bands
from ._response import Turbulence, channel_spectra, motion_covariances
from ._resting import Resting
from ._whittle import Expected

# How closely the spread of the relative velocities is that of the motion.
_CLOSE = 1e-7
_ROUNDS = 40

# Of the spectrum about zero that makes the mean of a record, in bins.
_ABOUT_ZERO = np.linspace(0.0, 20.0, 161)


@dataclasses.dataclass
class WindModel:
    """The expected spectra and means of a record, as functions of a wind.

    Where the last wind was balanced is where the next one begins.
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
        """The arm about its rest, the covariance of its angles and its places in the wind.

        Raises:
            InputError: it has no rest.
        """
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
                "the gusts and the arm's motion in them are too strong to be linearised about its "
                "rest: begin with a weaker wind"
            )
        self._angles, self._spread = angles, spread
        return here, covariance, places

    def expected(self, wind: Turbulence, noise: np.ndarray) -> Expected:
        """Spectra as tapers see them, and the mean.

        Arguments:
            wind: the wind.
            noise: deviation of white noise of each channel, SI.
        """
        here, covariance, places = self.about(wind)

        def spectra(frequencies: np.ndarray) -> np.ndarray:
            total = channel_spectra(here, wind, places, frequencies, self.record.delays)
            return total + self.noise(frequencies, noise)

        seen = spectra(self.bands.frequencies)[self.bands.members].mean(axis=1)
        if not self.use_mean:
            return Expected(seen, None, None)
        # Channels bend with the arm: the mean of a curve is beside its middle.
        mean = here.rest + 0.5 * np.einsum("cij,ij->c", here.bend, covariance)
        slow = spectra(np.maximum(_ABOUT_ZERO, 1e-6) / self.lasts).real
        window = np.sinc(_ABOUT_ZERO) ** 2 / self.lasts
        return Expected(seen, mean, np.trapezoid(window[:, None, None] * slow, _ABOUT_ZERO, axis=0))

    def noise(self, frequencies: np.ndarray, white: np.ndarray) -> np.ndarray:
        """One-sided spectra of the noise, diagonal, shape (frequency, channel, channel)."""
        levels = np.tile(2 * white**2 * self.record.interval, (len(frequencies), 1))
        for index, stated in enumerate(self.record.noise):
            if stated is not None and stated[1]:
                _, deviation, lasts = stated
                turn = 2 * np.pi * frequencies * lasts
                levels[:, index] += 4 * deviation**2 * lasts / (1 + turn**2)
        return levels[:, :, None] * np.eye(levels.shape[1])

    def bent(self, wind: Turbulence) -> np.ndarray:
        """Deviation of what bends of each channel over that of what does not."""
        here, covariance, _ = self.about(wind)
        straight = np.einsum("ci,ij,cj->c", here.shows_angle, covariance, here.shows_angle)
        curved = here.bend @ covariance
        bent = 0.5 * np.einsum("cij,cji->c", curved, curved)
        moving = np.any(here.shows_rate, axis=1)
        return np.where(moving, 0.0, np.sqrt(bent / np.maximum(straight, 1e-300)))
