"""Where things are in one joint: the points of a muscle, of its wire and of the balloon."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import is_concrete, parameter
from ..quantities import GEOMETRY

# How far the joint bends (table 2), rad.
LARGEST_ANGLE = float(np.deg2rad(60.0))

Point = tuple[Array, Array]


class JointGeometry(eqx.Module):
    """Coordinates of one muscle on one side of a joint (figs 7 and 8).

    Each point is given in the frame of its link: the origin E is the centre of the joint, x runs
    along the link away from it, y towards the muscle. The joint is symmetric, so a point stands
    for its mirror image on the other link too.

    The paper gives no coordinates. These were chosen so that the joint does what the paper says
    of it: the anchors are 0.9 m out, almost a link (0.99 m), and just outside the balloon's
    radius of 0.15 m; the balloon's shoulder lies on that radius, 0.055 m from the joint, so that
    the shoulders of the two links meet at 40 deg, where the paper sees balloons interfere; the
    muscle is a little longer than its path in the straight joint, so that it never has to
    stretch; the wire is slack near the straight joint and on the whole outer side.
    """

    anchor_x: Scalar = parameter(GEOMETRY.anchor_x)
    anchor_y: Scalar = parameter(GEOMETRY.anchor_y)
    wire_x: Scalar = parameter(GEOMETRY.wire_x)
    wire_y: Scalar = parameter(GEOMETRY.wire_y)
    contact_x: Scalar = parameter(GEOMETRY.contact_x)
    contact_y: Scalar = parameter(GEOMETRY.contact_y)
    wire_length: Scalar = parameter(GEOMETRY.wire_length)
    muscle_length: Scalar = parameter(GEOMETRY.muscle_length)

    def anchor(self, angle: Float[Array, "*shape"]) -> Point:
        """C = N: the muscle's end on the right link, in the frame of the bisector, m."""
        return turned(self.anchor_x, self.anchor_y, angle)

    def wire_end(self, angle: Float[Array, "*shape"]) -> Point:
        """D: the wire's end on the right link, in the frame of the bisector, m."""
        return turned(self.wire_x, self.wire_y, angle)

    def contact(self, angle: Float[Array, "*shape"]) -> Point:
        """Q: the balloon's shoulder on the right link, in the frame of the bisector, m."""
        return turned(self.contact_x, self.contact_y, angle)


def turned(x: Array, y: Array, angle: Float[Array, "*shape"]) -> Point:
    """A point of the right link in the frame of the bisector, whose y points to the muscle.

    Each link turns by half the bending angle.
    """
    cosine, sine = jnp.cos(angle / 2), jnp.sin(angle / 2)
    return x * cosine - y * sine, x * sine + y * cosine


def taut_bush_height(geometry: JointGeometry, angle: Float[Array, "*shape"]) -> Array:
    """H_y where the wire is taut (eq. 3): the outer root, m; NaN where there is none."""
    end_x, end_y = geometry.wire_end(angle)
    square = (geometry.wire_length / 2) ** 2 - end_x**2
    # The inner `where` keeps the slope of the root finite where there is no root.
    return end_y + jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), jnp.nan)


def outer_bush_height(geometry: JointGeometry, angle: Float[Array, "*shape"]) -> Array:
    """O_y: where the outer muscle crosses the bisector, m."""
    return jnp.maximum(geometry.anchor(angle)[1], geometry.contact(angle)[1])


def is_possible(
    geometry: JointGeometry, angle: Float[Array, "*shape"], inner: Bool[Array, "*shape"]
) -> Bool[Array, "*shape"]:
    """Whether a muscle has a path at bending angles (rad); may be traced.

    A wire that is too short for the outer muscle is no matter here: the outer equations do not
    know of it, and a fit may pass through such a joint. `check_geometry` refuses it.

    Arguments:
        geometry: of the joint.
        angle: bending angles of the muscle, rad.
        inner: whether the muscle is the inner one, of the same shape.

    Returns:
        Of the same shape.
    """
    possible = jnp.ones(angle.shape, bool)
    for bad, _ in _complaints(geometry, angle, inner=True):
        possible = possible & ~(inner & bad)
    for bad, _ in _complaints(geometry, angle, inner=False)[1:]:
        possible = possible & (inner | ~bad)
    return possible


def check_geometry(geometry: JointGeometry, angles: np.ndarray | None = None) -> None:
    """Refuse a geometry that has no path or no wire at some angle.

    Arguments:
        geometry: with concrete numbers; while a program is traced nothing is checked.
        angles: bending angles of the muscle to check, rad; by default -60 to 60 deg.

    Raises:
        InputError: naming what is impossible, the angle, and what to change.
    """
    if not is_concrete(geometry):
        return
    if angles is None:
        angles = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 241)
    values = np.unique(np.asarray(angles, dtype=float))
    for side in (values[values >= 0], values[values <= 0]):
        if len(side) == 0:
            continue
        inner = bool(side[-1] > 0)
        angle = jnp.asarray(side, dtype=jnp.result_type(float))
        for bad, sentence in _complaints(geometry, angle, inner=inner):
            if bool(jnp.any(bad)):
                at = np.rad2deg(side[int(jnp.argmax(bad))])
                raise InputError(f"the joint cannot be built at {at:.3g} deg, where {sentence}")


def _complaints(
    geometry: JointGeometry, angle: Float[Array, "*shape"], *, inner: bool
) -> list[tuple[Array, str]]:
    """What may be impossible on one side: where it is, and a sentence; of the outer wire first."""
    wire = geometry.wire_length
    anchor_x, anchor_y = geometry.anchor(angle)
    contact_x, contact_y = geometry.contact(angle)
    wire_x, wire_y = geometry.wire_end(angle)
    if inner:
        return [
            (
                wire_x >= wire / 2,
                "D_x is not below half of L_wire, so that the wire cannot reach the bush: make "
                "wire_length larger or wire_x smaller",
            ),
            (
                anchor_x <= 0,
                "the muscle's ends A and C have crossed: make anchor_x larger or anchor_y smaller",
            ),
        ]
    crossing = jnp.maximum(anchor_y, contact_y)
    return [
        (
            2 * jnp.hypot(wire_x, crossing - wire_y) > wire,
            "the wire does not reach around the outer muscle, where it must be slack: make "
            "wire_length larger or contact_y smaller",
        ),
        (
            (contact_x <= 0) | (crossing <= 0),
            "the balloon's shoulders P and Q have crossed, or lie behind the joint: make "
            "contact_x or contact_y larger",
        ),
        (
            (anchor_y < contact_y) & (anchor_x <= contact_x),
            "the muscle's end N lies nearer to the joint than the balloon's shoulder Q: make "
            "anchor_x larger",
        ),
    ]
