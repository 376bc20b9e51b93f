"""Path and force of one muscle of a joint at rest, on all four branches (eqs 2 to 11).

The bending angle is that of the muscle: positive where the joint bends towards it, so that it is
the inner one, negative where it is the outer one. Everything is in the frame of the bisector:
the origin E is the joint's centre, y points to the muscle, and the right half stands for both.
(Fig. 8 draws the outer muscle on -y, hence the signs of eqs 10 and 11 and its tests on N_y.)

- inner, taut: A-H-C with the bush H held by the wire B-H-D (eqs 2 to 5);
- inner, slack: straight from A to C (eq. 6), the wire hangs;
- outer, straight: M-O-N (eqs 8 and 11);
- outer, wrapped: M-P-O-Q-N around the balloon's shoulders (eqs 7, 9 and 10).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Bool, Float, Scalar
from ..parameters import inline, is_concrete, parameter
from ._correction import Correction
from ._geometry import (
    JointGeometry,
    Point,
    check_geometry,
    outer_bush_height,
    taut_bush_height,
)
from ._roots import bisect


class Joint(eqx.Module):
    """One joint: its geometry, the corrections, and the torque that is on it at all times.

    Arguments:
        geometry: where muscle, wire and balloon are.
        correction: alpha and beta; their parameters are `alpha.offset`, `beta.curvature`, ...
        torque: what each muscle balances beside the correction, N m.
    """

    geometry: JointGeometry = eqx.field(default_factory=JointGeometry)
    correction: Correction = eqx.field(default_factory=Correction, metadata=dict(inline().metadata))
    torque: Scalar = parameter(0.3, unit="N m", doc="torque on the joint at all times")


class MusclePath(eqx.Module):
    """Path of a muscle; arrays of one shape, that of the angles.

    Attributes:
        inner: whether the muscle is the inner one.
        engaged: whether the wire is taut (inner) or the muscle wraps the balloon (outer).
        half_length: half the length of the path, m.
        height: y of the bush H or O, on the bisector, m.
        wire_slack: L_wire less the length that the wire spans, m; 0 where it is taut.
    """

    inner: Bool[Array, "*shape"]
    engaged: Bool[Array, "*shape"]
    half_length: Float[Array, "*shape"]
    height: Float[Array, "*shape"]
    wire_slack: Float[Array, "*shape"]

    @property
    def length(self) -> Float[Array, "*shape"]:
        """Length of the path, m."""
        return 2 * self.half_length


class MuscleState(eqx.Module):
    """A muscle of a joint at rest; arrays of one shape, that of the angles.

    Attributes:
        angle: bending angle of the muscle, rad.
        torque: that the muscle balances, its correction included, N m.
        path: its path.
        contraction: epsilon of eq. (2), relative to L_pam.
        lever: of the muscle's force about the joint's centre, m.
        force: tension F of the muscle, N. Negative where it would have to push.
        wire_tension: F_w, N; 0 where the wire is slack.
        push_x, push_y: push F_b of the muscle on the balloon of the right link (eq. 9), N; 0
            where it touches no balloon.
    """

    angle: Float[Array, "*shape"]
    torque: Float[Array, "*shape"]
    path: MusclePath
    contraction: Float[Array, "*shape"]
    lever: Float[Array, "*shape"]
    force: Float[Array, "*shape"]
    wire_tension: Float[Array, "*shape"]
    push_x: Float[Array, "*shape"]
    push_y: Float[Array, "*shape"]

    @property
    def branch(self) -> Array:
        """0 inner and taut, 1 inner and slack, 2 outer and straight, 3 outer and wrapped."""
        inside = jnp.where(self.path.engaged, 0, 1)
        return jnp.where(self.path.inner, inside, jnp.where(self.path.engaged, 3, 2))


BRANCHES = ("inner, wire taut", "inner, wire slack", "outer, straight", "outer, wrapped")


def muscle_path(
    geometry: JointGeometry,
    angle: Float[Array, "*shape"],
    inner: Bool[Array, "*shape"] | None = None,
) -> MusclePath:
    """Path of a muscle (eqs 2, 3, 7, 8): geometry only, no force.

    Arguments:
        geometry: of the joint.
        angle: bending angles of the muscle, rad.
        inner: the side, which matters at 0 only; by default a muscle at 0 is the inner one.
    """
    inner = angle >= 0 if inner is None else inner
    anchor_x, anchor_y = geometry.anchor(angle)
    end_x, end_y = geometry.wire_end(angle)
    # What belongs to the other side is evaluated at 0, where it always exists.
    held = taut_bush_height(geometry, jnp.where(inner, angle, 0))
    taut = anchor_y > held
    contact_x, contact_y = geometry.contact(jnp.where(inner, 0, angle))
    wrapped = anchor_y < contact_y
    engaged = jnp.where(inner, taut, wrapped)
    height = jnp.where(
        inner,
        jnp.where(taut, held, anchor_y),
        outer_bush_height(geometry, angle),
    )
    # Where the path bends: at the bush, or at the balloon's shoulder.
    corner_x = jnp.where(inner, 0, contact_x)
    bent = corner_x + jnp.hypot(anchor_x - corner_x, anchor_y - height)
    spanned = 2 * jnp.hypot(end_x, height - end_y)
    return MusclePath(
        inner=inner,
        engaged=engaged,
        half_length=jnp.where(engaged, bent, anchor_x),
        height=height,
        wire_slack=jnp.where(inner & taut, 0, geometry.wire_length - spanned),
    )


def muscle_balance(
    geometry: JointGeometry,
    angle: Float[Array, "*shape"],
    torque: Float[Array, "*shape"],
    inner: Bool[Array, "*shape"] | None = None,
) -> MuscleState:
    """Forces that balance a torque, the correction already in it (eqs 4 to 6, 9 to 11).

    Everything is in closed form: the paper's equations are linear in the forces.

    Arguments:
        geometry: of the joint.
        angle: bending angles of the muscle, rad.
        torque: balanced torque, N m.
        inner: the side, as in `muscle_path`.
    """
    path = muscle_path(geometry, angle, inner)
    anchor = geometry.anchor(angle)
    wire_end = geometry.wire_end(angle)
    contact = geometry.contact(jnp.where(path.inner, 0, angle))
    bush = (jnp.zeros_like(path.height), path.height)
    taut, wrapped = path.inner & path.engaged, ~path.inner & path.engaged

    # Force of the muscle on the right link at C or N, per newton of tension. A straight muscle
    # pulls along -x.
    bend = (jnp.where(path.inner, 0, contact[0]), path.height)
    pull = _where(path.engaged, _unit(anchor, bend), _leftwards(angle))
    # Eq. (4): the wire takes what the muscle pushes the bush along the bisector.
    hold = _unit(wire_end, bush)
    tension = jnp.where(taut, -pull[1] / jnp.where(taut, hold[1], 1), 0)
    # Eq. (9): the push on the balloon's shoulder; the muscle leaves it towards N and towards P.
    push = _where(wrapped, _add(_minus(pull), _leftwards(angle)), _nothing(angle))
    # Moments about E (eqs 5, 6, 10, 11), per newton of tension.
    lever = (
        _moment(anchor, pull)
        + tension * _moment(wire_end, hold)
        + jnp.where(wrapped, _moment(contact, push), 0)
    )
    force = torque / lever
    return MuscleState(
        angle=angle,
        torque=torque,
        path=path,
        contraction=1 - path.length / geometry.muscle_length,
        lever=lever,
        force=force,
        wire_tension=force * tension,
        push_x=force * push[0],
        push_y=force * push[1],
    )


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
            f"the torque has the shape {torque.shape} and the angle {angle.shape}; give one "
            "torque, or one for each angle"
        )
    torque = jnp.broadcast_to(torque, angle.shape)
    if side not in (None, "inner", "outer"):
        raise InputError(f"the side is {side!r}; it must be 'inner' or 'outer'")
    if is_concrete((joint, angle, torque)):
        _check(joint, angle, torque, side)
    inner = angle >= 0 if side is None else jnp.full(angle.shape, side == "inner")
    return _muscle_state(joint, angle, torque, inner)


@program
def _muscle_state(joint: Joint, angle: Array, torque: Array, inner: Array) -> MuscleState:
    return balanced(joint, angle, torque, inner)


def balanced(joint: Joint, angle: Array, torque: Array, inner: Array) -> MuscleState:
    """State of a muscle, its correction added to the torque; nothing is checked."""
    corrected = torque + joint.correction(angle, inner)
    return muscle_balance(joint.geometry, angle, corrected, inner)


def _check(joint: Joint, angle: Array, torque: Array, side: str | None) -> None:
    if not bool(jnp.all(jnp.isfinite(angle)) & jnp.all(jnp.isfinite(torque))):
        raise InputError("an angle or a torque is not finite; give finite numbers")
    if bool(jnp.any(jnp.abs(angle) > jnp.pi / 2)):
        worst = float(jnp.rad2deg(angle.ravel()[jnp.argmax(jnp.abs(angle))]))
        raise InputError(
            f"the bending angle is {worst:.4g} deg, and a joint bends by at most 90 deg; give "
            "radians, not degrees"
        )
    wrong = {"inner": angle < 0, "outer": angle > 0}.get(side or "")
    if wrong is not None and bool(jnp.any(wrong)):
        at = float(jnp.rad2deg(angle.ravel()[jnp.argmax(wrong)]))
        raise InputError(
            f"at {at:.4g} deg the muscle is not the {side} one; give no side, or the angle with "
            "the other sign"
        )
    check_geometry(joint.geometry, jax.device_get(angle))


def branch_angles(geometry: JointGeometry) -> tuple[float, float]:
    """Angles at which the inner wire becomes taut and the outer muscle begins to wrap, rad.

    The second is in closed form, tan(angle / 2) = -(N_y - Q_y) / (N_x - Q_x) in the frame of the
    link; the first is a root of C_y = H_y, found by bisection. 0 where a muscle is on its branch at
    every angle of that side, and NaN where a branch is not reached within 90 deg.
    """
    taut, wrap = _branch_angles(geometry)
    return float(taut), float(wrap)


@program
def _branch_angles(geometry: JointGeometry) -> tuple[Array, Array]:
    half_turn = jnp.asarray(jnp.pi / 2, dtype=jnp.result_type(float))

    def above(angle: Array) -> Array:
        return geometry.anchor(angle)[1] - taut_bush_height(geometry, angle)

    straight = jnp.zeros_like(half_turn)
    taut = bisect(above, straight, half_turn)
    taut = jnp.where(jnp.isnan(taut) & (above(straight) > 0), 0, taut)
    wrap = 2 * jnp.arctan2(
        geometry.anchor_y - geometry.contact_y, geometry.anchor_x - geometry.contact_x
    )
    return taut, jnp.where(wrap > half_turn, jnp.nan, -jnp.maximum(wrap, 0))


def _unit(tail: Point, head: Point) -> Point:
    x, y = head[0] - tail[0], head[1] - tail[1]
    length = jnp.hypot(x, y)
    return x / length, y / length


def _moment(at: Point, force: Point) -> Array:
    return at[0] * force[1] - at[1] * force[0]


def _add(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1]


def _minus(a: Point) -> Point:
    return -a[0], -a[1]


def _leftwards(like: Array) -> Point:
    return -jnp.ones_like(like), jnp.zeros_like(like)


def _nothing(like: Array) -> Point:
    return jnp.zeros_like(like), jnp.zeros_like(like)


def _where(condition: Array, a: Point, b: Point) -> Point:
    return jnp.where(condition, a[0], b[0]), jnp.where(condition, a[1], b[1])
