"""The command series that lowers a criterion most: sequential quadratic programmes.

The set of series within the limits is convex and its borders are linear, so that each iterate of
SLSQP (Kraft 1988) is an experiment that may be made. Far from convex is what is minimised: several
starts are looked at, and the best few of them followed.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import LinearConstraint

from ...fitting import Tie, tied
from ...models import ArmModel
from ...runtime.arrays import Array, Float
from ...runtime.limits import ANGLE_DEG
from ...runtime.parallel import Batch, run_on_all_cores
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema.parameters import get, replace
from ...simulation import Signal
from ..synthetic import Drive

_MOST_ROWS = 100_000


@dataclasses.dataclass(frozen=True)
class Limits:
    """What the command of an experiment may do.

    Arguments:
        joints: numbers of the joints that move (1 is the base joint); the others hold 0.
        angle: largest size of a commanded angle, rad.
        rate: largest size of its rate, rad/s.
        duration: of the experiment, s.
        sampling: rows that are recorded, per second.

    Raises:
        InputError: a number that is not positive or too large, no joint, or a duration of no whole
            number of rows.
    """

    joints: tuple[int, ...] = (1,)
    angle: float = math.radians(30)
    rate: float = math.radians(30)
    duration: float = 25.0
    sampling: float = 10.0

    def __post_init__(self) -> None:
        for value, what in (
            (self.angle, "the largest angle"),
            (self.rate, "the largest rate"),
            (self.duration, "the duration"),
            (self.sampling, "the sampling rate"),
        ):
            if not 0 < value < math.inf:
                raise InputError(f"{what} is {value:g}: give a positive number")
        if self.angle > math.radians(ANGLE_DEG):
            raise InputError(
                f"the largest angle is {math.degrees(self.angle):g} deg: give at most "
                f"{ANGLE_DEG:g} deg"
            )
        if not self.joints:
            raise InputError("no joint is to move: give the number of at least one joint")
        if len(set(self.joints)) < len(self.joints):
            raise InputError("the same joint is given twice: give each joint number once")
        rows = self.duration * self.sampling
        if rows > _MOST_ROWS:
            raise InputError(
                f"the experiment has {rows:g} rows: shorten it, or reduce the sampling rate"
            )
        if self.rows < 2 or abs(rows - self.rows) > 1e-6 * rows:
            raise InputError(
                f"{self.duration:g} s at {self.sampling:g} rows per second does not give a whole "
                "number of at least 2 rows: change the duration or the sampling rate"
            )

    @property
    def rows(self) -> int:
        """Intervals between the rows of the experiment."""
        return round(self.duration * self.sampling)

    def check_joints(self, count: int) -> None:
        """Refuse joints that an arm of `count` joints does not have."""
        for joint in self.joints:
            if not 1 <= joint <= count:
                raise InputError(
                    f"joint {joint} is to move, but the arm has only joints 1 to {count}: correct "
                    "the number"
                )


# A command series as few numbers: angles at knots, between which each joint moves steadily.
#
# The numbers are angles over the largest angle. Angle and rate of such a series are largest at
# its knots and between two of them, so that its limits are linear in the numbers: a convex set,
# in which an optimiser for linear constraints stays. `within` is the projection that makes
# rounding harmless.

_ROUNDING = 1e-9  # what a decimal number in a file may add to an angle or a rate
_LEAD = 0.5  # when the paper's base step begins, s

Numbers = Float[np.ndarray, " number"]


@dataclasses.dataclass(frozen=True)
class CommandSeries:
    """The command series that some limits allow, with knots at rows of the experiment.

    Attributes:
        times: of the knots, the first of which is at 0 s, shape (knot,).
    """

    limits: Limits
    times: Float[np.ndarray, " knot"]

    @classmethod
    def of(cls, limits: Limits, knots: int) -> "CommandSeries":
        """Series of so many knots after the first one, as evenly spaced as rows allow."""
        if not 2 <= knots <= limits.rows:
            raise InputError(
                f"the command has {knots} knots, but the experiment has {limits.rows} intervals: "
                f"give a number from 2 to {limits.rows}"
            )
        rows = np.round(np.arange(knots + 1) * limits.rows / knots)
        return cls(limits, rows / limits.sampling)

    @property
    def size(self) -> int:
        """How many numbers a series is."""
        return (len(self.times) - 1) * len(self.limits.joints)

    def within(self, numbers: Numbers) -> Numbers:
        """The numbers of a series within the limits: each angle in turn as near as it may be."""
        reach = self._reach()
        wanted = np.asarray(numbers, dtype=float).reshape(len(reach), -1)
        angles = np.zeros_like(wanted)
        before = np.zeros(wanted.shape[1])
        for knot, most in enumerate(reach):
            angles[knot] = np.clip(wanted[knot], before - most, before + most)
            angles[knot] = before = np.clip(angles[knot], _ROUNDING - 1, 1 - _ROUNDING)
        return angles.ravel()

    def constraint(self) -> LinearConstraint:
        """How far angles of successive knots may be apart; the angles themselves are in [-1, 1]."""
        joints = len(self.limits.joints)
        difference = np.eye(self.size) - np.eye(self.size, k=-joints)
        most = np.repeat(self._reach(), joints)
        return LinearConstraint(difference, -most, most)

    def base_step(self) -> Numbers:
        """The paper's base step, as nearly as the knots allow."""
        wanted = base_step(self.limits, len(self.times))
        angles = [np.interp(self.times[1:], wanted.times, row) for row in wanted.table().T]
        return self.within(np.stack(angles, axis=1).ravel() / self.limits.angle)

    def at(self, numbers: Numbers) -> "Command":
        """The series of some numbers."""
        return Command(self.limits, self.times, np.asarray(numbers, dtype=float))

    def _reach(self) -> Float[np.ndarray, " knot"]:
        """How far a joint comes from each knot to the next, over the largest angle."""
        limits = self.limits
        return (1 - _ROUNDING) * np.diff(self.times) * limits.rate / limits.angle


def knotted(
    times: Float[Array, " knot"],
    angles: Float[Array, "turn moved"],
    moving: tuple[int, ...],
    count: int,
) -> Signal:
    """The command through angles (rad) at all knots but the first, where they are 0.

    It may be differentiated by the angles. The joints that move are numbers from 1; `count` is how
    many the arm has.
    """
    places = np.asarray(moving) - 1
    values = jnp.zeros((len(times), count), angles.dtype).at[1:, places].set(angles)
    slopes = jnp.diff(values, axis=0) / jnp.diff(times)[:, None]
    slopes = jnp.concatenate([slopes, jnp.zeros_like(slopes[:1])])
    return Signal(times, values, slopes, jnp.full_like(times, jnp.inf))


def base_step(limits: Limits, knots: int) -> "Command":
    """The paper's experiment: one joint to the largest angle at the largest rate.

    That is joint 1 if it may move, else the first that may. Knots beyond the three of its corners
    come after the end, so that one program does for all commands.
    """
    begin = min(_LEAD, 0.5 * limits.duration)
    corners = [0.0, begin, begin + limits.angle / limits.rate]
    end = max(corners[-1], limits.duration)
    times = np.asarray([*corners, *(end + 1.0 + np.arange(knots - 3))])
    numbers = np.zeros((knots - 1, len(limits.joints)))
    numbers[1:, limits.joints.index(1) if 1 in limits.joints else 0] = 1.0
    return Command(limits, times, numbers.ravel())


@dataclasses.dataclass(frozen=True)
class Command:
    """One command series: times of knots, s, and angles at all but the first over the largest."""

    limits: Limits
    times: Float[np.ndarray, " knot"]
    numbers: Numbers

    def table(self) -> Float[np.ndarray, "knot moved"]:
        """Angles of the joints that move, rad."""
        table = np.asarray(self.numbers, dtype=float).reshape(len(self.times) - 1, -1)
        return np.concatenate([np.zeros((1, table.shape[1])), table]) * self.limits.angle

    def drive(self) -> Drive:
        """The same as rows, by the channel of each joint that does move."""
        columns = zip(self.limits.joints, self.table().T, strict=True)
        named = {f"joint{joint:02d}_command": row for joint, row in columns}
        moving = {name: row for name, row in named.items() if np.any(row)} or named
        kept = np.flatnonzero(self.times <= max(self.limits.duration, self.times[1]))
        last = min(kept[-1] + 2, len(self.times))
        rows = {name: row[:last] for name, row in moving.items()}
        return Drive(self.times[:last], rows, "linear")


# What each body of an experiment tells, and how that changes with the command.
#
# The information is the sum of J^T J over the channels of a body, J the derivatives of its
# channels over their noise by the scaled parameters. A criterion has few directions of the
# parameters in which information changes it (one, where it is of one parameter), and derivatives
# by the numbers of the command are those of the channels along these alone. Both are forward, one
# within the other: no reverse pass through a solver of adaptive steps, and exact to its tolerance.

# Paths that a command disturbs an arm as: the model then takes the steps that this needs.
_DISTURBANCE = ("initial.angle",)


@dataclasses.dataclass(frozen=True)
class Experiment:
    """What is recorded of an arm, and what a fit of it would have free.

    Attributes:
        model: the arm; its parameters are replaced.
        inputs: a prepared run, whose command is replaced.
        paths: scalar parameters of the model, free in the fit.
        scales: what each is counted in, SI.
        own: what is free in the run alone, by path, and how many numbers that is.
        channels: all that may be recorded.
        noise: of each channel, SI.
        bodies: which body each channel is of.
    """

    model: ArmModel
    inputs: Any
    joints: int
    paths: tuple[str, ...]
    scales: Float[np.ndarray, " parameter"]
    own: tuple[tuple[str, int], ...]
    ties: tuple[Tie, ...]
    channels: tuple[str, ...]
    noise: Float[np.ndarray, " channel"]
    bodies: tuple[int, ...]


@dataclasses.dataclass(frozen=True)
class Informed:
    """Information of each draw and body, and what is to be expected of the channels."""

    values: Float[np.ndarray, "draw body parameter parameter"]
    predicted: Float[np.ndarray, "draw sample channel"]
    successful: np.ndarray


Draws = Float[np.ndarray, "draw parameter"]


def informed(experiment: Experiment, command: Command, draws: Draws) -> Informed:
    """The information of an experiment with a command; draws on all cores."""
    dtype = jnp.result_type(float)
    places = np.asarray(experiment.bodies)
    bodies = jnp.asarray(places[None, :] == np.arange(places.max() + 1)[:, None], dtype)
    shared = (bodies, *_shared(experiment, command))
    batch = Batch(_informed, np.asarray(draws, dtype), shared, np.ones(len(draws)), 1)
    return Informed(*run_on_all_cores([batch])[0])


def slopes(
    experiment: Experiment,
    command: Command,
    draws: Draws,
    directions: Float[np.ndarray, "draw direction parameter"],
    factors: Float[np.ndarray, "draw direction"],
    bodies: Sequence[int],
) -> Float[np.ndarray, "draw number"]:
    """Derivatives by the numbers of a command of the sum of f d^T I d, f the factors.

    I is the information of some bodies, and d each of the directions.
    """
    dtype = jnp.result_type(float)
    counts = jnp.asarray(np.isin(experiment.bodies, bodies), dtype)
    shared = (counts, *_shared(experiment, command))
    given = (draws, directions, factors)
    items = tuple(np.asarray(array, dtype) for array in given)
    batch = Batch(_slopes, items, shared, np.ones(len(draws)), 1)
    return np.asarray(run_on_all_cores([batch])[0])


def _shared(experiment: Experiment, command: Command) -> tuple[Any, ...]:
    """What of an experiment and a command is the same for all draws."""
    dtype = jnp.result_type(float)
    arrays = (command.numbers, command.times, experiment.scales, 1 / experiment.noise)
    angle = jnp.asarray(command.limits.angle, dtype)
    return (
        (*(jnp.asarray(array, dtype) for array in arrays), angle, experiment.inputs),
        experiment.model,
        (command.limits.joints, experiment.joints),
        (experiment.paths, experiment.own, experiment.ties, experiment.channels),
    )


@program
def _informed(
    draws: Float[Array, "1 parameter"],
    bodies: Float[Array, "body channel"],
    arrays: tuple[Any, ...],
    model: ArmModel,
    moving: tuple[tuple[int, ...], int],
    names: tuple[Any, ...],
) -> tuple[Array, Array, Array]:
    recorded, size = _recorded(draws[0], arrays, model, moving, names)
    still = jnp.zeros(size, draws.dtype)

    def push(tangent: Array) -> tuple[Array, Array, Array]:
        return jax.jvp(lambda a: recorded(a, arrays[0]), (still,), (tangent,), has_aux=True)

    basis = jnp.eye(size, dtype=still.dtype)
    table, columns, successful = jax.vmap(push, out_axes=(None, 0, None))(basis)
    found = jnp.einsum("isc,jsc,bc->bij", columns, columns, bodies)
    return found[None], (table / arrays[3][None])[None], successful[None]


@program
def _slopes(
    items: tuple[Array, Array, Array],
    counts: Float[Array, " channel"],
    arrays: tuple[Any, ...],
    model: ArmModel,
    moving: tuple[tuple[int, ...], int],
    names: tuple[Any, ...],
) -> Float[Array, "1 number"]:
    draw, directions, factors = (item[0] for item in items)
    recorded, size = _recorded(draw, arrays, model, moving, names)
    still = jnp.zeros(size, draw.dtype)

    def information(at: Array) -> Array:
        def push(tangent: Array) -> Array:
            return jax.jvp(lambda a: recorded(a, at)[0], (still,), (tangent,))[1]

        return jnp.einsum("dsc,c,d->", jax.vmap(push)(directions) ** 2, counts, factors)

    return jax.jacfwd(information)(arrays[0])[None]


def _recorded(
    draw: Float[Array, " parameter"],
    arrays: tuple[Any, ...],
    model: ArmModel,
    moving: tuple[tuple[int, ...], int],
    names: tuple[Any, ...],
) -> tuple[Callable[[Array, Array], tuple[Array, Array]], int]:
    """All channels over their noise, and whether they were found, by what is free and a command.

    What is free is counted from a draw on, in the scales of the experiment: so many numbers.
    """
    _, times, scales, weights, angle, inputs = arrays
    joints, count = moving
    paths, own, ties, channels = names
    ready = model.for_derivatives((*paths, *_DISTURBANCE))

    def recorded(amounts: Array, at: Array) -> tuple[Array, Array]:
        values = draw + amounts[: len(paths)] * scales
        there = tied(replace(ready, {path: values[i] for i, path in enumerate(paths)}), ties)
        moved, start = inputs, len(paths)
        for path, each in own:
            value = get(inputs, path)
            change = amounts[start : start + each].reshape(value.shape)
            moved = replace(moved, {path: value + change})
            start += each
        command = knotted(times, at.reshape(len(times) - 1, -1) * angle, joints, count)
        moved = eqx.tree_at(lambda prepared: prepared.command, moved, command)
        predicted, successful = there.predict(moved, channels)
        columns = jnp.stack([predicted[name] for name in channels], axis=-1)
        return columns * weights[None], successful

    return recorded, _size(names)


def _size(names: tuple[Any, ...]) -> int:
    """How many numbers are free."""
    paths, own, *_ = names
    return len(paths) + sum(each for _, each in own)


_WORSE = 3.0  # what a command that cannot be simulated is worse by than the best one, in logarithms
_CHOICES = 3  # how often markers are chosen again for what was found with others
_LIMIT = 9  # what SLSQP returns at the iteration limit
_SEED = 1

_TOLERANCE = 1e-3  # change of the logarithm of the error below which a search has ended


class Objective(Protocol):
    """What is minimised over the numbers of a command, for some choice of markers."""

    markers: tuple[int, ...]

    def __call__(self, numbers: Numbers) -> float:
        """The logarithm of the error; NaN where nothing can be simulated."""

    def slope(self, numbers: Numbers) -> Float[np.ndarray, " number"]:
        """Its gradient."""

    def choose(self, numbers: Numbers) -> None:
        """Change to the markers that tell most of a command."""


class Evaluation(NamedTuple):
    """What `progress` hears of.

    Attributes:
        number: of the evaluation, from 1.
        start: number of the start that is followed, from 1; 0 while starts are compared.
        value: logarithm of the error to expect.
    """

    number: int
    start: int
    value: float
    best: float


@dataclasses.dataclass
class Search:
    """A search that can be interrupted, and then has the best so far.

    Attributes:
        progress: hears of each evaluation; may raise KeyboardInterrupt.
        best: numbers of the best command so far; None before the first evaluation.
        markers, value: of that command.
        status: "iteration limit" where the descent to the best one ended there.
    """

    objective: Objective
    series: CommandSeries
    progress: Callable[[Evaluation], None] | None = None
    best: Numbers | None = None
    markers: tuple[int, ...] = ()
    value: float = np.inf
    evaluations: list[Evaluation] = dataclasses.field(default_factory=list)
    status: Literal["converged", "iteration limit", "interrupted"] = "converged"
    _start: int = 0

    def follow(self, starts: Sequence[Numbers], most: int, iterations: int) -> None:
        """Look at all starts, and follow the `most` best ones; before any, Ctrl-C is passed on."""
        try:
            values = []
            for start in starts:
                self.objective.choose(start)
                values.append(self._evaluate(start))
            order = np.argsort(np.nan_to_num(values, nan=np.inf), kind="stable")
            for number, index in enumerate(order[:most], 1):
                self._start = number
                if np.isfinite(values[index]):
                    self._descend(starts[index], iterations)
        except KeyboardInterrupt:
            if self.best is None:
                raise
            self.status = "interrupted"

    def _descend(self, numbers: Numbers, iterations: int) -> None:
        # Slow to import, and only needed here.
        from scipy.optimize import minimize

        chosen = None
        # Once more where other markers tell more of what was found.
        for _ in range(_CHOICES):
            self.objective.choose(numbers)
            if self.objective.markers == chosen:
                return
            chosen = self.objective.markers
            before = self.value
            end = minimize(
                self._safe,
                numbers,
                jac=self._slope,
                method="SLSQP",
                bounds=[(-1.0, 1.0)] * len(numbers),
                constraints=[self.series.constraint()],
                options={"maxiter": iterations, "ftol": _TOLERANCE},
            )
            numbers = end.x
            if self.value < before:
                self.status = "iteration limit" if end.status == _LIMIT else "converged"

    def _safe(self, numbers: Numbers) -> float:
        value = self._evaluate(numbers)
        return value if np.isfinite(value) else self.value + _WORSE

    def _slope(self, numbers: Numbers) -> np.ndarray:
        slope = self.objective.slope(self.series.within(numbers))
        return slope if np.all(np.isfinite(slope)) else np.zeros_like(numbers)

    def _evaluate(self, numbers: Numbers) -> float:
        # What rounding moved beyond a limit is put back.
        numbers = self.series.within(numbers)
        value = self.objective(numbers)
        if value < self.value:
            self.best, self.value, self.markers = numbers, value, self.objective.markers
        told = Evaluation(len(self.evaluations) + 1, self._start, value, self.value)
        self.evaluations.append(told)
        if self.progress is not None:
            self.progress(told)
        return value


def starts_of(series: CommandSeries, count: int) -> list[Numbers]:
    """Commands to begin from: the paper's base step, swings to and fro, and random ones.

    Half of the angles of a random one are at a limit, as those of good experiments are. They are
    the same ones each time.
    """
    base = series.base_step()
    knots, joints = len(series.times) - 1, len(series.limits.joints)
    # A swing that is as wide as it may be, and takes a knot or two each way.
    swings = [
        np.repeat(np.where(np.arange(knots) // turn % 2 == 0, 1.0, -1.0), joints) for turn in (1, 2)
    ]
    random = np.random.default_rng(_SEED).uniform(-2, 2, (max(count - 3, 0), series.size))
    return [series.within(numbers) for numbers in [base, *swings, *random][:count]]
