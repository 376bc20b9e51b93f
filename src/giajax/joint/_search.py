"""Search for every angle of one side at which the torque of a pair vanishes or jumps through 0.

The torque is evaluated on an even grid and at its kinks; each interval is divided at the extremum
of the torque where there is one inside, so that neither of two near roots is missed.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._program import program
from .._typing import Array, Bool, Float, Int, Scalar
from ._geometry import LARGEST_ANGLE
from ._pair import JointPair
from ._path import branch_angles, muscle_path
from ._roots import bisect
from ._torque import OneSide, correction_slope, side_slope, side_torque

# Intervals of the search on either side of 0: 0.1 deg each. Within one the torque is smooth or
# has one kink, and its extremum parts two roots.
_INTERVALS = 600

# More roots, or extrema, than a side of any pair can have.
_MOST = 24

# Around a jump of the torque, as the printed beta has: how far from it its two sides are taken,
# rad, which the search resolves, and from which rise between them (N m) on it is a jump.
_BESIDE = 1e-12
JUMP = 1e-9

# An extra node on either side of a jump, relative to its angle.
_APART = 1e-9


class Roots(eqx.Module):
    """Roots of the torque on one side of 0.

    The first `count` elements of each array belong to them, the last one to the angle 0.

    Attributes:
        count: how many there are.
        angles: rad.
        slopes: of the torque, N m/rad.
        resistance: slopes of the corrections, N m/rad.
        below, above: torques just beside each root, N m.
        engaged: of the first and the second muscle, whether the wire is taut or the muscle wraps.
        first, last: torques at the ends of the side, N m.
        idle: whether there is no torque anywhere between two nodes.
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
