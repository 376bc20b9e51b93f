"""The fastest or the calmest command, found by derivatives through the simulator.

Unknown are how long the command lasts and its values at equidistant knots, between which it is
straight: about the way there they are sums of the commands that hold the arm in shapes of the
modes that the move excites, and of the parts of the way. From its end on, and for one period of the
slowest mode, the tip is to stay near the target. That, and the clearance, are constraints by the
simulated motion; angles and rates of the command are linear ones. The sequential quadratic
programme of Kraft (1988), SLSQP in scipy, has the slope of each by forward differentiation. Slack
that costs makes every start feasible (Nocedal and Wright, Numerical Optimization, chapter 18.5).
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from ...fitting import FitResult, arm_model_of
from ...mechanics.arm import Arm, clearance
from ...models import AbstractModel, ArmModel
from ...runtime.arrays import Array, Float, Scalar, safe_norm
from ...runtime.parallel import Batch, run_on_all_cores
from ...runtime.programs import program
from ...runtime.text import InputError
from ...simulation import Signal
from .._moves import (
    SETTLING,
    UNTIL,
    WRONG,
    Command,
    Flight,
    arms_left_open,
    found_rest,
    rest_tips,
    settled_at,
    settling_times,
    softer,
)
from ._target import ROOM, AbstractTarget, CommandLimits, headroom, without_contact

KNOTS = 10
"""Intervals of a planned command by default."""

_MODES = 3  # that are commanded by themselves
_DURING, _AFTER = 40, 48  # samples of the motion while the command lasts, and after it
_COEFFICIENT = 0.1  # rad, for each unknown
_GAP = 0.1  # m, of each unit of clearance that is missing
_SHARE = 0.01  # of the largest pressure, of each unit of it that is missing
_BLUNT = 0.005  # m, over which the least of many distances is smoothed
_PLANNING, _FINAL = 1e-4, 1e-5  # tolerances of the motion


class _Task(NamedTuple):
    """What is constant while a plan is looked for.

    Attributes:
        base: commanded angles at the knots, about which they are changed, rad.
        moves: by which, rad.
        goal: of the tip, m.
        near: how far from it the tip may be from the command's end on, m.
        period: of the slowest mode, s.
        clear: clearance to keep, m.
        pressure: in muscles at most, Pa.
    """

    arm: Arm
    base: Float[Array, "knot joint"]
    moves: Float[Array, "move joint"]
    goal: Float[Array, "3"]
    near: Scalar
    period: Scalar
    clear: Scalar
    pressure: Scalar


def _knots(task: _Task, unknown: Array) -> Float[Array, "knot joint"]:
    """Commanded angles; the end is free where there are unknowns for it."""
    rows = unknown[1:].reshape(-1, len(task.moves)) * _COEFFICIENT
    ends = jnp.zeros_like(rows[:1])
    held = [rows, ends] if len(rows) < len(task.base) - 1 else [rows]
    return task.base + jnp.concatenate([ends, *held]) @ task.moves


def _signal(task: _Task, unknown: Array) -> Signal:
    knots, duration = _knots(task, unknown), unknown[0] * task.period
    count = len(knots) - 1
    slopes = jnp.diff(knots, axis=0) / (duration / count)
    times = jnp.linspace(0.0, 1.0, count + 1, dtype=knots.dtype) * duration
    rough = jnp.full(count + 1, jnp.inf, knots.dtype)
    return Signal(times, knots, jnp.concatenate([slopes, jnp.zeros_like(slopes[:1])]), rough)


def _sampled(duration: Scalar, after: Scalar) -> Array:
    until = jnp.linspace(0.0, 1.0, _DURING, endpoint=False, dtype=duration.dtype) * duration
    # What is quick dies away soon.
    since = jnp.linspace(0.0, 1.0, _AFTER, dtype=duration.dtype) ** 2 * after
    return jnp.concatenate([until, duration + since])


def _least(distances: Array) -> Array:
    """The least of each row, smoothed: by at most so much too small as it has columns."""
    flat = distances.reshape(len(distances), -1)
    return -_BLUNT * jax.nn.logsumexp(-flat / _BLUNT, axis=1)


def _kept(task: _Task, unknown: Array) -> Array:
    """How much is left of each constraint, without slack: at least 0 where it is kept.

    First how far from being near the tip is after the command, over `near`; then the clearance.
    """
    times = _sampled(unknown[0] * task.period, task.period)
    tolerance = jnp.asarray(_PLANNING, times.dtype)
    free = without_contact(task.arm)
    flight = Flight(free, _signal(task, unknown), times, tolerance)
    flown = flight.flown(1, steps_for="derivatives")
    off = jax.vmap(safe_norm)(flown.tips[_DURING:] - task.goal[None])
    rows = [1 - off / task.near]
    if task.arm.contact is not None:
        gaps = jax.vmap(lambda angles: clearance(task.arm, angles))(flown.angles)
        rows.append((_least(gaps) - task.clear) / _GAP)
    if task.arm.pneumatics is not None:
        knots = _knots(task, unknown)
        left = jax.vmap(lambda row: headroom(task.arm, row, task.pressure))(knots)
        rows.append(left.ravel() / _SHARE)
    return jnp.concatenate(rows)


@program
def _values(task: _Task, unknown: Array) -> tuple[Array, Array]:
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
        task: _Task,
        limits: CommandLimits,
        least: float,
        duration: float | None,
        free_end: bool,
    ) -> None:
        self.task = task
        self._last: tuple[bytes, Any] = (b"", None)
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
        if not len(self.values(self.start)) > _AFTER:
            self.high[-1] = 0.0

    def _with_slack(self, start: np.ndarray) -> np.ndarray:
        """A start that nothing forbids: slack for whatever is not kept."""
        start = np.concatenate([start[:-2], np.zeros(2)])
        missing = -np.minimum(self.values(start), 0)
        start[-2] = np.max(missing[:_AFTER], initial=0.0)
        start[-1] = np.max(missing[_AFTER:], initial=0.0)
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
        kept = self._looked(y)[0].copy()
        kept[:_AFTER] += y[-2]
        kept[_AFTER:] += y[-1]
        return kept

    def slopes(self, y: np.ndarray) -> np.ndarray:
        """Of the values, by the unknowns."""
        by = self._looked(y)[1]
        slack = np.zeros((len(by), 2))
        slack[:_AFTER, 0] = slack[_AFTER:, 1] = 1
        return np.concatenate([by, slack], axis=1)

    def _looked(self, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values and slopes without slack; the last are kept, as an optimiser needs both."""
        key = y[:-2].tobytes()
        if key != self._last[0]:
            values, slopes = map(np.asarray, _values(self.task, self._unknowns(y)))
            values = np.nan_to_num(values, nan=-_LOST, posinf=_LOST, neginf=-_LOST)
            self._last = key, (values, np.nan_to_num(slopes))
        return self._last[1]

    def _unknowns(self, y: np.ndarray) -> Array:
        return jnp.asarray(y[:-2], self.task.base.dtype)

    def command(self, y: np.ndarray) -> Command:
        """The command of unknowns."""
        knots = np.asarray(_knots(self.task, self._unknowns(y)))
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
                left = "" if y[-2] < _SLACK else f", {1 + y[-2]:.1f} times as far off as it may be"
                progress(f"step {count}: {took:.1f} s{left}")

        start = best = self.start
        for attempt in range(_TRIES):
            found = self._searched(start, most - count, step)
            if attempt == 0 or self.cost @ found < self.cost @ best:
                best = found
            near, clear = found[-2] < _SLACK, _GAP * found[-1] < ROOM + _OFF
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
_LOST = 1e3  # of a constraint by a motion that could not be simulated
_ENOUGH = 3e-4  # of the cost
_EVERY = 5  # steps between two lines of progress
_SLACK = 0.02  # that is left of a plan that keeps to everything


@dataclasses.dataclass(frozen=True)
class Planned:
    """A command, and what arms do by it.

    Attributes:
        name: "direct": the way there at the largest rate; "planned".
        command: angles over time.
        settled: when the tip has come to stay near where it comes to rest, s; None where that is
            not within three slowest periods after the command.
        residual: largest distance of the tip from where it comes to rest, after the command, m.
        missed: largest distance of the tip from the target, after the command, m.
        soft, stiff: residual with a stiffness a quarter lower and higher, m.
        drawn: residual with each draw of what the fit leaves open, m; empty without one.
        clearance: the least of any link, m; None where nothing stands around.
        closest: the same of the soft, the stiff and the drawn arms, m.
        times: s, shape (sample,).
        tips: of the tip, m, shape (sample, 3).
        angles: of the joints, rad, shape (sample, joint).
        drawn_tips: with each draw, m, shape (draw, sample, 3).
    """

    name: str
    command: Command
    settled: float | None
    residual: float
    missed: float
    soft: float
    stiff: float
    drawn: Float[np.ndarray, " draw"]
    clearance: float | None
    closest: float | None
    times: Float[np.ndarray, " sample"]
    tips: Float[np.ndarray, "sample 3"]
    angles: Float[np.ndarray, "sample joint"]
    drawn_tips: Float[np.ndarray, "draw sample 3"]


@dataclasses.dataclass(frozen=True)
class Plan:
    """What was planned; made by `plan_command`.

    Attributes:
        direct: the way there at the largest rate.
        planned: the command that was found.
        goal: of the tip, m.
        travel: distance of the tip from the goal in the beginning, m.
        within: share of the travel that is near the goal.
        period: of the slowest mode where it ends, s.
        limits: that were kept to.
        steps: of the search.
        model: of the arm.
        problem: that was solved.
        notes: sentences on what a reader should know.
    """

    direct: Planned
    planned: Planned
    goal: Float[np.ndarray, "3"]
    travel: float
    within: float
    period: float
    limits: CommandLimits
    steps: int
    model: ArmModel
    problem: PlanProblem
    notes: tuple[str, ...] = ()


def plan_command(
    model: AbstractModel | FitResult,
    target: AbstractTarget,
    *,
    begin: Sequence[float] | np.ndarray | None = None,
    limits: CommandLimits | None = None,
    duration: float | None = None,
    within: float = 0.02,
    knots: int = KNOTS,
    most_steps: int = 150,
    draw_count: int = 20,
    progress: Callable[[str], None] | None = None,
) -> Plan:
    """Plan a command that brings an arm to a target, where it then rests, in still air.

    Without a duration it is as short as the limits allow; with one, what is left of the swing is as
    little as can be. The arm rests when it begins. It is a local optimum, from the way there in a
    straight line, in at least one slowest period.

    Arguments:
        model: the arm, or a fit of it, whose uncertainty is then drawn from.
        target: `Pose`, `Tip` or `Through`.
        begin: commanded angles at which the arm rests in the beginning, rad; straight by default.
        limits: of the command, and how clear links keep.
        duration: of the command, s.
        within: share of the tip's travel; within that distance the tip counts as at rest.
        knots: intervals of the command.
        most_steps: of the search.
        draw_count: how many draws of what the fit leaves open.
        progress: called with a line now and then.

    Raises:
        InputError: a target out of reach, a beginning beyond the limits or too near an obstacle,
            or no command that keeps to the limits.

    Example:
        >>> import giajax, numpy as np
        >>> from giajax.apps.planning import Pose, plan_command
        >>> model = giajax.ArmModel(giajax.takeichi_20m_full(3))
        >>> found = plan_command(model, Pose(np.deg2rad([20.0, 0.0, 0.0])))
        >>> found.planned.missed < found.direct.missed
        True
    """
    stated, limits = arm_model_of(model), limits or CommandLimits()
    arm = stated.arm
    if limits.pressure is not None and arm.pneumatics is None:
        raise InputError("the arm has no muscles whose pressure is limited: leave the limit out")
    if duration is not None and not duration > 0:
        raise InputError(f"the command is to last {duration:g} s: give a positive number")
    if not 0 < within < 1:
        raise InputError(f"within is {within:g} of the travel: give a share between 0 and 1")
    if knots < 2:
        raise InputError(f"a command of {knots} intervals cannot brake: give at least 2")
    first = np.zeros(arm.count) if begin is None else np.asarray(begin, dtype=float)
    if first.shape != (arm.count,):
        raise InputError(
            f"the beginning has {first.size} angles, and the arm has {arm.count} joints"
        )
    ways = target.commands(arm, first, limits)
    route = np.concatenate([first[None], ways])
    if (worst := float(np.max(np.abs(route)))) > limits.angle * (1 + 1e-9):
        raise InputError(
            f"a joint is commanded to {np.rad2deg(worst):.3g} deg in the beginning or the end, and "
            f"{np.rad2deg(limits.angle):.3g} deg are allowed: allow more, or choose another pose"
        )
    free = without_contact(arm)
    tips = np.asarray(rest_tips(free, jnp.asarray(route, jnp.result_type(float))))
    travel = float(np.linalg.norm(tips[-1] - tips[0]))
    if not travel > 1e-6:
        raise InputError("the tip is where it is to go already: choose another target")
    problem = _problem(arm, route, tips[-1], within * travel, limits, duration, knots)
    if progress is not None:
        progress("looking for a command ...")
    y, steps = problem.solved(most_steps, progress)
    notes = _checked(problem, y, duration)
    last = problem.command(y)
    direct = _direct(route, limits.rate)
    wrong = [softer(stated, 1 - WRONG).arm, softer(stated, 1 + WRONG).arm]
    result = model if isinstance(model, FitResult) else None
    drawn = arms_left_open(stated, result, draw_count)
    arms = [arm, *wrong, *drawn]
    period = float(problem.task.period)
    if progress is not None:
        progress(f"looking at {len(arms)} arms ...")
    count = max(len(direct.times), len(last.times))
    how: Any = {"goal": tips[-1], "near": within * travel, "period": period, "rows": count}
    rows = [
        _looked(name, command, arms, **how)
        for name, command in (("direct", direct), ("planned", last))
    ]
    if lost := len(drawn) - min(len(row.drawn) for row in rows):
        notes.append(f"the motion could not be simulated with {lost} of {len(drawn)} draws")
    if steps >= most_steps:
        notes.append(f"the search was ended after {steps} steps: more may find a better command")
    notes += _doubts(rows[1], limits, within * travel)
    if result is not None and result.verdict.status == "inadequate":
        notes.append("the model of the fit is not adequate: the arm may move in another way")
    kept = (rows[0], rows[1], tips[-1], travel, within, period, limits, steps, stated)
    return Plan(*kept, problem, tuple(notes))


_OFF = 0.02  # m, of a clearance
_PRESSED = 1e-3  # of the largest pressure


def _doubts(row: Planned, limits: CommandLimits, near: float) -> list[str]:
    """Notes on what arms do by the planned command (`InputError`: a link meets something)."""
    notes = []
    if row.missed > near:
        notes.append(
            f"within three slowest periods after the command the tip is up to {row.missed:.2g} m "
            f"from the target, and {near:.2g} m are allowed: joints that remember may creep on"
        )
    if row.clearance is None or row.closest is None:
        return notes
    if row.clearance < 0:
        raise InputError(
            "between the times that are looked at while planning a link meets what stands around: "
            "plan with more clearance"
        )
    for gap, whose in ((row.clearance, ""), (row.closest, " of an arm that may be the true one")):
        if gap < limits.clearance:
            notes.append(f"a link{whose} comes as near as {gap:.2g} m: plan with more clearance")
            break
    return notes


def _problem(
    arm: Arm,
    route: np.ndarray,
    goal: np.ndarray,
    near: float,
    limits: CommandLimits,
    duration: float | None,
    knots: int,
) -> PlanProblem:
    dtype = jnp.result_type(float)
    rest = found_rest(without_contact(arm), route[-1])
    frequencies, shapes = rest.modes()
    legs = np.diff(route, axis=0)
    by_angles, by_command = np.asarray(rest.by_angles), np.asarray(rest.by_command)
    gain = shapes.T @ rest.mass @ np.linalg.solve(by_angles, by_command @ legs.T)
    reach = np.linalg.norm(rest.moves @ shapes, axis=0)
    excited = np.argsort(-np.max(np.abs(gain), axis=1) * reach)[:_MODES]
    # What holds the arm in the shape of a mode.
    holding = -np.linalg.lstsq(by_command, by_angles @ shapes[:, excited], rcond=None)[0].T
    moves = np.concatenate([holding, legs])
    moves = moves / np.max(np.abs(moves), axis=1, keepdims=True)
    moves[np.abs(moves) < 1e-9] = 0
    direct = _direct(route, limits.rate)
    least = float(direct.times[-1])
    if duration is not None and duration < least:
        raise InputError(
            f"within {np.rad2deg(limits.rate):g} deg/s the way there takes {least:.1f} s, and the "
            f"command is to last {duration:g} s: give it longer, or allow a larger rate"
        )
    base = direct.at(np.linspace(0.0, least, knots + 1))
    period, pressure = 2 * np.pi / frequencies[0], limits.pressure or np.inf
    numbers = (goal, _INSIDE * near, period, limits.clearance + ROOM, pressure)
    rows: Any = [jnp.asarray(each, dtype) for each in (base, moves, *numbers)]
    task = _Task(arm, *rows)
    # What remembers is held elsewhere than by the command of its pose alone.
    free_end = arm.further_laws.rows > 0
    return PlanProblem(task, limits, _MARGIN * least, duration, free_end)


_MARGIN = 1 + 1e-6  # of rounding
_INSIDE = 0.95  # of being near, as the motion is looked at now and then


def _direct(route: np.ndarray, rate: float) -> Command:
    """Along a route at the largest rate (rad/s) of the joint that turns most."""
    spans = np.max(np.abs(np.diff(route, axis=0)), axis=1) / rate
    kept = np.concatenate([[True], spans > 0])
    return Command(np.concatenate([[0.0], np.cumsum(spans)])[kept], route[kept])


def _checked(problem: PlanProblem, y: np.ndarray, duration: float | None) -> list[str]:
    """Notes on a solution (`InputError`: it does not keep to the limits)."""
    kept = problem.values(np.concatenate([y[:-2], np.zeros(2)]))
    if np.min(kept) <= -_LOST / 2:
        raise InputError(
            "the motion of the arm cannot be simulated on the way there: choose a nearer target, "
            "or a lower rate"
        )
    clear = 0 if problem.task.arm.contact is None else _DURING + _AFTER
    missing = -_GAP * float(np.min(kept[_AFTER : _AFTER + clear], initial=0.0)) - ROOM
    pressed = -_SHARE * float(np.min(kept[_AFTER + clear :], initial=0.0))
    if missing > _OFF or pressed > _PRESSED:
        what = f"a link comes {missing:.2g} m nearer to what stands around it than it may"
        if pressed > _PRESSED:
            what = f"a muscle needs {1 + pressed:.2f} times the largest pressure"
        raise InputError(
            f"no command is found that keeps to the limits ({what}): allow more, or go there in "
            "two moves"
        )
    off = float(1 - np.min(kept[:_AFTER]))
    if off <= 1 + _SLACK:
        return []
    if duration is None:
        muscles = problem.task.arm.pneumatics is not None
        held = "; muscles may hold a joint at several angles, near 0 above all" if muscles else ""
        raise InputError(
            f"no command within the limits is found after which the tip stays near the target (at "
            f"best {off:.2g} times as far as it may be{held}): allow larger angles or rates, or "
            "more knots"
        )
    return [
        f"the tip is {off:.2g} times as far from the target as it may be after {duration:g} s: "
        "give it longer"
    ]


@program
def _flights(cases: Flight, around: Arm) -> tuple[Array, ...]:
    """Angles, tips, rests, whether they were simulated, and the least clearance of each."""

    def one(flight: Flight) -> tuple[Array, ...]:
        flown = flight.flown(SETTLING // 3)
        gap = jnp.full((), jnp.inf, flown.tips.dtype)
        if around.contact is not None:
            gap = jnp.min(jax.lax.map(lambda q: jnp.min(clearance(around, q)), flown.angles))
        return (*flown, gap)

    return jax.lax.map(one, cases)


def _looked(
    name: str,
    command: Command,
    arms: Sequence[Arm],
    *,
    goal: np.ndarray,
    near: float,
    period: float,
    rows: int,
) -> Planned:
    """What arms do by a command (of so many rows): as it is, soft, stiff, and the drawn ones."""
    times = settling_times(float(command.times[-1]), 3 * period)
    signal, stamps = command.signal(rows), jnp.asarray(times)
    cases = [Flight(without_contact(each), signal, stamps, jnp.asarray(_FINAL)) for each in arms]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *cases)
    batch = Batch(_flights, stacked, (arms[0],), np.ones(len(cases)), 1)
    angles, tips, rests, successful, gaps = map(np.asarray, run_on_all_cores([batch])[0])
    if not successful[0]:
        raise InputError(
            "the motion of the arm cannot be simulated by the command: choose a nearer target"
        )
    from_rest = np.linalg.norm(tips - rests[:, None], axis=2)
    left = np.where(successful, np.max(from_rest[:, UNTIL:], axis=1), np.inf)
    sound = np.flatnonzero(successful)
    sound = sound[sound >= 3]
    return Planned(
        name=name,
        command=command,
        settled=settled_at(times, from_rest[0], near),
        residual=float(left[0]),
        missed=float(np.max(np.linalg.norm(tips[0, UNTIL:] - goal, axis=1))),
        soft=float(left[1]),
        stiff=float(left[2]),
        drawn=left[sound],
        clearance=None if arms[0].contact is None else float(gaps[0]),
        closest=None if arms[0].contact is None else float(np.min(gaps)),
        times=times,
        tips=tips[0],
        angles=angles[0],
        drawn_tips=tips[sound],
    )
