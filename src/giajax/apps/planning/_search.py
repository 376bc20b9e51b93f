"""The fastest or the calmest command, found by derivatives through the simulator.

Unknown are how long the command lasts and its values at equidistant knots, between which it is
straight: about the way there they are sums of the commands that hold the arm in shapes of the
modes that the move excites, and of the parts of the way. From its end on, and for one period of the
slowest mode (three where joints remember, and creep), the tip is to stay near the target. That, and
the clearance, are constraints by the simulated motion; angles and rates of the command are linear
ones. The sequential quadratic programme of Kraft (1988), SLSQP in scipy, has the slope of each by
forward differentiation. Slack that costs makes every start feasible (Nocedal and Wright, Numerical
Optimization, chapter 18.5).
"""

import copy
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from ...mechanics.arm import Arm, clearance
from ...runtime.arrays import Array, Float, Scalar, safe_norm
from ...runtime.programs import program
from ...simulation import Signal
from .._moves import Command, Flight
from ._target import ROOM, CommandLimits, headroom, kept_last, without_contact

DURING, AFTER = 40, 96  # samples of the motion while the command lasts, and after it
_COEFFICIENT = 0.1  # rad, for each unknown
GAP = 0.1  # m, of each unit of clearance that is missing
SHARE = 0.01  # of the largest pressure, of each unit of it that is missing
_BLUNT = 0.005  # m, over which the least of many distances is smoothed
_PLANNING = 1e-4  # tolerance of the motion


class Task(NamedTuple):
    """What is constant while a plan is looked for.

    Attributes:
        base: commanded angles at the knots, about which they are changed, rad.
        moves: by which, rad.
        goal: of the tip, m.
        near: how far from it the tip may be from the command's end on, m.
        period: of the slowest mode, s.
        after: how long after the command the tip is to be near, s.
        clear: clearance to keep, m.
        pressure: in muscles at most, Pa.
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
    """Commanded angles; the end is free where there are unknowns for it."""
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
    # What is quick dies away soon.
    since = jnp.linspace(0.0, 1.0, AFTER, dtype=duration.dtype) ** 2 * after
    return jnp.concatenate([until, duration + since])


def _least(distances: Array) -> Array:
    """The least of each row, smoothed: by at most so much too small as it has columns."""
    flat = distances.reshape(len(distances), -1)
    return -_BLUNT * jax.nn.logsumexp(-flat / _BLUNT, axis=1)


def _kept(task: Task, unknown: Array) -> Array:
    """How much is left of each constraint, without slack: at least 0 where it is kept.

    First how far from being near the tip is after the command, over `near`; then the clearance.
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
def _values(task: Task, unknown: Array) -> tuple[Array, Array]:
    """What is kept, and its slopes by the unknowns: one program for both."""

    def kept(unknown: Array) -> tuple[Array, Array]:
        values = _kept(task, unknown)
        return values, values

    slopes, values = jax.jacfwd(kept, has_aux=True)(unknown)
    return values, slopes


class PlanProblem:
    """A plan to look for, as any optimiser with constraints takes it.

    Unknowns are the duration over the slowest period, the coefficients of the knots, and two
    slacks: of being near, in units of that, and of all else. `cost` is linear in them.

    Attributes:
        start: unknowns to begin with.
        cost: of each unknown.
        low, high: bounds of the unknowns.
        linear, offset: `linear @ unknowns + offset` is at least 0 within angles and rates.
    """

    def __init__(
        self,
        task: Task,
        limits: CommandLimits,
        least: float,
        duration: float | None,
        free_end: bool,
    ) -> None:
        self.task = task
        self._looked = kept_last(self._look)
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
        """The problem of staying at this share of the distance, from unknowns on."""
        new = copy.copy(self)
        new.task = self.task._replace(near=self.task.near * share)
        new._looked = kept_last(new._look)
        new.start = new._with_slack(y)
        return new

    def _with_slack(self, start: np.ndarray) -> np.ndarray:
        """A start that nothing forbids: slack for whatever is not kept."""
        start = np.concatenate([start[:-2], np.zeros(2)])
        missing = -np.minimum(self.values(start), 0)
        start[-2] = np.max(missing[:AFTER], initial=0.0)
        start[-1] = np.max(missing[AFTER:], initial=0.0)
        return start

    def _linear(self, limits: CommandLimits, joints: int, moves: int, period: float) -> None:
        """Angles at the knots, and rates between them, of joints that are moved at all."""
        base, move = np.asarray(self.task.base), np.asarray(self.task.moves)
        used = np.flatnonzero(np.any(move != 0, axis=0) | (np.ptp(base, axis=0) > 0))
        count = len(self.start)
        values = np.zeros((self.knots, len(used), count))
        for row in range(self.rows):
            place = 1 + row * moves
            values[row + 1, :, place : place + moves] = _COEFFICIENT * move[:, used].T
        changes = np.diff(values, axis=0)
        away = np.diff(base[:, used], axis=0)
        # All are over the limit: of the angle, and of what the slowest period allows.
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
        """How much is left of each constraint by the motion, with slack."""
        kept = self._looked(y[:-2])[0].copy()
        kept[:AFTER] += y[-2]
        kept[AFTER:] += y[-1]
        return kept

    def kept(self, y: Array) -> Array:
        """The same as JAX traces and differentiates it."""
        kept = _kept(self.task, y[:-2])
        return kept + jnp.where(jnp.arange(len(kept)) < AFTER, y[-2], y[-1])

    def slopes(self, y: np.ndarray) -> np.ndarray:
        """Of the values, by the unknowns."""
        by = self._looked(y[:-2])[1]
        slack = np.zeros((len(by), 2))
        slack[:AFTER, 0] = slack[AFTER:, 1] = 1
        return np.concatenate([by, slack], axis=1)

    def _look(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes without slack."""
        unknowns = jnp.asarray(unknown, self.task.base.dtype)
        values, slopes = map(np.asarray, _values(self.task, unknowns))
        values = np.nan_to_num(values, nan=-LOST, posinf=LOST, neginf=-LOST)
        return values, np.nan_to_num(slopes)

    def command(self, y: np.ndarray) -> Command:
        """The command of unknowns."""
        knots = np.asarray(_knots(self.task, jnp.asarray(y[:-2], self.task.base.dtype)))
        duration = float(y[0] * self.task.period)
        return Command(np.linspace(0.0, duration, self.knots), knots)

    def solved(
        self, most: int, progress: Callable[[str], None] | None = None
    ) -> tuple[np.ndarray, int]:
        """The best unknowns that SLSQP finds, and in how many steps."""
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
            near, clear = found[-2] < SLACK, GAP * found[-1] < ROOM + NEARER
            if self.low[0] == self.high[0] or (near and clear) or count >= most:
                break
            # A slower one, from which it may find a way.
            start = start.copy()
            start[0] = min(2 * start[0], self.high[0])
            start = self._with_slack(start)
        return best, count

    def _searched(
        self, start: np.ndarray, most: int, step: Callable[[np.ndarray], None]
    ) -> np.ndarray:
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
            callback=step,
            options={"maxiter": most, "ftol": _ENOUGH},
        )
        return np.asarray(found.x)


_TRIES = 3  # from durations each of which is twice the one before
_HARD = 10.0  # a slowest period for each unit of what is not kept beside being near
_LONGEST = 6.0  # of a command, in periods of the slowest mode
LOST = 1e3  # of a constraint by a motion that could not be simulated
_ENOUGH = 3e-4  # of the cost
_EVERY = 5  # steps between two lines of progress
SLACK = 0.05  # of being near, that is left of a plan that keeps to everything
NEARER = 0.02  # m, than the clearance: what is overlooked
