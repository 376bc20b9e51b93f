"""Contact of inflated links in MuJoCo, with its distances and a penalty force in its callback."""

from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal
from peers.mujoco_chain import Array, MujocoChain

# Number of equally spaced points on the axis of a link at which MuJoCo computes the distance.
POINTS = 200


class MujocoContact(MujocoChain):
    """`Arm` in MuJoCo in contact with boxes.

    Arguments:
        arm: arm without friction at obstacles.
        boxes: centre (m), half sizes (m) and rotation vector (rad) of each box.
        command: commanded angles as a function of time.
    """

    def __init__(
        self, arm: Arm, boxes: list[tuple[Any, Any, Any]], command: Signal | None = None
    ) -> None:
        super().__init__(arm, command)
        assert arm.contact is not None
        assert arm.contact.friction is None
        geoms = ""
        for centre, half, turn in boxes:
            quaternion = Rotation.from_rotvec(turn).as_quat(scalar_first=True)
            geoms += (
                f'<geom type="box" size="{_text(half)}" pos="{_text(centre)}" '
                f'quat="{_text(quaternion)}"/>'
            )
        probe = '<body mocap="true"><geom type="sphere" size="0.001"/></body>'
        self._scene = mujoco.MjModel.from_xml_string(
            f"<mujoco><worldbody>{geoms}{probe}</worldbody></mujoco>"
        )
        self._scene_data = mujoco.MjData(self._scene)
        mujoco.mj_forward(self._scene, self._scene_data)
        self._line = float(arm.contact.line(arm.links)[0])
        self._harder = float(arm.contact.damping)
        self._radius = np.asarray(arm.links.diameter) / 2
        self._length = np.asarray(arm.links.length)

    def _passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        super()._passive(model, data)
        wrench = np.zeros((self.count, 6))
        for link in range(self.count):
            wrench[link] = self._pressed(data, link)
        carried = np.cumsum(wrench[::-1], axis=0)[::-1]
        data.qfrc_passive[:] += np.einsum("ij,ij->i", data.cdof, carried)

    def _pressed(self, data: mujoco.MjData, link: int) -> Array:
        body = link + 1
        direction = data.xmat[body, ::3]
        step = self._length[link] / POINTS
        wrench = np.zeros(6)
        probe, last = self._scene.ngeom - 1, np.zeros(6)
        for box in range(probe):
            reach = self._radius[link] + self._length[link] / 2
            if self._distance(probe, box, data.site_xpos[link], reach, last) >= reach:
                continue
            for place in (np.arange(POINTS) + 0.5) * step:
                x = data.xpos[body] + place * direction
                distance = self._distance(probe, box, x, self._radius[link], last)
                depth = self._radius[link] - distance
                if depth <= 0:
                    continue
                normal = last[:3] - last[3:]
                normal /= np.linalg.norm(normal)
                offset = x - data.subtree_com[1]
                velocity = data.cvel[body, 3:] + np.cross(data.cvel[body, :3], offset)
                harder = max(1 - self._harder * (velocity @ normal), 0.0)
                force = self._line * depth * step * harder * normal
                wrench += np.concatenate([np.cross(offset, force), force])
        return wrench

    def _distance(self, probe: int, box: int, x: Array, most: float, last: Array) -> float:
        """Return the distance from a point to a box; `last` receives the two nearest points."""
        self._scene_data.geom_xpos[probe] = x
        found = mujoco.mj_geomDistance(self._scene, self._scene_data, probe, box, most, last)
        return found + 0.001


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
