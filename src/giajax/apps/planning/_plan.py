"""Planning of a command: the problem, its solution, and the resulting motion of the arm."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...fitting import FitResult, arm_model_of
from ...mechanics.arm import Arm, clearance
from ...mechanics.obstacles import owners
from ...models import AbstractModel, ArmModel
from ...runtime.arrays import Array, Float
from ...runtime.parallel import Batch, run_on_all_cores, stacked_items
from ...runtime.programs import program
from ...runtime.text import InputError
from .._moves import (
    SETTLING,
    UNTIL,
    WRONG,
    Command,
    Flight,
    Rest,
    arms_left_open,
    found_rest,
    settled_at,
    settling_times,
    softer,
)
from ._search import AFTER, DURING, GAP, LOST, NEARER, SHARE, SLACK, PlanProblem, Task
from ._target import ROOM, AbstractTarget, CommandLimits, without_contact

KNOTS = 10
"""Default number of intervals of a planned command."""

_MODES = 3  # Number of modes that get a command of their own.
_LATER = 3  # Duration after the command that is evaluated, in slowest periods.
_FINAL = 1e-5  # Tolerance of the simulated motion.


@dataclasses.dataclass(frozen=True)
class Planned:
    """A command, and the motion of arms under it.

    Attributes:
        name: "direct" for the direct motion at the largest rate, or "planned".
        command: commanded angles versus time.
        settled: time from which the tip stays near its rest position, s; None if that is not within
            three slowest periods after the command.
        residual: largest distance of the tip from its rest position after the command, m.
        missed: largest distance of the tip from the target after the command, m.
        soft, stiff: residual with a stiffness a quarter lower and higher, m; None if all commanded
            joints have muscles instead of springs.
        drawn: residual of each draw of the uncertain parameters of the fit, m; empty without a fit.
        clearance: smallest clearance of any link, m; None without obstacles.
        closest: smallest clearance of all simulated arms, the soft, stiff and drawn ones included,
            m.
        times: sample times, s, shape (sample,).
        tips: positions of the tip, m, shape (sample, 3).
        angles: joint angles, rad, shape (sample, joint).
        drawn_tips: positions of the tip of each draw, m, shape (draw, sample, 3).
    """

    name: str
    command: Command
    settled: float | None
    residual: float
    missed: float
    soft: float | None
    stiff: float | None
    drawn: Float[np.ndarray, " draw"]
    clearance: float | None
    closest: float | None
    times: Float[np.ndarray, " sample"]
    tips: Float[np.ndarray, "sample 3"]
    angles: Float[np.ndarray, "sample joint"]
    drawn_tips: Float[np.ndarray, "draw sample 3"]


@dataclasses.dataclass(frozen=True)
class Plan:
    """Result of `plan_command`.

    Attributes:
        direct: the direct motion at the largest rate.
        planned: the command that was found.
        goal: target position of the tip, m.
        travel: initial distance of the tip from the goal, m.
        within: fraction of the travel within which the tip counts as near the goal.
        period: period of the slowest mode in the final pose, s.
        limits: limits of the command and its motion.
        steps: number of steps of the search.
        model: model of the arm.
        problem: optimisation problem that was solved first.
        notes: sentences on limitations of the result.
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
    """Plan a command that moves an arm to a target, where it then rests, in still air.

    Without a duration the command is as short as the limits allow. With a duration its residual
    swing is as small as possible. The arm is at rest initially. The result is a local optimum. The
    initial guess is a straight line between the poses, which lasts at least one slowest period.

    Arguments:
        model: the arm, or a fit of it. With a fit, draws of its uncertain parameters are evaluated.
        target: `Pose`, `Tip` or `Through`.
        begin: commanded angles of the initial rest pose, rad. The default is a straight arm.
        limits: limits of the command, and the required clearance of the links.
        duration: duration of the command, s.
        within: fraction of the tip's travel; within this distance the tip counts as at rest.
        knots: number of intervals of the command.
        most_steps: maximum number of steps of the search.
        draw_count: number of draws of the uncertain parameters of the fit.
        progress: called with a line of text from time to time.

    Raises:
        InputError: a target that cannot be reached, an initial pose beyond the limits or too
            close to an obstacle, or no command within the limits.

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
        raise InputError("the arm has no muscles whose pressure could be limited: remove the limit")
    if duration is not None and not duration > 0:
        raise InputError(f"the duration of the command is {duration:g} s: give a positive number")
    if not 0 < within < 1:
        raise InputError(
            f"within is {within:g}, but must be a fraction of the travel: give a number between 0 "
            "and 1"
        )
    if knots < 2:
        raise InputError(
            f"a command of {knots} intervals is too short to brake: give at least 2 intervals"
        )
    first = np.zeros(arm.count) if begin is None else np.asarray(begin, dtype=float)
    if first.shape != (arm.count,):
        raise InputError(
            f"the initial pose has {first.size} angles, but the arm has {arm.count} joints: give "
            "one angle for each joint"
        )
    ways = target.commands(arm, first, limits)
    route = np.concatenate([first[None], ways])
    if (worst := float(np.max(np.abs(route)))) > limits.angle * (1 + 1e-9):
        raise InputError(
            f"a joint is commanded to {np.rad2deg(worst):.3g} deg in the initial or final pose, "
            f"but only {np.rad2deg(limits.angle):.3g} deg are allowed: allow a larger angle, or "
            "choose another pose"
        )
    rests = [
        found_rest(without_contact(arm), row, "for the pose in which the command " + place)
        for row, place in zip(route, ["begins", *["passes"] * (len(ways) - 1), "ends"], strict=True)
    ]
    if arm.contact is not None:
        _clear_at_ends(arm, rests, limits)
    begun, goal = (np.asarray(rest.tip) for rest in (rests[0], rests[-1]))
    travel = float(np.linalg.norm(goal - begun))
    if not travel > 1e-6:
        raise InputError("the tip is already at its target: choose another target")
    problem = _problem(arm, route, rests[-1], within * travel, limits, duration, knots)
    if progress is not None:
        progress("searching for a command ...")
    y, steps = problem.solved(most_steps, progress)
    _check(problem, y, duration)
    direct = _direct(route, limits.rate)
    period = float(problem.task.period)
    how: Any = {"goal": goal, "near": within * travel, "period": period}
    how["rows"] = max(len(direct.times), knots + 1)
    if duration is None:
        y, steps = _searched_on(problem, y, steps, most_steps, progress, arm, how)
    springs = _springs(arm, route, problem.command(y).angles)
    wrong = [softer(stated, 1 + by).arm for by in (-WRONG, WRONG)] if springs != "none" else []
    result = model if isinstance(model, FitResult) else None
    drawn = arms_left_open(stated, result, draw_count)
    arms = [arm, *wrong, *drawn]
    if progress is not None:
        progress(f"evaluating {len(arms)} arms ...")
    rows = [
        _moved(name, command, arms, len(wrong), **how)
        for name, command in (("direct", direct), ("planned", problem.command(y)))
    ]
    target.check(arm, rows[1].tips)
    notes = _doubts(rows[1], limits, within * travel, arm.further_laws.rows > 0)
    if springs == "some":
        notes.append(
            "in the stiffness columns, only the springs change: muscles keep their given values"
        )
    if lost := len(drawn) - min(len(row.drawn) for row in rows):
        notes.append(f"the motion could not be simulated with {lost} of {len(drawn)} draws")
    if steps >= most_steps:
        notes.append(f"the search ended after {steps} steps: more steps may find a better command")
    if result is not None and result.verdict.status == "inadequate":
        notes.append("the model of the fit is not adequate: the arm may move differently")
    kept = (rows[0], rows[1], goal, travel, within, period, limits, steps, stated)
    return Plan(*kept, problem, tuple(notes))


def _clear_at_ends(arm: Arm, rests: Sequence[Rest], limits: CommandLimits) -> None:
    """Raise an error if the first or last pose is too close to an obstacle for any path."""
    assert arm.contact is not None
    things = arm.contact.obstacles
    for rest, where in ((rests[0], "begins"), (rests[-1], "ends")):
        gaps = np.asarray(clearance(arm, jnp.asarray(rest.angles)))
        link, box = np.unravel_index(np.argmin(gaps), gaps.shape)
        gap, name = float(gaps[link, box]), things[owners(things)[box]].name
        if gap < limits.clearance:
            far = f"{gap:.3g} m away from" if gap >= 0 else f"{-gap:.2g} m inside"
            raise InputError(
                f"when the command {where}, link {link + 1} is {far} {name}, but a clearance of "
                f"{limits.clearance:g} m is required: choose another pose, or a smaller "
                "clearance"
            )


def _springs(arm: Arm, route: np.ndarray, angles: np.ndarray) -> str:
    """Return whether all, some or none of the commanded joints have springs."""
    moved = np.ptp(np.concatenate([route, angles]), axis=0) > 1e-9
    if arm.pneumatics is None:
        return "all"
    pulled = np.isin(np.arange(1, arm.count + 1), arm.pneumatics.joints) & moved
    return "all" if not pulled.any() else "none" if np.array_equal(pulled, moved) else "some"


def _searched_on(
    problem: PlanProblem,
    y: np.ndarray,
    steps: int,
    most: int,
    progress: Callable[[str], None] | None,
    arm: Arm,
    how: dict[str, Any],
) -> tuple[np.ndarray, int]:
    """Return a solution that is near the target in an accurate simulation, and the number of steps.

    The tip may be too far from the target between the times of the search, or after them. The
    search then continues with a correspondingly smaller allowed distance. Each simulation is of the
    nominal arm only.
    """

    def missed(y: np.ndarray) -> float:
        return _moved("planned", problem.command(y), [arm], 0, **how).missed

    off, nearness = missed(y), 1.0
    for _ in range(_ROUNDS):
        over = off / how["near"]
        if over <= 1 or steps >= most:
            break
        nearness *= _FURTHER / over
        if progress is not None:
            progress("continuing the search, closer to the target ...")
        nearer, more = problem.closer(nearness, y).solved(most - steps, progress)
        steps += more
        try:
            _check(problem, nearer, None)
            found = missed(nearer)
        except InputError:
            break
        if found >= off:
            break
        y, off = nearer, found
    return y, steps


_ROUNDS = 3  # Number of continued searches, each closer to the target.
_FURTHER = 0.99
_PRESSED = 1e-3  # Tolerance of the pressure limit, as a fraction of the limit.


def _doubts(row: Planned, limits: CommandLimits, near: float, remembers: bool) -> list[str]:
    """Return notes on the motion under the planned command.

    Raises:
        InputError: a link touches an obstacle.
    """
    notes = []
    if row.missed > near:
        why = (
            "joints with hysteresis may continue to creep: allow a larger distance"
            if remembers
            else "allow the command more time, or more knots"
        )
        notes.append(
            "during three periods of the slowest mode after the end of the command, the tip is up "
            f"to {row.missed:.3g} m from the target, but only {near:.3g} m are allowed: {why}"
        )
    if row.clearance is None or row.closest is None:
        return notes
    if row.clearance < 0:
        raise InputError(
            "a link touches an obstacle between the planned times: plan with a larger clearance"
        )
    for gap, whose in ((row.clearance, ""), (row.closest, " in one of the draws")):
        if gap < limits.clearance:
            notes.append(
                f"a link{whose} comes within {gap:.3g} m of an obstacle: plan with a larger "
                "clearance"
            )
            break
    return notes


def _problem(
    arm: Arm,
    route: np.ndarray,
    rest: Rest,
    near: float,
    limits: CommandLimits,
    duration: float | None,
    knots: int,
) -> PlanProblem:
    dtype = jnp.result_type(float)
    frequencies, shapes = rest.modes()
    legs = np.diff(route, axis=0)
    by_angles, by_command = np.asarray(rest.by_angles), np.asarray(rest.by_command)
    gain = shapes.T @ rest.mass @ np.linalg.solve(by_angles, by_command @ legs.T)
    reach = np.linalg.norm(rest.moves @ shapes, axis=0)
    excited = np.argsort(-np.max(np.abs(gain), axis=1) * reach)[:_MODES]
    # Commands that hold the arm in the shape of a mode.
    holding = -np.linalg.lstsq(by_command, by_angles @ shapes[:, excited], rcond=None)[0].T
    moves = np.concatenate([holding, legs])
    moves = moves / np.max(np.abs(moves), axis=1, keepdims=True)
    moves[np.abs(moves) < 1e-9] = 0
    direct = _direct(route, limits.rate)
    least = float(direct.times[-1])
    if duration is not None and duration < least:
        raise InputError(
            f"at {np.rad2deg(limits.rate):g} deg/s, the motion to the target takes {least:.1f} s, "
            f"but the command is to last only {duration:g} s: allow more time, or a larger rate"
        )
    base = direct.at(np.linspace(0.0, least, knots + 1))
    period, pressure = 2 * np.pi / frequencies[0], limits.pressure or np.inf
    # With hysteresis the command that holds a pose depends on the history, and the arm creeps.
    remembers = arm.further_laws.rows > 0
    after = (_LATER if remembers else 1) * period
    numbers = (rest.tip, _INSIDE * near, period, after, limits.clearance + ROOM, pressure)
    rows: Any = [jnp.asarray(each, dtype) for each in (base, moves, *numbers)]
    return PlanProblem(Task(arm, *rows), limits, _MARGIN * least, duration, remembers)


_MARGIN = 1 + 1e-6  # Margin for rounding.
_INSIDE = 0.95  # Factor of the allowed distance, because the motion is evaluated at discrete times.


def _direct(route: np.ndarray, rate: float) -> Command:
    """Return the command along a route at the largest rate (rad/s) of the fastest joint."""
    spans = np.max(np.abs(np.diff(route, axis=0)), axis=1) / rate
    kept = np.concatenate([[True], spans > 0])
    return Command(np.concatenate([[0.0], np.cumsum(spans)])[kept], route[kept])


def _check(problem: PlanProblem, y: np.ndarray, duration: float | None) -> None:
    """Raise an error for a solution that violates the limits."""
    kept = problem.values(np.concatenate([y[:-2], np.zeros(2)]))
    if np.min(kept) <= -LOST / 2:
        raise InputError(
            "the motion to the target cannot be simulated: choose a closer target, or a lower rate"
        )
    clear = 0 if problem.task.arm.contact is None else DURING + AFTER
    missing = -GAP * float(np.min(kept[AFTER : AFTER + clear], initial=0.0)) - ROOM
    pressed = -SHARE * float(np.min(kept[AFTER + clear :], initial=0.0))
    if missing > NEARER or pressed > _PRESSED:
        what = f"a link comes {missing:.2g} m closer to an obstacle than the clearance allows"
        if pressed > _PRESSED:
            what = f"a muscle needs {1 + pressed:.2f} times the largest allowed pressure"
        raise InputError(
            f"no command within the limits was found ({what}): relax the limits, or plan two moves"
        )
    off = float(1 - np.min(kept[:AFTER]))
    if duration is None and off > 1 + SLACK:
        muscles = problem.task.arm.pneumatics is not None
        held = "; muscles may hold a joint at several angles, mainly near 0" if muscles else ""
        raise InputError(
            "no command within the limits was found that keeps the tip near the target afterwards "
            f"(the best one leaves it at {off:.3g} times the allowed distance{held}): allow larger "
            "angles or rates, or more knots"
        )


@program
def _flights(cases: Flight, around: Arm) -> tuple[Array, ...]:
    """Return angles, tips, rests, success and the smallest clearance of each flight."""

    def one(flight: Flight) -> tuple[Array, ...]:
        flown = flight.flown(SETTLING // 3)
        gap = jnp.full((), jnp.inf, flown.tips.dtype)
        if around.contact is not None:
            gap = jnp.min(jax.lax.map(lambda q: jnp.min(clearance(around, q)), flown.angles))
        return (*flown, gap)

    return jax.lax.map(one, cases)


def _moved(
    name: str,
    command: Command,
    arms: Sequence[Arm],
    wrong: int,
    *,
    goal: np.ndarray,
    near: float,
    period: float,
    rows: int,
) -> Planned:
    """Simulate a command: the nominal arm, then `wrong` arms of other stiffness, then the draws.

    `rows` is the number of rows of the command, the same for all commands.
    """
    times = settling_times(float(command.times[-1]), _LATER * period)
    signal, stamps = command.signal(rows), jnp.asarray(times)
    cases = [Flight(without_contact(each), signal, stamps, jnp.asarray(_FINAL)) for each in arms]
    batch = Batch(_flights, stacked_items(cases), (arms[0],), np.ones(len(cases)), 1)
    angles, tips, rests, successful, gaps = map(np.asarray, run_on_all_cores([batch])[0])
    if not successful[0]:
        raise InputError(
            "the motion of the arm under the command cannot be simulated: choose a closer target"
        )
    from_rest = np.linalg.norm(tips - rests[:, None], axis=2)
    left = np.where(successful, np.max(from_rest[:, UNTIL:], axis=1), np.inf)
    sound = np.flatnonzero(successful)
    sound = sound[sound > wrong]
    soft, stiff = map(float, left[1 : 1 + wrong]) if wrong else (None, None)
    return Planned(
        name=name,
        command=command,
        settled=settled_at(times, from_rest[0], near),
        residual=float(left[0]),
        missed=float(np.max(np.linalg.norm(tips[0, UNTIL:] - goal, axis=1))),
        soft=soft,
        stiff=stiff,
        drawn=left[sound],
        clearance=None if arms[0].contact is None else float(gaps[0]),
        closest=None if arms[0].contact is None else float(np.min(gaps[successful])),
        times=times,
        tips=tips[0],
        angles=angles[0],
        drawn_tips=tips[sound],
    )
