"""The arm in MuJoCo with what MuJoCo does not have: added mass, and joints with memory.

Kinematics, masses, gravity and velocity terms are MuJoCo's, drag and lift those of
`peers.mujoco_chain`. The air that a link moves across itself is a rod of mass m = C_a rho V with
inertia across the link alone; with e its direction, w its velocity through the air and P, L the
impulse and its couple about the centre,

    P = m (w - (e.w) e),    L = J (omega - (e.omega) e),    J = m l^2 / 12,
    F = -dP/dt + rho V du/dt,    couple = -(dL/dt + w x P).

Projected on the joints by Jacobians, the terms with joint accelerations are added to MuJoCo's mass
matrix. Friction of a joint follows Dahl, dz/dt = s (rate - z |rate| / F), and z is its torque.
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
    """An `Arm` with added mass in MuJoCo, integrated by a Runge-Kutta method of fourth order.

    Arguments:
        arm: the arm whose numbers are read.
        command: commanded angles over time.
        wind: velocity of the air over time, without jumps; still air by default.
        friction: strength of Dahl's friction in every joint, N m; 0 for none.
        friction_stiffness: of the friction, N m/rad.
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
        # Joint k moves link i where k <= i.
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
        """Joint accelerations, rad/s^2; `torque` acts on the joints, N m."""
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
        """What the air's inertia adds to the mass matrix and to the forces of the joints."""
        data = self.chain.data
        axis, anchor = data.xaxis, data.xanchor
        e = data.xmat[self.chain._bodies, ::3]
        arms = data.site_xpos - anchor
        # From one joint to the next, which moves with the link before it.
        steps = np.diff(anchor, axis=0, prepend=anchor[:1])
        omega = np.cumsum(axis * rates[:, None], axis=0)
        before = np.concatenate([np.zeros((1, 3)), omega[:-1]])
        velocity = np.cumsum(cross(before, steps), axis=0) + cross(omega, arms)
        # Accelerations at rates that do not change: axes turn with the link before them.
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
            """What the turning of the link takes from the part of a vector across it."""
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
        """Of the rods, from how each joint (second axis) moves and turns each link (first)."""
        total = np.zeros((self.count, self.count))
        for weight, by_joint in ((self._mass, moving), (self._inertia, turning)):
            along = (by_joint @ e[:, :, None]) * e[:, None]
            rows = (by_joint - along).transpose(0, 2, 1).reshape(-1, self.count)
            total += (np.repeat(weight, 3)[:, None] * rows).T @ rows
        return total

    def trajectory(self, times: Array, step: float) -> Array:
        """Angles and rates at the times, shape (sample, 2, joint), from rest.

        Arguments:
            times: each a whole number of steps after the first.
            step: time step, s; corners of the command and the wind must fall on steps too.
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
        """Centres of the links, m, shape (sample, link, 3), and the tip, shape (sample, 3)."""
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
