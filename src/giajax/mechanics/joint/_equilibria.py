"""All angles at which two pressures hold a joint, their stability and stiffness.

Where the muscles are straight their levers grow with the angle of the outer one: the pair is then
unstable, and the same two pressures hold the joint on either side of 0. That is the paper's
singularity at 0 deg.
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

from ...runtime.arrays import Array, Bool, Float, Int, Scalar, bisect
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import crushed
from ..wrinkling import check_neck, stretching
from ._geometry import BRANCHES, LARGEST_ANGLE, branch_angles, check_geometry, muscle_path
from ._pair import (
    JointPair,
    OneSide,
    checked_pressures,
    compression,
    correction_slope,
    side_slope,
    side_torque,
)


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
        every: the equilibria, stable or not, from the smallest angle to the largest.
        at_lower_stop, at_upper_stop: whether the torque drives the joint against the end of its
            range, -60 or 60 deg.
        indifferent: whether there is a range of angles in which nothing acts on the joint, as
            with slack muscles: it rests at any of them, and none of them is listed.
    """

    every: tuple[Equilibrium, ...]
    at_lower_stop: bool
    at_upper_stop: bool
    indifferent: bool

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those to which the joint comes back."""
        return tuple(equilibrium for equilibrium in self.every if equilibrium.stable)

    @property
    def angles(self) -> np.ndarray:
        """Angles of all of them, rad, shape (equilibrium,)."""
        return np.asarray([equilibrium.angle for equilibrium in self.every])


# Intervals of the search on either side of 0: 0.1 deg each. Within one the torque is smooth or
# has one kink, and its extremum parts two roots.
_INTERVALS = 600

_MOST = 24  # more roots, or extrema, than a side of any pair can have

# Around a jump of the torque, as the printed beta has: how far from it its two sides are taken,
# rad, which the search resolves, and from which rise between them (N m) on it is a jump.
_BESIDE = 1e-12
JUMP = 1e-9

_APART = 1e-9  # an extra node on either side of a jump, relative to its angle


class Roots(eqx.Module):
    """Roots of the torque on one side of 0.

    The first `count` elements of each array belong to them, the last one to the angle 0: angles
    (rad), slopes of the torque and of the corrections (N m/rad), and torques just beside each root
    (N m). `engaged` is whether the wire of the first and of the second muscle is taut or the muscle
    wraps, `first` and `last` the torques at the ends of the side (N m), `idle` whether there is no
    torque anywhere between two nodes.
    """

    count: Int[Array, ""]
    angles: Float[Array, " root"]
    slopes: Float[Array, " root"]
    resistance: Float[Array, " root"]
    below: Float[Array, " root"]
    above: Float[Array, " root"]
    engaged: tuple[Bool[Array, " root"], Bool[Array, " root"]]
    first: Scalar
    last: Scalar
    idle: Bool[Array, ""]


@program
def search(side: OneSide, nodes: Float[Array, " node"]) -> Roots:
    """All roots between increasing nodes: one program for any pair of a kind."""
    torque, slope = side_torque(nodes, side), side_slope(nodes, side)
    # An extremum inside an interval may hide two roots.
    turning = _between(side_slope, side, nodes, slope)
    inside = jnp.sort(jnp.concatenate([nodes, jnp.where(jnp.isnan(turning), nodes[-1], turning)]))
    roots = _between(side_torque, side, inside, side_torque(inside, side))
    roots = jnp.sort(roots)  # NaN, where there is none, comes last
    count = jnp.sum(~jnp.isnan(roots))
    angles = jnp.append(jnp.where(jnp.isnan(roots), 0, roots), jnp.zeros(1))
    below, above = (side_torque(angles + step, side) for step in (-_BESIDE, _BESIDE))
    geometry, ahead = side.pair.joint.geometry, jnp.broadcast_to(side.ahead, angles.shape)
    # At one end of a jump the slopes are those of that end.
    smooth = jnp.where(jnp.abs(above) < jnp.abs(below), angles + _BESIDE, angles - _BESIDE)
    smooth = jnp.where(jnp.abs(above - below) > JUMP, smooth, angles)
    return Roots(
        count=count,
        angles=angles,
        slopes=side_slope(smooth, side),
        resistance=correction_slope(smooth, side),
        below=below,
        above=above,
        engaged=(
            muscle_path(geometry, angles, ahead).engaged,
            muscle_path(geometry, -angles, ~ahead).engaged,
        ),
        first=torque[0],
        last=torque[-1],
        idle=jnp.any((torque[1:] == 0) & (torque[:-1] == 0) & (nodes[1:] > nodes[:-1])),
    )


def _between(
    function: Callable[[Array, OneSide], Array], side: OneSide, nodes: Array, values: Array
) -> Array:
    """Roots between neighbouring nodes where the sign differs; NaN fills the array."""
    sign = jnp.sign(values)
    (at,) = jnp.nonzero(
        (sign[:-1] != sign[1:]) & (sign[1:] != 0) & (nodes[1:] > nodes[:-1]),
        size=_MOST,
        fill_value=len(nodes),
    )
    low, high = (nodes.at[at + step].get(mode="fill", fill_value=0.0) for step in (0, 1))
    signs = tuple(sign.at[at + step].get(mode="fill", fill_value=0.0) for step in (0, 1))
    roots = jax.vmap(lambda *ends: bisect(lambda x: function(x, side), *ends))(low, high, signs)
    return jnp.where(at < len(nodes), roots, jnp.nan)


def angles_to_search(pair: JointPair, ahead: bool) -> np.ndarray:
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


# A torque below this (N m) at 0 is the rounding of 0, and an angle below this (rad) is 0.
_NO_TORQUE = 1e-12
_NO_ANGLE = 1e-9

_ZERO = -1  # where each array of a side has what belongs to the angle 0


def equilibria(
    pair: JointPair, pressures: npt.ArrayLike | Array, load: float | Array = 0.0
) -> Equilibria:
    """All angles within -60 to 60 deg at which two pressures hold a joint.

    The torque is evaluated every 0.1 deg and at its kinks; each interval is divided at the
    extremum of the torque where there is one inside, so that neither of two near roots is missed.

    Arguments:
        pressures: of the first and the second muscle, Pa.
        load: torque from outside, towards negative angles, N m.

    Raises:
        InputError: pressures that are not two numbers of at least 0, an impossible geometry, or a
            neck that the muscles crush in the straight joint.

    Example:
        >>> import numpy as np
        >>> from giajax.mechanics.joint import JointPair, equilibria, pair_command
        >>> pair = JointPair()
        >>> command = pair_command(pair, np.deg2rad(20.0))
        >>> rests = equilibria(pair, command.pressures)
        >>> [(round(float(np.rad2deg(item.angle)), 1), item.stable) for item in rests.every]
        [(-6.0, True), (-3.3, False), (20.0, True)]
    """
    pressures = checked_pressures(pressures)
    load = jnp.asarray(load, dtype=pressures.dtype)
    if not bool(jnp.isfinite(load)):
        raise InputError("the load is not finite: give a torque in N m")
    check_geometry(pair.joint.geometry)
    sentence = crushed_neck(pair, pressures)
    if sentence is not None:
        raise InputError(f"{sentence}: make neck.pressure or neck.radius larger")
    sides = {}
    for ahead in (False, True):
        nodes = jnp.asarray(angles_to_search(pair, ahead), dtype=pressures.dtype)
        roots = search(OneSide(pair, pressures, load, jnp.asarray(ahead)), nodes)
        sides[ahead] = jax.device_get(roots)
    resting = [item for ahead, roots in sides.items() for item in _listed(roots, ahead)]
    idle = [bool(roots.idle) for roots in sides.values()]
    resting += [] if any(idle) else _at_zero(sides[False], sides[True])
    return Equilibria(
        every=tuple(sorted(resting, key=lambda item: item.angle)),
        at_lower_stop=bool(sides[False].first < 0),
        at_upper_stop=bool(sides[True].last > 0),
        indifferent=any(idle),
    )


def crushed_neck(pair: JointPair, pressures: Array) -> str | None:
    """That pressures (Pa) of the muscles crush the neck of the straight joint; None: they do not.

    Raises:
        InputError: a size of the neck is 0.
    """
    if pair.neck.radius is None:
        return None
    check_neck(pair.neck)
    pressed = compression(pair, pressures, jnp.zeros(()), jnp.asarray(True))
    return crushed(float(pressed), float(pressed + stretching(pair.neck, pressed)))


def _listed(roots: Roots, ahead: bool) -> list[Equilibrium]:
    """The roots of one side, without one at 0."""
    rows = [row for row in range(int(roots.count)) if abs(roots.angles[row]) > _NO_ANGLE]
    return [_equilibrium(roots, row, ahead, **_in_jump(roots, row)) for row in rows]


def _in_jump(roots: Roots, row: int) -> dict[str, Any]:
    """What is different at a root in a jump of the torque; nothing elsewhere."""
    below, above = float(roots.below[row]), float(roots.above[row])
    if abs(above - below) <= JUMP:
        return {}
    falls = above < below
    if min(abs(below), abs(above)) <= JUMP:
        return {"stable": falls and bool(roots.slopes[row] < 0)}
    return _step(roots, row, falls=falls)


def _step(roots: Roots, row: int, *, falls: bool) -> dict[str, Any]:
    """What is different where the torque steps through 0: it is stable where it falls."""
    slope = float(roots.slopes[row] + roots.resistance[row])
    stiffness = math.inf if falls else -math.inf
    return {"stiffness": stiffness, "muscle_stiffness": -slope, "stable": falls, "at_step": True}


def _equilibrium(roots: Roots, row: int, ahead: bool, **more: Any) -> Equilibrium:
    stiffness = -float(roots.slopes[row])
    facts: dict[str, Any] = {
        "angle": float(roots.angles[row]),
        "stiffness": stiffness,
        "muscle_stiffness": stiffness - float(roots.resistance[row]),
        "stable": stiffness > 0,
        "branches": tuple(
            BRANCHES[1 - int(engaged[row]) if inner else 2 + int(engaged[row])]
            for inner, engaged in zip((ahead, not ahead), roots.engaged, strict=True)
        ),
    }
    return Equilibrium(**{**facts, **more})


def _at_zero(behind: Roots, ahead: Roots) -> list[Equilibrium]:
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
    return [_equilibrium(ahead, _ZERO, True, **_step(ahead, _ZERO, falls=before > 0))]
