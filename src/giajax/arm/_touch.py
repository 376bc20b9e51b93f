"""What contact does to an arm: torques, energy, and the stiffness that integrators need."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, scaled
from .._typing import Array, Float, Scalar
from ._arm import Arm
from ._contact import Contact
from ._kinematics import Pose, Rows, pose, sum_from_tip
from ._load import load_torque
from ._meeting import Meeting, Numbers, Pairs, Points, in_reach, meeting

T = TypeVar("T")

# Pairs of links and boxes that are looked at together where no more are near each other.
_FEW = 24


class Touch(NamedTuple):
    """What obstacles do to an arm in one state.

    Attributes:
        torque: of the joints, N m.
        slip: how fast the stretch of each link's skin grows while it sticks, m/s; 0 where nothing
            touches.
        normal: force that presses each link, N.
    """

    torque: Float[Array, " joint"]
    slip: Rows
    normal: Float[Array, " link"]


def touch(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    strain: Float[Array, "3 link"] | None = None,
) -> Touch:
    """Torques of contact, and what the states of its friction need.

    Derivatives are those of the penalty; at first touch, where it begins with a kink in the force,
    they are those of an arm that does not touch.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.

    Returns:
        Torque, N m, of shape (joint,), rate of the stretch and normal forces.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)

    def of(pairs: Pairs) -> Touch:
        return _touch(arm, contact, here, rates, strain, pairs)

    return of_near(arm, contact, here, of)


def contact_energy(
    arm: Arm, angles: Float[Array, " joint"], strain: Float[Array, "3 link"] | None = None
) -> Scalar:
    """Energy of flattened links and stretched skin, J.

    Arguments:
        arm: the arm; without obstacles it is 0.
        angles: joint angles, rad.
        strain: stretch of the links' skin, m, where contact has friction; none by default.
    """
    if arm.contact is None:
        return jnp.zeros(())
    contact, here = arm.contact, pose(arm, angles)
    still = jnp.zeros_like(angles)
    energy = of_near(arm, contact, here, lambda p: meeting(arm, contact, here, still, p).energy)
    if strain is None or contact.friction is None:
        return energy
    return energy + contact.friction_stiffness * jnp.sum(strain * strain) / 2


def of_near(arm: Arm, contact: Contact, here: Pose, of: Callable[[Pairs], T]) -> T:
    """What `of` makes of the pairs of links and boxes that are near each other.

    Seldom are they many: the arrays of most states are short.
    """
    near = in_reach(arm, contact, here)
    every = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices(near.shape)))
    shapes = jax.eval_shape(of, every)

    def none() -> T:
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def few() -> T:
        chosen = jax.lax.top_k(near.ravel().astype(jnp.int32), _FEW)[1]
        return of(Pairs(every.link[chosen], every.box[chosen]))

    # In a batch, all take the way of the one that has most.
    count = eqxi.unvmap_max(jnp.sum(near))
    branches = [none, few, lambda: of(every)] if near.size > _FEW else [none, lambda: of(every)]
    which = (count > 0).astype(jnp.int32) + (count > _FEW).astype(jnp.int32)
    return jax.lax.switch(which, branches)


def pressing(contact: Contact, met: Meeting) -> Numbers:
    """Normal forces at the points of a meeting, N."""
    return met.load * jnp.maximum(1 + contact.damping * met.closing, 0)


def friction_force(
    contact: Contact,
    met: Meeting,
    normal: Numbers,
    total: Float[Array, " link"],
    strain: Rows,
) -> Points:
    """Forces of friction at the points of a meeting, in proportion to the normal ones, N.

    `total` are the normal forces of the links.
    """
    held = -contact.friction_stiffness * contact.hold(strain, total)
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    force = jnp.broadcast_to(held[:, met.link, None], met.normal.shape)
    return scaled(share, force - scaled(dot(met.normal, force), met.normal))


def _touch(
    arm: Arm, contact: Contact, here: Pose, rates: Array, strain: Rows | None, pairs: Pairs
) -> Touch:
    met = meeting(arm, contact, here, rates, pairs)
    normal = pressing(contact, met)
    # What damping adds to the elastic force, which is known as a whole.
    push = scaled(normal - met.load, met.normal)
    moment = cross(met.place, push)
    total = met.of_links(jnp.sum(normal, axis=1)[None], arm.count)[0]
    slip = jnp.zeros_like(here.joint)
    if contact.friction is not None:
        share = normal / jnp.where(total > 0, total, 1)[met.link, None]
        slip = met.of_links(jnp.sum(scaled(share, met.sliding), axis=2), arm.count)
        if strain is not None:
            drag = friction_force(contact, met, normal, total, strain)
            push = push + drag
            moment = moment + cross(met.place - scaled(met.distance, met.normal), drag)
    force = met.force + jnp.sum(push, axis=2)
    turn = met.couple + cross(here.joint[:, met.link], met.force) + jnp.sum(moment, axis=2)
    load = met.of_links(jnp.concatenate([force, turn]), arm.count)
    return Touch(load_torque(here, sum_from_tip(load)), slip, total)
