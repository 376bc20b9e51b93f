"""Drag of the bodies that links carry: a ball on a string, an instrument in the wind."""

import jax.numpy as jnp
import numpy as np

from .._maths import cross, safe_norm, scaled
from .._typing import Array
from ._arm import Arm
from ._kinematics import Pose, Rows


def body_drag(arm: Arm, here: Pose, relative: Rows, omega: Rows) -> tuple[Rows, Rows] | None:
    """Drag of the point masses, as it acts on the links that carry them.

    F = -1/2 rho (C_D A) |V| V at each body, with V its velocity relative to the air: that of the
    link's centre, and what the link's turning adds. C_D A does not depend on the direction, as
    for a sphere, nor on the Reynolds number.

    Arguments:
        arm: the arm.
        here: its pose.
        relative: velocity of the links' centres relative to the air, m/s.
        omega: angular velocity of the links, rad/s.

    Returns:
        Force on each link, N, and couple about its geometric centre, N m; None where no body has
        a drag of its own.
    """
    bodies = arm.point_masses
    if bodies is None or bodies.drag_area is None:
        return None
    carriers = np.asarray(bodies.links) - 1

    def each(value: Array) -> Array:
        return jnp.broadcast_to(value, carriers.shape)

    along = each(bodies.position) - arm.links.length[carriers] / 2
    lever = scaled(along, here.direction[:, carriers])
    if bodies.left is not None:
        assert here.left is not None
        lever = lever + scaled(each(bodies.left), here.left[:, carriers])
    if bodies.up is not None:
        lever = lever + scaled(each(bodies.up), here.up[:, carriers])
    velocity = relative[:, carriers] + cross(omega[:, carriers], lever)
    size = 0.5 * arm.air.density * each(bodies.drag_area) * safe_norm(velocity)
    force = -scaled(size, velocity)
    # Sums over the bodies of each link, of which it may carry several.
    carried = np.eye(arm.count, dtype=force.dtype)[carriers]
    return force @ carried, cross(lever, force) @ carried
