"""The scene of an arm: its links as cylinders, its markers and its tip."""

import jax
import jax.numpy as jnp
import numpy as np

from .._program import program
from .._typing import Array, Float
from ..arm import Arm, pose
from ..simulation import Trajectory
from ._scene import Line, Scene
from ._sensors import Marker


def arm_scene(motion: Trajectory, marker: Marker | None = None) -> Scene:
    """What is seen of an arm that moves.

    Arguments:
        motion: of the arm, such as `giajax.simulate` gives.
        marker: where the tracked points lie; at the links' centres and the tip by default.

    Returns:
        One line `link` for each link, from its joint to its end, and one marker for each
        tracked point (`link01`, ..., `tip`).

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
    return Scene(lines, {**markers, "tip": tip}, np.asarray(motion.times))


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
