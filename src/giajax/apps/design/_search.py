"""Optimisation of the command series by sequential quadratic programming.

The set of series within the limits is convex and its constraints are linear. Each iterate of SLSQP
(Kraft 1988) is therefore a feasible experiment. The objective is not convex: several initial
commands are compared, and the optimiser is started from the best few.
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
    """Limits of the command of an experiment.

    Arguments:
        joints: numbers of the joints that move (1 is the base joint); the others are held at 0.
        angle: largest magnitude of a commanded angle, rad.
        rate: largest magnitude of the rate of a commanded angle, rad/s.
        duration: duration of the experiment, s.
        sampling: number of recorded rows per second.

    Raises:
        InputError: a number is not positive or too large, no joint is given, or the duration is not
            a whole number of rows.
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
            raise InputError("no joint is given: give the number of at least one joint")
        if len(set(self.joints)) < len(self.joints):
            raise InputError("the same joint is given twice: give each joint number once")
        rows = self.duration * self.sampling
        if rows > _MOST_ROWS:
            raise InputError(
                f"the experiment has {rows:g} rows, but may have at most {_MOST_ROWS}: shorten it, "
                "or reduce the sampling rate"
            )
        if self.rows < 2 or abs(rows - self.rows) > 1e-6 * rows:
            raise InputError(
                f"{self.duration:g} s at {self.sampling:g} rows per second does not give a whole "
                "number of at least 2 rows: change the duration or the sampling rate"
            )

    @property
    def rows(self) -> int:
        """Number of intervals between the rows of the experiment."""
        return round(self.duration * self.sampling)

    def check_joints(self, count: int) -> None:
        """Raise an error for a joint that an arm of `count` joints does not have."""
        for joint in self.joints:
            if not 1 <= joint <= count:
                raise InputError(
                    f"joint {joint} is given, but the arm has only joints 1 to {count}: correct "
                    "the number"
                )


# A command series described by few numbers: angles at knots with linear interpolation.
#
# The numbers are angles divided by the largest angle. The angle of such a series is extreme at a
# knot, and its rate is constant between two knots. The limits are therefore linear in the numbers
# and define a convex set, which an optimiser for linear constraints does not leave. The projection
# `within` removes violations due to rounding.

_ROUNDING = 1e-9  # Margin for the rounding of decimal numbers in files, for angles and rates.
_LEAD = 0.5  # Start of the paper's base step, s.

Numbers = Float[np.ndarray, " number"]


@dataclasses.dataclass(frozen=True)
class CommandSeries:
    """The command series that satisfy some limits, with knots at rows of the experiment.

    Attributes:
        times: times of the knots, shape (knot,); the first one is 0 s.
    """

    limits: Limits
    times: Float[np.ndarray, " knot"]

    @classmethod
    def of(cls, limits: Limits, knots: int) -> "CommandSeries":
        """Return the series with this number of knots after the first, about evenly spaced."""
        if not 2 <= knots <= limits.rows:
            raise InputError(
                f"the command has {knots} knots, but the experiment has {limits.rows} intervals: "
                f"give a number of knots from 2 to {limits.rows}"
            )
        rows = np.round(np.arange(knots + 1) * limits.rows / knots)
        return cls(limits, rows / limits.sampling)

    @property
    def size(self) -> int:
        """Number of values that describe one series."""
        return (len(self.times) - 1) * len(self.limits.joints)

    def within(self, numbers: Numbers) -> Numbers:
        """Project onto the limits: each angle in turn takes the nearest admissible value."""
        reach = self._reach()
        wanted = np.asarray(numbers, dtype=float).reshape(len(reach), -1)
        angles = np.zeros_like(wanted)
        before = np.zeros(wanted.shape[1])
        for knot, most in enumerate(reach):
            angles[knot] = np.clip(wanted[knot], before - most, before + most)
            angles[knot] = before = np.clip(angles[knot], _ROUNDING - 1, 1 - _ROUNDING)
        return angles.ravel()

    def constraint(self) -> LinearConstraint:
        """Return the limits of the angle between successive knots; angles are within [-1, 1]."""
        joints = len(self.limits.joints)
        difference = np.eye(self.size) - np.eye(self.size, k=-joints)
        most = np.repeat(self._reach(), joints)
        return LinearConstraint(difference, -most, most)

    def base_step(self) -> Numbers:
        """Return the paper's base step, as closely as the knots permit."""
        wanted = base_step(self.limits, len(self.times))
        angles = [np.interp(self.times[1:], wanted.times, row) for row in wanted.table().T]
        return self.within(np.stack(angles, axis=1).ravel() / self.limits.angle)

    def at(self, numbers: Numbers) -> "Command":
        """Return the command that some numbers describe."""
        return Command(self.limits, self.times, np.asarray(numbers, dtype=float))

    def _reach(self) -> Float[np.ndarray, " knot"]:
        """Return the largest change from each knot to the next, divided by the largest angle."""
        limits = self.limits
        return (1 - _ROUNDING) * np.diff(self.times) * limits.rate / limits.angle


def knotted(
    times: Float[Array, " knot"],
    angles: Float[Array, "turn moved"],
    moving: tuple[int, ...],
    count: int,
) -> Signal:
    """Return the command through angles (rad) at all knots but the first, where they are 0.

    It is differentiable with respect to the angles. The moving joints are numbered from 1; `count`
    is the number of joints of the arm.
    """
    places = np.asarray(moving) - 1
    values = jnp.zeros((len(times), count), angles.dtype).at[1:, places].set(angles)
    slopes = jnp.diff(values, axis=0) / jnp.diff(times)[:, None]
    slopes = jnp.concatenate([slopes, jnp.zeros_like(slopes[:1])])
    return Signal(times, values, slopes, jnp.full_like(times, jnp.inf))


def base_step(limits: Limits, knots: int) -> "Command":
    """Return the paper's experiment: one joint moves to its largest angle at its largest rate.

    The joint is joint 1 if it may move, else the first joint that may. Knots beyond the three
    corners come after the end, so that all commands share one compiled program.
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
    """One command series: times of the knots, s, and the angles divided by the largest angle."""

    limits: Limits
    times: Float[np.ndarray, " knot"]
    numbers: Numbers

    def table(self) -> Float[np.ndarray, "knot moved"]:
        """Return the angles of the moving joints at the knots, rad."""
        table = np.asarray(self.numbers, dtype=float).reshape(len(self.times) - 1, -1)
        return np.concatenate([np.zeros((1, table.shape[1])), table]) * self.limits.angle

    def drive(self) -> Drive:
        """Return the command as rows, by the channel of each joint that moves."""
        columns = zip(self.limits.joints, self.table().T, strict=True)
        named = {f"joint{joint:02d}_command": row for joint, row in columns}
        moving = {name: row for name, row in named.items() if np.any(row)} or named
        kept = np.flatnonzero(self.times <= max(self.limits.duration, self.times[1]))
        last = min(kept[-1] + 2, len(self.times))
        rows = {name: row[:last] for name, row in moving.items()}
        return Drive(self.times[:last], rows, "linear")


# Information of each body of an experiment, and its derivative with respect to the command.
#
# The information is the sum of J^T J over the channels of a body. J contains the derivatives of the
# channels, divided by their noise, with respect to the scaled parameters. Information changes a
# criterion only in few directions of the parameters (in one, for a single parameter). The
# derivatives with respect to the command are therefore needed along these directions only. Both
# differentiations are in forward mode, one inside the other: there is no reverse pass through an
# adaptive solver, and the result is exact to the tolerance of the solver.

# A command disturbs the arm like these paths: the model then chooses its step size for them.
_DISTURBANCE = ("initial.angle",)


@dataclasses.dataclass(frozen=True)
class Experiment:
    """The recorded channels of an arm and the free parameters of a fit.

    Attributes:
        model: the arm; its parameters are replaced.
        inputs: a prepared run; its command is replaced.
        paths: scalar parameters of the model that are free in the fit.
        scales: scale of each parameter, SI.
        own: path and number of values of each quantity that is free in this run only.
        channels: all channels that may be recorded.
        noise: standard deviation of the noise of each channel, SI.
        bodies: index of the body of each channel.
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
    """Information of each draw and body, and the predicted channels."""

    values: Float[np.ndarray, "draw body parameter parameter"]
    predicted: Float[np.ndarray, "draw sample channel"]
    successful: np.ndarray


Draws = Float[np.ndarray, "draw parameter"]


def informed(experiment: Experiment, command: Command, draws: Draws) -> Informed:
    """Return the information of an experiment with a command; draws run on all cores."""
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
    """Return the derivatives of the sum of f d^T I d with respect to the numbers of a command.

    I is the information of some bodies, d are the directions and f their factors.
    """
    dtype = jnp.result_type(float)
    counts = jnp.asarray(np.isin(experiment.bodies, bodies), dtype)
    shared = (counts, *_shared(experiment, command))
    given = (draws, directions, factors)
    items = tuple(np.asarray(array, dtype) for array in given)
    batch = Batch(_slopes, items, shared, np.ones(len(draws)), 1)
    return np.asarray(run_on_all_cores([batch])[0])


def _shared(experiment: Experiment, command: Command) -> tuple[Any, ...]:
    """Return the arguments that are the same for all draws."""
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
    """Return a function that predicts all channels divided by their noise, and its input size.

    The function takes the free quantities, relative to a draw and in the scales of the experiment,
    and the numbers of a command. It also returns whether the simulation succeeded.
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
    """Return the number of free values."""
    paths, own, *_ = names
    return len(paths) + sum(each for _, each in own)


# A command that cannot be simulated gets the best value so far plus this, in logarithms.
_WORSE = 3.0
_CHOICES = 3  # How often the markers may be chosen again for the command that was found.
_LIMIT = 9  # Status that SLSQP returns at the iteration limit.
_SEED = 1

_TOLERANCE = 1e-3  # The search ends at a smaller change of the logarithm of the error.


class Objective(Protocol):
    """The function of a command's numbers that is minimised, for some choice of markers."""

    markers: tuple[int, ...]

    def __call__(self, numbers: Numbers) -> float:
        """Return the logarithm of the error; NaN if a simulation fails."""

    def slope(self, numbers: Numbers) -> Float[np.ndarray, " number"]:
        """Return the gradient."""

    def choose(self, numbers: Numbers) -> None:
        """Select the markers that are most informative for a command."""


class Evaluation(NamedTuple):
    """One evaluation of the objective, as passed to `progress`.

    Attributes:
        number: number of the evaluation, from 1.
        start: number of the initial command of the descent, from 1; 0 while these are compared.
        value: logarithm of the expected error.
        best: smallest value so far.
    """

    number: int
    start: int
    value: float
    best: float


@dataclasses.dataclass
class Search:
    """A search that keeps the best command so far if it is interrupted.

    Attributes:
        progress: called after each evaluation; may raise KeyboardInterrupt.
        best: numbers of the best command so far; None before the first evaluation.
        markers, value: markers of that command and the value of its objective.
        status: "iteration limit" if the descent to the best command ended at that limit.
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
        """Evaluate all initial commands and descend from the `most` best ones.

        Ctrl-C before the first evaluation is passed on.
        """
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
        # This import is slow and needed only here.
        from scipy.optimize import minimize

        chosen = None
        # Repeat if other markers are more informative for the command that was found.
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
        # Correct violations of a limit that are due to rounding.
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
    """Return initial commands: the paper's base step, two oscillations, and random commands.

    Half of the angles of a random command are at a limit, as in good experiments. The random
    commands are the same in each call.
    """
    base = series.base_step()
    knots, joints = len(series.times) - 1, len(series.limits.joints)
    # Oscillations of the largest amplitude, with one or two knots in each direction.
    swings = [
        np.repeat(np.where(np.arange(knots) // turn % 2 == 0, 1.0, -1.0), joints) for turn in (1, 2)
    ]
    random = np.random.default_rng(_SEED).uniform(-2, 2, (max(count - 3, 0), series.size))
    return [series.within(numbers) for numbers in [base, *swings, *random][:count]]
