"""Forces of one muscle that balance a torque on a joint at rest (eqs 4 to 6, 9 to 11).

The frame, the angle and the four branches are those of the muscle's path.
"""

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Bool, Float
from ._geometry import JointGeometry, Point
from ._path import MusclePath, muscle_path


class MuscleState(eqx.Module):
    """A muscle of a joint at rest; arrays of one shape, that of the angles.

    Attributes:
        angle: bending angle of the muscle, rad.
        torque: that the muscle balances, its correction included, N m.
        path: its path.
        contraction: epsilon of eq. (2), relative to L_pam.
        lever: of the muscle's force about the joint's centre, m.
        force: tension F of the muscle, N. Negative where it would have to push.
        wire_tension: F_w, N; 0 where the wire is slack.
        push_x, push_y: push F_b of the muscle on the balloon of the right link (eq. 9), N; 0
            where it touches no balloon.
    """

    angle: Float[Array, "*shape"]
    torque: Float[Array, "*shape"]
    path: MusclePath
    contraction: Float[Array, "*shape"]
    lever: Float[Array, "*shape"]
    force: Float[Array, "*shape"]
    wire_tension: Float[Array, "*shape"]
    push_x: Float[Array, "*shape"]
    push_y: Float[Array, "*shape"]

    @property
    def branch(self) -> Array:
        """0 inner and taut, 1 inner and slack, 2 outer and straight, 3 outer and wrapped."""
        inside = jnp.where(self.path.engaged, 0, 1)
        return jnp.where(self.path.inner, inside, jnp.where(self.path.engaged, 3, 2))


def muscle_balance(
    geometry: JointGeometry,
    angle: Float[Array, "*shape"],
    torque: Float[Array, "*shape"],
    inner: Bool[Array, "*shape"] | None = None,
) -> MuscleState:
    """Forces that balance a torque, the correction already in it (eqs 4 to 6, 9 to 11).

    Everything is in closed form: the paper's equations are linear in the forces.

    Arguments:
        geometry: of the joint.
        angle: bending angles of the muscle, rad.
        torque: balanced torque, N m.
        inner: the side, as in `muscle_path`.

    Returns:
        The state of the muscle; nothing is checked.
    """
    path = muscle_path(geometry, angle, inner)
    anchor = geometry.anchor(angle)
    wire_end = geometry.wire_end(angle)
    contact = geometry.contact(jnp.where(path.inner, 0, angle))
    bush = (jnp.zeros_like(path.height), path.height)
    taut, wrapped = path.inner & path.engaged, ~path.inner & path.engaged

    # Force of the muscle on the right link at C or N, per newton of tension. A straight muscle
    # pulls along -x.
    bend = (jnp.where(path.inner, 0, contact[0]), path.height)
    pull = _where(path.engaged, _unit(anchor, bend), _leftwards(angle))
    # Eq. (4): the wire takes what the muscle pushes the bush along the bisector.
    hold = _unit(wire_end, bush)
    tension = jnp.where(taut, -pull[1] / jnp.where(taut, hold[1], 1), 0)
    # Eq. (9): the push on the balloon's shoulder; the muscle leaves it towards N and towards P.
    push = _where(wrapped, _add(_minus(pull), _leftwards(angle)), _nothing(angle))
    # Moments about E (eqs 5, 6, 10, 11), per newton of tension.
    lever = (
        _moment(anchor, pull)
        + tension * _moment(wire_end, hold)
        + jnp.where(wrapped, _moment(contact, push), 0)
    )
    force = torque / lever
    return MuscleState(
        angle=angle,
        torque=torque,
        path=path,
        contraction=1 - path.length / geometry.muscle_length,
        lever=lever,
        force=force,
        wire_tension=force * tension,
        push_x=force * push[0],
        push_y=force * push[1],
    )


def _unit(tail: Point, head: Point) -> Point:
    x, y = head[0] - tail[0], head[1] - tail[1]
    length = jnp.hypot(x, y)
    return x / length, y / length


def _moment(at: Point, force: Point) -> Array:
    return at[0] * force[1] - at[1] * force[0]


def _add(a: Point, b: Point) -> Point:
    return a[0] + b[0], a[1] + b[1]


def _minus(a: Point) -> Point:
    return -a[0], -a[1]


def _leftwards(like: Array) -> Point:
    return -jnp.ones_like(like), jnp.zeros_like(like)


def _nothing(like: Array) -> Point:
    return jnp.zeros_like(like), jnp.zeros_like(like)


def _where(condition: Array, a: Point, b: Point) -> Point:
    return jnp.where(condition, a[0], b[0]), jnp.where(condition, a[1], b[1])
