"""Path of one muscle of a joint, on all four branches (eqs 2, 3, 7 and 8).

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
import jax.numpy as jnp

from .._program import program
from .._typing import Array, Bool, Float
from ._geometry import JointGeometry, outer_bush_height, taut_bush_height
from ._roots import bisect

BRANCHES = ("inner, wire taut", "inner, wire slack", "outer, straight", "outer, wrapped")


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

    Returns:
        The path, in arrays of the shape of the angle.
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


def branch_angles(geometry: JointGeometry) -> tuple[float, float]:
    """Angles at which the inner wire becomes taut and the outer muscle begins to wrap, rad.

    The second is in closed form, tan(angle / 2) = -(N_y - Q_y) / (N_x - Q_x) in the frame of the
    link; the first is a root of C_y = H_y, by bisection. 0 where a muscle is on its branch at
    every angle of that side, and NaN where a branch is not reached within 90 deg.

    Arguments:
        geometry: of the joint.

    Returns:
        The angle of the inner wire, and that of the outer muscle, rad.
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
