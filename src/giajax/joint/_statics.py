"""One joint at rest: its parameters, and the state of a muscle on either side of it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Scalar
from ..parameters import inline, is_concrete, parameter
from ..quantities import LOAD
from ._balance import MuscleState, muscle_balance
from ._correction import Correction
from ._geometry import JointGeometry, check_geometry


class Joint(eqx.Module):
    """One joint: its geometry, the corrections, and the torque that is on it at all times.

    Arguments:
        geometry: where muscle, wire and balloon are.
        correction: alpha and beta; their parameters are `alpha.offset`, `beta.curvature`, ...
        torque: what each muscle balances beside the correction, N m.
    """

    geometry: JointGeometry = eqx.field(default_factory=JointGeometry)
    correction: Correction = eqx.field(default_factory=Correction, metadata=dict(inline().metadata))
    torque: Scalar = parameter(LOAD.torque)


def muscle_state(
    joint: Joint,
    angle: npt.ArrayLike | Array,
    torque: npt.ArrayLike | Array | None = None,
    side: str | None = None,
) -> MuscleState:
    """Contraction and forces of one muscle that balances a torque on the joint at rest.

    Arguments:
        joint: the joint.
        angle: bending angle of the muscle, rad, of any shape: positive where the joint bends
            towards it (inner), negative where it bends away (outer).
        torque: on the joint, without the correction, N m, a number or of the angle's shape; that
            of the joint (0.3 N m) by default.
        side: "inner" or "outer" at an angle of 0, where both hold; "inner" by default.

    Returns:
        The state, in closed form on every branch. It is continuous across the branches; at 0 the
        force steps by the difference of alpha and beta, unless the correction is blended.

    Raises:
        InputError: the geometry is impossible at one of the angles, an angle beyond 90 deg, a
            number that is not finite, or a side that contradicts an angle.

    Example:
        >>> import giajax, numpy as np
        >>> state = giajax.muscle_state(giajax.Joint(), np.deg2rad([40.0, -60.0]))
        >>> [round(float(force), 2) for force in state.force]
        [1.56, 0.0]
    """
    dtype = jnp.result_type(float)
    angle = jnp.asarray(angle, dtype=dtype)
    torque = joint.torque if torque is None else jnp.asarray(torque, dtype=dtype)
    if torque.shape not in ((), angle.shape):
        raise InputError(
            f"the torque has the shape {torque.shape} and the angle {angle.shape}: give one "
            "torque, or one for each angle"
        )
    torque = jnp.broadcast_to(torque, angle.shape)
    if side not in (None, "inner", "outer"):
        raise InputError(f"the side is {side!r}: use 'inner' or 'outer'")
    if is_concrete((joint, angle, torque)):
        _check(joint, angle, torque, side)
    inner = angle >= 0 if side is None else jnp.full(angle.shape, side == "inner")
    return _muscle_state(joint, angle, torque, inner)


@program
def _muscle_state(joint: Joint, angle: Array, torque: Array, inner: Array) -> MuscleState:
    return balanced(joint, angle, torque, inner)


def balanced(joint: Joint, angle: Array, torque: Array, inner: Array) -> MuscleState:
    """State of a muscle, its correction added to the torque; nothing is checked.

    Arguments:
        joint: the joint.
        angle: bending angles of the muscle, rad.
        torque: on the joint, N m, of the same shape.
        inner: whether the muscle is the inner one, of the same shape.

    Returns:
        The state of the muscle.
    """
    corrected = torque + joint.correction(angle, inner)
    return muscle_balance(joint.geometry, angle, corrected, inner)


def _check(joint: Joint, angle: Array, torque: Array, side: str | None) -> None:
    if not bool(jnp.all(jnp.isfinite(angle)) & jnp.all(jnp.isfinite(torque))):
        raise InputError("an angle or a torque is not finite: give finite numbers")
    if bool(jnp.any(jnp.abs(angle) > jnp.pi / 2)):
        worst = float(jnp.rad2deg(angle.ravel()[jnp.argmax(jnp.abs(angle))]))
        raise InputError(
            f"the bending angle is {worst:.4g} deg, and a joint bends by at most 90 deg: give "
            "radians, not degrees"
        )
    wrong = {"inner": angle < 0, "outer": angle > 0}.get(side or "")
    if wrong is not None and bool(jnp.any(wrong)):
        at = float(jnp.rad2deg(angle.ravel()[jnp.argmax(wrong)]))
        raise InputError(
            f"at {at:.4g} deg the muscle is not the {side} one: give no side, or the angle with "
            "the other sign"
        )
    check_geometry(joint.geometry, jax.device_get(angle))
