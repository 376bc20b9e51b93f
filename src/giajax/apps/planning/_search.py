"""Search for the fastest command, or the one of least residual swing, by exact derivatives.

The unknowns are the duration of the command and its values at equidistant knots, between which it
is linear. The values are deviations from the direct route: sums of the commands that hold the arm
in the shapes of the excited modes, and of the legs of the route. After the end of the command the
tip must stay near the target for one period of the slowest mode (three with hysteresis, because the
joints creep). This and the clearance are constraints on the simulated motion. The limits of angles
and rates are linear constraints. Sequential quadratic programming (Kraft 1988, SLSQP in scipy) gets
the gradient of each constraint by forward-mode differentiation. Penalised slack variables make
every initial guess feasible (Nocedal and Wright, Numerical Optimization, chapter 18.5). A search
for the shortest command ends early if it makes little progress.
"""

import copy
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from ...mechanics.arm import Arm, clearance
from ...runtime.arrays import Array, Float, Scalar, safe_norm
from ...runtime.parallel import Batch, run_on_all_cores, tangents_in_parts
from ...runtime.programs import program
from ...simulation import Signal
from .._moves import Command, Flight
from ._target import ROOM, CommandLimits, KeptLast, headroom, without_contact

DURING, AFTER = 40, 96  # Samples of the motion during the command, and after it.
_COEFFICIENT = 0.1  # Angle per unit of an unknown, rad.
GAP = 0.1  # Missing clearance per unit of its constraint, m.
SHARE = 0.01  # Missing headroom per unit of its constraint, as a share of the largest pressure.
_BLUNT = 0.005  # Smoothing length of the minimum of many distances, m.
_PLANNING = 1e-4  # Tolerance of the simulated motion.


class Task(NamedTuple):
    """Constants of a search.

    Attributes:
        base: commanded angles of the direct route at the knots, rad.
        moves: directions in which these angles are changed, rad.
        goal: target position of the tip, m.
        near: largest allowed distance of the tip from the goal after the command, m.
        period: period of the slowest mode, s.
        after: time after the command during which the tip must stay near the goal, s.
        clear: required clearance, m.
        pressure: largest pressure of a muscle, Pa.
    """

    arm: Arm
    base: Float[Array, "knot joint"]
    moves: Float[Array, "move joint"]
    goal: Float[Array, "3"]
    near: Scalar
    period: Scalar
    after: Scalar
    clear: Scalar
    pressure: Scalar


def _knots(task: Task, unknown: Array) -> Float[Array, "knot joint"]:
    """Return the commanded angles; the last knot is free if there are unknowns for it."""
    rows = unknown[1:].reshape(-1, len(task.moves)) * _COEFFICIENT
    ends = jnp.zeros_like(rows[:1])
    held = [rows, ends] if len(rows) < len(task.base) - 1 else [rows]
    return task.base + jnp.concatenate([ends, *held]) @ task.moves


def _signal(task: Task, unknown: Array) -> Signal:
    knots, duration = _knots(task, unknown), unknown[0] * task.period
    count = len(knots) - 1
    slopes = jnp.diff(knots, axis=0) / (duration / count)
    times = jnp.linspace(0.0, 1.0, count + 1, dtype=knots.dtype) * duration
    rough = jnp.full(count + 1, jnp.inf, knots.dtype)
    return Signal(times, knots, jnp.concatenate([slopes, jnp.zeros_like(slopes[:1])]), rough)


def _sampled(duration: Scalar, after: Scalar) -> Array:
    until = jnp.linspace(0.0, 1.0, DURING, endpoint=False, dtype=duration.dtype) * duration
    # Fast motions decay soon: sample more densely at the beginning.
    since = jnp.linspace(0.0, 1.0, AFTER, dtype=duration.dtype) ** 2 * after
    return jnp.concatenate([until, duration + since])


def _least(distances: Array) -> Array:
    """Return the smoothed minimum of each row.

    It is too small by at most `_BLUNT` times the logarithm of the number of columns.
    """
    flat = distances.reshape(len(distances), -1)
    return -_BLUNT * jax.nn.logsumexp(-flat / _BLUNT, axis=1)


def _kept(task: Task, unknown: Array) -> Array:
    """Return the margin of each constraint without slack: at least 0 if the constraint holds.

    The first margins are of the distance of the tip from the goal after the command, divided by
    `near`. The margins of clearance and of muscle pressure follow.
    """
    times = _sampled(unknown[0] * task.period, task.after)
    tolerance = jnp.asarray(_PLANNING, times.dtype)
    free = without_contact(task.arm)
    flight = Flight(free, _signal(task, unknown), times, tolerance)
    flown = flight.flown(1, steps_for="derivatives")
    off = jax.vmap(safe_norm)(flown.tips[DURING:] - task.goal[None])
    rows = [1 - off / task.near]
    if task.arm.contact is not None:
        gaps = jax.vmap(lambda angles: clearance(task.arm, angles))(flown.angles)
        rows.append((_least(gaps) - task.clear) / GAP)
    if task.arm.pneumatics is not None:
        knots = _knots(task, unknown)
        left = jax.vmap(lambda row: headroom(task.arm, row, task.pressure))(knots)
        rows.append(left.ravel() / SHARE)
    return jnp.concatenate(rows)


@program
def _values_and_slopes(
    tangents: Float[Array, "part tangent unknown"], task: Task, unknown: Array
) -> tuple[Array, Array]:
    """Return the constraints, and their derivatives along tangents of the unknowns.

    Each part simulates the motion once; the results have one row for each part.
    """

    def along(tangent: Array) -> tuple[Array, Array]:
        return jax.jvp(lambda unknown: _kept(task, unknown), (unknown,), (tangent,))

    return jax.lax.map(jax.vmap(along, out_axes=(None, 0)), tangents)


class PlanProblem:
    """Optimisation problem of a plan, for any optimiser with constraints.

    The unknowns are the duration divided by the slowest period, the coefficients of the knots, and
    two slack variables: one for the distance of the tip from the goal, in units of the allowed
    distance, and one for all other constraints. The objective is linear in the unknowns.

    Attributes:
        rate: largest rate of a joint, rad/s.
        start: initial guess of the unknowns.
        cost: coefficient of each unknown in the objective.
        low, high: bounds of the unknowns.
        linear, offset: `linear @ unknowns + offset` is at least 0 within the limits of angles and
            rates.
    """

    def __init__(
        self,
        task: Task,
        limits: CommandLimits,
        least: float,
        duration: float | None,
        free_end: bool,
    ) -> None:
        self.task, self.rate = task, limits.rate
        self._looked = KeptLast(self._look)
        self.knots, joints = task.base.shape
        moves = len(task.moves)
        self.rows = self.knots - 1 if free_end else self.knots - 2
        count = 1 + self.rows * moves + 2
        self.start = np.zeros(count)
        period = float(task.period)
        self.start[0] = (max(least, period) if duration is None else duration) / period
        self.low, self.high = np.full(count, -np.inf), np.full(count, np.inf)
        self.cost = np.zeros(count)
        self.cost[-2:] = 1.0, _HARD
        self.low[-2:] = 0.0
        if duration is None:
            self.cost[0], self.low[0] = 1.0, least / period
            self.high[0] = max(_LONGEST, 2 * self.low[0])
        else:
            self.low[0] = self.high[0] = self.start[0]
            self.low[-2] = -1.0
        self._linear(limits, joints, moves, period)
        self.start = self._with_slack(self.start)
        if not len(self.values(self.start)) > AFTER:
            self.high[-1] = 0.0

    def closer(self, share: float, y: np.ndarray) -> "PlanProblem":
        """Return the problem with a smaller allowed distance, started from the unknowns `y`.

        `share` multiplies the allowed distance.
        """
        new = copy.copy(self)
        new.task = self.task._replace(near=self.task.near * share)
        new._looked = KeptLast(new._look)
        new.start = new._with_slack(y)
        return new

    def _with_slack(self, start: np.ndarray) -> np.ndarray:
        """Return a feasible initial guess, with enough slack for all violated constraints."""
        start = np.concatenate([start[:-2], np.zeros(2)])
        missing = -np.minimum(self.values(start), 0)
        start[-2] = np.max(missing[:AFTER], initial=0.0)
        start[-1] = np.max(missing[AFTER:], initial=0.0)
        return start

    def _linear(self, limits: CommandLimits, joints: int, moves: int, period: float) -> None:
        """Set the constraints on angles at the knots and rates between them, for moving joints."""
        base, move = np.asarray(self.task.base), np.asarray(self.task.moves)
        used = np.flatnonzero(np.any(move != 0, axis=0) | (np.ptp(base, axis=0) > 0))
        count = len(self.start)
        values = np.zeros((self.knots, len(used), count))
        for row in range(self.rows):
            place = 1 + row * moves
            values[row + 1, :, place : place + moves] = _COEFFICIENT * move[:, used].T
        changes = np.diff(values, axis=0)
        away = np.diff(base[:, used], axis=0)
        # Each row is divided by its limit: the angle, or the change per interval in one slowest
        # period.
        step = limits.rate * period / (self.knots - 1)
        rows, offsets = [], []
        for sign in (-1, 1):
            rows.append(sign * values[1:].reshape(-1, count) / limits.angle)
            offsets.append((1 + sign * base[1:, used] / limits.angle).ravel())
            turned = sign * changes.reshape(-1, count) / step
            turned[:, 0] += 1
            rows.append(turned)
            offsets.append((sign * away / step).ravel())
        self.linear, self.offset = np.concatenate(rows), np.concatenate(offsets)

    def values(self, y: np.ndarray) -> np.ndarray:
        """Return the margins of the constraints on the motion, with slack."""
        kept = self._looked(y[:-2])[0].copy()
        kept[:AFTER] += y[-2]
        kept[AFTER:] += y[-1]
        return kept

    def kept(self, y: Array) -> Array:
        """Return the same margins in a form that JAX can trace and differentiate."""
        kept = _kept(self.task, y[:-2])
        return kept + jnp.where(jnp.arange(len(kept)) < AFTER, y[-2], y[-1])

    def slopes(self, y: np.ndarray) -> np.ndarray:
        """Return the derivatives of `values` by the unknowns."""
        by = self._looked(y[:-2])[1]
        slack = np.zeros((len(by), 2))
        slack[:AFTER, 0] = slack[AFTER:, 1] = 1
        return np.concatenate([by, slack], axis=1)

    def _look(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return margins and derivatives without slack."""
        unknowns = jnp.asarray(unknown, self.task.base.dtype)
        # Half of the derivatives for each of two cores. A single core uses the same halves, so that
        # the results do not depend on the number of cores.
        parts = 2 if jax.default_backend() == "cpu" else 1
        tangents, given = tangents_in_parts(len(unknown), parts), (self.task, unknowns)
        batch = Batch(_values_and_slopes, tangents, given, np.ones(parts), 1)
        (values, *_), slopes = run_on_all_cores([batch])[0]
        slopes = np.concatenate(slopes)[: len(unknown)].T
        values = np.nan_to_num(values, nan=-LOST, posinf=LOST, neginf=-LOST)
        return values, np.nan_to_num(slopes)

    def command(self, y: np.ndarray) -> Command:
        """Return the command that belongs to the unknowns."""
        knots = np.asarray(_knots(self.task, jnp.asarray(y[:-2], self.task.base.dtype)))
        # The rates satisfy their limit only to within the tolerance of SLSQP.
        steps = np.max(np.abs(np.diff(knots, axis=0)), initial=0.0) / self.rate
        duration = max(float(y[0] * self.task.period), float(steps * (self.knots - 1)))
        return Command(np.linspace(0.0, duration, self.knots), knots)

    def solved(
        self, most: int, progress: Callable[[str], None] | None = None
    ) -> tuple[np.ndarray, int]:
        """Return the best unknowns that SLSQP finds, and the number of its steps."""
        count = 0

        def step(y: np.ndarray) -> None:
            nonlocal count
            count += 1
            if progress is not None and count % _EVERY == 0:
                took = float(y[0] * self.task.period)
                left = (
                    ""
                    if y[-2] < SLACK
                    else f", {1 + y[-2]:.1f} times the allowed distance from the target"
                )
                progress(f"step {count}: {took:.1f} s{left}")

        start = best = self.start
        for attempt in range(_TRIES):
            found = self._searched(start, most - count, step)
            if attempt == 0 or self.cost @ found < self.cost @ best:
                best = found
            if self.low[0] == self.high[0] or self._suffices(found) or count >= most:
                break
            # A slower command is more likely to lead to a feasible one.
            start = start.copy()
            start[0] = min(2 * start[0], self.high[0])
            start = self._with_slack(start)
        return best, count

    def _suffices(self, y: np.ndarray) -> bool:
        """Return whether the slack is small: the command reaches the target and keeps clear."""
        return bool(y[-2] < SLACK and GAP * y[-1] < ROOM + NEARER)

    def _searched(
        self, start: np.ndarray, most: int, step: Callable[[np.ndarray], None]
    ) -> np.ndarray:
        free = self.low[0] < self.high[0]
        # The cost of the best command so far, and its unknowns, after each step.
        best: list[tuple[float, np.ndarray]] = []

        def reached(y: np.ndarray) -> None:
            step(y)
            # SLSQP calls this at the first trial point of a step, which may violate constraints.
            valid = (
                np.min(self.values(y)) > -_EXCESS and np.min(self.linear @ y + self.offset) > -1e-6
            )
            here = float(self.cost @ y) if valid and self._suffices(y) else math.inf
            best.append(min([*best[-1:], (here, np.array(y))], key=lambda each: each[0]))
            # Further points that violate constraints may still lead to a shorter command.
            if free and here < math.inf and len(best) > _WINDOW:
                (before, _), (now, shortest) = best[-1 - _WINDOW], best[-1]
                if before - now < _GAIN * now:
                    raise _LittleGainError(shortest)

        try:
            found = minimize(
                lambda y: (float(self.cost @ y), self.cost),
                start,
                jac=True,
                method="SLSQP",
                bounds=list(zip(self.low, self.high, strict=True)),
                constraints=[
                    {"type": "ineq", "fun": self.values, "jac": self.slopes},
                    {
                        "type": "ineq",
                        "fun": lambda y: self.linear @ y + self.offset,
                        "jac": lambda y: self.linear,
                    },
                ],
                callback=reached,
                options={"maxiter": most, "ftol": _ENOUGH},
            )
        except _LittleGainError as ended:
            return ended.y
        return np.asarray(found.x)


class _LittleGainError(Exception):
    """The last steps shortened the command little. Before SciPy 1.17, SLSQP has no other end."""

    def __init__(self, y: np.ndarray) -> None:
        super().__init__()
        self.y = y


_TRIES = 3  # Number of attempts, each from twice the duration of the one before.
_HARD = 10.0  # Cost of a unit of the second slack, in slowest periods.
_LONGEST = 6.0  # Longest command, in periods of the slowest mode.
LOST = 1e3  # Violation of a constraint by a motion that could not be simulated.
_ENOUGH = 3e-4  # Convergence tolerance of the cost.
# A search for the shortest command also ends if the last steps have shortened it by less than this
# fraction. The command may violate its margins by the excess. SLSQP may crawl for a hundred steps.
_WINDOW, _GAIN, _EXCESS = 10, 5e-3, 5e-3
_EVERY = 5  # Steps between two lines of progress.
SLACK = 0.05  # Slack of the distance that a feasible plan may have.
NEARER = 0.02  # Tolerated violation of the clearance, m.
