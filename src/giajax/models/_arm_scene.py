"""The scene of an arm: links, muscles, markers, forces, and what stands around."""

import jax
import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, safe_norm, scaled
from .._program import program
from .._typing import Array, Float
from ..arm import Arm, drag_force, pose
from ..obstacles import owners, solids
from ..simulation import Trajectory, contacts
from ._scene import Arrows, Block, Line, Scene
from ._sensors import Marker


def arm_scene(motion: Trajectory, marker: Marker | None = None) -> Scene:
    """What is seen of an arm that moves.

    Arguments:
        motion: of the arm, such as `giajax.simulate` gives.
        marker: where the tracked points lie; at the links' centres and the tip by default.

    Returns:
        One line `link` for each link, from its joint to its end; two lines `muscle` for each joint
        that has some, with their pressures; one marker for each tracked point (`link01`, ...,
        `tip`); the drag on each link as arrows `air`, and what obstacles press on each as arrows
        `contact`, both at its centre; and the obstacles.

    Example:
        >>> import giajax, jax.numpy as jnp
        >>> from giajax.models import arm_scene
        >>> arm = giajax.takeichi_20m(4)
        >>> command = giajax.joint_steps(arm.count, {1: 0.2})
        >>> scene = arm_scene(giajax.simulate(arm, command, jnp.linspace(0.0, 1.0, 11)))
        >>> len(scene.lines), scene.lines[0].points.shape, list(scene.markers)[-1]
        (4, (11, 2, 3), 'tip')
    """
    arm = motion.arm
    corners, centres, tip = map(
        np.asarray, _points(arm, Marker() if marker is None else marker, motion.angles)
    )
    radii = np.broadcast_to(np.asarray(arm.links.diameter) / 2, (arm.count,))
    lines = tuple(
        Line("link", corners[:, index : index + 2], np.full(2, radii[index]))
        for index in range(arm.count)
    )
    markers = {f"link{index + 1:02d}": centres[:, index] for index in range(arm.count)}
    middles = (corners[:, 1:] + corners[:, :-1]) / 2
    arrows = [Arrows("air", "N", middles, np.asarray(_drag(motion)))]
    blocks: tuple[Block, ...] = ()
    if arm.contact is not None:
        pressed = np.asarray(contacts(motion).force).sum(axis=2)
        arrows.append(Arrows("contact", "N", middles, pressed))
        blocks = _blocks(arm)
    return Scene(
        lines + _muscles(motion),
        {**markers, "tip": tip},
        np.asarray(motion.times),
        tuple(arrows),
        blocks,
    )


def _muscles(motion: Trajectory) -> tuple[Line, ...]:
    """The pairs of muscles along their joints, from link to link."""
    pneumatics = motion.arm.pneumatics
    if pneumatics is None:
        return ()
    assert motion.pressures is not None
    paths, pressures = np.asarray(_pairs(motion.arm, motion.angles)), np.asarray(motion.pressures)
    return tuple(
        Line(
            "muscle",
            paths[:, side, :, joint - 1],
            np.zeros(3),
            pressure=pressures[:, side, joint - 1],
        )
        for joint in pneumatics.joints
        for side in (0, 1)
    )


def _blocks(arm: Arm) -> tuple[Block, ...]:
    """The boxes of all obstacles."""
    assert arm.contact is not None
    obstacles = arm.contact.obstacles
    boxes = solids(obstacles)
    return tuple(
        Block(
            obstacles[owner].name,
            np.asarray(boxes.centre[:, index]),
            2 * np.asarray(boxes.half[:, index]),
            np.asarray(boxes.frame[:, :, index]),
        )
        for index, owner in enumerate(owners(obstacles))
    )


@program
def _points(
    arm: Arm, marker: Marker, angles: Float[Array, "sample joint"]
) -> tuple[
    Float[Array, "sample corner 3"], Float[Array, "sample link 3"], Float[Array, "sample 3"]
]:
    """Joints and end of the arm, markers of its links, and the tip's, m."""

    def at(row: Array) -> tuple[Array, Array, Array]:
        here = pose(arm, row)
        end = here.joint[:, -1:] + arm.links.length[-1] * here.direction[:, -1:]
        corners = jnp.concatenate([here.joint, end], axis=1).T
        return corners, marker.on_links(arm, row), marker.at_tip(arm, row)

    return jax.vmap(at)(angles)


@program
def _drag(motion: Trajectory) -> Float[Array, "sample link 3"]:
    """Drag of the air on each link, N."""
    arm = motion.arm

    def at(time: Array, angles: Array, rates: Array) -> Array:
        wind = None if motion.wind is None else motion.wind(time)
        if wind is not None and wind.size != 3:
            wind = wind.reshape(arm.count, 3)
        return drag_force(arm, angles, rates, wind)

    return jax.vmap(at)(motion.times, motion.angles, motion.rates)


@program
def _pairs(
    arm: Arm, angles: Float[Array, "sample joint"]
) -> Float[Array, "sample side point joint 3"]:
    """Where a muscle would lie on either side of each joint, m: the first, and the second.

    A picture, not the geometry of the wire: on the skin of the balloons, over a quarter of each.
    """

    def at(row: Array) -> Array:
        here = pose(arm, row)
        # The link before, by Rodrigues' formula.
        before = scaled(jnp.cos(row), here.direction)
        before = before - scaled(jnp.sin(row), cross(here.axis, here.direction))
        along = dot(here.axis, here.direction) * (1 - jnp.cos(row))
        before = before + scaled(along, here.axis)
        radius = arm.links.diameter / 2 * jnp.ones_like(row)
        reach = arm.links.length / 4 * jnp.ones_like(row)
        ends = [scaled(-reach, before), jnp.zeros_like(before), scaled(reach, here.direction)]
        # A positive angle bends towards the first muscle.
        sides = [cross(here.axis, each) for each in (before, here.direction)]
        bow = sides[0] + sides[1]
        bow = scaled(1 / safe_norm(bow), bow)
        across = [scaled(radius, each) for each in (sides[0], bow, sides[1])]
        centres, offsets = here.joint[None] + jnp.stack(ends), jnp.stack(across)
        return jnp.moveaxis(jnp.stack([centres + offsets, centres - offsets]), 2, -1)

    return jax.vmap(at)(angles)
