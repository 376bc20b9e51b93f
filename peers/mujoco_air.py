"""The arm in MuJoCo, extended by two effects that MuJoCo lacks: added mass and joint hysteresis.

MuJoCo computes kinematics, masses, gravity and velocity-dependent inertial terms.
`peers.mujoco_chain` adds drag and lift. The air that a link displaces in transverse motion is
modelled as a rod of mass m = C_a rho V whose inertia acts only in transverse directions. Let e be
the direction of the link, w its velocity relative to the air, P the impulse of this air and L its
angular impulse about the centre. Then

    P = m (w - (e.w) e),    L = J (omega - (e.omega) e),    J = m l^2 / 12,
    F = -dP/dt + rho V du/dt,    couple = -(dL/dt + w x P).

These forces are projected onto the joints with Jacobians. The terms that contain joint
accelerations are added to MuJoCo's mass matrix. The joint friction follows Dahl's model,
dz/dt = s (rate - z |rate| / F), where z is the friction torque.
"""

import dataclasses

import mujoco
import numpy as np

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal
from peers.mujoco_chain import MujocoChain
from peers.scipy_chain import NumpySignal, cross

Array = np.ndarray


class MujocoInAir:
    """`Arm` with added mass in MuJoCo, integrated by a Runge-Kutta method of fourth order.

    Arguments:
        arm: arm whose numbers are used.
        command: commanded angles as a function of time.
        wind: continuous velocity of the air as a function of time; still air by default.
        friction: strength of Dahl's friction in every joint, N m; 0 disables the friction.
        friction_stiffness: initial stiffness of the friction, N m/rad.
    """

    def __init__(
        self,
        arm: Arm,
        command: Signal,
        wind: Signal | None = None,
        *,
        friction: float = 0.0,
        friction_stiffness: float = 1.0,
    ) -> None:
        coefficient = arm.air.added_mass_coefficient
        bare = dataclasses.replace(
            arm, air=dataclasses.replace(arm.air, added_mass_coefficient=None)
        )
        self.chain = MujocoChain(bare)
        self.count = arm.count
        self.command = NumpySignal(command)
        self.wind = None if wind is None else NumpySignal(wind)
        self.friction, self.friction_stiffness = friction, friction_stiffness
        air_mass = float(arm.air.density) * np.asarray(arm.links.volume, dtype=float)
        self._air_mass = air_mass
        self._mass = (0.0 if coefficient is None else float(coefficient)) * air_mass
        self._inertia = self._mass * np.asarray(arm.links.length, dtype=float) ** 2 / 12
        self._has_added_mass = coefficient is not None
        steady = arm.air.wind
        self._steady = np.zeros(3) if steady is None else np.asarray(steady, dtype=float)
        # Joint k moves link i if k <= i.
        self._moves = np.tril(np.ones((arm.count, arm.count)))[:, :, None]

    def acceleration(
        self,
        angles: Array,
        rates: Array,
        command: Array,
        wind: Array | None = None,
        wind_rate: Array | None = None,
        torque: Array | float = 0.0,
    ) -> Array:
        """Return the joint accelerations, rad/s^2; `torque` is a torque on the joints, N m."""
        wind = np.zeros(3) if wind is None else wind
        wind_rate = np.zeros(3) if wind_rate is None else wind_rate
        self.chain.acceleration(angles, rates, command, wind)
        data = self.chain.data
        force = data.qfrc_smooth + torque
        mass = np.empty((self.count, self.count))
        row = np.empty(self.count)
        for joint, unit in enumerate(np.eye(self.count)):
            mujoco.mj_mulM(self.chain.model, data, row, unit)
            mass[joint] = row
        if self._has_added_mass:
            more, less = self._of_the_air(rates, wind + self._steady, wind_rate)
            mass, force = mass + more, force + less
        return np.linalg.solve(mass, force)

    def _of_the_air(self, rates: Array, wind: Array, wind_rate: Array) -> tuple[Array, Array]:
        """Return the contributions of the added mass to the mass matrix and the joint torques."""
        data = self.chain.data
        axis, anchor = data.xaxis, data.xanchor
        e = data.xmat[self.chain._bodies, ::3]
        arms = data.site_xpos - anchor
        # Vectors from the previous joint to each joint. They move with the link between the two.
        steps = np.diff(anchor, axis=0, prepend=anchor[:1])
        omega = np.cumsum(axis * rates[:, None], axis=0)
        before = np.concatenate([np.zeros((1, 3)), omega[:-1]])
        velocity = np.cumsum(cross(before, steps), axis=0) + cross(omega, arms)
        # Accelerations at constant joint rates. A joint axis rotates with the link before the
        # joint.
        alpha = np.cumsum(cross(before, axis) * rates[:, None], axis=0)
        alpha_before = np.concatenate([np.zeros((1, 3)), alpha[:-1]])
        of_anchor = cross(alpha_before, steps) + cross(before, cross(before, steps))
        acceleration = np.cumsum(of_anchor, axis=0) + cross(alpha, arms)
        acceleration = acceleration + cross(omega, cross(omega, arms))

        through = velocity - wind
        e_rate = cross(omega, e)

        def across(vector: Array) -> Array:
            return vector - np.sum(e * vector, axis=-1, keepdims=True) * e

        def turned(vector: Array) -> Array:
            """Return the rate at which the link's rotation changes the axial part of a vector."""
            along, along_rate = np.sum(e * vector, axis=1), np.sum(e_rate * vector, axis=1)
            return along_rate[:, None] * e + along[:, None] * e_rate

        impulse = self._mass[:, None] * across(through)
        force = -self._mass[:, None] * (across(acceleration - wind_rate) - turned(through))
        force = force + self._air_mass[:, None] * wind_rate
        couple = -self._inertia[:, None] * (across(alpha) - turned(omega))
        couple = couple - cross(through, impulse)
        turning = self._moves * axis[None]
        moving = cross(turning, data.site_xpos[:, None] - anchor[None])
        on_joints = np.einsum("ikx,ix->k", moving, force) + np.einsum("ikx,ix->k", turning, couple)
        return self._inertia_matrix(moving, turning, e), on_joints

    def _inertia_matrix(self, moving: Array, turning: Array, e: Array) -> Array:
        """Return the mass matrix of the rods.

        `moving` and `turning` are the velocity and the angular velocity of each link (first axis)
        for a unit rate of each joint (second axis).
        """
        total = np.zeros((self.count, self.count))
        for weight, by_joint in ((self._mass, moving), (self._inertia, turning)):
            along = (by_joint @ e[:, :, None]) * e[:, None]
            rows = (by_joint - along).transpose(0, 2, 1).reshape(-1, self.count)
            total += (np.repeat(weight, 3)[:, None] * rows).T @ rows
        return total

    def trajectory(self, times: Array, step: float) -> Array:
        """Return the angles and rates at the times, from rest, shape (sample, 2, joint).

        Arguments:
            times: times of the samples, s; each must be a whole number of steps after the first.
            step: time step, s; it must also divide the times of the corners of command and wind.
        """
        times = np.asarray(times, dtype=float)
        samples = _whole((times - times[0]) / step, "times")
        for signal in (self.command, self.wind):
            if signal is not None:
                inside = (signal.times > times[0]) & (signal.times < times[-1])
                _whole((signal.times[inside] - times[0]) / step, "corners")
        state = np.zeros((3, self.count))
        out = np.empty((len(times), 2, self.count))
        sample = 0
        for done in range(samples[-1] + 1):
            if done == samples[sample]:
                out[sample] = state[:2]
                sample += 1
            if sample == len(times):
                break
            now = times[0] + done * step
            state = self._step(state, now, step)
            if not np.all(np.isfinite(state)):
                raise FloatingPointError(f"a step of {step:g} s is unstable")
        return out

    def places(self, angles: Array) -> tuple[Array, Array]:
        """Return the link centres, m, shape (sample, link, 3), and the tip, shape (sample, 3)."""
        model, data = self.chain.model, self.chain.data
        centres, tips = [], []
        for row in angles:
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            last = data.site_xpos[-1]
            centres.append(data.site_xpos.copy())
            tips.append(2 * last - data.xanchor[-1])
        return np.array(centres), np.array(tips)

    def _step(self, state: Array, now: float, step: float) -> Array:
        command = self.command.piece(now + step / 2)
        wind = None if self.wind is None else self.wind.piece(now + step / 2)
        slope = None if wind is None else (wind(now + step) - wind(now)) / step

        def rate(at: float, here: Array) -> Array:
            angles, rates, memory = here
            pushed = self.acceleration(
                angles, rates, command(at), None if wind is None else wind(at), slope, -memory
            )
            if not self.friction:
                return np.stack([rates, pushed, np.zeros_like(memory)])
            drawn = self.friction_stiffness * (rates - memory * np.abs(rates) / self.friction)
            return np.stack([rates, pushed, drawn])

        one = rate(now, state)
        two = rate(now + step / 2, state + step / 2 * one)
        three = rate(now + step / 2, state + step / 2 * two)
        four = rate(now + step, state + step * three)
        return state + step / 6 * (one + 2 * two + 2 * three + four)


def _whole(steps: Array, what: str) -> Array:
    counts = np.round(steps).astype(int)
    if np.abs(steps - counts).max(initial=0) > 1e-6:
        raise ValueError(f"the {what} do not fall on steps; choose a step that divides them")
    return counts
