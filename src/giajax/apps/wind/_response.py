"""Spectra of the channels of an arm in gusts, linearised about its equilibrium."""

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

# Linear response of joints and channels to gusts, about the equilibrium of the arm in a wind.
#
# Drag is nonlinear, and gusts are not small compared with the mean flow. The drag is therefore
# linearised statistically, for relative velocities with a normal distribution about their mean:
# the equilibrium uses the mean of the force, and the linearisation the mean of its derivative
# (Roberts and Spanos, Random vibration and statistical linearization, Wiley 1990, section 5.3). The
# means are sums over three Gauss-Hermite points along each axis.

# Points and weights for a normal variable, exact for polynomials up to the fifth power.
_POINTS = np.sqrt(3.0) * np.array([-1.0, 0.0, 1.0])
_WEIGHTS = np.array([1 / 6, 2 / 3, 1 / 6])


class Linear(NamedTuple):
    """Arm linearised about one pose, averaged over the relative velocities of links and air.

    Attributes:
        unbalanced: acceleration in the pose at rest, rad/s^2; 0 in equilibrium.
        by_angle, by_rate: derivatives of the acceleration with respect to the angles, rad, and to
            the rates, rad/s.
        by_wind, by_wind_rate: derivatives of the acceleration with respect to the wind at each
            link, m/s, and to its rate of change, m/s^2.
        rest: recorded channels in the pose, SI units.
        shows_angle, shows_rate: derivatives of the channels with respect to angles and rates.
        bend: second derivatives of the channels with respect to the angles.
        places: centres of the links, m.
        moves: derivatives of the centres with respect to the angles, m/rad.
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
    """Return the acceleration as a function, averaged over the relative velocities.

    Its arguments are the angles, the rates, and the wind at the links with its rate of change.
    """
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
    """Return only `unbalanced` and `by_angle` of `linear`; the arguments are the same."""
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
    """Linearise an arm about a pose, without the clocks of its sensors.

    Arguments:
        model: arm and its sensors.
        names: names of the channels.
        command, angles: commanded angles, and angles of the pose, rad.
        mean: mean velocity of the wind, m/s.
        spread: square root of the covariance of the velocity of each link relative to the air, m/s.
    """
    arm = model.arm
    mean_acceleration = _mean_acceleration(arm, command, spread)
    still = jnp.zeros_like(angles)
    steady = jnp.broadcast_to(mean, (arm.count, 3))

    def shown(angles: Array, rates: Array) -> Array:
        # Provide what the sensors require of a motion, for one instant.
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
    """Return the equilibrium angles of the arm in a wind, and the arm linearised about them.

    The search starts from the angles `begin`. The other arguments are as in `linear`.

    Raises:
        InputError: the arm has no equilibrium, or an unstable one.
    """
    # Ignore the clocks: a delay only multiplies a spectrum by a phase, which is added later.
    model = dataclasses.replace(model, sensors=model.sensors.without_clocks())

    def off(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        given = (jnp.asarray(item, float) for item in (command, angles, mean, spread))
        found, slope = unbalanced(model, *given)
        return np.asarray(found), np.asarray(slope)

    found = root(off, begin, jac=True, options={"xtol": 1e-13})
    given = (jnp.asarray(item, float) for item in (command, found.x, mean, spread))
    # Convert to NumPy arrays, which all further computations use.
    values: Any = [np.asarray(item) for item in linear(model, names, *given)]
    here = Linear(*values)
    # The remaining error of the angles is estimated by one more Newton step.
    left = np.linalg.lstsq(here.by_angle, here.unbalanced, rcond=None)[0]
    if not np.all(np.isfinite(left)) or np.max(np.abs(left)) > 1e-7:
        raise InputError(
            "no equilibrium of the arm was found in a mean wind of "
            f"{np.array2string(mean, precision=3)} m/s: start from a weaker wind"
        )
    joints = len(found.x)
    motion = np.block([[np.zeros((joints, joints)), np.eye(joints)], [here.by_angle, here.by_rate]])
    if np.max(np.linalg.eigvals(motion).real) > 0:
        raise InputError(
            f"the equilibrium of the arm is unstable in a mean wind of "
            f"{np.array2string(mean, precision=3)} m/s, so its motion has no spectrum: start from "
            "a weaker wind, or correct the stiffness and gravity of the arm"
        )
    return found.x, here


@dataclasses.dataclass(frozen=True)
class Turbulence:
    """Mean flow and turbulence.

    Attributes:
        mean: velocity of the mean flow, m/s, shape (3,).
        deviation: standard deviation of the gusts along the mean flow, m/s.
        length_scale: longitudinal length scale, m.
        decay: decay coefficient of the coherence.
        shares: standard deviations along the mean flow, horizontally across it, and perpendicular
            to both, divided by the first one.
    """

    mean: np.ndarray
    deviation: float
    length_scale: float
    decay: float
    shares: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def speed(self) -> float:
        """Speed of the mean flow, m/s."""
        return float(np.linalg.norm(self.mean))

    def covariance(self) -> np.ndarray:
        """Return the covariance of the gusts at one place, m^2/s^2, shape (3, 3)."""
        frame = np.stack(wind_frame(self.mean / self.speed))
        return frame.T @ np.diag((self.deviation * np.asarray(self.shares)) ** 2) @ frame

    def roots(
        self, places: np.ndarray, frequencies: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the direction of each component, and the square root of its spectra.

        The places are in m and the frequencies in Hz. The one-sided spectra are R R^H, with the
        square root R of shape (frequency, place, place).
        """
        along = self.mean / self.speed
        carried = {"speed": self.speed, "length_scale": self.length_scale}
        about: Any = {"along": along, "decay": self.decay, **carried}
        coherence = gust_coherence(places, frequencies, **about)
        # The small diagonal term allows coincident places, which have the same wind.
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
    """Return the frequency responses of the joint angles to the wind at each link, rad per m/s.

    The frequencies are in Hz. The result has the shape (frequency, joint, link, 3).
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
    """Return the one-sided cross-spectra of the channels without noise, SI units squared per Hz.

    The wind is evaluated at the places, m. The result has the shape (frequency, channel, channel).
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
    """Return the covariances of the angles, rad^2, and of the relative velocities, m^2/s^2.

    The relative velocities are those of the links relative to the air. The shapes are
    (joint, joint) and (link, 3, 3).
    """
    # Periods from a thousand times the duration of a gust down to a hundredth of it.
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
    # For frequencies outside the grid, assume that the arm does not follow the wind.
    powers = [np.abs(each[:, 0, 0]) ** 2 for _, each in wind.roots(places[:1], frequencies)]
    known = np.trapezoid(sum(powers), frequencies)
    beyond = 1 - known / np.trace(wind.covariance())
    of_joints = np.asarray(np.trapezoid(angles, frequencies, axis=0))
    return of_joints, of_links + beyond * wind.covariance()
