"""What each link touches: flattening and force, by obstacle."""

import jax.numpy as jnp
import numpy as np

from .._maths import scaled
from .._typing import Array, Float
from ..obstacles import owners
from ._arm import Arm
from ._kinematics import pose
from ._meeting import Pairs, flattening, meeting
from ._touch import friction_force, pressing


def touched(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    strain: Float[Array, "3 link"] | None = None,
) -> tuple[Float[Array, "link obstacle"], Float[Array, "link obstacle 3"]]:
    """Flattening of each link by each obstacle, and the force of the obstacle on it.

    Arguments:
        arm: an arm with obstacles.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.

    Returns:
        Flattening, m, and force in the base frame, N.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)
    owner = owners(contact.obstacles)
    shape = (arm.count, owner.size)
    pairs = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices(shape)))
    met = meeting(arm, contact, here, rates, pairs)
    normal = pressing(contact, met)
    push = scaled(normal - met.load, met.normal)
    if strain is not None and contact.friction is not None:
        total = jnp.sum(normal.reshape(arm.count, -1), axis=1)
        push = push + friction_force(contact, met, normal, total, strain)
    force = (met.force + jnp.sum(push, axis=2)).reshape(3, *shape)
    deep = flattening(arm, contact, here, pairs).reshape(shape)
    of = [np.flatnonzero(owner == each) for each in range(len(contact.obstacles))]
    flattened = jnp.stack([jnp.max(deep[:, boxes], axis=1) for boxes in of], axis=1)
    forces = jnp.stack([jnp.sum(force[:, :, boxes], axis=2) for boxes in of], axis=2)
    return flattened, jnp.moveaxis(forces, 0, -1)
