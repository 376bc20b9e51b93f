"""A pair of muscles near one equilibrium as the spring of a joint of the arm."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Scalar
from ..parameters import is_concrete
from ._geometry import LARGEST_ANGLE
from ._pair import JointPair
from ._roots import polish
from ._torque import OneSide, checked_pressures, side_slope, side_torque


class Spring(eqx.Module):
    """A joint held by two pressures, near one stable equilibrium: what a joint of the arm needs.

    Attributes:
        rest_angle: rad, the command of the arm's joint.
        stiffness: N m/rad, the stiffness of the arm's joint.
    """

    rest_angle: Scalar
    stiffness: Scalar


def joint_spring(
    pair: JointPair,
    pressures: npt.ArrayLike | Array,
    near: float | Array,
    load: float | Array = 0.0,
) -> Spring:
    """Rest angle and stiffness of the equilibrium near an angle; differentiable.

    The derivative of the rest angle is that of the equation which it solves (implicit), so it is
    right whatever led to the root. To be used as the spring of section III.A, whose constant
    and initial length change.

    Arguments:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, shape (2,).
        near: where to look, rad; not 0, where the corrections have their step.
        load: torque from outside, towards negative angles, N m.

    Returns:
        Rest angle (rad) and stiffness (N m/rad).

    Raises:
        InputError: there is no equilibrium near, or it is not stable, or it lies at 0.

    Example:
        >>> import giajax, numpy as np
        >>> pair, angle = giajax.JointPair(), np.deg2rad(20.0)
        >>> spring = giajax.joint_spring(pair, giajax.pair_command(pair, angle).pressures, angle)
        >>> round(float(spring.stiffness), 3)
        0.358
    """
    pressures = checked_pressures(pressures)
    near = jnp.asarray(near, dtype=pressures.dtype)
    load = jnp.asarray(load, dtype=pressures.dtype)
    spring, converged = _spring(pair, pressures, load, near)
    if is_concrete((spring, converged)):
        shown = float(jnp.rad2deg(near))
        remedy = "call equilibria, which lists them all"
        same_side = float(spring.rest_angle) * float(near) > 0
        inside = abs(float(spring.rest_angle)) <= LARGEST_ANGLE * (1 + 1e-9)
        if not (bool(converged) and same_side and inside):
            raise InputError(f"these pressures have no equilibrium near {shown:.4g} deg: {remedy}")
        if not float(spring.stiffness) > 0:
            raise InputError(f"the equilibrium near {shown:.4g} deg is not stable: {remedy}")
    return spring


@program
def _spring(pair: JointPair, pressures: Array, load: Array, near: Array) -> tuple[Spring, Array]:
    side = OneSide(pair, pressures, load, jax.lax.stop_gradient(near) >= 0)
    angle, converged = polish(side_torque, near, side)
    return Spring(rest_angle=angle, stiffness=-side_slope(angle, side)), converged
