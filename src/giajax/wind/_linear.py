"""An arm about its rest in a wind: what its joints and channels do of a small gust.

Drag is no linear force, and gusts are not small beside the mean flow. It is linearised
statistically, for relative velocities that are normal about the mean: the mean of the force over
them keeps the balance, and the mean of its slope is the slope (Roberts and Spanos, Random vibration
and statistical linearization, Wiley 1990, section 5.3). The means are sums over three points of
Gauss and Hermite along each axis.
"""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import root

from .._errors import InputError
from .._program import program
from .._typing import Array, Float
from ..arm import acceleration, link_centres
from ..models import ArmModel, recorded_channels

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


class _Still(NamedTuple):
    """What sensors ask of a motion, of one instant."""

    angles: Float[Array, "1 joint"]
    rates: Float[Array, "1 joint"]
    successful: bool


@program
def linear(
    model: ArmModel,
    names: tuple[str, ...],
    command: Float[Array, " joint"],
    angles: Float[Array, " joint"],
    mean: Float[Array, "3"],
    spread: Float[Array, "link 3 3"],
) -> Linear:
    """Linearise about a pose.

    Arguments:
        model: the arm and its sensors, whose clocks are left out.
        names: of the recorded channels.
        command: commanded angles, rad.
        angles: of the pose, rad.
        mean: of the wind, m/s.
        spread: root of the covariance of each link's velocity relative to the air, m/s.
    """
    arm = model.arm
    nodes = jnp.asarray(list(itertools.product(_POINTS, repeat=3)))
    weights = jnp.asarray([np.prod(part) for part in itertools.product(_WEIGHTS, repeat=3)])
    still = jnp.zeros_like(angles)
    steady = jnp.broadcast_to(mean, (arm.count, 3))

    def mean_acceleration(angles: Array, rates: Array, wind: Array, wind_rate: Array) -> Array:
        def at(node: Array) -> Array:
            return acceleration(arm, angles, rates, command, wind + spread @ node, wind_rate)

        return weights @ jax.vmap(at)(nodes)

    def shown(angles: Array, rates: Array) -> Array:
        motion: Any = _Still(angles[None], rates[None], True)
        seen, _ = recorded_channels(
            arm, model.sensors, lambda times, end: motion, jnp.zeros(1), names
        )
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
    """The pose in which the arm rests in a wind, and the arm about it.

    Arguments:
        begin: angles to look from, rad; the others are those of `linear`.

    Raises:
        InputError: no rest is found, or one that the arm does not stay in.
    """

    def about(angles: np.ndarray) -> Linear:
        given = (command, angles, mean, spread)
        return linear(model, names, *(jnp.asarray(item, float) for item in given))

    found = root(
        lambda angles: np.asarray(about(angles).unbalanced),
        begin,
        jac=lambda angles: np.asarray(about(angles).by_angle),
        options={"xtol": 1e-13},
    )
    # As arrays of NumPy, in which the rest of it is done.
    values: Any = [np.asarray(item) for item in about(found.x)]
    here = Linear(*values)
    # A step of Newton's method from here, which is what remains of the angles.
    left = np.linalg.lstsq(here.by_angle, here.unbalanced, rcond=None)[0]
    if not np.all(np.isfinite(left)) or np.max(np.abs(left)) > 1e-7:
        raise InputError(
            f"no rest of the arm is found in a mean wind of {np.array2string(mean, precision=3)} "
            "m/s: begin with a weaker one"
        )
    joints = len(found.x)
    motion = np.block([[np.zeros((joints, joints)), np.eye(joints)], [here.by_angle, here.by_rate]])
    if np.max(np.linalg.eigvals(motion).real) > 0:
        raise InputError(
            f"the arm does not stay at its rest in a mean wind of "
            f"{np.array2string(mean, precision=3)} m/s, and no spectrum is that of its motion: "
            "begin with a weaker wind, or correct stiffness and gravity"
        )
    return found.x, here
