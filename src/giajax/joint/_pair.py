"""The bending-angle controller (fig. 6): two muscles against each other, and their pressures."""

from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Float, Scalar
from ..parameters import is_concrete
from ._answer import PressureAnswer
from ._balance import MuscleState
from ._braided import BraidedMuscle
from ._geometry import LARGEST_ANGLE, check_geometry
from ._muscle import AbstractMuscle
from ._statics import Joint, balanced

T = TypeVar("T")


class JointPair(eqx.Module):
    """A joint with two equal muscles on opposite sides, and no friction.

    The angle of the pair is positive where the joint bends towards the first muscle, which is
    then the inner one.

    Arguments:
        joint: geometry and corrections, of either side.
        muscle: the law of both muscles.
    """

    joint: Joint = eqx.field(default_factory=Joint)
    muscle: AbstractMuscle = eqx.field(default_factory=BraidedMuscle)

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

    angle: Float[Array, "*shape"]
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

    The inner muscle balances the co-contraction torque, alpha and what of the load acts against
    the bending; the outer one the co-contraction torque and beta.

    Arguments:
        pair: the joint and its muscles.
        angle: to be held, rad, any shape, within -60 to 60 deg.
        load: torque from outside, towards negative angles, N m, one number or one an angle.
        cocontraction: torque of each muscle against the other, N m; the joint's 0.3 by default.

    Returns:
        Contractions, forces and pressures of both muscles. Where no pressure gives a
        force, its answer says why.

    Raises:
        InputError: an angle beyond 60 deg, a number that is not finite, or an impossible
            geometry.

    Example:
        >>> import giajax, numpy as np
        >>> command = giajax.pair_command(giajax.JointPair(), np.deg2rad(20.0))
        >>> [round(float(pressure) / 1e3, 1) for pressure in command.pressures]
        [29.5, 27.2]
    """
    dtype = jnp.result_type(float)
    angle = jnp.asarray(angle, dtype=dtype)
    load = jnp.broadcast_to(jnp.asarray(load, dtype=dtype), angle.shape)
    torque = pair.joint.torque if cocontraction is None else cocontraction
    torque = jnp.broadcast_to(jnp.asarray(torque, dtype=dtype), angle.shape)
    if is_concrete((pair, angle, load, torque)):
        check_range(angle)
        if not bool(jnp.all(jnp.isfinite(load) & jnp.isfinite(torque))):
            raise InputError("a load or co-contraction torque is not finite: give finite numbers")
        angles = np.asarray(angle).ravel()
        check_geometry(pair.joint.geometry, np.concatenate([angles, -angles]))
    return _pair_command(pair, angle, load, torque)


def check_range(angle: Array) -> None:
    """Refuse angles beyond the range of the joint."""
    inside = jnp.abs(angle) <= LARGEST_ANGLE * (1 + 1e-12)
    if not bool(jnp.all(inside)):
        worst = float(jnp.rad2deg(angle.ravel()[jnp.argmin(inside)]))
        raise InputError(
            f"the angle is {worst:.4g} deg, and a joint bends by at most 60 deg: give "
            "radians, and a smaller angle"
        )


def commanded(pair: JointPair, angle: Array, load: Array, torque: Array) -> PairCommand:
    """What holds a pair at an angle, as `pair_command` does; nothing is checked.

    Arguments:
        pair: the joint and its muscles.
        angle: to be held, rad.
        load: torque from outside, towards negative angles, N m, of the same shape.
        torque: co-contraction torque, N m, of the same shape.

    Returns:
        Contractions, forces and pressures of both muscles.
    """
    ahead = angle >= 0
    share = jnp.stack([jnp.where(ahead, load, 0), jnp.where(ahead, 0, -load)])
    sides, angles = jnp.stack([ahead, ~ahead]), jnp.stack([angle, -angle])
    # Both muscles at once are half of the operations.
    state = balanced(pair.joint, angles, torque[None] + share, sides)
    answer = pair.muscle.answer(state.force, state.contraction, pair.length)

    def of(muscle: int, both: T) -> T:
        return jax.tree.map(lambda values: values[muscle], both)

    return PairCommand(
        angle=angle,
        first=of(0, state),
        second=of(1, state),
        first_pressure=of(0, answer),
        second_pressure=of(1, answer),
    )


_pair_command = program(commanded)
