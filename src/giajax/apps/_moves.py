"""Commands versus time, and the poses in which arms rest under them."""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..fitting import FitResult
from ..mechanics.arm import Arm, acceleration, mass_matrix, tip_position
from ..models import ArmModel
from ..runtime.arrays import Array, Bool, Float, Scalar
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema.parameters import declared, elements, replace
from ..simulation import Signal, constant, followed, simulate
from .design import draws, known_before

DIGITS = 9
"""Resolution of the times, s."""


@dataclasses.dataclass(frozen=True)
class Command:
    """Commanded angles versus time, linear between the rows or held.

    The arm initially rests under the first row.

    Attributes:
        times: times of the rows, increasing, s, shape (row,).
        angles: commanded angles, rad, shape (row, joint).
        held: whether each row is held until the next.
    """

    times: Float[np.ndarray, " row"]
    angles: Float[np.ndarray, "row joint"]
    held: bool = False

    def __post_init__(self) -> None:
        if self.times.ndim != 1 or self.angles.shape[:1] != self.times.shape or self.times[0] != 0:
            raise InputError(
                f"the times of a command have the shape {self.times.shape}, but its angles have "
                f"the shape {self.angles.shape}: give one row of angles for each time, and start "
                "at 0 s"
            )

    def at(self, times: np.ndarray) -> np.ndarray:
        """Return the angles at some times, rad; the first and last angles are held outside."""
        if self.held:
            rows = np.searchsorted(self.times, times + 10.0**-DIGITS, side="right") - 1
            return np.asarray(self.angles[np.maximum(rows, 0)])
        return np.stack([np.interp(times, self.times, row) for row in self.angles.T], axis=1)

    def shaped(self, impulses: tuple[np.ndarray, np.ndarray]) -> "Command":
        """Return the command convolved with impulses, given by their times (s) and sizes."""
        times = np.unique((self.times[:, None] + impulses[0]).ravel().round(DIGITS))
        parts = zip(*impulses, strict=True)
        return Command(times, sum(size * self.at(times - late) for late, size in parts), self.held)

    def signal(self, rows: int) -> Signal:
        """Return the command as a signal of the simulator, padded to a number of rows.

        Compiled programs depend on the number of rows.
        """
        slopes = np.zeros_like(self.angles)
        if not self.held:
            slopes[:-1] = np.diff(self.angles, axis=0) / np.diff(self.times)[:, None]
        more = rows - len(self.times)
        last = self.times[-1] + np.arange(1, more + 1)
        parts = (
            np.concatenate([self.times, last]),
            np.concatenate([self.angles, np.repeat(self.angles[-1:], more, axis=0)]),
            np.concatenate([slopes, np.zeros((more, self.angles.shape[1]))]),
            np.concatenate([np.full(len(self.times), np.inf), np.zeros(more)]),
        )
        return Signal(*(jnp.asarray(part, dtype=jnp.result_type(float)) for part in parts))


class Rest(NamedTuple):
    """Linearisation of an arm about a pose in which it rests.

    Attributes:
        angles: joint angles, rad.
        off: largest remaining Newton step of the angles, rad.
        by_angles, by_command: derivatives of the accelerations, 1/s^2.
        mass: mass matrix, kg m^2.
        tip: position of the tip, m.
        moves: derivative of the tip position with respect to the angles, m/rad.
    """

    angles: Float[Array, " joint"]
    off: Float[Array, ""]
    by_angles: Float[Array, "joint joint"]
    by_command: Float[Array, "joint joint"]
    mass: Float[Array, "joint joint"]
    tip: Float[Array, "3"]
    moves: Float[Array, "3 joint"]

    @property
    def known(self) -> bool:
        """Whether the pose was found."""
        return bool(np.all(np.isfinite(self.angles)) and self.off < CLOSE)

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the natural frequencies (rad/s) and the mass-normalised mode shapes, as columns.

        Raises:
            InputError: the arm is not stable there.
        """
        stiffness = -np.asarray(self.mass @ self.by_angles)
        root = np.linalg.cholesky(np.asarray(self.mass))
        half = np.linalg.solve(root, (stiffness + stiffness.T) / 2)
        squares, turned = np.linalg.eigh(np.linalg.solve(root, half.T))
        if squares[0] <= 0:
            raise InputError(
                "the pose at the end of the command is unstable: choose another final pose, or "
                "correct the stiffness and gravity of the arm"
            )
        return np.sqrt(squares), np.linalg.solve(root.T, turned)


_NEWTON = 20
CLOSE = 1e-6  # Largest Newton step of the angles of a rest pose that counts as found, rad.


def _pulled(arm: Arm, angles: Array, command: Array) -> Array:
    """Return the accelerations of a motionless arm whose drives have reached the command."""
    pressures = None if arm.pneumatics is None else arm.pneumatics.commanded(command)
    return acceleration(arm, angles, jnp.zeros_like(angles), command, pressures=pressures)


@eqx.filter_jit  # A motion needs two poses, and the function is then traced once.
def resting(arm: Arm, command: Array) -> tuple[Array, Array]:
    """Return the angles at which an arm rests (rad), and the size of the last Newton step.

    The angles can be differentiated in forward mode; the derivative of the step is zero.
    """
    return _resting(arm, command)


@eqx.filter_custom_jvp
def _resting(arm: Arm, command: Array) -> tuple[Array, Array]:
    def better(_: Any, carried: tuple[Array, Array]) -> tuple[Array, Array]:
        angles, _ = carried
        slope = jax.jacfwd(lambda q: _pulled(arm, q, command))(angles)
        step = jnp.linalg.solve(slope, _pulled(arm, angles, command))
        return angles - step, jnp.max(jnp.abs(step))

    begun = (command, jnp.asarray(jnp.inf, command.dtype))
    return jax.lax.fori_loop(0, _NEWTON, better, begun)


@_resting.def_jvp
def _resting_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, Any]:
    """Differentiate by the implicit function theorem instead of through the iterations.

    Tracing the derivative of the loop takes several times as long as tracing the simulation.
    """
    arm, command = primals
    angles, off = _resting(arm, command)
    slope = jax.jacfwd(lambda q: _pulled(arm, q, command))(angles)
    _, pulled = eqx.filter_jvp(
        lambda arm, command: _pulled(arm, angles, command), primals, tangents
    )
    return (angles, off), (-jnp.linalg.solve(slope, pulled), jnp.zeros_like(off))


@program
def rest_at(arm: Arm, commanded: Array) -> Rest:
    command = reached(arm, commanded)
    angles, off = resting(arm, command)
    by_angles, by_command = jax.jacfwd(
        lambda q, u: _pulled(arm, q, reached(arm, u)), argnums=(0, 1)
    )(angles, commanded)
    moves = jax.jacfwd(lambda q: tip_position(arm, q))(angles)
    tip = tip_position(arm, angles)
    return Rest(angles, off, by_angles, by_command, mass_matrix(arm, angles), tip, moves)


def found_rest(
    arm: Arm, commanded: np.ndarray, where: str = "for the final pose of the command"
) -> Rest:
    """Return the linearised arm at rest under commanded angles (rad), as NumPy arrays.

    Raises:
        InputError: no rest pose is found.
    """
    rest = rest_at(arm, jnp.asarray(commanded, jnp.result_type(float)))
    if not rest.known:
        raise InputError(f"no equilibrium of the arm was found {where}: choose other angles")
    parts: Any = map(np.asarray, rest)
    return Rest(*parts)


def reached(arm: Arm, commanded: Array) -> Array:
    """Return the angles that the drives reach in the end under a constant command, rad."""
    return followed(constant(commanded), arm.joints)(jnp.zeros((), commanded.dtype))


class Flown(NamedTuple):
    """Motion of an arm under a command.

    Attributes:
        angles: joint angles, rad.
        tips: positions of the tip, m.
        rest: final rest position of the tip, m.
        successful: whether the motion could be simulated.
    """

    angles: Float[Array, "sample joint"]
    tips: Float[Array, "sample 3"]
    rest: Float[Array, "3"]
    successful: Bool[Array, ""]


class Flight(NamedTuple):
    """An arm that is initially at rest and then follows a command in still air.

    Attributes:
        times: sample times, s.
        tolerance: tolerance of the simulated motion.
    """

    arm: Arm
    command: Signal
    times: Float[Array, " sample"]
    tolerance: Scalar

    def flown(self, last: int, **how: Any) -> Flown:
        """Simulate the motion.

        With hysteresis the rest position is the mean of the last `last` positions of the tip.
        """
        arm, command = self.arm, self.command
        begun = resting(arm, followed(command, arm.joints)(self.times[0]))[0]
        exact: Any = {"rtol": self.tolerance, "atol": self.tolerance, "throw": False}
        exact |= {"initial": (begun, jnp.zeros_like(begun))}
        motion = simulate(arm, command, self.times, **exact, **how)
        tips = jax.vmap(functools.partial(tip_position, arm))(motion.angles)
        angles, off = resting(arm, followed(command, arm.joints)(self.times[-1]))
        # With hysteresis the equilibrium is not known in advance: the arm finally swings about the
        # mean.
        known = (off < CLOSE) & (arm.further_laws.rows == 0)
        rest = jnp.where(known, tip_position(arm, angles), jnp.mean(tips[-last:], axis=0))
        return Flown(motion.angles, tips, rest, motion.successful)


UNTIL, SETTLING = 150, 360
"""Numbers of samples of a motion during and after its command."""


def settling_times(end: float, longer: float) -> Float[np.ndarray, " sample"]:
    """Return sample times until the end of a command (s), and for a duration (s) after it."""
    until = np.linspace(0.0, end, UNTIL, endpoint=False)
    return np.concatenate([until, end + np.linspace(0.0, longer, SETTLING)])


def settled_at(times: np.ndarray, distance: np.ndarray, near: float) -> float | None:
    """Return the time from which the tip stays near its rest (m), s; None if there is none."""
    far = np.flatnonzero(distance > near)
    if not far.size:
        return 0.0
    return None if far[-1] == len(times) - 1 else float(times[far[-1] + 1])


WRONG = 0.25
"""Assumed relative error of a stiffness."""

_STIFFNESSES = ("joints.pitch_stiffness", "joints.yaw_stiffness")


def softer(model: ArmModel, factor: float) -> ArmModel:
    """Return the model with the stiffness of all springs multiplied by a factor."""
    values = {path: getattr(model.arm.joints, path.partition(".")[2]) for path in _STIFFNESSES}
    return replace(model, {path: value * factor for path, value in values.items()})


def arms_left_open(model: ArmModel, result: FitResult | None, count: int) -> list[Arm]:
    """Return arms with draws of the uncertain parameters of a fit; none without a fit."""
    if result is None:
        return []
    of_arm = declared(model.arm)
    shared = [path for path in result.free if path.partition("[")[0] in of_arm]
    parts = [part for path in shared for part in elements(model, path)]
    if not parts or count < 1:
        return []
    values = np.asarray([float(part.value(model)) for part in parts])
    errors, correlation = known_before(result, [part.path for part in parts])
    found = draws(parts, values, errors, correlation, count + 1)[1:]
    paths = [part.path for part in parts]
    return [replace(model, dict(zip(paths, row, strict=True))).arm for row in found]
