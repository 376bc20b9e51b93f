"""Kinematics of the chain: poses and velocities of the links in the base frame.

All vectors are in one frame, so each recursion along the chain is a cumulative sum. Only the
rotations require a loop. Arrays of vectors have the shape `(3, link)` internally and `(link, 3)` in
public functions.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import (
    Array,
    Float,
    cross,
    quaternion_product,
    rotate,
    rotation_vector_to_quaternion,
    running_sum,
    scaled,
)
from ...runtime.programs import traced_once
from ._arm import Arm, Bodies, bodies
from ._joint_laws import PerJoint
from ._parts import Axis

Rows = Float[Array, "3 link"]


class Pose(NamedTuple):
    """Configuration of the chain in the base frame. The first axis of each array is the component.

    Attributes:
        direction: unit vector along each link.
        axis: unit vector of each joint axis.
        joint: position of the joint of each link, m.
        centre: position of the geometric centre of each link, m.
        mass_centre: position of the centre of mass of each link and all that it carries, m.
        left: unit vector to the left of each link; None if all masses lie on the axes of the links.
    """

    direction: Rows
    axis: Rows
    joint: Rows
    centre: Rows
    mass_centre: Rows
    left: Rows | None = None

    @property
    def up(self) -> Rows:
        """Unit vector along the z axis (up in the straight arm) of the frame of each link."""
        assert self.left is not None
        return cross(self.direction, self.left)


def sum_from_base(x: Float[Array, "*row link"]) -> Float[Array, "*row link"]:
    """Sum over each link and all links before it."""
    return running_sum(x)


def sum_from_tip(x: Float[Array, "*row link"]) -> Float[Array, "*row link"]:
    """Sum over each link and all links after it."""
    return running_sum(x, backwards=True)


@eqx.filter_custom_jvp
def _orient(
    base: Array, angles: Array, axes: tuple[Axis, ...], sideways: bool
) -> tuple[Rows, Rows, Rows | None]:
    """Return the directions of the links, the joint axes and, on request, the left directions.

    Arguments:
        base: unit quaternion of the base.
        angles: joint angles, rad.
        axes: joint axes in the straight arm.
        sideways: whether to return the unit vectors to the left of the links; otherwise None.
    """
    fixed = jnp.asarray(axes, dtype=angles.dtype).T
    turns = jnp.concatenate([jnp.cos(angles / 2)[None], scaled(jnp.sin(angles / 2), fixed)])
    first = quaternion_product(base[:, None], turns[:, :1])

    def compose(k: Array, turned: Array) -> Array:
        column = functools.partial(jax.lax.dynamic_slice_in_dim, turned, slice_size=1, axis=1)
        after = quaternion_product(column(k - 1), column(k))
        return jax.lax.dynamic_update_slice_in_dim(turned, after, k, 1)

    # The loop updates the array in place. A scan would copy its inputs and outputs.
    whole = jnp.concatenate([first, turns[:, 1:]], axis=1)
    orientations = jax.lax.fori_loop(1, angles.size, compose, whole)
    w, x, y, z = orientations
    direction = jnp.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    left = jnp.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)])
    return direction, rotate(orientations, fixed), left if sideways else None


@_orient.def_jvp
def _orient_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """Differentiate through the small rotation of each link, which is a sum along the chain.

    The loop is then not differentiated, which saves most of the cost of derivatives.
    """
    base, angles, axes, sideways = primals
    t_base, t_angles, *_ = tangents
    direction, axis, left = _orient(base, angles, axes, sideways)
    turn = jnp.zeros_like(axis)
    if t_angles is not None:
        turn = turn + sum_from_base(scaled(t_angles, axis))
    if t_base is not None:
        conjugate = base * np.asarray([1, -1, -1, -1], base.dtype)
        turn = turn + 2 * quaternion_product(t_base, conjugate)[1:, None]
    t_left = None if left is None else cross(turn, left)
    return (direction, axis, left), (cross(turn, direction), cross(turn, axis), t_left)


@traced_once
def pose(arm: Arm, angles: PerJoint, *, sideways: bool = False) -> Pose:
    """Return the forward kinematics at joint angles.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        sideways: whether to compute the left directions even if all masses lie on the link axes.
    """
    base = rotation_vector_to_quaternion(arm.base_rotation)
    body = bodies(arm)
    sideways = sideways or body.across is not None
    direction, axis, left = _orient(base, angles, arm.joints.axes, sideways)
    span = scaled(arm.links.length, direction)
    joint = sum_from_base(span) - span
    here = Pose(direction, axis, joint, joint + span / 2, joint, left)
    beside, mass_centre = beside_axis(body, here), joint + scaled(body.along, direction)
    return here._replace(mass_centre=mass_centre if beside is None else mass_centre + beside)


def beside_axis(body: Bodies, here: Pose) -> Rows | None:
    """Return the vectors from link axes to centres of mass, m; None if all lie on the axes."""
    if body.across is None:
        return None
    assert here.left is not None
    return scaled(body.across[0], here.left) + scaled(body.across[1], here.up)


def angular_velocities(pose: Pose, rates: PerJoint) -> Rows:
    """Return the angular velocity of each link, rad/s."""
    return sum_from_base(scaled(rates, pose.axis))


def centre_velocities(arm: Arm, pose: Pose, angular_velocity: Rows) -> Rows:
    """Return the velocity of the geometric centre of each link, m/s: V_Gi of eq. (1)."""
    span = cross(angular_velocity, scaled(arm.links.length, pose.direction))
    return sum_from_base(span) - span / 2


def link_centres(arm: Arm, angles: PerJoint) -> Float[Array, "link 3"]:
    """Return the positions of the link centres in the base frame at joint angles (rad), m."""
    return pose(arm, angles).centre.T


def tip_position(arm: Arm, angles: PerJoint) -> Float[Array, "3"]:
    """Return the position of the end of the last link in the base frame at angles (rad), m."""
    return scaled(arm.links.length, pose(arm, angles).direction).sum(axis=-1)


def link_velocities(arm: Arm, angles: PerJoint, rates: PerJoint) -> Float[Array, "link 3"]:
    """Return the velocities of the link centres in the base frame, m/s.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
    """
    here = pose(arm, angles)
    return centre_velocities(arm, here, angular_velocities(here, rates)).T
