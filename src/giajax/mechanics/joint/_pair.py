"""The bending-angle controller (fig. 6): two muscles against each other, and their pressures."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ...runtime.arrays import Array, Bool, Float, Scalar, polish
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema.parameters import is_concrete
from ..wrinkling import Neck, neck_moment
from ._geometry import LARGEST_ANGLE, Bend, Shaped, check_geometry
from ._muscle import AbstractMuscle, BraidedMuscle, PressureAnswer
from ._statics import (
    Joint,
    MuscleState,
    Tension,
    balance_of,
    inner_tension,
    outer_tension,
    resistance,
)


class JointPair(eqx.Module):
    """A joint with two equal muscles on opposite sides, and no friction.

    The angle of the pair is positive where the joint bends towards the first muscle, which is
    then the inner one.

    Arguments:
        joint: geometry and corrections, of either side.
        muscle: the law of both muscles.
        neck: of film between the links, which is bent and pressed together; none by default.
    """

    joint: Joint = eqx.field(default_factory=Joint)
    muscle: AbstractMuscle = eqx.field(default_factory=BraidedMuscle)
    neck: Neck = eqx.field(default_factory=Neck)

    @property
    def length(self) -> Scalar:
        """Length of each muscle at rest, m."""
        return self.joint.geometry.muscle_length


class PairCommand(eqx.Module):
    """What holds the joint at an angle.

    Attributes:
        angle: of the pair, rad, any shape.
        first, second: states of the muscle towards which a positive angle bends, and of the
            other one.
        first_pressure, second_pressure: their pressures, and whether they give these forces.
    """

    angle: Shaped
    first: MuscleState
    second: MuscleState
    first_pressure: PressureAnswer
    second_pressure: PressureAnswer

    @property
    def pressures(self) -> Float[Array, "*shape 2"]:
        """Both pressures along a last axis, Pa."""
        both = (self.first_pressure.pressure, self.second_pressure.pressure)
        return jnp.stack(both, axis=-1)

    @property
    def reached(self) -> Array:
        """Whether both muscles can do what they must."""
        return self.first_pressure.reached & self.second_pressure.reached


def pair_command(
    pair: JointPair,
    angle: npt.ArrayLike | Array,
    load: npt.ArrayLike | Array = 0.0,
    cocontraction: npt.ArrayLike | Array | None = None,
) -> PairCommand:
    """Pressures that hold a pair at an angle against a load (fig. 6).

    The inner muscle balances the co-contraction torque, alpha and what of the load acts against the
    bending; the outer one the co-contraction torque and beta. Where no pressure gives a force, its
    answer says why. It is the controller of the paper, which knows of no neck.

    Arguments:
        angle: to be held, rad, any shape, within -60 to 60 deg.
        load: torque from outside, towards negative angles, N m, one number or one an angle.
        cocontraction: torque of each muscle against the other, N m; the joint's 0.3 by default.

    Raises:
        InputError: an angle beyond 60 deg, a number that is not finite, or an impossible
            geometry.

    Example:
        >>> import numpy as np
        >>> from giajax.mechanics.joint import JointPair, pair_command
        >>> command = pair_command(JointPair(), np.deg2rad(20.0))
        >>> [round(float(pressure) / 1e3, 1) for pressure in command.pressures]
        [29.5, 27.2]
    """
    dtype = jnp.result_type(float)
    angle = jnp.asarray(angle, dtype=dtype)
    load = jnp.broadcast_to(jnp.asarray(load, dtype=dtype), angle.shape)
    torque = pair.joint.torque if cocontraction is None else cocontraction
    torque = jnp.broadcast_to(jnp.asarray(torque, dtype=dtype), angle.shape)
    if is_concrete((pair, angle, load, torque)):
        inside = jnp.abs(angle) <= LARGEST_ANGLE * (1 + 1e-12)
        if not bool(jnp.all(inside)):
            worst = float(jnp.rad2deg(angle.ravel()[jnp.argmin(inside)]))
            raise InputError(
                f"the angle is {worst:.4g} deg, but a joint bends by at most 60 deg: give a "
                f"smaller angle, in radians"
            )
        if not bool(jnp.all(jnp.isfinite(load) & jnp.isfinite(torque))):
            raise InputError("a load or co-contraction torque is not finite: give finite numbers")
        angles = np.asarray(angle).ravel()
        check_geometry(pair.joint.geometry, np.concatenate([angles, -angles]))
    return _pair_command(pair, angle, load, torque)


def commanded(pair: JointPair, angle: Array, load: Array, torque: Array) -> PairCommand:
    """What holds a pair at an angle, as `pair_command` does; nothing is checked.

    Arguments:
        angle: to be held, rad.
        load: torque from outside, towards negative angles, N m, of the same shape.
        torque: co-contraction torque, N m, of the same shape.
    """
    ahead, joint = angle >= 0, pair.joint
    size = jnp.where(ahead, angle, -angle)
    resisted = jnp.where(ahead, load, -load)  # what of the load acts against the bending

    def answered(
        unit: Tension, angle: Shaped, torque: Shaped, inner: Array
    ) -> tuple[MuscleState, PressureAnswer]:
        state = balance_of(unit, joint.geometry, angle, torque + joint.correction(angle, inner))
        return state, pair.muscle.answer(state.force, state.contraction, pair.length)

    bend, yes = Bend.by(size), jnp.ones_like(ahead)
    inner = answered(inner_tension(joint.geometry, bend), size, torque + resisted, yes)
    outer = answered(outer_tension(joint.geometry, bend.back), -size, torque, ~yes)
    # The first muscle is the inner one where the joint bends towards it.
    choose = functools.partial(jnp.where, ahead)
    first, second = jax.tree.map(choose, inner, outer), jax.tree.map(choose, outer, inner)
    return PairCommand(angle, first[0], second[0], first[1], second[1])


_pair_command = program(commanded)


def net_torque(
    pair: JointPair,
    pressures: Float[Array, "2 ..."],
    load: Float[Array, ""],
    angle: Shaped,
    ahead: Array,
) -> Shaped:
    """Torque towards positive angles that two pressures leave over, N m: 0 in equilibrium.

    The corrections resist the bending: alpha - beta, towards 0, whichever side is bent to; and so
    does the neck, where there is one.

    Arguments:
        pressures: of the first and the second muscle, Pa, the same at all angles or each with a
            last axis for each of theirs.
        load: torque from outside, towards negative angles, N m.
        angle: of the pair, rad.
        ahead: whether the first muscle is the inner one; what decides at 0.
    """
    first, second = muscle_torques(pair, pressures, angle, ahead)
    torque = first - second - resistance(pair.joint.correction, angle, ahead) - load
    if pair.neck.radius is None:
        return torque
    return torque - neck_moment(pair.neck, angle, compression(pair, pressures, angle, ahead))


def muscle_torques(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> Float[Array, "2 *shape"]:
    """Torque of each muscle of a pair towards its own side, N m; arguments as of `net_torque`."""
    inner, outer = (pull.force * pull.lever for pull in _pulls(pair, pressures, angle, ahead))
    return jnp.stack([jnp.where(ahead, inner, outer), jnp.where(ahead, outer, inner)])


def compression(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> Shaped:
    """Force with which both muscles press the links of a joint together, N.

    On the bisector a muscle, with its wire, is a force along the links at the height where it
    crosses it: its torque over that height. Arguments as of `net_torque`.
    """
    inner, outer = _pulls(pair, pressures, angle, ahead)
    return inner.force * inner.lever / inner.height + outer.force * outer.lever / outer.height


class _Pull(NamedTuple):
    """Tension of a muscle, N, its lever about the joint, and its height on the bisector, m."""

    force: Shaped
    lever: Shaped
    height: Shaped


def _pulls(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> tuple[_Pull, _Pull]:
    """Of the inner and of the outer muscle."""
    # One of both is the inner muscle: each side is worked out once, for whichever it is.
    bend = Bend.by(jnp.where(ahead, angle, -angle))
    pressure = pressures.reshape(pressures.shape + (1,) * (angle.ndim + 1 - pressures.ndim))
    first, second = jnp.broadcast_to(pressure, (2, *angle.shape))
    geometry = pair.joint.geometry
    inner = _pull(pair, jnp.where(ahead, first, second), inner_tension(geometry, bend))
    outer = _pull(pair, jnp.where(ahead, second, first), outer_tension(geometry, bend.back))
    return inner, outer


def _pull(pair: JointPair, pressure: Shaped, unit: Tension) -> _Pull:
    contraction = 1 - unit.path.length / pair.length
    force = pair.muscle.force(pressure, contraction, pair.length)
    return _Pull(force, unit.lever, unit.path.height)


class OneSide(NamedTuple):
    """A pair at two pressures (Pa) and a load (N m), and the side of 0 on which it is looked at:
    `ahead` where it is that of positive angles, which counts at 0.
    """

    pair: JointPair
    pressures: Float[Array, "2"]
    load: Scalar
    ahead: Bool[Array, ""]


def side_torque(angle: Shaped, side: OneSide) -> Shaped:
    """Torque on the joint at angles (rad) of one side, N m."""
    ahead = jnp.broadcast_to(side.ahead, angle.shape)
    return net_torque(side.pair, side.pressures, side.load, angle, ahead)


def side_slope(angle: Shaped, side: OneSide) -> Shaped:
    """Slope of the torque over the angle, N m/rad."""
    return jax.jvp(lambda a: side_torque(a, side), (angle,), (jnp.ones_like(angle),))[1]


def correction_slope(angle: Shaped, side: OneSide) -> Shaped:
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
            f"the pressures are {pressures.tolist()} Pa: give finite gauge pressures that are not "
            f"negative"
        )
    return pressures


class Spring(eqx.Module):
    """A joint held by two pressures, near one stable equilibrium: what a joint of the arm needs.

    Its rest angle (rad) is the command of the arm's joint.
    """

    rest_angle: Scalar
    stiffness: Scalar


def joint_spring(
    pair: JointPair,
    pressures: npt.ArrayLike | Array,
    near: float | Array,
    load: float | Array = 0.0,
) -> Spring:
    """Rest angle (rad) and stiffness (N m/rad) of the equilibrium near an angle; differentiable.

    The derivative of the rest angle is that of the equation which it solves (implicit), so it is
    right whatever led to the root. To be used as the spring of section III.A, whose constant
    and initial length change.

    Arguments:
        pressures: of the first and the second muscle, Pa.
        near: where to look, rad; not 0, where the corrections have their step.
        load: torque from outside, towards negative angles, N m.

    Raises:
        InputError: there is no equilibrium near, or it is not stable, or it lies at 0.

    Example:
        >>> import numpy as np
        >>> from giajax.mechanics.joint import JointPair, joint_spring, pair_command
        >>> pair, angle = JointPair(), np.deg2rad(20.0)
        >>> spring = joint_spring(pair, pair_command(pair, angle).pressures, angle)
        >>> round(float(spring.stiffness), 3)
        0.358
    """
    pressures = checked_pressures(pressures)
    near = jnp.asarray(near, dtype=pressures.dtype)
    load = jnp.asarray(load, dtype=pressures.dtype)
    spring, converged = _spring(pair, pressures, load, near)
    if is_concrete((spring, converged)):
        shown = float(jnp.rad2deg(near))
        remedy = "call equilibria, which returns all equilibria"
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
