"""The arm again, in MuJoCo: an independent reference for the tests, a peer for the benchmark.

The chain is an MJCF string made from the numbers of a giajax `Arm`. Springs (about zero) and
dampers are MuJoCo's own; the commanded angle and the drag of the paper's eq. (1) enter through the
passive-force callback, in Python, as a MuJoCo user would add a force that MuJoCo does not have.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from giajax.arm import Arm
from giajax.simulation import Signal
from scipy_chain import NumpySignal, cross

Array = np.ndarray


def mjcf(arm: Arm) -> str:
    """The arm as MJCF: one body, one hinge and one site (the link's centre) for each link."""
    links = arm.links
    quaternion = Rotation.from_rotvec(np.array(arm.base_rotation)).as_quat(scalar_first=True)
    stiffness = np.asarray(arm.joints.stiffness).tolist()
    damping = np.broadcast_to(np.asarray(arm.joints.damping), (arm.count,)).tolist()
    opening, closing = "", ""
    before = 0.0
    for i in range(arm.count):
        turn = f' quat="{_numbers(*quaternion)}"' if i == 0 else ""
        length, along = float(links.length[i]), float(links.centre_of_mass[i])
        axial, transverse = float(links.inertia_axial[i]), float(links.inertia_transverse[i])
        opening += (
            f'<body name="link{i + 1}" pos="{_numbers(before, 0, 0)}"{turn}>'
            f'<joint name="joint{i + 1}" type="hinge" axis="{_numbers(*arm.joints.axes[i])}" '
            f'stiffness="{_numbers(stiffness[i])}" damping="{_numbers(damping[i])}"/>'
            f'<inertial pos="{_numbers(along, 0, 0)}" mass="{_numbers(float(links.mass[i]))}" '
            f'diaginertia="{_numbers(axial, transverse, transverse)}"/>'
            f'<site name="centre{i + 1}" pos="{_numbers(length / 2, 0, 0)}"/>\n'
        )
        closing += "</body>"
        before = length
    return (
        '<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option integrator="RK4" gravity="{_numbers(0, 0, -float(arm.gravity))}">'
        '<flag contact="disable" constraint="disable"/></option>\n'
        f"<worldbody>{opening}{closing}</worldbody></mujoco>"
    )


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


class MujocoChain:
    """An `Arm` in MuJoCo.

    Arguments:
        arm: the arm whose numbers are read.
        command: commanded angles over time; only `trajectory` needs it.
        wind: velocity of the air over time; still air by default.
    """

    def __init__(self, arm: Arm, command: Signal | None = None, wind: Signal | None = None) -> None:
        self.count = arm.count
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm))
        self.data = mujoco.MjData(self.model)
        self.command = None if command is None else NumpySignal(command)
        self.wind = None if wind is None else NumpySignal(wind)
        self._stiffness = np.array(arm.joints.stiffness, dtype=float)
        area = np.asarray(arm.links.length * arm.links.diameter, dtype=float)
        factor = 0.5 * float(arm.air.density) * float(arm.air.drag_coefficient)
        self._drag_factor = factor * area
        self._command_now: Callable[[float], Array] = lambda _: np.zeros(self.count)
        self._wind_now: Callable[[float], Array] | None = None

    @contextmanager
    def forces(self) -> Iterator[None]:
        """While this lasts, MuJoCo asks for the spring's commands and the drag."""
        # Callbacks are global to MuJoCo: leave them as they were found. Its warnings are counted
        # in `data.warning`, and would else go to a file in the working directory.
        mujoco.set_mjcb_passive(self._passive)
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            yield
        finally:
            mujoco.set_mjcb_passive(None)
            mujoco.set_mju_user_warning(None)

    def _passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Add k * command, and the drag of eq. (1), to the passive torques.

        MuJoCo keeps velocities `cvel` and joint axes `cdof` as spatial vectors (turning, then
        translation) about the centre of mass of the whole chain, which saves twenty Jacobians.
        """
        offset = data.site_xpos - data.subtree_com[1]
        velocity = data.cvel[1:, 3:] + cross(data.cvel[1:, :3], offset)
        if self._wind_now is not None:
            velocity = velocity - self._wind_now(data.time)
        speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
        force = -(self._drag_factor * speed)[:, None] * velocity
        wrench = np.concatenate([cross(offset, force), force], axis=1)
        carried = np.cumsum(wrench[::-1], axis=0)[::-1]
        drag = np.einsum("ij,ij->i", data.cdof, carried)
        data.qfrc_passive[:] += self._stiffness * self._command_now(data.time) + drag

    def acceleration(
        self, angles: Array, rates: Array, command: Array, wind: Array | None = None
    ) -> Array:
        """Joint accelerations, rad/s^2."""
        self._command_now = lambda _: command
        self._wind_now = None if wind is None else (lambda _: wind)
        self.data.qpos[:], self.data.qvel[:] = angles, rates
        with self.forces():
            mujoco.mj_forward(self.model, self.data)
        return self.data.qacc.copy()

    def trajectory(
        self, times: Array, step: float, *, initial: tuple[Array, Array] | None = None
    ) -> Array:
        """Angles and rates at the times, shape (sample, 2, joint), by MuJoCo's RK4.

        Arguments:
            times: each a whole number of steps after the first.
            step: time step, s; corners of the command and the wind must fall on steps too.
            initial: angles and rates at the first time; straight and at rest by default.
        """
        assert self.command is not None
        model, data = self.model, self.data
        times = np.asarray(times, dtype=float)
        counts = _whole((times - times[0]) / step, "times")
        for signal in (self.command, self.wind):
            if signal is not None:
                inside = (signal.times > times[0]) & (signal.times < times[-1])
                _whole((signal.times[inside] - times[0]) / step, "corners")
        mujoco.mj_resetData(model, data)
        model.opt.timestep = step
        if initial is not None:
            data.qpos[:], data.qvel[:] = initial
        found = np.empty((len(times), 2, self.count))
        found[0] = data.qpos, data.qvel
        sample = 1
        with self.forces():
            for done in range(counts[-1]):
                # Count steps instead of adding them up, or the corners drift off the steps.
                data.time = times[0] + done * step
                middle = data.time + step / 2
                self._command_now = self.command.piece(middle)
                self._wind_now = None if self.wind is None else self.wind.piece(middle)
                mujoco.mj_step(model, data)
                # MuJoCo starts again from the initial state after an overflow, and goes on.
                if data.warning.number.any():
                    raise FloatingPointError(f"MuJoCo is unstable with a step of {step:g} s")
                if done + 1 == counts[sample]:
                    found[sample] = data.qpos, data.qvel
                    sample += 1
        return found


def _whole(steps: Array, what: str) -> Array:
    counts = np.round(steps).astype(int)
    if np.abs(steps - counts).max(initial=0) > 1e-6:
        raise ValueError(f"the {what} do not fall on steps; choose a step that divides them")
    return counts
