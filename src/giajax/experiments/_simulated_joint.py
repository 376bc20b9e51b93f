"""A simulated 1-link arm that stands for the paper's prototype of section IV.A.

It is made of other parts than what is fitted to it: Preisach hysteresis of the film, Bouc-Wen
hysteresis of the muscles, and a joint that snaps through about 0 deg.
"""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..hysteresis import BoucWen, Preisach

Degrees = npt.NDArray[np.float64]

RANGE = 60.0


@dataclass(frozen=True)
class SimulatedJoint:
    """Angle of a joint by its command, both in degrees, at rest after each step.

    The command, through the hysteresis of film and muscles, gives a drive x. The angle is
    x + gap exp(-x / decay) on the positive side, and the mirror image of that on the negative one.
    Within the gap about 0 the stiffness is negative and the joint does not stay: it snaps through
    when the drive goes beyond the snap. So it is soft about 0, and follows further out.

    Attributes:
        gap: angles on the positive and the negative side where the joint does not stay, deg.
        decay: drive within which the effect of the gap goes down, above the gap, deg.
        snap: drive at which it snaps through, deg.
        film: share of the film in the drive; `film_width`, `film_spread` and `film_scatter` are
            half-width (deg), spread and centre spread (deg) of its Preisach density.
        muscle: share of the muscles' hysteresis in the drive.
        muscle_travel: command (deg) within which a muscle goes from one branch to the other.
        pressure_noise: standard deviation of the drive from step to step, deg.
        inclination: of the camera, added to every measured angle, deg.
        marker_noise: standard deviation of a marker's position, m.
        marker_distance: between the two markers, m.
        seed: of the noise.
    """

    gap: tuple[float, float] = (12.6, 12.3)
    decay: float = 30.0
    snap: float = 0.3
    film: float = 0.95
    film_width: float = 14.0
    film_spread: float = 0.6
    film_scatter: float = 40.0
    muscle: float = 0.04
    muscle_travel: float = 8.0
    pressure_noise: float = 0.05
    inclination: float = 1.5
    marker_noise: float = 0.001
    marker_distance: float = 0.4
    seed: int = 0

    def drive(self, commands: npt.ArrayLike) -> Degrees:
        """Command after the hysteresis of film and muscles, deg, shape (sample,)."""
        u = jnp.asarray(np.asarray(commands, dtype=float) / RANGE)
        film = Preisach(
            slope=jnp.asarray(0.0),
            saturation=jnp.asarray(1.0),
            coercivity=jnp.asarray(self.film_width / RANGE),
            coercivity_spread=jnp.asarray(self.film_spread),
            bias=jnp.asarray(0.0),
            interaction=jnp.asarray(self.film_scatter / RANGE),
            extent=1.1,
            rows=60,
        )
        rate = RANGE / self.muscle_travel
        muscle = BoucWen(
            elastic=jnp.asarray(0.0),
            alpha=jnp.asarray(rate),
            beta=jnp.asarray(rate),
            gamma=jnp.asarray(0.8),
            delta=jnp.asarray(0.2),
            nu=jnp.asarray(1.0),
        )
        elastic = 1 - self.film - self.muscle
        parts = self.film * film.history(u)[0] + self.muscle * muscle.history(u)[0]
        return RANGE * np.asarray(elastic * u + parts)

    def rest_angles(self, drive: Degrees) -> Degrees:
        """The angle that the joint settles at, on the side of the gap that it is on, deg."""
        settled, upper = [], bool(drive[0] >= 0)
        for x in drive:
            if abs(x) > self.snap:
                upper = bool(x > 0)
            settled.append(
                self._beyond(x, self.gap[0]) if upper else -self._beyond(-x, self.gap[1])
            )
        return np.asarray(settled)

    def _beyond(self, drive: float, gap: float) -> float:
        return float(drive + gap * np.exp(-drive / self.decay))

    def angles(self, commands: npt.ArrayLike, *, trial: int = 0) -> Degrees:
        """The true angle after each step of a history of commands, deg, shape (sample,)."""
        drive = self.drive(commands)
        random = np.random.default_rng([self.seed, trial, 1])
        return self.rest_angles(drive + self.pressure_noise * random.standard_normal(len(drive)))

    def measured(self, commands: npt.ArrayLike, *, trial: int = 0) -> Degrees:
        """The angle as two markers on the link show it to an inclined camera, deg.

        Arguments:
            commands: shape (sample,), deg.
            trial: another repetition has other noise.

        Returns:
            Shape (sample,), deg.
        """
        true = np.deg2rad(self.angles(commands, trial=trial) + self.inclination)
        random = np.random.default_rng([self.seed, trial, 2])
        ahead = self.marker_distance * np.stack([np.cos(true), np.sin(true)])
        seen = ahead + self.marker_noise * (
            random.standard_normal(ahead.shape) - random.standard_normal(ahead.shape)
        )
        return np.rad2deg(np.arctan2(seen[1], seen[0]))
