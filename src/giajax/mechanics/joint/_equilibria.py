"""All equilibrium angles of a joint at two given pressures, with stability and stiffness.

If the muscles are straight, the lever arm of the outer muscle increases with the angle. The pair is
then unstable, and the same two pressures hold the joint on either side of 0. This is the
singularity at 0 deg that the paper describes.
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
    """One equilibrium of a pair.

    Attributes:
        angle: equilibrium angle, rad.
        stiffness: increase in the restoring torque with the displacement, N m/rad; negative if the
            equilibrium is unstable, infinite at a jump of the torque (see `at_step`).
        muscle_stiffness: contribution of the muscles to the stiffness, without the corrections.
        stable: whether the joint returns after a small displacement.
        branches: branches of the paths of the first and the second muscle.
        at_step: whether the torque changes sign in a jump of the corrections and is zero on neither
            side, similar to dry friction. Jumps occur at 0, where alpha(0) and beta(0) differ, and
            at the width and the threshold of the printed beta (2 and 20 deg). If the torque
            decreases in the jump, the equilibrium is stable with the stiffness inf. If it
            increases, the stiffness is -inf.
    """

    angle: float
    stiffness: float
    muscle_stiffness: float
    stable: bool
    branches: tuple[str, str]
    at_step: bool = False


@dataclasses.dataclass(frozen=True)
class Equilibria:
    """All equilibria within the range of the joint.

    Attributes:
        every: stable and unstable equilibria in order of increasing angle.
        at_lower_stop, at_upper_stop: whether the torque drives the joint against the end of its
            range, -60 or 60 deg.
        indifferent: whether there is an interval of angles without torque, for example with slack
            muscles. The joint rests at any of these angles, and none of them is listed.
    """

    every: tuple[Equilibrium, ...]
    at_lower_stop: bool
    at_upper_stop: bool
    indifferent: bool

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """The stable equilibria."""
        return tuple(equilibrium for equilibrium in self.every if equilibrium.stable)

    @property
    def angles(self) -> np.ndarray:
        """Angles of all equilibria, rad, shape (equilibrium,)."""
        return np.asarray([equilibrium.angle for equilibrium in self.every])


# Number of search intervals of 0.1 deg on either side of 0. In each interval, the torque is smooth
# or has one kink, and an extremum separates two roots.
_INTERVALS = 600

_MOST = 24  # larger than the number of roots or extrema on one side of any pair

# The printed beta causes jumps of the torque. `_BESIDE` is the distance (rad) from a root at which
# the torques on both sides are evaluated. Their difference is a jump if it exceeds `JUMP` (N m).
_BESIDE = 1e-12
JUMP = 1e-9

_APART = 1e-9  # distance of an extra node on either side of a jump, relative to its angle


class Roots(eqx.Module):
    """Roots of the torque on one side of 0.

    In each array, the first `count` elements belong to the roots, and the last element belongs to
    the angle 0.

    Attributes:
        count: number of roots.
        angles: angles of the roots, rad.
        slopes: derivatives of the torque with respect to the angle, N m/rad.
        resistance: derivatives of the resisting torque of the corrections, N m/rad.
        below, above: torques directly below and above each root, N m.
        engaged: for the first and the second muscle, whether its wire is taut or it wraps around
            the balloon.
        first, last: torques at the first and the last node of the side, N m.
        idle: whether the torque is 0 at two neighbouring nodes.
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
    """Find all roots between increasing nodes.

    One compiled program serves all pairs of the same structure.
    """
    torque, slope = side_torque(nodes, side), side_slope(nodes, side)
    # An interval with an extremum may contain two roots.
    turning = _between(side_slope, side, nodes, slope)
    inside = jnp.sort(jnp.concatenate([nodes, jnp.where(jnp.isnan(turning), nodes[-1], turning)]))
    roots = _between(side_torque, side, inside, side_torque(inside, side))
    roots = jnp.sort(roots)  # missing roots are NaN and are sorted to the end
    count = jnp.sum(~jnp.isnan(roots))
    angles = jnp.append(jnp.where(jnp.isnan(roots), 0, roots), jnp.zeros(1))
    below, above = (side_torque(angles + step, side) for step in (-_BESIDE, _BESIDE))
    geometry, ahead = side.pair.joint.geometry, jnp.broadcast_to(side.ahead, angles.shape)
    # If a root is at one end of a jump, the slopes are evaluated on that side of the jump.
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
    """Return the roots between neighbouring nodes whose signs differ, padded with NaN."""
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
    """Return increasing angles of one side: a uniform grid and the kinks of the torque."""
    # The grid ends slightly beyond the range, so that rounding does not lose an equilibrium there.
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
    # The number of angles is fixed, so that the program is not compiled again for other kinks.
    sizes = np.pad(sizes, (0, _INTERVALS + 12 - len(sizes)), mode="edge")
    return sizes if ahead else -sizes[::-1]


# A smaller torque (N m) at the angle 0 and a smaller angle (rad) are rounding errors of zero.
_NO_TORQUE = 1e-12
_NO_ANGLE = 1e-9

_ZERO = -1  # index of the element that belongs to the angle 0 in the arrays of a side


def equilibria(
    pair: JointPair, pressures: npt.ArrayLike | Array, load: float | Array = 0.0
) -> Equilibria:
    """Find all angles from -60 to 60 deg at which two pressures hold a joint.

    The torque is evaluated every 0.1 deg and at its kinks. An interval that contains an extremum of
    the torque is divided there, so that two roots near each other are both found.

    Arguments:
        pair: the joint with its muscles.
        pressures: pressures of the first and the second muscle, Pa.
        load: external torque towards negative angles, N m.

    Raises:
        InputError: the pressures are not two numbers of at least 0, the geometry is impossible, or
            the muscles crush the neck of the straight joint.

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
    """Return a message if pressures (Pa) crush the neck of the straight joint, otherwise None.

    Raises:
        InputError: a dimension of the neck is not positive.
    """
    if pair.neck.radius is None:
        return None
    check_neck(pair.neck)
    pressed = compression(pair, pressures, jnp.zeros(()), jnp.asarray(True))
    return crushed(float(pressed), float(pressed + stretching(pair.neck, pressed)))


def _listed(roots: Roots, ahead: bool) -> list[Equilibrium]:
    """Return the equilibria of one side, except at the angle 0."""
    rows = [row for row in range(int(roots.count)) if abs(roots.angles[row]) > _NO_ANGLE]
    return [_equilibrium(roots, row, ahead, **_in_jump(roots, row)) for row in rows]


def _in_jump(roots: Roots, row: int) -> dict[str, Any]:
    """Return the attributes of an equilibrium that differ in a jump; empty elsewhere."""
    below, above = float(roots.below[row]), float(roots.above[row])
    if abs(above - below) <= JUMP:
        return {}
    falls = above < below
    if min(abs(below), abs(above)) <= JUMP:
        return {"stable": falls and bool(roots.slopes[row] < 0)}
    return _step(roots, row, falls=falls)


def _step(roots: Roots, row: int, *, falls: bool) -> dict[str, Any]:
    """Return the attributes of an equilibrium where the torque jumps through 0.

    The equilibrium is stable if the torque falls in the jump.
    """
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
    """Return the equilibrium at the angle 0, if there is one.

    The torque jumps there by alpha(0) - beta(0) on either side. It may change sign in the jump. If
    it is zero at one end of the jump, stability also depends on the torque at the other end.
    """
    before, after = float(behind.last), float(ahead.first)
    # Whether the torque on the opposite side of 0 drives the joint towards 0.
    to_zero = {False: after < 0, True: before > 0}
    if abs(before) <= _NO_TORQUE and abs(after) <= _NO_TORQUE:
        return [_equilibrium(ahead, _ZERO, True)]
    for value, side, is_ahead in ((after, ahead, True), (before, behind, False)):
        if abs(value) <= _NO_TORQUE:
            stable = bool(side.slopes[_ZERO] < 0) and to_zero[is_ahead]
            return [_equilibrium(side, _ZERO, is_ahead, stable=stable)]
    if before * after > 0:
        return []
    return [_equilibrium(ahead, _ZERO, True, **_step(ahead, _ZERO, falls=before > 0))]
