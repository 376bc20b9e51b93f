"""The bending-angle controller (fig. 6): two antagonistic muscles and their pressures."""

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
    """A joint with two equal muscles on opposite sides, without friction.

    The angle of the pair is positive if the joint bends towards the first muscle, which is then the
    inner muscle.

    Arguments:
        joint: geometry and corrections, the same on both sides.
        muscle: law of both muscles.
        neck: neck of film between the links, which bends and is compressed; none by default.
    """

    joint: Joint = eqx.field(default_factory=Joint)
    muscle: AbstractMuscle = eqx.field(default_factory=BraidedMuscle)
    neck: Neck = eqx.field(default_factory=Neck)

    @property
    def length(self) -> Scalar:
        """Length of each muscle at rest, m."""
        return self.joint.geometry.muscle_length


class PairCommand(eqx.Module):
    """Muscle states and pressures that hold the joint at an angle.

    Attributes:
        angle: angle of the pair, rad, any shape.
        first, second: states of the first and the second muscle; a positive angle bends the joint
            towards the first muscle.
        first_pressure, second_pressure: pressures of the two muscles, and whether they produce
            the required forces.
    """

    angle: Shaped
    first: MuscleState
    second: MuscleState
    first_pressure: PressureAnswer
    second_pressure: PressureAnswer

    @property
    def pressures(self) -> Float[Array, "*shape 2"]:
        """Both pressures, stacked along the last axis, Pa."""
        both = (self.first_pressure.pressure, self.second_pressure.pressure)
        return jnp.stack(both, axis=-1)

    @property
    def reached(self) -> Array:
        """Whether both muscles can produce the required forces."""
        return self.first_pressure.reached & self.second_pressure.reached


def pair_command(
    pair: JointPair,
    angle: npt.ArrayLike | Array,
    load: npt.ArrayLike | Array = 0.0,
    cocontraction: npt.ArrayLike | Array | None = None,
) -> PairCommand:
    """Return the pressures that hold a pair at an angle against a load (fig. 6).

    The inner muscle balances the co-contraction torque, alpha and the load, which is positive if it
    acts against the bending. The outer muscle balances the co-contraction torque and beta. If no
    pressure produces a required force, the corresponding `PressureAnswer` gives the reason. This is
    the controller of the paper, which does not take a neck into account.

    Arguments:
        pair: the joint with its muscles.
        angle: angle to be held, rad, any shape, within -60 to 60 deg.
        load: external torque towards negative angles, N m; one number, or one for each angle.
        cocontraction: torque of each muscle against the other, N m; by default the torque of the
            joint (0.3 N m).

    Raises:
        InputError: an angle is beyond 60 deg, a number is not finite, or the geometry is
            impossible.

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
                "smaller angle, in radians"
            )
        if not bool(jnp.all(jnp.isfinite(load) & jnp.isfinite(torque))):
            raise InputError("a load or co-contraction torque is not finite: give finite numbers")
        angles = np.asarray(angle).ravel()
        check_geometry(pair.joint.geometry, np.concatenate([angles, -angles]))
    return _pair_command(pair, angle, load, torque)


def commanded(pair: JointPair, angle: Array, load: Array, torque: Array) -> PairCommand:
    """Return the command of `pair_command` without checking the arguments.

    Arguments:
        pair: the joint with its muscles.
        angle: angle to be held, rad.
        load: external torque towards negative angles, N m, of the same shape.
        torque: co-contraction torque, N m, of the same shape.
    """
    ahead, joint = angle >= 0, pair.joint
    size = jnp.where(ahead, angle, -angle)
    resisted = jnp.where(ahead, load, -load)  # load that acts against the bending

    def answered(
        unit: Tension, angle: Shaped, torque: Shaped, inner: Array
    ) -> tuple[MuscleState, PressureAnswer]:
        state = balance_of(unit, joint.geometry, angle, torque + joint.correction(angle, inner))
        return state, pair.muscle.answer(state.force, state.contraction, pair.length)

    bend, yes = Bend.by(size), jnp.ones_like(ahead)
    inner = answered(inner_tension(joint.geometry, bend), size, torque + resisted, yes)
    outer = answered(outer_tension(joint.geometry, bend.back), -size, torque, ~yes)
    # The first muscle is the inner one if the joint bends towards it.
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
    """Return the net torque towards positive angles at two pressures, N m; 0 in equilibrium.

    The corrections resist bending towards either side with alpha - beta, towards 0. The neck, if
    there is one, resists bending as well.

    Arguments:
        pair: the joint with its muscles.
        pressures: pressures of the first and the second muscle, Pa; shape (2,) if they are the same
            at all angles, otherwise with further axes that correspond to those of the angles.
        load: external torque towards negative angles, N m.
        angle: angle of the pair, rad.
        ahead: whether the first muscle is the inner one; needed at an angle of 0.
    """
    first, second = muscle_torques(pair, pressures, angle, ahead)
    torque = first - second - resistance(pair.joint.correction, angle, ahead) - load
    if pair.neck.radius is None:
        return torque
    return torque - neck_moment(pair.neck, angle, compression(pair, pressures, angle, ahead))


def muscle_torques(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> Float[Array, "2 *shape"]:
    """Return the torque of each muscle of a pair towards its own side, N m.

    The arguments are those of `net_torque`.
    """
    inner, outer = (pull.force * pull.lever for pull in _pulls(pair, pressures, angle, ahead))
    return jnp.stack([jnp.where(ahead, inner, outer), jnp.where(ahead, outer, inner)])


def compression(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> Shaped:
    """Return the force with which both muscles press the links of a joint together, N.

    On the bisector, a muscle with its wire exerts a force along the links at the height at which it
    crosses the bisector. This force is the torque of the muscle divided by the height. The
    arguments are those of `net_torque`.
    """
    inner, outer = _pulls(pair, pressures, angle, ahead)
    return inner.force * inner.lever / inner.height + outer.force * outer.lever / outer.height


class _Pull(NamedTuple):
    """Force and geometry of a muscle.

    Attributes:
        force: tension of the muscle, N.
        lever: lever arm about the centre of the joint, m.
        height: height at which the muscle crosses the bisector, m.
    """

    force: Shaped
    lever: Shaped
    height: Shaped


def _pulls(
    pair: JointPair, pressures: Float[Array, "2 ..."], angle: Shaped, ahead: Array
) -> tuple[_Pull, _Pull]:
    """Return the pulls of the inner and of the outer muscle."""
    # One of the two muscles is the inner one. Each side is computed once, for the muscle on it.
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
    """A pair at given pressures and load, on one side of 0.

    Attributes:
        pair: the joint with its muscles.
        pressures: pressures of the first and the second muscle, Pa.
        load: external torque towards negative angles, N m.
        ahead: whether the side is that of positive angles; needed at an angle of 0.
    """

    pair: JointPair
    pressures: Float[Array, "2"]
    load: Scalar
    ahead: Bool[Array, ""]


def side_torque(angle: Shaped, side: OneSide) -> Shaped:
    """Return the torque on the joint at angles (rad) of one side, N m."""
    ahead = jnp.broadcast_to(side.ahead, angle.shape)
    return net_torque(side.pair, side.pressures, side.load, angle, ahead)


def side_slope(angle: Shaped, side: OneSide) -> Shaped:
    """Return the derivative of the torque with respect to the angle, N m/rad."""
    return jax.jvp(lambda a: side_torque(a, side), (angle,), (jnp.ones_like(angle),))[1]


def correction_slope(angle: Shaped, side: OneSide) -> Shaped:
    """Return the derivative of the resisting torque of both corrections, N m/rad."""
    correction, ahead = side.pair.joint.correction, jnp.broadcast_to(side.ahead, angle.shape)
    return jax.jvp(lambda a: resistance(correction, a, ahead), (angle,), (jnp.ones_like(angle),))[1]


def checked_pressures(pressures: npt.ArrayLike | Array) -> Float[Array, "2"]:
    """Convert two pressures to an array, Pa.

    Raises:
        InputError: the pressures are not two finite numbers of at least 0.
    """
    pressures = jnp.asarray(pressures, dtype=jnp.result_type(float))
    if pressures.shape != (2,):
        raise InputError(
            f"the pressures have the shape {pressures.shape}: give two numbers, one for each muscle"
        )
    if is_concrete(pressures) and not bool(jnp.all((pressures >= 0) & jnp.isfinite(pressures))):
        raise InputError(
            f"the pressures are {pressures.tolist()} Pa: give finite gauge pressures that are not "
            "negative"
        )
    return pressures


class Spring(eqx.Module):
    """Linear spring equivalent to a joint with two pressures near a stable equilibrium.

    It can replace the muscles in a joint of an arm.

    Attributes:
        rest_angle: equilibrium angle, rad, which is the command of the joint of the arm.
        stiffness: stiffness, N m/rad.
    """

    rest_angle: Scalar
    stiffness: Scalar


def joint_spring(
    pair: JointPair,
    pressures: npt.ArrayLike | Array,
    near: float | Array,
    load: float | Array = 0.0,
) -> Spring:
    """Return rest angle (rad) and stiffness (N m/rad) of the stable equilibrium near an angle.

    The result is differentiable. The derivative of the rest angle is computed implicitly from the
    equilibrium condition, so it does not depend on the steps of the solver. The result can be used
    as the spring of section III.A of the paper, whose constant and initial length change.

    Arguments:
        pair: the joint with its muscles.
        pressures: pressures of the first and the second muscle, Pa.
        near: initial guess of the angle, rad; not 0, where the corrections jump.
        load: external torque towards negative angles, N m.

    Raises:
        InputError: there is no equilibrium near the angle, or it is not stable, or it lies at 0.

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
            raise InputError(
                f"the joint has no equilibrium near {shown:.4g} deg at these pressures: {remedy}"
            )
        if not float(spring.stiffness) > 0:
            raise InputError(f"the equilibrium near {shown:.4g} deg is not stable: {remedy}")
    return spring


@program
def _spring(pair: JointPair, pressures: Array, load: Array, near: Array) -> tuple[Spring, Array]:
    side = OneSide(pair, pressures, load, jax.lax.stop_gradient(near) >= 0)
    angle, converged = polish(side_torque, near, side)
    return Spring(rest_angle=angle, stiffness=-side_slope(angle, side)), converged
