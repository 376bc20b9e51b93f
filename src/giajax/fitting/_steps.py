"""A fit between two steps of its loop, as frozen data, and pure functions to the next state.

None changes the state that it takes, so that whoever holds one (the loop, after Ctrl-C) has a
whole fit in hand. All of them evaluate the model by the same compiled program.
"""

import dataclasses
import functools
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, Protocol, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..models import capabilities
from ..recordings import Run
from ..runtime.arrays import Array, Float, on_device
from ..runtime.records import from_plain
from ._configuration import Setup
from ._coordinates import Bijector, names_of
from ._linearise import BlockJacobian, blank, residuals, stepped
from ._losses import Linear
from ._problem import Problem, RunBatch, build_batches, own_start, with_recorded
from ._records import Iteration, Status
from ._solver import Marquardt, MarquardtState, residual_scale
from ._weights import KeptNoise, Noise, Priors


def coordinate_paths(problem: Problem) -> list[str]:
    """Path of the parameter at each position of the free coordinate."""
    names = [""] * problem.size
    for path, places in zip(problem.paths, problem.positions, strict=True):
        for place in places:
            names[place] = path
    for batch in problem.batches:
        for columns in batch.own_columns():
            for label, column in zip(batch.own_labels(), columns.tolist(), strict=True):
                names[column] = label
    return names


def labels(problem: Problem, runs: Sequence[Run]) -> list[str]:
    """Names of all free coordinates, each with the runs that it belongs to, if that is not all."""
    sharing: dict[int, list[int]] = {}
    for batch in problem.batches:
        for member, columns in zip(batch.members, batch.columns(), strict=True):
            for column in columns.tolist():
                sharing.setdefault(column, []).append(member)
    common = {places[0] for places in problem.positions if len(places) == 1}
    return [
        path if index in common else f"{path} of {names_of([runs[i] for i in sorted(who)])}"
        for index, path in enumerate(coordinate_paths(problem))
        for who in [sharing[index]]
    ]


Reason = Literal[
    "optimum",
    "iterations",
    "budget",
    "rough",
    "wall",
    "crawl",
    "cannot_fit",
    "no_response",
    "interrupted",
    "",
]
"""As `FitResult.reason` has it; empty in a file of an earlier version."""


_NOISE_ROUNDS = 3  # how often the noise is estimated anew, unless it settles before


@dataclasses.dataclass(frozen=True)
class FitState:
    """One fit between two steps of its loop; arrays are of the free coordinates.

    Attributes:
        start: values of the free parameters, those of single runs last, which what is held keeps.
        sizes: their typical sizes, for judging whether anything responds to them.
        coordinate: the best point so far; `inner` is the solver's own state there.
        active: which may move.
        part: of the rows of each run, from the first, that count; less than 1 on the way from a
            start that is far off.
        finer: what a finer tolerance of the integrator changes of the residuals there; None where
            it was not requested.
        done: whether the solver wants no further step; `converged`, whether it is at an optimum.
        rounds_left: how often the noise may still be estimated again.
        round_began: how long the history was when noise or tolerance last changed.
        step_seconds: wall time of each evaluation; the first one compiles.
        ending: how the fit ended, one sentence about it, and the word of `FitResult.reason`; None
            while it goes on.
    """

    setup: Setup
    problem: Problem
    noise: Noise
    start: np.ndarray
    sizes: np.ndarray
    solver: Marquardt
    coordinate: Array
    inner: MarquardtState
    active: Array
    part: float = 1.0
    finer: np.ndarray | None = None
    done: bool = False
    converged: bool = False
    trials: int = 0
    rounds_left: int = _NOISE_ROUNDS
    round_began: int = 0
    history: tuple[Iteration, ...] = ()
    step_seconds: tuple[float, ...] = ()
    ending: tuple[Status, str, Reason] | None = None

    @property
    def cost(self) -> float:
        """Half the sum of the loss; infinite where nothing was evaluated."""
        return float(self.inner.cost)

    @property
    def evaluated(self) -> bool:
        """Whether the model was evaluated at the present point."""
        return bool(np.isfinite(self.cost))

    def values(self) -> np.ndarray:
        """Values of all free parameters at the best point, shape (parameter,)."""
        values = self.problem.bijector.forward(np.asarray(self.coordinate, dtype=float))
        # What is held keeps its start exactly, not as it comes back from its coordinate.
        return np.where(np.asarray(self.active), values, self.start)

    def parameters(self) -> dict[str, float]:
        """Values of the model's free parameters at the best point, by path.

        Of what has a value for each group of runs, the mean.
        """
        values, problem = self.values(), self.problem
        return {
            path: float(np.mean(values[list(places)]))
            for path, places in zip(problem.paths, problem.positions, strict=True)
        }

    @functools.cached_property
    def tolerance(self) -> float | None:
        """The tolerance in use; None of a model without an integrator."""
        integration = capabilities.integration(self.problem.model)
        return None if integration is None else integration.tolerance

    @functools.cached_property
    def jacobian(self) -> BlockJacobian:
        """Weighted residuals by the free coordinates; those that are held count as zero."""
        return self.jacobian_at(self.inner)

    def jacobian_at(self, inner: MarquardtState) -> BlockJacobian:
        """The same where another point was evaluated."""
        whole = BlockJacobian.of(self.problem, inner.jacobian)
        return whole.scaled(np.asarray(self.active, dtype=float))

    @functools.cached_property
    def natural_jacobian(self) -> BlockJacobian:
        """Weighted residuals by the parameters themselves."""
        slope = self.problem.bijector.slope(np.asarray(self.coordinate))
        return self.jacobian.scaled(1 / np.maximum(slope, 1e-300))

    def predicted_decrease(self) -> float:
        """By how much the linear model would lower the cost with its best step within the bounds.

        A fit has converged where that is little, and this is how little it is.
        """
        names = ("residual", "factor", "projected", "cost", "scale")
        parts: dict[str, Any] = {name: np.asarray(getattr(self.inner, name)) for name in names}
        inner = dataclasses.replace(self.inner, **parts)
        lower, upper = (np.asarray(each) for each in self.problem.bijector.ends())
        options, coordinate = {"lower": lower, "upper": upper}, np.asarray(self.coordinate)
        return float(self.solver.explainable_norm(coordinate, options, inner, maths=np)) ** 2 / 2

    def residual_scale(self) -> float:
        """The size of the residuals in units of their noise: the root of the reduced chi-square."""
        # By numpy: each operation of JAX here would be a program of its own.
        cost: Any = np.asarray(self.inner.cost)
        return float(residual_scale(dataclasses.replace(self.inner, cost=cost)))

    def recorded(self, *, accepted: bool) -> Self:
        """With the present point as the last entry of the history."""
        iteration = Iteration(
            number=self.trials,
            cost=self.cost,
            step=float(np.max(np.abs(np.asarray(self.inner.step)), initial=0.0)),
            accepted=accepted,
            parameters=self.parameters(),
            part=self.part,
        )
        return dataclasses.replace(self, history=(*self.history, iteration))

    def next_round(self) -> Self:
        """With one estimation of the noise less."""
        return dataclasses.replace(
            self,
            rounds_left=self.rounds_left - 1,
            round_began=len(self.history),
            done=False,
            converged=False,
        )

    def ended(self, status: Status, message: str, reason: Reason) -> Self:
        """The end of the fit."""
        return dataclasses.replace(self, ending=(status, message, reason))


# In the free coordinate: a positive parameter grows by less than a factor of 6 in one step, and far
# above its start by less than 4.5.
_LARGEST_STEP = 1.5

# Where an evaluation with derivatives takes longer than this, s, residuals without them are worth a
# program of their own, which takes seconds to compile: at the end of a fit they are asked for
# several times. The number of steps grows as tolerance^(-1/5) for a method of order 5; for others
# that is a rough guess.
_LONG_STEP, _ORDER = 1.0, 5

_MANY_ROWS = 5_000  # with so many rows a step is known to be long before any was timed

# Where a fit begins that chooses its tolerance. Recordings with many rows tell more: a fit of them
# would only find out, by two evaluations, that the first one is too coarse.
_COARSEST, _COARSEST_OF_MANY = 1e-5, 3e-6


def begin(setup: Setup) -> FitState:
    """The state before anything is evaluated."""
    setup = setup.at_start()
    model, parameters, layout = setup.model, setup.parameters, setup.layout
    noise = Noise.of(setup.runs, setup.settings.noise_model, per_run=setup.settings.noise_per_run)
    batches = build_batches(model, setup.runs, noise, layout)
    if setup.chooses_tolerance:
        coarsest = _COARSEST_OF_MANY if _have_many_rows(batches) else _COARSEST
        model = capabilities.with_integration(
            model, solver=None, tolerance=setup.suited or coarsest
        )
    own = own_start(batches, setup.runs, setup.own)
    # Each value of a parameter, of which there is one for all runs or one for each group of them.
    each = [p for p, places in zip(parameters, layout.places, strict=True) for _ in places]
    start = np.asarray([*setup.starts(), *own])
    # Values of one path share a map, whose coordinates are those of its first value.
    first = [places[0] for places in layout.places for _ in places]
    # A parameter whose start and default are zero has no size of its own: one unit.
    defaults = np.asarray([*(p.declaration.default for p in each), *(0.0 for _ in own)])
    sizes = np.maximum(np.abs(start), np.abs(defaults))
    sizes = np.where(sizes > 0, sizes, 1.0)
    bijector = Bijector.of(
        (*(p.declaration.lower for p in each), *(-np.inf for _ in own)),
        (*(p.declaration.upper for p in each), *(np.inf for _ in own)),
        (*start[first], *own),
        sizes,
    )
    problem = Problem(
        model=model,
        batches=batches,
        bijector=bijector,
        paths=tuple(p.path for p in parameters),
        loss=setup.loss,
        places=layout.places,
        ties=setup.ties,
    )
    known = Priors.of(setup.priors, coordinate_paths(problem))
    problem = dataclasses.replace(problem, priors=known)
    # In 32-bit the rounding of a simulation hides the last hundredth of a standard error.
    distance = 0.1 if jnp.result_type(float) == jnp.float32 else 0.01
    solver = Marquardt(
        distance=distance,
        # Residuals of this norm, in units of the noise, move no parameter by more than that.
        floor=distance**2 / 2,
        largest_step=_LARGEST_STEP,
    )
    coordinate = on_device(bijector.inverse(start), jnp.result_type(float))
    return FitState(
        setup=setup,
        problem=problem,
        noise=noise,
        start=start,
        sizes=sizes,
        solver=solver,
        coordinate=coordinate,
        inner=blank(solver, problem, coordinate),
        active=on_device(np.ones(problem.size, bool)),
    )


def step(state: FitState) -> FitState:
    """One trial step; at a point that was not evaluated yet, its evaluation."""
    began = time.perf_counter()
    coordinate, inner, done, converged = stepped(
        state.solver, state.coordinate, state.problem, state.inner, state.active
    )
    # Waits for the result, so that the time below is that of the step.
    finished, optimum = bool(done), bool(converged)
    return dataclasses.replace(
        state,
        coordinate=coordinate,
        inner=inner,
        finer=None if bool(inner.accepted) else state.finer,
        done=finished,
        converged=optimum,
        step_seconds=(*state.step_seconds, time.perf_counter() - began),
    )


def trial(state: FitState) -> FitState:
    """One trial step, counted and recorded in the history."""
    tried = dataclasses.replace(step(state), trials=state.trials + 1)
    return tried.recorded(accepted=bool(tried.inner.accepted))


def move(state: FitState, coordinate: Any) -> FitState:
    """Continue from another point, which is not evaluated yet."""
    coordinate = on_device(coordinate, state.coordinate.dtype)
    inner = blank(state.solver, state.problem, coordinate)
    return dataclasses.replace(state, coordinate=coordinate, inner=inner, finer=None)


def in_coordinates(state: FitState, bijector: Bijector) -> FitState:
    """Continue from the same point in other coordinates; not evaluated yet."""
    coordinate = bijector.inverse(state.values())
    problem = dataclasses.replace(state.problem, bijector=bijector)
    return move(dataclasses.replace(state, problem=problem), coordinate)


def counting(state: FitState, part: float) -> FitState:
    """The same point with the first part of the rows of each run, which is not evaluated yet."""
    runs = state.setup.runs
    recorded = [run.observations for run in runs]
    batches = []
    for batch in with_recorded(state.problem.batches, runs, state.noise, recorded):
        weight = np.array(batch.weight)
        weight[:, math.ceil(part * weight.shape[1]) :] = 0
        counted = on_device(weight, batch.weight.dtype)
        batches.append(eqx.tree_at(lambda batch: batch.weight, batch, counted))
    problem = dataclasses.replace(state.problem, batches=tuple(batches))
    state = dataclasses.replace(state, problem=problem, part=part)
    return move(dataclasses.replace(state, round_began=len(state.history)), state.coordinate)


def reweight(state: FitState, noise: Noise) -> FitState:
    """Continue from the same point with another noise; not evaluated yet."""
    runs = state.setup.runs
    batches = with_recorded(state.problem.batches, runs, noise, [run.observations for run in runs])
    # Weights of cells take the place of a robust loss: whitened residuals are no single cells.
    loss = state.setup.loss if noise.weights is None else Linear()
    problem = dataclasses.replace(state.problem, batches=batches, loss=loss)
    moved = move(dataclasses.replace(state, problem=problem, noise=noise), state.coordinate)
    # The valley is nearly the same one: a fit that knew it keeps its long steps.
    before, anew = state.inner.damping, moved.inner.damping
    damping = on_device(np.minimum(np.asarray(before), np.asarray(anew)))
    return dataclasses.replace(
        moved, inner=eqx.tree_at(lambda inner: inner.damping, moved.inner, damping)
    )


def at_tolerance(state: FitState, tolerance: float | None) -> FitState:
    """Continue from the same point with another tolerance, if any; not evaluated yet."""
    if tolerance == state.tolerance:
        return state
    model = capabilities.with_integration(state.problem.model, solver=None, tolerance=tolerance)
    problem = dataclasses.replace(state.problem, model=model)
    # Costs before it say nothing of those to come.
    state = dataclasses.replace(state, problem=problem, round_began=len(state.history))
    return move(state, state.coordinate)


def evaluate(
    state: FitState, coordinate: Any, problem: Problem | None = None, *, sample: bool = False
) -> MarquardtState:
    """The solver's state at a point, by the same compiled program as a step.

    Of several runs a `sample` has one or a few evaluated, and zeros for the others.
    """
    coordinate = on_device(coordinate, state.coordinate.dtype)
    problem = state.problem if problem is None else problem
    fresh = blank(state.solver, problem, coordinate)
    _, inner, _, _ = stepped(state.solver, coordinate, problem, fresh, state.active, sample=sample)
    return inner


def residuals_at(
    state: FitState, coordinate: Any, problem: Problem | None = None, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Residuals at a point within the bounds, without derivatives where those take long.

    A `sample` is as of `evaluate`; NaN where the model cannot be evaluated.
    """
    problem = state.problem if problem is None else problem
    if _seconds(state, problem) < _LONG_STEP and not has_many_rows(state):
        inner = evaluate(state, coordinate, problem, sample=sample)
        row = np.asarray(inner.residual)
        return row if np.isfinite(inner.cost) else np.full(row.shape, np.nan)
    coordinate = on_device(coordinate, state.coordinate.dtype)
    return residuals(coordinate, problem, sample=sample)


def _seconds(state: FitState, problem: Problem) -> float:
    """How long an evaluation with derivatives takes, by the last ones, at another tolerance."""
    # The first one compiles, and one may have been held up.
    took = min(state.step_seconds[1:][-2:], default=0.0)
    finer = capabilities.integration(problem.model)
    if state.tolerance is None or finer is None or finer.tolerance is None:
        return took
    return took * (state.tolerance / finer.tolerance) ** (1 / _ORDER)


def has_many_rows(state: FitState) -> bool:
    """Whether one of the recordings is so long that each evaluation counts."""
    return _have_many_rows(state.problem.batches)


def _have_many_rows(batches: Iterable[RunBatch]) -> bool:
    return any(batch.observed.shape[1] > _MANY_ROWS for batch in batches)


# A state of a fit as plain data, from which the fit goes on bit for bit.
#
# Residual and Jacobian are not among them: the same compiled program computes them anew at the
# same point. Python's JSON gives every float back as it was.

# The numbers of the solver that its next step depends on, apart from what is evaluated anew.
_SOLVER = ("damping", "growth", "scale", "step", "accepted", "detour", "finite", "evaluations")

_STORED = {"finite": "sound"}  # their names in a journal, where they are others

# Attributes of a state that a line has as they are.
_AS_THEY_ARE = ("part", "trials", "done", "converged", "rounds_left", "round_began", "ending")

CHANGED = "the journal belongs to another fit, or one of its lines was changed"


@dataclasses.dataclass(frozen=True, kw_only=True)
class KeptState:
    """A state of a fit as a line of its journal has it; attributes of `FitState` where not said.

    Attributes:
        cost: shows whether this machine computes the same.
        solver: numbers of the solver by name, those of `_SOLVER`.
        tolerance: of the integration; None of a model without one, and of an earlier version.
        distances: from the lower bounds, which make the coordinates (`Bijector.linear_within`);
            None of an earlier version, whose coordinates are those of the start.
        history, step_seconds: what has come since the line before.
        seconds: that the fit has taken.
    """

    trials: int
    cost: float
    coordinate: list[float]
    active: list[bool]
    solver: dict[str, bool | float | list[float]]
    done: bool
    converged: bool
    rounds_left: int
    round_began: int
    noise: KeptNoise
    tolerance: float | None = None
    distances: list[float] | None = None
    part: float = 1.0
    history: tuple[Iteration, ...]
    step_seconds: tuple[float, ...]
    seconds: float
    ending: tuple[Status, str, Reason] | None


class FitJournal(Protocol):
    """Where a fit writes what it has reached, and finds the lines of before, oldest first."""

    @property
    def lines(self) -> Sequence[Mapping[str, Any]]: ...

    def append(self, line: Mapping[str, Any]) -> None:
        """Keep one more line; it must not fail, because a fit does not end for that."""

    def bits_differ(self) -> None:
        """Called where a kept point has another cost now: the end may differ in its last digits."""


def restored(begun: FitState, journal: FitJournal) -> tuple[FitState, float]:
    """The last state that a journal holds, evaluated again, and the seconds of the fit up to it.

    Raises:
        InputError, ValueError, LookupError, TypeError: a line is not of this fit.
    """
    if not journal.lines:
        return begun, 0.0
    records = [{name: one for name, one in line.items() if name != "fit"} for line in journal.lines]
    remedy = "start again without the journal"
    lines = [from_plain(KeptState, record, CHANGED, remedy) for record in records]
    last = lines[-1]
    coordinate, active = np.asarray(last.coordinate, dtype=float), np.asarray(last.active)
    if coordinate.shape != begun.coordinate.shape or active.shape != coordinate.shape:
        raise ValueError("has a different number of free coordinates")
    if last.distances is not None:
        begun = in_coordinates(begun, begun.problem.bijector.linear_within(last.distances))
    there = at_tolerance(reweight(begun, begun.noise.again(last.noise)), last.tolerance)
    if last.part < 1:
        there = counting(there, last.part)
    there = dataclasses.replace(move(there, coordinate), active=jnp.asarray(active))
    there = step(there)
    if there.cost != last.cost:
        journal.bits_differ()
    state = dataclasses.replace(
        there,
        inner=_with_solver(there.inner, last.solver),
        history=tuple(item for line in lines for item in line.history),
        step_seconds=tuple(item for line in lines for item in line.step_seconds),
        **{name: getattr(last, name) for name in _AS_THEY_ARE},
    )
    return state, last.seconds


def journal_writer(state: FitState, journal: FitJournal, elapsed: Callable[[], float]) -> Callable:
    """A function that writes each state that a fit reaches into its journal."""
    shown, stepped = len(state.history), len(state.step_seconds)

    def keep(reached: FitState) -> None:
        nonlocal shown, stepped
        inner = reached.inner
        line = KeptState(
            **{name: getattr(reached, name) for name in _AS_THEY_ARE},
            cost=reached.cost,
            coordinate=np.asarray(reached.coordinate).tolist(),
            active=np.asarray(reached.active).tolist(),
            solver={_STORED.get(k, k): np.asarray(getattr(inner, k)).tolist() for k in _SOLVER},
            noise=reached.noise.kept(),
            tolerance=reached.tolerance,
            distances=reached.problem.bijector.distances().tolist(),
            history=reached.history[shown:],
            step_seconds=reached.step_seconds[stepped:],
            seconds=elapsed(),
        )
        shown, stepped = len(reached.history), len(reached.step_seconds)
        journal.append(dataclasses.asdict(line))

    return keep


def _with_solver(inner: MarquardtState, stored: Mapping[str, Any]) -> MarquardtState:
    """The solver's state with its stored numbers, in the types that the program is compiled for."""
    values = []
    for name in _SOLVER:
        before = getattr(inner, name)
        value = jnp.asarray(stored[_STORED.get(name, name)], dtype=before.dtype)
        if value.shape != before.shape:
            raise ValueError(f"{name} has a different shape")
        values.append(value)
    return eqx.tree_at(lambda inner: [getattr(inner, name) for name in _SOLVER], inner, values)
