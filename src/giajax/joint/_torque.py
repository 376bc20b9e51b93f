"""Torque of a pair of muscles at two pressures, as a function of the angle, and its slopes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import is_concrete
from ._balance import muscle_balance
from ._pair import JointPair
from ._resistance import resistance


def net_torque(
    pair: JointPair,
    pressures: Float[Array, "2 ..."],
    load: Float[Array, ""],
    angle: Float[Array, "*shape"],
    ahead: Array,
) -> Float[Array, "*shape"]:
    """Torque towards positive angles that two pressures leave over, N m: 0 in equilibrium.

    The corrections resist the bending: alpha - beta, towards 0, whichever side is bent to.

    Arguments:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, the same at all angles or each with a
            last axis for each of theirs.
        load: torque from outside, towards negative angles, N m.
        angle: of the pair, rad.
        ahead: whether the first muscle is the inner one, of the angle's shape; what decides at 0.

    Returns:
        Torque, N m, of the shape of the angle.
    """
    first, second = muscle_torques(pair, pressures, angle, ahead)
    return first - second - resistance(pair.joint.correction, angle, ahead) - load


def muscle_torques(
    pair: JointPair,
    pressures: Float[Array, "2 ..."],
    angle: Float[Array, "*shape"],
    ahead: Array,
) -> Float[Array, "2 *shape"]:
    """Torque of each muscle of a pair towards its own side, N m; arguments as of `net_torque`."""
    angles, inner = jnp.stack([angle, -angle]), jnp.stack([ahead, ~ahead])
    state = muscle_balance(pair.joint.geometry, angles, jnp.ones_like(angles), inner)
    spread = pressures.reshape(pressures.shape + (1,) * (angles.ndim - pressures.ndim))
    pressure = jnp.broadcast_to(spread, angles.shape)
    return pair.muscle.force(pressure, state.contraction, pair.length) * state.lever


class OneSide(NamedTuple):
    """A pair at two pressures, and the side of 0 on which it is looked at.

    Attributes:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, shape (2,).
        load: torque from outside, towards negative angles, N m.
        ahead: whether the side is that of positive angles; it counts at 0.
    """

    pair: JointPair
    pressures: Float[Array, "2"]
    load: Scalar
    ahead: Bool[Array, ""]


def side_torque(angle: Float[Array, "*shape"], side: OneSide) -> Float[Array, "*shape"]:
    """Torque on the joint at angles (rad) of one side, N m."""
    ahead = jnp.broadcast_to(side.ahead, angle.shape)
    return net_torque(side.pair, side.pressures, side.load, angle, ahead)


def side_slope(angle: Float[Array, "*shape"], side: OneSide) -> Float[Array, "*shape"]:
    """Slope of the torque over the angle, N m/rad."""
    return jax.jvp(lambda a: side_torque(a, side), (angle,), (jnp.ones_like(angle),))[1]


def correction_slope(angle: Float[Array, "*shape"], side: OneSide) -> Float[Array, "*shape"]:
    """Slope of what the corrections of both muscles resist, N m/rad."""
    correction, ahead = side.pair.joint.correction, jnp.broadcast_to(side.ahead, angle.shape)
    return jax.jvp(lambda a: resistance(correction, a, ahead), (angle,), (jnp.ones_like(angle),))[1]


def checked_pressures(pressures: npt.ArrayLike | Array) -> Float[Array, "2"]:
    """Two pressures as an array, Pa.

    Raises:
        InputError: they are not two finite numbers of at least 0.
    """
    pressures = jnp.asarray(pressures, dtype=jnp.result_type(float))
    if pressures.shape != (2,):
        raise InputError(
            f"the pressures have the shape {pressures.shape}: give two numbers, of the first and "
            "of the second muscle"
        )
    if is_concrete(pressures) and not bool(jnp.all((pressures >= 0) & jnp.isfinite(pressures))):
        raise InputError(
            f"the pressures are {pressures.tolist()} Pa: give pressures above the surroundings, "
            "finite and not negative"
        )
    return pressures
