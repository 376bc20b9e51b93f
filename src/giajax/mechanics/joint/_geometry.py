"""Geometry of one joint, and the path of its muscle on all four branches (eqs 2, 3, 7 and 8)."""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Bool, Float, Scalar, bisect, hypotenuse, larger
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import GEOMETRY
from ...schema.parameters import is_concrete, parameter

Shaped = Float[Array, "*shape"]

LARGEST_ANGLE = float(np.deg2rad(60.0))  # how far the joint bends (table 2), rad

Point = tuple[Array, Array]


class Bend(NamedTuple):
    """Cosine and sine of half a bending angle, by which each link turns.

    They are worked out once an angle: a compiler that works them out for each use makes muscles
    twice as dear.
    """

    cosine: Array
    sine: Array

    @classmethod
    def by(cls, angle: Shaped) -> "Bend":
        """The bend by an angle, rad."""
        return cls(jnp.cos(angle / 2), jnp.sin(angle / 2))

    @property
    def back(self) -> "Bend":
        """The bend by the same angle to the other side."""
        return Bend(self.cosine, -self.sine)

    def turned(self, x: Array, y: Array) -> Point:
        """A point of the right link in the frame of the bisector, whose y points to the muscle."""
        return x * self.cosine - y * self.sine, x * self.sine + y * self.cosine


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

    def anchor(self, bend: Bend) -> Point:
        """C = N: the muscle's end on the right link, in the frame of the bisector, m."""
        return bend.turned(self.anchor_x, self.anchor_y)

    def wire_end(self, bend: Bend) -> Point:
        """D: the wire's end on the right link, in the frame of the bisector, m."""
        return bend.turned(self.wire_x, self.wire_y)

    def contact(self, bend: Bend) -> Point:
        """Q: the balloon's shoulder on the right link, in the frame of the bisector, m."""
        return bend.turned(self.contact_x, self.contact_y)


def taut_bush_height(geometry: JointGeometry, bend: Bend) -> Array:
    """H_y where the wire is taut (eq. 3): the outer root, m; NaN where there is none."""
    end_x, end_y = geometry.wire_end(bend)
    square = (geometry.wire_length / 2) ** 2 - end_x**2
    # The inner `where` keeps the slope of the root finite where there is no root.
    return end_y + jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), jnp.nan)


def is_possible(
    geometry: JointGeometry, angle: Shaped, inner: Bool[Array, "*shape"]
) -> Bool[Array, "*shape"]:
    """Whether a muscle has a path at bending angles (rad); may be traced.

    A wire that is too short for the outer muscle does not matter here: the outer equations do not
    know of it, and a fit may pass through such a joint. `check_geometry` refuses it.
    """
    possible = jnp.ones(angle.shape, bool)
    for bad, _ in _complaints(geometry, angle, inner=True):
        possible = possible & ~(inner & bad)
    for bad, _ in _complaints(geometry, angle, inner=False)[1:]:
        possible = possible & (inner | ~bad)
    return possible


def check_geometry(geometry: JointGeometry, angles: np.ndarray | None = None) -> None:
    """Refuse a geometry that has no path or no wire at some angle; nothing is checked in a trace.

    Arguments:
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


def _complaints(geometry: JointGeometry, angle: Shaped, *, inner: bool) -> list[tuple[Array, str]]:
    """What may be impossible on one side: where it is, and a sentence; of the outer wire first."""
    wire, bend = geometry.wire_length, Bend.by(angle)
    anchor_x, anchor_y = geometry.anchor(bend)
    contact_x, contact_y = geometry.contact(bend)
    wire_x, wire_y = geometry.wire_end(bend)
    if inner:
        return [
            (
                wire_x >= wire / 2,
                "D_x is not less than half of L_wire, so that the wire cannot reach the bush: make "
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
            "there: make "
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


# Path of one muscle of a joint, on all four branches (eqs 2, 3, 7 and 8).
#
# The bending angle is that of the muscle: positive where the joint bends towards it, so that it
# is the inner one, negative where it is the outer one. Everything is in the frame of the
# bisector: the origin E is the joint's centre, y points to the muscle, and the right half stands
# for both. (Fig. 8 draws the outer muscle on -y, hence the signs of eqs 10 and 11 and its tests
# on N_y.)
#
# - inner, taut: A-H-C with the bush H held by the wire B-H-D (eqs 2 to 5);
# - inner, slack: straight from A to C (eq. 6), the wire hangs;
# - outer, straight: M-O-N (eqs 8 and 11);
# - outer, wrapped: M-P-O-Q-N around the balloon's shoulders (eqs 7, 9 and 10).

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
    """Path of a muscle at bending angles (rad; eqs 2, 3, 7, 8): geometry only, no force.

    `inner` is the side, which matters at 0 only; by default a muscle at 0 is the inner one.
    """
    inner = angle >= 0 if inner is None else inner
    sides = (
        inner_path(geometry, inner_bend(angle, inner)),
        outer_path(geometry, outer_bend(angle, inner)),
    )
    return jax.tree.map(functools.partial(jnp.where, inner), *sides)


def inner_bend(angle: Shaped, inner: Bool[Array, "*shape"]) -> Bend:
    """The bend of an inner muscle; 0, where its path always exists, for an outer one."""
    return Bend.by(jnp.where(inner, angle, 0))


def outer_bend(angle: Shaped, inner: Bool[Array, "*shape"]) -> Bend:
    """The bend of an outer muscle; 0, where its path always exists, for an inner one."""
    return Bend.by(jnp.where(inner, 0, angle))


def inner_path(geometry: JointGeometry, bend: Bend) -> MusclePath:
    """Path of the inner muscle: over the bush where its wire is taut, else straight."""
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
    """Path of the outer muscle: around the balloon's shoulders where it has to, else straight."""
    anchor_x, anchor_y = geometry.anchor(bend)
    end_x, end_y = geometry.wire_end(bend)
    contact_x, contact_y = geometry.contact(bend)
    wrapped = anchor_y < contact_y
    # Where the muscle crosses the bisector.
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
    """Angles at which the inner wire becomes taut and the outer muscle begins to wrap, rad.

    The second is in closed form, tan(angle / 2) = -(N_y - Q_y) / (N_x - Q_x) in the frame of the
    link; the first is a root of C_y = H_y, by bisection. 0 where a muscle is on its branch at
    every angle of that side, and NaN where a branch is not reached within 90 deg.
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
