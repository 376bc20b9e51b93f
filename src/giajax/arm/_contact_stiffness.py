"""How stiff contact is, as integrators need it."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, scaled
from .._typing import Array, Float, Scalar
from ._arm import Arm
from ._contact import Contact
from ._kinematics import Pose, Rows, pose, sum_from_tip
from ._meeting import Meeting, Pairs, meeting
from ._touch import of_near, pressing


class Stiffness(NamedTuple):
    """How the torques of contact change with the state.

    Attributes:
        angles: with the angles of the joints, N m/rad; symmetric and not negative.
        rates: with their rates, N m s/rad; likewise.
        sticking: velocity of the skin of links that stick, with the rates of the joints, m; the
            stretch of the skin acts on the joints through its transpose. None without friction.
        skin: stiffness of the skin along an obstacle, N/m.
    """

    angles: Float[Array, "joint joint"]
    rates: Float[Array, "joint joint"]
    sticking: Float[Array, "3 link joint"] | None
    skin: Scalar


def contact_stiffness(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    strain: Float[Array, "3 link"] | None = None,
) -> Stiffness:
    """How the torques of pressed contacts change, but for the turning of normals.

    Arguments:
        arm: an arm with obstacles.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.

    Returns:
        Stiffness and damping, and what sticks.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)

    def of(pairs: Pairs) -> Stiffness:
        met = meeting(arm, contact, here, rates, pairs)
        harder = jnp.maximum(1 + contact.damping * met.closing, 0)
        deep = met.depth > 0
        line = jnp.where(deep, met.load / jnp.where(deep, met.depth, 1), 0)
        damper = jnp.where(harder > 0, met.load * contact.damping, 0)
        sticking = None if strain is None else _sticking(contact, here, met, strain)
        spring, resistance = (_of_joints(here, met, each) for each in (line * harder, damper))
        return Stiffness(spring, resistance, sticking, contact.friction_stiffness)

    return of_near(arm, contact, here, of)


def _of_joints(here: Pose, met: Meeting, weight: Array) -> Float[Array, "joint joint"]:
    """Sum of weighted squares of how joints move points along their normals.

    As for the mass matrix: squares of wrenches about the base origin are summed from the tip.
    """
    wrench = jnp.concatenate([met.normal, cross(met.place, met.normal)])
    square = jnp.einsum("ikp,jkp,kp->ijk", wrench, wrench, weight)
    count = here.joint.shape[1]
    carried = sum_from_tip(met.of_links(square.reshape(36, -1), count)).reshape(6, 6, count)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    upper = jnp.triu(screw.T @ jnp.einsum("ijl,jl->il", carried, screw))
    return upper + jnp.triu(upper, 1).T


def _sticking(contact: Contact, here: Pose, met: Meeting, strain: Rows) -> Array:
    """Velocity of the skin with the rates of the joints, of the links that stick."""
    count = here.joint.shape[1]
    normal = pressing(contact, met)
    total = met.of_links(jnp.sum(normal, axis=1)[None], count)[0]
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    place = met.place - scaled(met.distance, met.normal)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    # Velocity of the place by each component of a velocity of the origin, and of a turn.
    moves = [jnp.broadcast_to(unit[:, None, None], place.shape) for unit in np.eye(3)]
    moves += [cross(unit, place) for unit in moves]
    slides = [move - scaled(dot(met.normal, move), met.normal) for move in moves]
    by_link = [met.of_links(jnp.sum(scaled(share, slide), axis=2), count) for slide in slides]
    sticks = jnp.all(contact.hold(strain, total) == strain, axis=0) & (total > 0)
    by_joint = jnp.einsum("kil,kj->ilj", jnp.stack(by_link), screw)
    before = np.tri(count, dtype=bool)[None] & sticks[None, :, None]
    return jnp.where(before, by_joint, 0)
