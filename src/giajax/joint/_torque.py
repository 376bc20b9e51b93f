"""Torque of a pair of muscles at two pressures, as a function of the angle, and its slopes."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import is_concrete
from ._pair import JointPair, net_torque
from ._resistance import resistance


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
