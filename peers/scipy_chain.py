"""Independent implementation of the arm in numpy and scipy: a reference for tests and benchmarks.

It uses the numbers of the giajax classes `Arm` and `Signal`, but no other part of giajax. The
equations of motion are projected onto the joints with Jacobians (Kane's form),

    M = sum_i m_i Jv_i' Jv_i + Jw_i' I_i Jw_i,

whereas giajax sums spatial inertias about the base origin. Rotations are represented by matrices
instead of quaternions.
"""

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import solve
from scipy.spatial.transform import Rotation

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal

Array = np.ndarray


def cross(a: Array, b: Array) -> Array:
    """Return the vector product over the last axis.

    For small arrays, `numpy.cross` takes ten times as long.
    """
    c = np.empty(np.broadcast_shapes(a.shape, b.shape))
    c[..., 0] = a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1]
    c[..., 1] = a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2]
    c[..., 2] = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return c


class NumpySignal:
    """`Signal` as numpy arrays, which can be evaluated on either side of a jump."""

    def __init__(self, signal: Signal) -> None:
        self.times, self.values, self.slopes = (
            np.asarray(x, dtype=float) for x in (signal.times, signal.values, signal.slopes)
        )

    def piece(self, time: float) -> Callable[[float], Array]:
        """Return the straight line of the signal on the piece that contains a given time."""
        knot = int(np.searchsorted(self.times, time, side="right")) - 1
        if knot < 0:
            first = self.values[0]
            return lambda _: first
        start, value, slope = self.times[knot], self.values[knot], self.slopes[knot]
        return lambda now: value + slope * (now - start)


def pieces(
    t0: float, t1: float, signals: tuple[NumpySignal, ...]
) -> Iterator[tuple[float, float, tuple[Callable[[float], Array], ...]]]:
    """Split a time span at the corners of the signals; yield start, end and lines of each piece."""
    corners = np.unique(np.concatenate([[t0, t1], *(signal.times for signal in signals)]))
    corners = corners[(corners >= t0) & (corners <= t1)]
    for start, end in pairwise(corners.tolist()):
        middle = (start + end) / 2
        yield start, end, tuple(signal.piece(middle) for signal in signals)


class ScipyChain:
    """Equations of motion of an `Arm` in numpy.

    Arguments:
        arm: arm whose numbers are used.
        command: commanded angles as a function of time; required only for `trajectory`.
        wind: velocity of the air as a function of time; still air by default.
    """

    def __init__(self, arm: Arm, command: Signal | None = None, wind: Signal | None = None) -> None:
        self.count = arm.count
        self.command = None if command is None else NumpySignal(command)
        self.wind = None if wind is None else NumpySignal(wind)
        links = arm.links
        self.length, self.diameter, self.mass, self.mass_centre, self.transverse, self.axial = (
            np.asarray(x, dtype=float)
            for x in (
                links.length,
                links.diameter,
                links.mass,
                links.centre_of_mass,
                links.inertia_transverse,
                links.inertia_axial,
            )
        )
        self.axes = np.asarray(arm.joints.axes, dtype=float)
        self.base = Rotation.from_rotvec(np.array(arm.base_rotation)).as_matrix()
        self.gravity = np.array([0.0, 0.0, -float(arm.gravity)])
        yaw = np.abs(self.axes[:, 2]) > np.sqrt(0.5)
        self.stiffness = np.where(
            yaw, float(arm.joints.yaw_stiffness), float(arm.joints.pitch_stiffness)
        )
        self.damping = np.broadcast_to(np.asarray(arm.joints.damping), (self.count,))
        # 1/2 rho C_D L d
        self.drag_factor = (0.5 * float(arm.air.density) * float(arm.air.drag_coefficient)) * (
            self.length * self.diameter
        )
        self._before = np.tril(np.ones((self.count, self.count)))[:, :, None]
        # Constant matrices of Rodrigues' formula for each axis.
        self._skew = np.zeros((self.count, 3, 3))
        x, y, z = self.axes.T
        self._skew[:, 0, 1], self._skew[:, 0, 2], self._skew[:, 1, 2] = -z, y, -x
        self._skew[:, 1, 0], self._skew[:, 2, 0], self._skew[:, 2, 1] = z, -y, x
        self._skew_square = self._skew @ self._skew

    def orientations(self, angles: Array) -> Array:
        """Return the rotation matrix of each link, shape (link, 3, 3)."""
        turns = (
            np.eye(3)
            + np.sin(angles)[:, None, None] * self._skew
            + (1 - np.cos(angles))[:, None, None] * self._skew_square
        )
        orientations = np.empty_like(turns)
        before = self.base
        for link in range(self.count):
            before = orientations[link] = before @ turns[link]
        return orientations

    def tip(self, angles: Array) -> Array:
        """Return the position of the tip for angles of shape (joint,) or (sample, joint)."""
        if angles.ndim == 2:
            return np.array([self.tip(row) for row in angles])
        return self.length @ self.orientations(angles)[:, :, 0]

    def acceleration(
        self, angles: Array, rates: Array, command: Array, wind: Array | None = None
    ) -> Array:
        """Return the joint accelerations, rad/s^2."""
        orientations = self.orientations(angles)
        along = orientations[:, :, 0]
        # A joint axis has the same components in the frames of both adjacent links.
        axis = np.einsum("jab,jb->ja", orientations, self.axes)
        span = self.length[:, None] * along
        joint = np.cumsum(span, axis=0) - span
        to_mass = self.mass_centre[:, None] * along

        turning = rates[:, None] * axis
        omega = np.cumsum(turning, axis=0)
        alpha = np.cumsum(cross(omega, turning), axis=0)
        span_acceleration = cross(alpha, span) + cross(omega, cross(omega, span))
        bias = np.cumsum(span_acceleration, axis=0) - span_acceleration
        bias += cross(alpha, to_mass) + cross(omega, cross(omega, to_mass))
        spin = self._inertia_times(along, omega)
        bias_moment = self._inertia_times(along, alpha) + cross(omega, spin)

        # Index [link, joint, component]: velocity of a point of the link per unit joint rate.
        to_joint = self._before * cross(axis[None], joint[:, None] - joint[None])
        sweep = self._before * cross(axis[None], along[:, None])
        mass_jacobian = to_joint + self.mass_centre[:, None, None] * sweep
        centre_jacobian = to_joint + (self.length / 2)[:, None, None] * sweep
        turn_jacobian = self._before * axis[None]

        velocity = np.tensordot(rates, centre_jacobian, axes=(0, 1))
        relative = velocity if wind is None else velocity - wind
        speed = np.sqrt(np.einsum("ij,ij->i", relative, relative))
        drag = -(self.drag_factor * speed)[:, None] * relative

        weighted = self.mass[:, None, None] * mass_jacobian
        axial_turn = np.einsum("lja,la->lj", turn_jacobian, along)
        flat = _by_joint(mass_jacobian), _by_joint(weighted), _by_joint(turn_jacobian)
        matrix = flat[1] @ flat[0].T
        matrix += _by_joint(self.transverse[:, None, None] * turn_jacobian) @ flat[2].T
        matrix += axial_turn.T @ ((self.axial - self.transverse)[:, None] * axial_turn)

        force = flat[1] @ (self.gravity - bias).ravel() - flat[2] @ bias_moment.ravel()
        force += _by_joint(centre_jacobian) @ drag.ravel()
        force += self.stiffness * (command - angles) - self.damping * rates
        return solve(matrix, force, assume_a="pos", check_finite=False)

    def _inertia_times(self, along: Array, vector: Array) -> Array:
        projection = (self.axial - self.transverse) * np.einsum("ij,ij->i", along, vector)
        return self.transverse[:, None] * vector + projection[:, None] * along

    def trajectory(
        self,
        times: Array,
        *,
        initial: tuple[Array, Array] | None = None,
        method: str = "DOP853",
        rtol: float = 1e-10,
        atol: float = 1e-10,
    ) -> Array:
        """Return the angles and rates at the times, shape (sample, 2, joint), by `solve_ivp`."""
        assert self.command is not None
        n = self.count
        state = np.zeros(2 * n) if initial is None else np.concatenate(initial)
        times = np.asarray(times, dtype=float)
        found = np.empty((len(times), 2 * n))
        found[0] = state
        signals = (self.command,) if self.wind is None else (self.command, self.wind)
        for start, end, lines in pieces(times[0], times[-1], signals):
            command, wind = lines[0], lines[1] if len(lines) > 1 else None

            def motion(
                time: float, state: Array, command: Any = command, wind: Any = wind
            ) -> Array:
                angles, rates = state[:n], state[n:]
                air = None if wind is None else wind(time)
                return np.concatenate([rates, self.acceleration(angles, rates, command(time), air)])

            inside = (times > start) & (times <= end)
            wanted = np.unique(np.append(times[inside], end))
            solution = solve_ivp(
                motion, (start, end), state, method=method, t_eval=wanted, rtol=rtol, atol=atol
            )
            if not solution.success:
                raise RuntimeError(solution.message)
            found[inside] = solution.y.T[: inside.sum()]
            state = solution.y[:, -1]
        return found.reshape(-1, 2, n)


def _by_joint(jacobian: Array) -> Array:
    """Reshape an array from (link, joint, 3) to (joint, 3 link)."""
    return jacobian.transpose(1, 0, 2).reshape(jacobian.shape[1], -1)
