"""Independent implementation of the arm in MuJoCo: a reference for the tests and the benchmarks.

The chain is an MJCF string with the numbers of a giajax `Arm`. MuJoCo computes the springs (with a
rest angle of zero), dampers, armature and all bodies with a mass. The passive-force callback, which
is in Python, adds the effects that MuJoCo lacks: the commanded angle, the drag of the paper's
eq. (1) or the drag along the links, the lift and the joint friction. Added mass and a C_D that
depends on the Reynolds number are not available here.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from giajax.mechanics.arm import Arm, lift
from giajax.simulation import Signal
from peers.scipy_chain import NumpySignal, cross

Array = np.ndarray


def mjcf(arm: Arm) -> str:
    """Return the arm as MJCF: one body, one hinge and one site (the link centre) per link."""
    links = arm.links
    quaternion = Rotation.from_rotvec(np.array(arm.base_rotation)).as_quat(scalar_first=True)
    stiffness = np.asarray(arm.joints.stiffness).tolist()
    damping = _each(arm.joints.damping, arm.count)
    armature = _each(arm.joints.armature, arm.count)
    opening, closing = "", ""
    before = 0.0
    for i in range(arm.count):
        turn = f' quat="{_numbers(*quaternion)}"' if i == 0 else ""
        length, along = float(links.length[i]), float(links.centre_of_mass[i])
        axial, transverse = float(links.inertia_axial[i]), float(links.inertia_transverse[i])
        opening += (
            f'<body name="link{i + 1}" pos="{_numbers(before, 0, 0)}"{turn}>'
            f'<joint name="joint{i + 1}" type="hinge" axis="{_numbers(*arm.joints.axes[i])}" '
            f'stiffness="{_numbers(stiffness[i])}" damping="{_numbers(damping[i])}" '
            f'armature="{_numbers(armature[i])}"/>'
            f'<inertial pos="{_numbers(along, 0, 0)}" mass="{_numbers(float(links.mass[i]))}" '
            f'diaginertia="{_numbers(axial, transverse, transverse)}"/>'
            f'<site name="centre{i + 1}" pos="{_numbers(length / 2, 0, 0)}"/>\n' + _carried(arm, i)
        )
        closing += "</body>"
        before = length
    return (
        '<mujoco><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option integrator="RK4" gravity="{_numbers(0, 0, -float(arm.gravity))}">'
        '<flag contact="disable" constraint="disable"/></option>\n'
        f"<worldbody>{opening}{closing}</worldbody></mujoco>"
    )


def _carried(arm: Arm, i: int) -> str:
    """Return the helium, trim weight and point masses of a link as bodies fixed to it."""
    bodies = []
    if arm.buoyancy is not None:
        held, count = arm.buoyancy, arm.count
        length, diameter = float(arm.links.length[i]), float(arm.links.diameter[i])
        helium = float(held.helium_density * arm.links.volume[i])
        # The helium is a cylinder that does not rotate about its own axis, so this inertia is 0.
        across = helium * (length**2 / 12 + diameter**2 / 16)
        bodies.append((helium, (length / 2, 0.0, 0.0), (0.0, across, across)))
        depth = _each(held.trim_depth, count)[i]
        place = (_each(held.trim_position, count)[i], 0.0, -depth)
        bodies.append((_each(held.trim_mass, count)[i], place, (0.0, 0.0, 0.0)))
    if arm.point_masses is not None:
        fixed = arm.point_masses
        columns = (fixed.mass, fixed.position, fixed.left, fixed.up)
        rows = (_each(x, len(fixed.links)) for x in columns)
        for link, mass, x, y, z in zip(fixed.links, *rows, strict=True):
            if link == i + 1:
                bodies.append((mass, (x, y, z), (0.0, 0.0, 0.0)))
    return "".join(
        f'<body><inertial pos="{_numbers(*place)}" mass="{_numbers(mass)}" '
        f'diaginertia="{_numbers(*inertia)}"/></body>\n'
        for mass, place, inertia in bodies
    )


def _each(values: Any, count: int) -> list[float]:
    """Return one number per element; zeros if the arm does not have the property."""
    return np.broadcast_to(0.0 if values is None else np.asarray(values), (count,)).tolist()


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


class MujocoChain:
    """`Arm` in MuJoCo.

    Arguments:
        arm: arm whose numbers are used.
        command: commanded angles as a function of time; required only for `trajectory`.
        wind: velocity of the air as a function of time; still air by default.
    """

    def __init__(self, arm: Arm, command: Signal | None = None, wind: Signal | None = None) -> None:
        self.count = arm.count
        self.model = mujoco.MjModel.from_xml_string(mjcf(arm))
        self.data = mujoco.MjData(self.model)
        # Indices of the links, without the bodies that are fixed to them: a slice if possible,
        # otherwise an array.
        self._bodies: Any = slice(1, None)
        if self.model.nbody > 1 + arm.count:
            names = (f"link{link}" for link in range(1, arm.count + 1))
            self._bodies = np.array([self.model.body(name).id for name in names])
        self.command = None if command is None else NumpySignal(command)
        self.wind = None if wind is None else NumpySignal(wind)
        self._stiffness = np.array(arm.joints.stiffness, dtype=float)
        area = np.asarray(arm.links.length * arm.links.diameter, dtype=float)
        factor = 0.5 * float(arm.air.density) * float(arm.air.drag_coefficient)
        self._drag_factor = factor * area
        self._lift = None if (upwards := lift(arm)) is None else np.asarray(upwards, dtype=float)
        self._friction = np.asarray(_each(arm.joints.friction, arm.count))
        self._friction_rate = float(arm.joints.friction_rate)
        self._rubs = arm.joints.friction is not None
        self._own_wind = None if arm.air.wind is None else np.asarray(arm.air.wind, dtype=float)
        if arm.air.added_mass_coefficient is not None or arm.air.drag_curve != "constant":
            raise ValueError("MuJoCo has neither added mass nor this drag curve; leave them out")
        if arm.point_masses is not None and arm.point_masses.drag_area is not None:
            raise ValueError("no drag is put on MuJoCo's point masses; leave drag_area out")
        self._strip: list[tuple[float, float]] | None = None
        if arm.air.drag == "strip":
            nodes, weights = np.polynomial.legendre.leggauss(arm.air.strip_points)
            self._strip = list(zip(nodes.tolist(), (weights / 2).tolist(), strict=True))
        self._half_length = np.asarray(arm.links.length, dtype=float)[:, None] / 2
        axial = arm.air.axial_coefficient
        ratio = 0.0 if axial is None else float(axial) / float(arm.air.drag_coefficient)
        self._axial_factor = ratio * self._drag_factor
        self._command_now: Callable[[float], Array] = lambda _: np.zeros(self.count)
        self._wind_now: Callable[[float], Array] | None = None

    @contextmanager
    def forces(self) -> Iterator[None]:
        """Return a context in which MuJoCo calls `_passive` for the additional forces."""
        # The callbacks of MuJoCo are global, so they are removed at the end. MuJoCo counts warnings
        # in `data.warning`. By default, it also writes them to a file in the working directory.
        mujoco.set_mjcb_passive(self._passive)
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            yield
        finally:
            mujoco.set_mjcb_passive(None)
            mujoco.set_mju_user_warning(None)

    def _passive(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Add k * command, the forces of the air and the friction to the passive torques.

        MuJoCo stores velocities `cvel` and joint axes `cdof` as spatial vectors (rotation, then
        translation) about the centre of mass of the whole chain. With these vectors, the method
        needs no Jacobians of the links.
        """
        centre = data.site_xpos - data.subtree_com[1]
        wind = self._wind_now(data.time) if self._wind_now is not None else None
        if self._own_wind is not None:
            wind = self._own_wind if wind is None else wind + self._own_wind
        if self._strip is None:
            velocity = self._velocity(data, centre, wind)
            speed = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
            wrench = _wrench(centre, -(self._drag_factor * speed)[:, None] * velocity)
        else:
            wrench = self._along_the_links(data, centre, wind)
        if self._lift is not None:
            wrench = wrench + _wrench(centre, self._lift[:, None] * np.array([0.0, 0.0, 1.0]))
        carried = np.cumsum(wrench[::-1], axis=0)[::-1]
        torque = np.einsum("ij,ij->i", data.cdof, carried)
        if self._rubs:
            torque -= self._friction * np.tanh(data.qvel / self._friction_rate)
        data.qfrc_passive[:] += self._stiffness * self._command_now(data.time) + torque

    def _velocity(self, data: mujoco.MjData, offset: Array, wind: Array | None) -> Array:
        """Return the velocity of one point of each link relative to the air."""
        spatial = data.cvel[self._bodies]
        velocity = spatial[:, 3:] + cross(spatial[:, :3], offset)
        return velocity if wind is None else velocity - wind

    def _along_the_links(self, data: mujoco.MjData, centre: Array, wind: Array | None) -> Array:
        """Return the wrenches of the drag along the links.

        The cross-flow drag acts at the Gauss points of each link, and the axial drag at its centre.
        """
        assert self._strip is not None
        direction = data.xmat[self._bodies, ::3]
        slip = np.einsum("ij,ij->i", self._velocity(data, centre, wind), direction)
        axial = -(self._axial_factor * np.abs(slip) * slip)[:, None] * direction
        wrench = _wrench(centre, axial)
        for node, weight in self._strip:
            place = centre + node * self._half_length * direction
            velocity = self._velocity(data, place, wind)
            velocity = velocity - np.einsum("ij,ij->i", velocity, direction)[:, None] * direction
            speed = np.linalg.norm(velocity, axis=1)
            force = -(weight * self._drag_factor * speed)[:, None] * velocity
            wrench = wrench + _wrench(place, force)
        return wrench

    def acceleration(
        self, angles: Array, rates: Array, command: Array, wind: Array | None = None
    ) -> Array:
        """Return the joint accelerations, rad/s^2."""
        self._command_now = lambda _: command
        self._wind_now = None if wind is None else (lambda _: wind)
        self.data.qpos[:], self.data.qvel[:] = angles, rates
        with self.forces():
            mujoco.mj_forward(self.model, self.data)
        return self.data.qacc.copy()

    def trajectory(
        self, times: Array, step: float, *, initial: tuple[Array, Array] | None = None
    ) -> Array:
        """Return the angles and rates at the times, shape (sample, 2, joint).

        The integrator is MuJoCo's RK4.

        Arguments:
            times: times of the samples, s; each must be a whole number of steps after the first.
            step: time step, s; it must also divide the times of the corners of command and wind.
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
                # A sum of time steps would accumulate rounding errors, and the corners would no
                # longer coincide with steps.
                data.time = times[0] + done * step
                middle = data.time + step / 2
                self._command_now = self.command.piece(middle)
                self._wind_now = None if self.wind is None else self.wind.piece(middle)
                mujoco.mj_step(model, data)
                # After an overflow, MuJoCo resets the state and continues.
                if data.warning.number.any():
                    raise FloatingPointError(f"MuJoCo is unstable with a step of {step:g} s")
                if done + 1 == counts[sample]:
                    found[sample] = data.qpos, data.qvel
                    sample += 1
        return found


def _wrench(offset: Array, force: Array) -> Array:
    return np.concatenate([cross(offset, force), force], axis=1)


def _whole(steps: Array, what: str) -> Array:
    counts = np.round(steps).astype(int)
    if np.abs(steps - counts).max(initial=0) > 1e-6:
        raise ValueError(f"the {what} do not fall on steps; choose a step that divides them")
    return counts
