"""Geometry of one joint, and the path of its muscle on the four branches (eqs 2, 3, 7 and 8)."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Bool, Float, Scalar, bisect, computed_once, hypotenuse, larger
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import GEOMETRY
from ...schema.parameters import is_concrete, parameter

Shaped = Float[Array, "*shape"]

LARGEST_ANGLE = float(np.deg2rad(60.0))  # largest bending angle of the joint (table 2), rad

Point = tuple[Array, Array]


class Bend(NamedTuple):
    """Cosine and sine of half the bending angle, by which each link rotates.

    They are computed once for each angle. If the compiler recomputes them for each use, muscles
    take twice as much time.
    """

    cosine: Array
    sine: Array

    @classmethod
    def by(cls, angle: Shaped) -> "Bend":
        """Return the bend for a bending angle, rad."""
        return cls(*computed_once(jnp.stack([jnp.cos(angle / 2), jnp.sin(angle / 2)])))

    @property
    def back(self) -> "Bend":
        """The bend by the same angle towards the opposite side."""
        return Bend(self.cosine, -self.sine)

    def turned(self, x: Array, y: Array) -> Point:
        """Return a point of the right link in the frame of the bisector (y towards the muscle)."""
        return x * self.cosine - y * self.sine, x * self.sine + y * self.cosine


class JointGeometry(eqx.Module):
    """Coordinates of one muscle on one side of a joint (figs 7 and 8).

    Each point is given in the frame of its link. The origin E is the centre of the joint, x runs
    along the link away from the joint, and y points towards the muscle. The joint is symmetric, so
    each point also represents its mirror image on the other link.

    The paper gives no coordinates. The default values were chosen so that the joint behaves as the
    paper describes:

    - The anchors are 0.9 m from the joint, which is almost the length of a link (0.99 m), and just
      outside the radius of the balloon, 0.15 m.
    - The shoulder of the balloon lies on that radius, 0.055 m from the joint. The shoulders of the
      two links therefore meet at 40 deg, where the balloons interfere according to the paper.
    - The muscle is slightly longer than its path in the straight joint, so it never has to stretch.
    - The wire is slack near the straight joint and on the whole outer side.
    """

    anchor_x: Scalar = parameter(GEOMETRY.anchor_x)
    anchor_y: Scalar = parameter(GEOMETRY.anchor_y)
    wire_x: Scalar = parameter(GEOMETRY.wire_x)
    wire_y: Scalar = parameter(GEOMETRY.wire_y)
    contact_x: Scalar = parameter(GEOMETRY.contact_x)
    contact_y: Scalar = parameter(GEOMETRY.contact_y)
    wire_length: Scalar = parameter(GEOMETRY.wire_length)
    muscle_length: Scalar = parameter(GEOMETRY.muscle_length)

    def anchor(self, bend: Bend) -> Point:
        """Return C = N, the end of the muscle on the right link, in the bisector frame, m."""
        return bend.turned(self.anchor_x, self.anchor_y)

    def wire_end(self, bend: Bend) -> Point:
        """Return D, the end of the wire on the right link, in the frame of the bisector, m."""
        return bend.turned(self.wire_x, self.wire_y)

    def contact(self, bend: Bend) -> Point:
        """Return Q, the shoulder of the balloon of the right link, in the bisector frame, m."""
        return bend.turned(self.contact_x, self.contact_y)


def taut_bush_height(geometry: JointGeometry, bend: Bend) -> Array:
    """Return the outer root H_y for a taut wire (eq. 3), m; NaN if there is no root."""
    end_x, end_y = geometry.wire_end(bend)
    square = (geometry.wire_length / 2) ** 2 - end_x**2
    # The inner `where` keeps the derivative finite where there is no root.
    return end_y + jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), jnp.nan)


def is_possible(
    geometry: JointGeometry, angle: Shaped, inner: Bool[Array, "*shape"]
) -> Bool[Array, "*shape"]:
    """Return whether a muscle has a path at bending angles (rad); this function can be traced.

    A wire that is too short for the outer muscle is permitted here, because the outer equations do
    not contain the wire, and a fit may pass through such a geometry. `check_geometry` rejects it.
    """
    possible = jnp.ones(angle.shape, bool)
    for bad, _ in _complaints(geometry, angle, inner=True):
        possible = possible & ~(inner & bad)
    for bad, _ in _complaints(geometry, angle, inner=False)[1:]:
        possible = possible & (inner | ~bad)
    return possible


def check_geometry(geometry: JointGeometry, angles: np.ndarray | None = None) -> None:
    """Check that muscle and wire can be built at all angles; traced geometries are not checked.

    Arguments:
        geometry: geometry of the joint.
        angles: bending angles of the muscle to check, rad; by default -60 to 60 deg.

    Raises:
        InputError: the geometry is impossible; the message gives the reason, the angle and what to
            change.
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


def _complaints(geometry: JointGeometry, angle: Shaped, *, inner: bool) -> list[tuple[Array, str]]:
    """List the conditions that make the geometry impossible on one side.

    Returns:
        Pairs of a mask of the angles at which the condition holds, and the end of an error message.
        On the outer side, the condition of the wire comes first.
    """
    wire, bend = geometry.wire_length, Bend.by(angle)
    anchor_x, anchor_y = geometry.anchor(bend)
    contact_x, contact_y = geometry.contact(bend)
    wire_x, wire_y = geometry.wire_end(bend)
    if inner:
        return [
            (
                wire_x >= wire / 2,
                "D_x is not less than half of L_wire, so the wire cannot reach the bush: make "
                "wire_length larger or wire_x smaller",
            ),
            (
                anchor_x <= 0,
                "the muscle's ends A and C have crossed: make anchor_x larger or anchor_y smaller",
            ),
        ]
    crossing = larger(anchor_y, contact_y)
    return [
        (
            2 * hypotenuse(wire_x, crossing - wire_y) > wire,
            "the wire does not reach around the outer muscle, although the wire must be slack "
            "there: make wire_length larger or contact_y smaller",
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


# Path of one muscle of a joint, on all four branches (eqs 2, 3, 7 and 8).
#
# The bending angle is that of the muscle. It is positive if the joint bends towards the muscle,
# which is then the inner muscle, and negative if it is the outer muscle. All coordinates are in the
# frame of the bisector: the origin E is the centre of the joint, y points to the muscle, and the
# right half represents both halves. (Fig. 8 draws the outer muscle on the negative y side, which
# explains the signs in eqs 10 and 11 and their conditions on N_y.)
#
# - inner, taut: A-H-C; the wire B-H-D holds the bush H (eqs 2 to 5);
# - inner, slack: straight from A to C (eq. 6); the wire is slack;
# - outer, straight: M-O-N (eqs 8 and 11);
# - outer, wrapped: M-P-O-Q-N around the shoulders of the balloons (eqs 7, 9 and 10).

BRANCHES = ("inner, wire taut", "inner, wire slack", "outer, straight", "outer, wrapped")


class MusclePath(eqx.Module):
    """Path of a muscle. All arrays have the shape of the angles.

    Attributes:
        inner: whether the muscle is the inner one.
        engaged: whether the wire is taut (inner muscle) or the muscle wraps around the balloon
            (outer muscle).
        half_length: half of the length of the path, m.
        height: y coordinate of the bush H or of the point O, on the bisector, m.
        wire_slack: L_wire minus the length that the wire spans, m; 0 if the wire is taut.
    """

    inner: Bool[Array, "*shape"]
    engaged: Bool[Array, "*shape"]
    half_length: Shaped
    height: Shaped
    wire_slack: Shaped

    @property
    def length(self) -> Shaped:
        """Length of the path, m."""
        return 2 * self.half_length


def muscle_path(
    geometry: JointGeometry, angle: Shaped, inner: Bool[Array, "*shape"] | None = None
) -> MusclePath:
    """Return the path of a muscle at bending angles, without forces (eqs 2, 3, 7 and 8).

    Arguments:
        geometry: geometry of the joint.
        angle: bending angles of the muscle, rad.
        inner: whether the muscle is the inner one, which is needed only at an angle of 0; by
            default a muscle at 0 is the inner one.
    """
    inner = angle >= 0 if inner is None else inner
    sides = (
        inner_path(geometry, inner_bend(angle, inner)),
        outer_path(geometry, outer_bend(angle, inner)),
    )
    return jax.tree.map(functools.partial(jnp.where, inner), *sides)


def inner_bend(angle: Shaped, inner: Bool[Array, "*shape"]) -> Bend:
    """Return the bend of an inner muscle; for an outer muscle 0, where the path always exists."""
    return Bend.by(jnp.where(inner, angle, 0))


def outer_bend(angle: Shaped, inner: Bool[Array, "*shape"]) -> Bend:
    """Return the bend of an outer muscle; for an inner muscle 0, where the path always exists."""
    return Bend.by(jnp.where(inner, 0, angle))


def inner_path(geometry: JointGeometry, bend: Bend) -> MusclePath:
    """Return the path of an inner muscle: over the bush if the wire is taut, otherwise straight."""
    anchor_x, anchor_y = geometry.anchor(bend)
    end_x, end_y = geometry.wire_end(bend)
    held = taut_bush_height(geometry, bend)
    taut = anchor_y > held
    height = jnp.where(taut, held, anchor_y)
    slack = geometry.wire_length - 2 * hypotenuse(end_x, height - end_y)
    return MusclePath(
        inner=jnp.ones_like(taut),
        engaged=taut,
        half_length=jnp.where(taut, hypotenuse(anchor_x, anchor_y - height), anchor_x),
        height=height,
        wire_slack=jnp.where(taut, 0, slack),
    )


def outer_path(geometry: JointGeometry, bend: Bend) -> MusclePath:
    """Return the path of an outer muscle: straight, or around the shoulders of the balloons."""
    anchor_x, anchor_y = geometry.anchor(bend)
    end_x, end_y = geometry.wire_end(bend)
    contact_x, contact_y = geometry.contact(bend)
    wrapped = anchor_y < contact_y
    # Height at which the muscle crosses the bisector.
    height = larger(anchor_y, contact_y)
    bent = contact_x + hypotenuse(anchor_x - contact_x, anchor_y - height)
    return MusclePath(
        inner=jnp.zeros_like(wrapped),
        engaged=wrapped,
        half_length=jnp.where(wrapped, bent, anchor_x),
        height=height,
        wire_slack=geometry.wire_length - 2 * hypotenuse(end_x, height - end_y),
    )


def branch_angles(geometry: JointGeometry) -> tuple[float, float]:
    """Return the angles at which the wire becomes taut and the outer muscle starts to wrap, rad.

    The first angle is a root of C_y = H_y, found by bisection. The second angle is in closed form,
    tan(angle / 2) = -(N_y - Q_y) / (N_x - Q_x) in the frame of the link. An angle is 0 if the
    branch applies to all angles of its side, and NaN if the branch is not reached within 90 deg.
    """
    taut, wrap = _branch_angles(geometry)
    return float(taut), float(wrap)


@program
def _branch_angles(geometry: JointGeometry) -> tuple[Array, Array]:
    half_turn = jnp.asarray(jnp.pi / 2, dtype=jnp.result_type(float))

    def above(angle: Array) -> Array:
        bend = Bend.by(angle)
        return geometry.anchor(bend)[1] - taut_bush_height(geometry, bend)

    straight = jnp.zeros_like(half_turn)
    taut = bisect(above, straight, half_turn)
    taut = jnp.where(jnp.isnan(taut) & (above(straight) > 0), 0, taut)
    wrap = 2 * jnp.arctan2(
        geometry.anchor_y - geometry.contact_y, geometry.anchor_x - geometry.contact_x
    )
    return taut, jnp.where(wrap > half_turn, jnp.nan, -larger(wrap, 0))
