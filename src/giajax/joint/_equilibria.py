"""All angles at which two pressures hold a joint, their stability and stiffness.

Where the muscles are straight their levers grow with the angle of the outer one: the pair is then
unstable, and the same two pressures hold the joint on either side of 0. That is the singularity
at 0 deg of which the paper speaks.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Scalar
from ..parameters import is_concrete
from ._geometry import LARGEST_ANGLE, check_geometry
from ._pair import JointPair, net_torque
from ._roots import bisect, polish
from ._statics import BRANCHES, branch_angles, muscle_path

# Intervals of the search on either side of 0: 0.1 deg each. Within one the torque is smooth or
# has one kink, and two roots in it are found by its extremum.
_INTERVALS = 600

# More roots, or extrema, than a side of any pair can have.
_MOST = 24

# A torque below this (N m) at 0 is the rounding of 0, and an angle below this (rad) is 0.
_NO_TORQUE = 1e-12
_NO_ANGLE = 1e-9

# Around a jump of the torque, as the printed beta has: how far from it its two sides are taken,
# rad, which the search resolves, and from which rise between them (N m) on it is a jump.
_BESIDE = 1e-12
_JUMP = 1e-9
# An extra node on either side of a jump, relative to its angle.
_APART = 1e-9

# Where each array of a side has what belongs to the angle 0.
_ZERO = -1


@dataclasses.dataclass(frozen=True)
class Equilibrium:
    """One angle at which a pair rests.

    Attributes:
        angle: rad.
        stiffness: d(torque)/d(angle) against a displacement, N m/rad; negative where the joint
            runs away. Infinite at a step of the torque (see `at_step`).
        muscle_stiffness: the muscles' part of it, without the corrections.
        stable: whether the joint comes back after a small push.
        branches: which path the first and the second muscle take.
        at_step: the torque changes its sign in a step of the corrections, as at a point of
            friction, and is zero on neither side of it: at 0, where alpha(0) and beta(0) differ,
            and with the printed beta at its width and its threshold (2 and 20 deg). The joint
            rests there, stiffness inf, where the torque falls through the step; where it rises
            the stiffness is -inf.
    """

    angle: float
    stiffness: float
    muscle_stiffness: float
    stable: bool
    branches: tuple[str, str]
    at_step: bool = False


@dataclasses.dataclass(frozen=True)
class Equilibria:
    """Every equilibrium within the joint's range, by angle.

    Attributes:
        found: the equilibria, from the smallest angle to the largest.
        at_lower_stop, at_upper_stop: whether the torque drives the joint against the end of its
            range, -60 or 60 deg.
        indifferent: whether there is a range of angles in which nothing acts on the joint, as
            with slack muscles: it rests at any of them, and none of them is listed.
    """

    found: tuple[Equilibrium, ...]
    at_lower_stop: bool
    at_upper_stop: bool
    indifferent: bool

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those to which the joint comes back."""
        return tuple(equilibrium for equilibrium in self.found if equilibrium.stable)

    @property
    def angles(self) -> np.ndarray:
        """Angles of all of them, rad, shape (equilibrium,)."""
        return np.asarray([equilibrium.angle for equilibrium in self.found])


def equilibria(
    pair: JointPair, pressures: npt.ArrayLike | Array, load: float | Array = 0.0
) -> Equilibria:
    """All angles within -60 to 60 deg at which two pressures hold a joint.

    The torque is evaluated every 0.1 deg and at its kinks; each interval is divided at the
    extremum of the torque where there is one inside, so that two near roots are both found.

    Arguments:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, shape (2,).
        load: torque from outside, towards negative angles, N m.

    Raises:
        InputError: pressures that are not two numbers of at least 0, or an impossible geometry.

    Example:
        >>> import giajax, numpy as np
        >>> pair = giajax.JointPair()
        >>> command = giajax.pair_command(pair, np.deg2rad(20.0))
        >>> found = giajax.equilibria(pair, command.pressures)
        >>> [(round(float(np.rad2deg(item.angle)), 1), item.stable) for item in found.found]
        [(-6.0, True), (-3.3, False), (20.0, True)]
    """
    pressures = _pressures(pressures)
    load = jnp.asarray(load, dtype=pressures.dtype)
    if not bool(jnp.isfinite(load)):
        raise InputError("the load is not finite; give a torque in N m")
    check_geometry(pair.joint.geometry)
    sides = {}
    for ahead in (False, True):
        nodes = jnp.asarray(_nodes(pair, ahead), dtype=pressures.dtype)
        side = _search((pair, pressures, load, jnp.asarray(ahead)), nodes)
        sides[ahead] = jax.device_get(side)
    found = [item for ahead, side in sides.items() for item in _listed(side, ahead)]
    idle = [bool(side.idle) for side in sides.values()]
    found += [] if any(idle) else _at_zero(sides[False], sides[True])
    return Equilibria(
        found=tuple(sorted(found, key=lambda item: item.angle)),
        at_lower_stop=bool(sides[False].first < 0),
        at_upper_stop=bool(sides[True].last > 0),
        indifferent=any(idle),
    )


def _pressures(pressures: npt.ArrayLike | Array) -> Array:
    pressures = jnp.asarray(pressures, dtype=jnp.result_type(float))
    if pressures.shape != (2,):
        raise InputError(
            f"the pressures have the shape {pressures.shape}; give two numbers, of the first and "
            "of the second muscle"
        )
    if is_concrete(pressures) and not bool(jnp.all((pressures >= 0) & jnp.isfinite(pressures))):
        raise InputError(
            f"the pressures are {pressures.tolist()} Pa; give pressures above the surroundings, "
            "finite and not negative"
        )
    return pressures


def _nodes(pair: JointPair, ahead: bool) -> np.ndarray:
    """Angles of one side, increasing: an even grid, and where the torque has a kink."""
    # A little beyond the end, so that an equilibrium at the end is not lost to rounding.
    end = LARGEST_ANGLE * (1 + 1e-9)
    grid = np.linspace(0.0, end, _INTERVALS + 1)
    correction = pair.joint.correction
    beta = correction.beta
    bends = (correction.alpha.threshold, beta.threshold, beta.width)
    kinks = [*map(float, bends), correction.blend]
    if correction.reading == "printed":
        jumps = np.array([float(beta.width), float(beta.threshold)])
        kinks += [*(jumps * (1 - _APART)), *(jumps * (1 + _APART))]
    sizes = np.abs([*branch_angles(pair.joint.geometry), *kinks])
    sizes = np.unique(np.concatenate([grid, sizes[sizes < end]]))
    # A fixed number, so that other kinks need no other program.
    sizes = np.pad(sizes, (0, _INTERVALS + 12 - len(sizes)), mode="edge")
    return sizes if ahead else -sizes[::-1]


def _torque(angle: Array, arguments: Any) -> Array:
    pair, pressures, load, ahead = arguments
    return net_torque(pair, pressures, load, angle, jnp.broadcast_to(ahead, angle.shape))


def _slope(angle: Array, arguments: Any) -> Array:
    return jax.jvp(lambda a: _torque(a, arguments), (angle,), (jnp.ones_like(angle),))[1]


def _resistance_slope(angle: Array, arguments: Any) -> Array:
    pair, _, _, ahead = arguments
    correction, side = pair.joint.correction, jnp.broadcast_to(ahead, angle.shape)

    def resistance(angle: Array) -> Array:
        return correction(angle, side) - correction(-angle, ~side)

    return jax.jvp(resistance, (angle,), (jnp.ones_like(angle),))[1]


class _Side(eqx.Module):
    """Roots of one side: the first `count` of each array, whose last element belongs to 0.

    `below` and `above` are the torques just beside each root, `first` and `last` those at the ends
    of the side, N m; `idle` whether there is none between two nodes.
    """

    count: Array
    angles: Array
    slopes: Array
    resistance: Array
    below: Array
    above: Array
    engaged: tuple[Array, Array]
    first: Array
    last: Array
    idle: Array


@program
def _search(arguments: Any, nodes: Array) -> _Side:
    """All roots between increasing nodes: one program for any pair of a kind."""
    pair, _, _, ahead = arguments
    torque, slope = _torque(nodes, arguments), _slope(nodes, arguments)
    # An extremum inside an interval may hide two roots.
    turning = _between(_slope, arguments, nodes, slope)
    inside = jnp.sort(jnp.concatenate([nodes, jnp.where(jnp.isnan(turning), nodes[-1], turning)]))
    roots = _between(_torque, arguments, inside, _torque(inside, arguments))
    roots = jnp.sort(roots)  # NaN, where there is none, comes last
    count = jnp.sum(~jnp.isnan(roots))
    angles = jnp.append(jnp.where(jnp.isnan(roots), 0, roots), jnp.zeros(1))
    side = jnp.broadcast_to(ahead, angles.shape)
    below, above = (_torque(angles + step, arguments) for step in (-_BESIDE, _BESIDE))
    # At one end of a jump the slopes are those of that end.
    smooth = jnp.where(jnp.abs(above) < jnp.abs(below), angles + _BESIDE, angles - _BESIDE)
    smooth = jnp.where(jnp.abs(above - below) > _JUMP, smooth, angles)
    return _Side(
        count=count,
        angles=angles,
        slopes=_slope(smooth, arguments),
        resistance=_resistance_slope(smooth, arguments),
        below=below,
        above=above,
        engaged=(
            muscle_path(pair.joint.geometry, angles, side).engaged,
            muscle_path(pair.joint.geometry, -angles, ~side).engaged,
        ),
        first=torque[0],
        last=torque[-1],
        idle=jnp.any((torque[1:] == 0) & (torque[:-1] == 0) & (nodes[1:] > nodes[:-1])),
    )


def _between(
    function: Callable[[Array, Any], Array], arguments: Any, nodes: Array, values: Array
) -> Array:
    """Roots between neighbouring nodes where the sign differs; NaN fills the array."""
    sign = jnp.sign(values)
    (at,) = jnp.nonzero(
        (sign[:-1] != sign[1:]) & (sign[1:] != 0) & (nodes[1:] > nodes[:-1]),
        size=_MOST,
        fill_value=len(nodes),
    )
    low, high = (nodes.at[at + step].get(mode="fill", fill_value=0.0) for step in (0, 1))
    roots = jax.vmap(lambda a, b: bisect(lambda x: function(x, arguments), a, b))(low, high)
    return jnp.where(at < len(nodes), roots, jnp.nan)


def _listed(side: _Side, ahead: bool) -> list[Equilibrium]:
    """The roots of one side, without one at 0."""
    rows = [row for row in range(int(side.count)) if abs(side.angles[row]) > _NO_ANGLE]
    return [_equilibrium(side, row, ahead, **_in_jump(side, row)) for row in rows]


def _in_jump(side: _Side, row: int) -> dict[str, Any]:
    """What is different of a root that is a jump of the torque; nothing where it is none."""
    below, above = float(side.below[row]), float(side.above[row])
    if abs(above - below) <= _JUMP:
        return {}
    falls = above < below
    if min(abs(below), abs(above)) <= _JUMP:
        return {"stable": falls and bool(side.slopes[row] < 0)}
    slope = float(side.slopes[row] + side.resistance[row])
    stiffness = math.inf if falls else -math.inf
    return {"stiffness": stiffness, "muscle_stiffness": -slope, "stable": falls, "at_step": True}


def _equilibrium(side: _Side, row: int, ahead: bool, **more: Any) -> Equilibrium:
    stiffness = -float(side.slopes[row])
    facts: dict[str, Any] = {
        "angle": float(side.angles[row]),
        "stiffness": stiffness,
        "muscle_stiffness": stiffness - float(side.resistance[row]),
        "stable": stiffness > 0,
        "branches": (
            _branch(ahead, bool(side.engaged[0][row])),
            _branch(not ahead, bool(side.engaged[1][row])),
        ),
    }
    return Equilibrium(**{**facts, **more})


def _branch(inner: bool, engaged: bool) -> str:
    return BRANCHES[(0 if engaged else 1) if inner else (3 if engaged else 2)]


def _at_zero(behind: _Side, ahead: _Side) -> list[Equilibrium]:
    """The equilibrium at 0, if there is one.

    The torque steps there by alpha(0) - beta(0) on either side. It may change its sign in the
    step, or be zero at one of its ends, where only the other side decides what is stable.
    """
    before, after = float(behind.last), float(ahead.first)
    to_zero = {False: after < 0, True: before > 0}  # what the torque beyond 0 does
    if abs(before) <= _NO_TORQUE and abs(after) <= _NO_TORQUE:
        return [_equilibrium(ahead, _ZERO, True)]
    for value, side, is_ahead in ((after, ahead, True), (before, behind, False)):
        if abs(value) <= _NO_TORQUE:
            stable = bool(side.slopes[_ZERO] < 0) and to_zero[is_ahead]
            return [_equilibrium(side, _ZERO, is_ahead, stable=stable)]
    if before * after > 0:
        return []
    stable = before > 0
    stiffness = math.inf if stable else -math.inf
    muscles = -float(ahead.slopes[_ZERO] + ahead.resistance[_ZERO])
    return [
        _equilibrium(
            ahead,
            _ZERO,
            True,
            stiffness=stiffness,
            muscle_stiffness=muscles,
            stable=stable,
            at_step=True,
        )
    ]


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
    right however the root was found. To be used as the spring of section III.A, whose constant
    and initial length change.

    Arguments:
        pair: the joint and its muscles.
        pressures: of the first and the second muscle, Pa, shape (2,).
        near: where to look, rad; not 0, where the corrections have their step.
        load: torque from outside, towards negative angles, N m.

    Raises:
        InputError: there is no equilibrium near, or it is not stable, or it lies at 0.

    Example:
        >>> import giajax, numpy as np
        >>> pair, angle = giajax.JointPair(), np.deg2rad(20.0)
        >>> spring = giajax.joint_spring(pair, giajax.pair_command(pair, angle).pressures, angle)
        >>> round(float(spring.stiffness), 3)
        0.358
    """
    pressures = _pressures(pressures)
    near = jnp.asarray(near, dtype=pressures.dtype)
    load = jnp.asarray(load, dtype=pressures.dtype)
    spring, converged = _spring(pair, pressures, load, near)
    if is_concrete((spring, converged)):
        shown = float(jnp.rad2deg(near))
        remedy = "'equilibria' lists them all"
        same_side = float(spring.rest_angle) * float(near) > 0
        inside = abs(float(spring.rest_angle)) <= LARGEST_ANGLE * (1 + 1e-9)
        if not (bool(converged) and same_side and inside):
            raise InputError(f"these pressures have no equilibrium near {shown:.4g} deg; {remedy}")
        if not float(spring.stiffness) > 0:
            raise InputError(f"the equilibrium near {shown:.4g} deg is not stable; {remedy}")
    return spring


@program
def _spring(pair: JointPair, pressures: Array, load: Array, near: Array) -> tuple[Spring, Array]:
    arguments = (pair, pressures, load, jax.lax.stop_gradient(near) >= 0)
    angle, converged = polish(_torque, near, arguments)
    return Spring(rest_angle=angle, stiffness=-_slope(angle, arguments)), converged
