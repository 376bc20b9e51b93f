"""Spectra of an arm's channels in gusts, from the arm about its rest."""

import dataclasses

import numpy as np

from ..synthetic import gust_coherence, gust_spectrum, wind_frame
from ._linear import Linear


@dataclasses.dataclass(frozen=True)
class Turbulence:
    """A wind by its numbers.

    Attributes:
        mean: velocity of the mean flow, m/s, shape (3,).
        deviation: standard deviation of the gusts along the mean flow, m/s.
        length_scale: longitudinal length scale, m.
        decay: of the coherence over distances.
        shares: deviations along the mean flow, across it on the level and across both, over
            the first of them.
    """

    mean: np.ndarray
    deviation: float
    length_scale: float
    decay: float
    shares: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def speed(self) -> float:
        """Of the mean flow, m/s."""
        return float(np.linalg.norm(self.mean))

    def covariance(self) -> np.ndarray:
        """Of the gusts at one place, m^2/s^2, shape (3, 3)."""
        frame = np.stack(wind_frame(self.mean / self.speed))
        return frame.T @ np.diag((self.deviation * np.asarray(self.shares)) ** 2) @ frame

    def roots(
        self, places: np.ndarray, frequencies: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Directions of the gusts, and roots of their spectra at places.

        Arguments:
            places: m, shape (place, 3).
            frequencies: Hz, shape (frequency,).

        Returns:
            For each component its direction, and R with R R^H its one-sided spectra, shape
            (frequency, place, place).
        """
        along = self.mean / self.speed
        carried = {"speed": self.speed, "length_scale": self.length_scale}
        coherence = np.stack(
            [
                gust_coherence(places, float(f), along=along, decay=self.decay, **carried)
                for f in frequencies
            ]
        )
        # Places that are one have the same wind.
        root = np.linalg.cholesky(coherence + 1e-9 * np.eye(len(places)))
        late = np.exp(-2j * np.pi * frequencies[:, None] * (places @ along) / self.speed)
        parts = []
        for component, axis in enumerate(wind_frame(along)):
            spectrum = gust_spectrum(
                frequencies,
                deviation=self.deviation * self.shares[component],
                along=component == 0,
                **carried,
            )
            parts.append((axis, np.sqrt(spectrum)[:, None, None] * late[..., None] * root))
        return parts


def joint_responses(here: Linear, frequencies: np.ndarray) -> np.ndarray:
    """Angles of the joints by the wind of each link.

    Arguments:
        here: the arm about its rest.
        frequencies: Hz.

    Returns:
        Complex amplitudes, rad per m/s, shape (frequency, joint, link, 3).
    """
    turn = 2j * np.pi * frequencies[:, None, None]
    joints = len(here.by_angle)
    motion = turn**2 * np.eye(joints) - turn * here.by_rate - here.by_angle
    push = here.by_wind + turn[..., None] * here.by_wind_rate
    flat = push.reshape(len(frequencies), joints, -1)
    return np.linalg.solve(motion, flat).reshape(push.shape)


def channel_responses(here: Linear, frequencies: np.ndarray, delays: np.ndarray) -> np.ndarray:
    """Channels by the angles of the joints.

    Arguments:
        delays: of each channel, s; the others are those of `joint_responses`.

    Returns:
        Shape (frequency, channel, joint).
    """
    turn = 2j * np.pi * frequencies[:, None, None]
    late = np.exp(-turn * delays[None, :, None])
    return late * (here.shows_angle + turn * here.shows_rate)


def channel_spectra(
    here: Linear, wind: Turbulence, places: np.ndarray, frequencies: np.ndarray, delays: np.ndarray
) -> np.ndarray:
    """One-sided spectra of the channels without noise, SI^2/Hz.

    Arguments:
        places: where the links are to the wind, m, shape (link, 3).

    Returns:
        Shape (frequency, channel, channel).
    """
    shown = channel_responses(here, frequencies, delays) @ joint_responses(
        here, frequencies
    ).reshape(len(frequencies), len(here.by_angle), -1)
    shown = shown.reshape(len(frequencies), -1, len(places), 3)
    total = np.zeros((len(frequencies), shown.shape[1], shown.shape[1]), complex)
    for axis, root in wind.roots(places, frequencies):
        part = (shown @ axis) @ root
        total += part @ part.conj().swapaxes(1, 2)
    return total


def motion_covariances(
    here: Linear, wind: Turbulence, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the angles, rad^2, and of each link's velocity relative to the air, m^2/s^2.

    Returns:
        Shapes (joint, joint) and (link, 3, 3).
    """
    # From a thousand times what a gust lasts to a hundredth of it.
    frequencies = np.geomspace(1e-3, 1e2, 141) * wind.speed / wind.length_scale
    turned = joint_responses(here, frequencies)
    rates = 2j * np.pi * frequencies[:, None, None, None]
    angles = np.zeros((len(frequencies), *here.by_angle.shape))
    relative = np.zeros((len(frequencies), len(places), 3, 3))
    for axis, root in wind.roots(places, frequencies):
        moved = (turned @ axis) @ root
        angles += np.real(moved @ moved.conj().swapaxes(1, 2))
        follows = np.einsum("lcj,fjm->flcm", here.moves, rates[..., 0] * moved)
        apart = axis[None, None, :, None] * root[:, :, None, :] - follows
        relative += np.real(apart @ apart.conj().swapaxes(2, 3))
    of_links = np.asarray(np.trapezoid(relative, frequencies, axis=0))
    # What is slower and quicker than the grid is as it is for an arm that does not follow.
    known = np.trapezoid(
        sum(np.abs(root[:, 0, 0]) ** 2 for _, root in wind.roots(places[:1], frequencies)),
        frequencies,
    )
    beyond = 1 - known / np.trace(wind.covariance())
    return np.asarray(
        np.trapezoid(angles, frequencies, axis=0)
    ), of_links + beyond * wind.covariance()
