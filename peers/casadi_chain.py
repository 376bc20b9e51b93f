"""Independent implementation of the paper's arm in CasADi: a reference and a source of C code.

The equations of motion are Featherstone's articulated-body algorithm ("Rigid Body Dynamics
Algorithms", 2008, table 7.1), written in the frames of the links with 3 x 3 blocks about the
joints. In contrast, giajax sums spatial inertias in the base frame and factorises a mass matrix.
The numbers of the chain become constants of the CasADi expressions, and CasADi computes the
derivatives.
"""

from typing import Any

import casadi
import numpy as np
from scipy.spatial.transform import Rotation

from giajax.mechanics.arm import Arm
from peers.plain_arm import PARAMETERS, PlainArm

Array = np.ndarray
Blocks = tuple[Any, Any, Any]


def _sparse(numbers: Any) -> Any:
    """Return numbers as a sparse expression, in which zeros cause no computation."""
    return casadi.SX(casadi.sparsify(casadi.DM(numbers)))


def _skew(vector: Any) -> Any:
    return _sparse(casadi.skew(casadi.DM(vector)))


def _turn(axis: Array, angle: Any) -> Any:
    """Return the rotation about an axis, from the frame after the joint to the frame before it."""
    skew = _skew(axis)
    return casadi.SX.eye(3) + casadi.sin(angle) * skew + (1 - casadi.cos(angle)) * skew @ skew


def _mirrored(matrix: Any) -> Any:
    """Return a symmetric matrix built from its upper half, so no entry is computed twice."""
    return casadi.triu2symm(casadi.triu(matrix))


class CasadiChain:
    """Equations of motion of an `Arm` as CasADi expressions.

    Arguments:
        arm: arm whose numbers are used.

    Raises:
        ValueError: the arm has parts other than links, springs, dampers and drag at the centres.
    """

    def __init__(self, arm: Arm) -> None:
        self.plain = plain = PlainArm(arm)
        self.count = n = arm.count
        self.angles, self.rates, self.command = (casadi.SX.sym(name, n) for name in ("q", "v", "u"))
        self.parameters = casadi.SX.sym("p", len(PARAMETERS))
        self._base = Rotation.from_rotvec(plain.base_rotation).as_matrix()
        self._turns = [_turn(axis, self.angles[i]) for i, axis in enumerate(plain.axes)]
        self.accelerations = casadi.cse(self._accelerations())
        self.ends = casadi.cse(self._ends())
        inputs = [self.angles, self.rates, self.command, self.parameters]
        self._evaluate = casadi.Function("accelerations", inputs, [self.accelerations])

    def acceleration(self, angles: Array, rates: Array, command: Array) -> Array:
        """Return the joint accelerations, rad/s^2."""
        values = list(self.plain.parameters.values())
        return np.asarray(self._evaluate(angles, rates, command, values)).ravel()

    def _joint_offset(self, i: int) -> Array:
        return np.array([self.plain.length[i - 1] if i else 0.0, 0.0, 0.0])

    def _ends(self) -> Any:
        """Return the ends of the links, shape (3, link)."""
        place, frame, columns = casadi.SX(3, 1), casadi.SX(self._base), []
        for turn, length in zip(self._turns, self.plain.length, strict=True):
            frame = frame @ turn
            place = place + length * frame[:, 0]
            columns.append(place)
        return casadi.horzcat(*columns)

    def _torques(self) -> Any:
        """Return the torques of springs and dampers."""
        _, pitch, yaw, damping = casadi.vertsplit(self.parameters)
        stiffness = casadi.vertcat(*(yaw if is_yaw else pitch for is_yaw in self.plain.yaws))
        return stiffness * (self.command - self.angles) - damping * self.rates

    def _accelerations(self) -> Any:
        plain, torques = self.plain, self._torques()
        motions = self._outwards()
        matrix: Blocks = (casadi.SX(3, 3), casadi.SX(3, 3), casadi.SX(3, 3))
        bias = (casadi.SX(3, 1), casadi.SX(3, 1))
        halves: list[Any] = [None] * self.count
        for i in reversed(range(self.count)):
            axis = _sparse(plain.axes[i])
            coriolis, inertia, force = motions[i]
            rotary, mixed, mass = (x + y for x, y in zip(matrix, inertia, strict=True))
            moment, push = bias[0] + force[0], bias[1] + force[1]
            turned, moved = rotary @ axis, mixed.T @ axis
            size = casadi.dot(axis, turned)
            rest = torques[i] - casadi.dot(axis, moment)
            halves[i] = (turned, moved, size, rest)
            if i == 0:
                break
            # Articulated inertia and bias force that links i to the tip contribute to the link
            # before them.
            rotary = _mirrored(rotary - turned @ turned.T / size)
            mixed = mixed - turned @ moved.T / size
            mass = _mirrored(mass - moved @ moved.T / size)
            moment = moment + rotary @ coriolis[0] + mixed @ coriolis[1] + turned * (rest / size)
            push = push + mixed.T @ coriolis[0] + mass @ coriolis[1] + moved * (rest / size)
            matrix, bias = self._before(i, (rotary, mixed, mass), (moment, push))
        return self._inwards(motions, halves)

    def _outwards(self) -> list[Any]:
        """Return the Coriolis acceleration, inertia about its joint and bias force of each link."""
        plain, found = self.plain, []
        turning, velocity = casadi.SX(3, 1), casadi.SX(3, 1)
        for i, turn in enumerate(self._turns):
            axis = _sparse(plain.axes[i])
            offset = _sparse(self._joint_offset(i))
            velocity = turn.T @ (velocity + casadi.cross(turning, offset))
            turning = turn.T @ turning
            rate = axis * self.rates[i]
            coriolis = (casadi.cross(turning, rate), casadi.cross(velocity, rate))
            turning = turning + rate

            mass, centre = plain.mass[i], plain.centre[i]
            across = plain.transverse[i] + mass * centre**2
            inertia = (
                casadi.SX(casadi.diag(casadi.DM([plain.axial[i], across, across]))),
                mass * _skew([centre, 0.0, 0.0]),
                casadi.SX(mass * casadi.DM.eye(3)),
            )
            momentum = inertia[0] @ turning + inertia[1] @ velocity
            impulse = inertia[1].T @ turning + inertia[2] @ velocity
            middle = _sparse([plain.length[i] / 2, 0.0, 0.0])
            relative = velocity + casadi.cross(turning, middle)
            # The added constant makes the derivative at rest 0 instead of 0 / 0.
            speed = casadi.sqrt(casadi.sumsqr(relative) + 1e-24)
            drag = -(self.parameters[0] * plain.per_coefficient[i]) * speed * relative
            moment = casadi.cross(turning, momentum) + casadi.cross(velocity, impulse)
            force = (
                moment - casadi.cross(middle, drag),
                casadi.cross(turning, impulse) - drag,
            )
            found.append((coriolis, inertia, force))
        return found

    def _before(self, i: int, matrix: Blocks, bias: Any) -> tuple[Blocks, Any]:
        """Transform inertia and bias force to the frame of the previous link, about its joint."""
        turn, shift = self._turns[i], _skew(self._joint_offset(i))
        rotary, mixed, mass = (turn @ each @ turn.T for each in matrix)
        mass = _mirrored(mass)
        moved = mixed + shift @ mass
        rotary = _mirrored(rotary - mixed @ shift + shift @ moved.T)
        moment, push = (turn @ each for each in bias)
        return (rotary, moved, mass), (moment + shift @ push, push)

    def _inwards(self, motions: list[Any], halves: list[Any]) -> Any:
        """Return the joint accelerations, computed from the base to the tip.

        The acceleration of each joint follows from the acceleration of the previous link.
        """
        turned_by = casadi.SX(3, 1)
        # An upward acceleration of the base replaces gravity on every link.
        falls = _sparse(self._base.T @ [0, 0, self.plain.gravity])
        found = []
        for i, turn in enumerate(self._turns):
            (turned, moved, size, rest), (coriolis, _, _) = halves[i], motions[i]
            offset = _sparse(self._joint_offset(i))
            falls = turn.T @ (falls + casadi.cross(turned_by, offset)) + coriolis[1]
            turned_by = turn.T @ turned_by + coriolis[0]
            joint = (rest - casadi.dot(turned, turned_by) - casadi.dot(moved, falls)) / size
            turned_by = turned_by + casadi.DM(self.plain.axes[i]) * joint
            found.append(joint)
        return casadi.vertcat(*found)
