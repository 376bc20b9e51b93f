"""Spectra of an arm's channels in gusts, from the arm about its rest."""

import dataclasses
import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root

from ...mechanics.arm import Arm, acceleration, link_centres
from ...models import ArmModel, recorded_channels
from ...runtime.arrays import Array, Float
from ...runtime.programs import program
from ...runtime.text import InputError
from ..synthetic import gust_coherence, gust_spectrum, wind_frame

# An arm about its rest in a wind: what its joints and channels do of a small gust.
#
# Drag is no linear force, and gusts are not small beside the mean flow. It is linearised
# statistically, for relative velocities that are normal about the mean: the mean of the force
# over them keeps the balance, and the mean of its slope is the slope (Roberts and Spanos, Random
# vibration and statistical linearization, Wiley 1990, section 5.3). The means are sums over three
# points of Gauss and Hermite along each axis.

# Of a normal variable: exact for polynomials up to the fifth power.
_POINTS = np.sqrt(3.0) * np.array([-1.0, 0.0, 1.0])
_WEIGHTS = np.array([1 / 6, 2 / 3, 1 / 6])


class Linear(NamedTuple):
    """The arm about one pose, with means over the relative velocities of links and air.

    Attributes:
        unbalanced: acceleration in the pose at rest, rad/s^2; 0 where it is the balance.
        by_angle, by_rate: derivatives of the acceleration by angles (rad) and rates (rad/s).
        by_wind, by_wind_rate: by the wind of each link, m/s, and by its rate of change, m/s^2.
        rest: recorded channels in the pose, SI.
        shows_angle, shows_rate: their derivatives by angles and rates.
        bend: their second derivatives by angles.
        places: centres of the links, m.
        moves: derivatives of the centres by the angles, m/rad.
    """

    unbalanced: Float[Array, " joint"]
    by_angle: Float[Array, "joint joint"]
    by_rate: Float[Array, "joint joint"]
    by_wind: Float[Array, "joint link 3"]
    by_wind_rate: Float[Array, "joint link 3"]
    rest: Float[Array, " channel"]
    shows_angle: Float[Array, "channel joint"]
    shows_rate: Float[Array, "channel joint"]
    bend: Float[Array, "channel joint joint"]
    places: Float[Array, "link 3"]
    moves: Float[Array, "link 3 joint"]


def _mean_acceleration(
    arm: Arm, command: Array, spread: Array
) -> Callable[[Array, Array, Array, Array], Array]:
    """The acceleration by angles, rates, winds and their rates, over the relative velocities."""
    nodes = jnp.asarray(list(itertools.product(_POINTS, repeat=3)))
    weights = jnp.asarray([np.prod(part) for part in itertools.product(_WEIGHTS, repeat=3)])

    def mean(angles: Array, rates: Array, wind: Array, wind_rate: Array) -> Array:
        def at(node: Array) -> Array:
            return acceleration(arm, angles, rates, command, wind + spread @ node, wind_rate)

        return weights @ jax.vmap(at)(nodes)

    return mean


@program
def unbalanced(
    model: ArmModel,
    command: Float[Array, " joint"],
    angles: Float[Array, " joint"],
    mean: Float[Array, "3"],
    spread: Float[Array, "link 3 3"],
) -> tuple[Array, Array]:
    """`unbalanced` and `by_angle` of `linear` alone, by arguments as it has them."""
    accelerated = _mean_acceleration(model.arm, command, spread)
    steady = jnp.broadcast_to(mean, (model.arm.count, 3))

    def at_rest(angles: Array) -> tuple[Array, Array]:
        found = accelerated(angles, jnp.zeros_like(angles), steady, jnp.zeros_like(steady))
        return found, found

    slope, found = jax.jacfwd(at_rest, has_aux=True)(angles)
    return found, slope


@program
def linear(
    model: ArmModel,
    names: tuple[str, ...],
    command: Float[Array, " joint"],
    angles: Float[Array, " joint"],
    mean: Float[Array, "3"],
    spread: Float[Array, "link 3 3"],
) -> Linear:
    """Linearise about a pose of an arm, without the clocks of its sensors.

    Arguments:
        command, angles: commanded, and of the pose, rad.
        mean: of the wind, m/s.
        spread: root of the covariance of each link's velocity relative to the air, m/s.
    """
    arm = model.arm
    mean_acceleration = _mean_acceleration(arm, command, spread)
    still = jnp.zeros_like(angles)
    steady = jnp.broadcast_to(mean, (arm.count, 3))

    def shown(angles: Array, rates: Array) -> Array:
        # What sensors ask of a motion, of one instant.
        instant = {"angles": angles[None], "rates": rates[None], "successful": True}
        motion: Any = SimpleNamespace(arm=arm, **instant)
        given = (model.sensors, lambda times, end: motion, jnp.zeros(1), names)
        seen, _ = recorded_channels(*given)
        return jnp.stack([seen[name][0] for name in names])

    def centres(angles: Array) -> Array:
        return link_centres(arm, angles)

    by_angle, by_rate, by_wind, by_wind_rate = jax.jacfwd(mean_acceleration, argnums=(0, 1, 2, 3))(
        angles, still, steady, jnp.zeros_like(steady)
    )
    shows_angle, shows_rate = jax.jacfwd(shown, argnums=(0, 1))(angles, still)
    return Linear(
        unbalanced=mean_acceleration(angles, still, steady, jnp.zeros_like(steady)),
        by_angle=by_angle,
        by_rate=by_rate,
        by_wind=by_wind,
        by_wind_rate=by_wind_rate,
        rest=shown(angles, still),
        shows_angle=shows_angle,
        shows_rate=shows_rate,
        bend=jax.jacfwd(jax.jacfwd(shown))(angles, still),
        places=centres(angles),
        moves=jax.jacfwd(centres)(angles),
    )


def at_rest(
    model: ArmModel,
    names: tuple[str, ...],
    command: np.ndarray,
    begin: np.ndarray,
    mean: np.ndarray,
    spread: np.ndarray,
) -> tuple[np.ndarray, Linear]:
    """The pose in which the arm rests in a wind, looked for from some angles, and the arm there."""
    # Spectra are late by a phase.
    model = dataclasses.replace(model, sensors=model.sensors.without_clocks())

    def off(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        given = (jnp.asarray(item, float) for item in (command, angles, mean, spread))
        found, slope = unbalanced(model, *given)
        return np.asarray(found), np.asarray(slope)

    found = root(off, begin, jac=True, options={"xtol": 1e-13})
    given = (jnp.asarray(item, float) for item in (command, found.x, mean, spread))
    # As arrays of NumPy, in which the rest of it is done.
    values: Any = [np.asarray(item) for item in linear(model, names, *given)]
    here = Linear(*values)
    # A step of Newton's method from here, which is what remains of the angles.
    left = np.linalg.lstsq(here.by_angle, here.unbalanced, rcond=None)[0]
    if not np.all(np.isfinite(left)) or np.max(np.abs(left)) > 1e-7:
        raise InputError(
            "no equilibrium of the arm was found in a mean wind of "
            f"{np.array2string(mean, precision=3)} "
            "m/s: start from a weaker wind"
        )
    joints = len(found.x)
    motion = np.block([[np.zeros((joints, joints)), np.eye(joints)], [here.by_angle, here.by_rate]])
    if np.max(np.linalg.eigvals(motion).real) > 0:
        raise InputError(
            f"the arm does not stay at its rest in a mean wind of "
            f"{np.array2string(mean, precision=3)} m/s, so its motion has no spectrum: start from "
            "a weaker wind, or correct the stiffness and gravity of the arm"
        )
    return found.x, here


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
        """Of each component the direction, and roots of its spectra at places (m), by Hz.

        A root R, of shape (frequency, place, place), has R R^H for the one-sided spectra.
        """
        along = self.mean / self.speed
        carried = {"speed": self.speed, "length_scale": self.length_scale}
        about: Any = {"along": along, "decay": self.decay, **carried}
        coherence = gust_coherence(places, frequencies, **about)
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
    """Complex angles of the joints by the wind of each link, rad per m/s; frequencies in Hz.

    Their shape is (frequency, joint, link, 3).
    """
    turn = 2j * np.pi * frequencies[:, None, None]
    joints = len(here.by_angle)
    motion = turn**2 * np.eye(joints) - turn * here.by_rate - here.by_angle
    push = here.by_wind + turn[..., None] * here.by_wind_rate
    flat = push.reshape(len(frequencies), joints, -1)
    return np.linalg.solve(motion, flat).reshape(push.shape)


def channel_spectra(
    here: Linear, wind: Turbulence, places: np.ndarray, frequencies: np.ndarray, delays: np.ndarray
) -> np.ndarray:
    """One-sided spectra of the channels without noise, SI^2/Hz, (frequency, channel, channel).

    The places, m, are those where the links are to the wind.
    """
    turned = joint_responses(here, frequencies).reshape(len(frequencies), len(here.by_angle), -1)
    turn = 2j * np.pi * frequencies[:, None, None]
    late = np.exp(-turn * delays[None, :, None])
    shown = (late * (here.shows_angle + turn * here.shows_rate)) @ turned
    shown = shown.reshape(len(frequencies), -1, len(places), 3)
    total = np.zeros((len(frequencies), shown.shape[1], shown.shape[1]), complex)
    for axis, square_root in wind.roots(places, frequencies):
        part = (shown @ axis) @ square_root
        total += part @ part.conj().swapaxes(1, 2)
    return total


def motion_covariances(
    here: Linear, wind: Turbulence, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the angles, rad^2, and of each link's velocity relative to the air, m^2/s^2.

    Their shapes are (joint, joint) and (link, 3, 3).
    """
    # From a thousand times what a gust lasts to a hundredth of it.
    frequencies = np.geomspace(1e-3, 1e2, 141) * wind.speed / wind.length_scale
    turned = joint_responses(here, frequencies)
    rates = 2j * np.pi * frequencies[:, None, None, None]
    angles = np.zeros((len(frequencies), *here.by_angle.shape))
    relative = np.zeros((len(frequencies), len(places), 3, 3))
    for axis, square_root in wind.roots(places, frequencies):
        moved = (turned @ axis) @ square_root
        angles += np.real(moved @ moved.conj().swapaxes(1, 2))
        follows = np.einsum("lcj,fjm->flcm", here.moves, rates[..., 0] * moved)
        apart = axis[None, None, :, None] * square_root[:, :, None, :] - follows
        relative += np.real(apart @ apart.conj().swapaxes(2, 3))
    of_links = np.asarray(np.trapezoid(relative, frequencies, axis=0))
    # What is slower and quicker than the grid is as it is for an arm that does not follow.
    powers = [np.abs(each[:, 0, 0]) ** 2 for _, each in wind.roots(places[:1], frequencies)]
    known = np.trapezoid(sum(powers), frequencies)
    beyond = 1 - known / np.trace(wind.covariance())
    of_joints = np.asarray(np.trapezoid(angles, frequencies, axis=0))
    return of_joints, of_links + beyond * wind.covariance()
