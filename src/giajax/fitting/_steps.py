"""State of a fit between two steps as frozen data, and pure functions that return the next state.

No function changes its argument, so a caller that has a state (such as the loop after Ctrl-C) has a
complete fit. All functions evaluate the model with the same compiled program.
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
    """Return the path of the parameter at each position of the free coordinate."""
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
    """Return the names of all free coordinates, with their runs unless all runs share them."""
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
"""Values of `FitResult.reason`; empty if an earlier version wrote the result."""


_NOISE_ROUNDS = 3  # maximum number of noise estimates, unless the noise converges earlier


@dataclasses.dataclass(frozen=True)
class FitState:
    """A fit between two steps of its loop. Arrays contain one value for each free coordinate.

    Attributes:
        setup: configuration of the fit.
        problem: least-squares problem.
        noise: noise with which the residuals are weighted.
        start: initial values of the free parameters, those of single runs last. Held parameters
            keep them.
        sizes: typical sizes of the parameters, used to decide whether a channel responds to them.
        solver: least-squares solver.
        coordinate: best point so far.
        inner: state of the solver at this point.
        active: which coordinates may move.
        part: fraction of the rows of each run in use, counted from the first. It is less than 1
            after a poor initial guess.
        finer: change of the residuals at this point at a finer integrator tolerance, or None if it
            was not computed.
        done: whether the solver has ended.
        converged: whether the solver is at an optimum.
        trials: number of trial steps.
        rounds_left: remaining number of noise estimates.
        round_began: length of the history when the noise or the tolerance last changed.
        history: initial guess and each iteration.
        step_seconds: wall-clock time of each evaluation. The first one includes the compilation.
        ending: how the fit ended, a sentence about it, and the value of `FitResult.reason`. None
            while the fit is running.
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
        """Half the sum of the losses, infinite if nothing was evaluated."""
        return float(self.inner.cost)

    @property
    def evaluated(self) -> bool:
        """Whether the model was evaluated at the current point."""
        return bool(np.isfinite(self.cost))

    def values(self) -> np.ndarray:
        """Return the values of all free parameters at the best point, shape (parameter,)."""
        values = self.problem.bijector.forward(np.asarray(self.coordinate, dtype=float))
        # Held parameters keep their initial values exactly, without rounding by the coordinate.
        return np.where(np.asarray(self.active), values, self.start)

    def parameters(self) -> dict[str, float]:
        """Return the values of the model's free parameters at the best point, by path.

        The values of groups of runs are averaged.
        """
        values, problem = self.values(), self.problem
        return {
            path: float(np.mean(values[list(places)]))
            for path, places in zip(problem.paths, problem.positions, strict=True)
        }

    @functools.cached_property
    def tolerance(self) -> float | None:
        """Tolerance in use, or None for a model without an integrator."""
        integration = capabilities.integration(self.problem.model)
        return None if integration is None else integration.tolerance

    @functools.cached_property
    def jacobian(self) -> BlockJacobian:
        """Jacobian of the weighted residuals by the free coordinates, zero for held coordinates."""
        return self.jacobian_at(self.inner)

    def jacobian_at(self, inner: MarquardtState) -> BlockJacobian:
        """Return the same Jacobian at another evaluated point."""
        whole = BlockJacobian.of(self.problem, inner.jacobian)
        return whole.scaled(np.asarray(self.active, dtype=float))

    @functools.cached_property
    def natural_jacobian(self) -> BlockJacobian:
        """Jacobian of the weighted residuals with respect to the parameters themselves."""
        slope = self.problem.bijector.slope(np.asarray(self.coordinate))
        return self.jacobian.scaled(1 / np.maximum(slope, 1e-300))

    def predicted_decrease(self) -> float:
        """Return the decrease of the cost that the linear model predicts for its best step.

        The step stays within the bounds. A fit has converged if this decrease is small.
        """
        names = ("residual", "factor", "projected", "cost", "scale")
        parts: dict[str, Any] = {name: np.asarray(getattr(self.inner, name)) for name in names}
        inner = dataclasses.replace(self.inner, **parts)
        lower, upper = (np.asarray(each) for each in self.problem.bijector.ends())
        options, coordinate = {"lower": lower, "upper": upper}, np.asarray(self.coordinate)
        return float(self.solver.explainable_norm(coordinate, options, inner, maths=np)) ** 2 / 2

    def residual_scale(self) -> float:
        """Return the ratio of the residuals to their noise: the root of the reduced chi-square."""
        # NumPy is used, because each operation of JAX would be a separate program.
        cost: Any = np.asarray(self.inner.cost)
        return float(residual_scale(dataclasses.replace(self.inner, cost=cost)))

    def recorded(self, *, accepted: bool) -> Self:
        """Return the state with the current point as the last entry of the history."""
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
        """Return the state with one noise estimate less remaining."""
        return dataclasses.replace(
            self,
            rounds_left=self.rounds_left - 1,
            round_began=len(self.history),
            done=False,
            converged=False,
        )

    def ended(self, status: Status, message: str, reason: Reason) -> Self:
        """Return the state at the end of the fit."""
        return dataclasses.replace(self, ending=(status, message, reason))


# Largest step in the free coordinate: a positive parameter grows by less than a factor of 6 in one
# step, and by less than 4.5 if it is far above its initial value.
_LARGEST_STEP = 1.5

# If an evaluation with derivatives takes longer than this, s, a separate program for residuals
# alone is worthwhile. It takes seconds to compile, and is called several times at the end of a fit.
# The number of steps grows as tolerance^(-1/5) for a method of order 5. For other methods that is a
# rough approximation.
_LONG_STEP, _ORDER = 1.0, 5

_MANY_ROWS = 5_000  # with more rows a step is long, even before the first one was timed

# Initial tolerance of a fit that chooses its tolerance. Recordings with many rows contain more
# information, and such a fit would only spend two evaluations to reject the coarser value.
_COARSEST, _COARSEST_OF_MANY = 1e-5, 3e-6


def begin(setup: Setup) -> FitState:
    """Return the state before anything is evaluated."""
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
    # Each parameter has one value for all runs or one for each group of runs.
    each = [p for p, places in zip(parameters, layout.places, strict=True) for _ in places]
    start = np.asarray([*setup.starts(), *own])
    # Values of one path share a map, which is determined by the first value.
    first = [places[0] for places in layout.places for _ in places]
    # A parameter whose initial value and default are zero has a size of one unit.
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
    # In 32 bit, the rounding of a simulation hides the last hundredth of a standard error.
    distance = 0.1 if jnp.result_type(float) == jnp.float32 else 0.01
    solver = Marquardt(
        distance=distance,
        # Residuals with this norm, relative to the noise, move no parameter by more than
        # `distance`.
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
    """Make one trial step. At a point that was not evaluated yet, evaluate it."""
    began = time.perf_counter()
    coordinate, inner, done, converged = stepped(
        state.solver, state.coordinate, state.problem, state.inner, state.active
    )
    # Wait for the result, so that the time below is that of the step.
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
    """Make one trial step, count it, and record it in the history."""
    tried = dataclasses.replace(step(state), trials=state.trials + 1)
    return tried.recorded(accepted=bool(tried.inner.accepted))


def move(state: FitState, coordinate: Any) -> FitState:
    """Continue from another point, which is not evaluated yet."""
    coordinate = on_device(coordinate, state.coordinate.dtype)
    inner = blank(state.solver, state.problem, coordinate)
    return dataclasses.replace(state, coordinate=coordinate, inner=inner, finer=None)


def in_coordinates(state: FitState, bijector: Bijector) -> FitState:
    """Continue from the same point in other coordinates, without evaluating it."""
    coordinate = bijector.inverse(state.values())
    problem = dataclasses.replace(state.problem, bijector=bijector)
    return move(dataclasses.replace(state, problem=problem), coordinate)


def counting(state: FitState, part: float) -> FitState:
    """Continue with the first part of the rows of each run, without evaluating the point."""
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
    """Continue from the same point with different noise, without evaluating it."""
    runs = state.setup.runs
    batches = with_recorded(state.problem.batches, runs, noise, [run.observations for run in runs])
    # Weights of cells replace a robust loss, because whitened residuals are not single cells.
    loss = state.setup.loss if noise.weights is None else Linear()
    problem = dataclasses.replace(state.problem, batches=batches, loss=loss)
    moved = move(dataclasses.replace(state, problem=problem, noise=noise), state.coordinate)
    # The valley is almost the same, so a fit that has explored it keeps its long steps.
    before, anew = state.inner.damping, moved.inner.damping
    damping = on_device(np.minimum(np.asarray(before), np.asarray(anew)))
    return dataclasses.replace(
        moved, inner=eqx.tree_at(lambda inner: inner.damping, moved.inner, damping)
    )


def at_tolerance(state: FitState, tolerance: float | None) -> FitState:
    """Continue from the same point at another tolerance, if any, without evaluating it."""
    if tolerance == state.tolerance:
        return state
    model = capabilities.with_integration(state.problem.model, solver=None, tolerance=tolerance)
    problem = dataclasses.replace(state.problem, model=model)
    # Costs at the previous tolerance cannot be compared with later ones.
    state = dataclasses.replace(state, problem=problem, round_began=len(state.history))
    return move(state, state.coordinate)


def evaluate(
    state: FitState, coordinate: Any, problem: Problem | None = None, *, sample: bool = False
) -> MarquardtState:
    """Return the state of the solver at a point, with the same compiled program as a step.

    With `sample`, only one or a few of several runs are evaluated, and the others are zero.
    """
    coordinate = on_device(coordinate, state.coordinate.dtype)
    problem = state.problem if problem is None else problem
    fresh = blank(state.solver, problem, coordinate)
    _, inner, _, _ = stepped(state.solver, coordinate, problem, fresh, state.active, sample=sample)
    return inner


def residuals_at(
    state: FitState, coordinate: Any, problem: Problem | None = None, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Return the residuals at a point within the bounds, without derivatives if these take long.

    `sample` has the same effect as in `evaluate`. The residuals are NaN if the model cannot be
    evaluated.
    """
    problem = state.problem if problem is None else problem
    if _seconds(state, problem) < _LONG_STEP and not has_many_rows(state):
        inner = evaluate(state, coordinate, problem, sample=sample)
        row = np.asarray(inner.residual)
        return row if np.isfinite(inner.cost) else np.full(row.shape, np.nan)
    coordinate = on_device(coordinate, state.coordinate.dtype)
    return residuals(coordinate, problem, sample=sample)


def _seconds(state: FitState, problem: Problem) -> float:
    """Return the expected time of an evaluation with derivatives at another tolerance, s."""
    # The first evaluation includes compilation, and a later one may have been delayed.
    took = min(state.step_seconds[1:][-2:], default=0.0)
    finer = capabilities.integration(problem.model)
    if state.tolerance is None or finer is None or finer.tolerance is None:
        return took
    return took * (state.tolerance / finer.tolerance) ** (1 / _ORDER)


def has_many_rows(state: FitState) -> bool:
    """Return whether a recording is so long that the number of evaluations matters."""
    return _have_many_rows(state.problem.batches)


def _have_many_rows(batches: Iterable[RunBatch]) -> bool:
    return any(batch.observed.shape[1] > _MANY_ROWS for batch in batches)


# State of a fit as plain data, from which the fit continues with identical bits.
#
# Residual and Jacobian are not stored, because the same compiled program recomputes them at the
# same point. JSON in Python preserves every float exactly.

# Values of the solver on which its next step depends, apart from those that are recomputed.
_SOLVER = ("damping", "growth", "scale", "step", "accepted", "detour", "finite", "evaluations")

_STORED = {"finite": "sound"}  # names in a journal that differ from those of the attributes

# Attributes of a state that are stored unchanged.
_AS_THEY_ARE = ("part", "trials", "done", "converged", "rounds_left", "round_began", "ending")

CHANGED = "the journal belongs to another fit, or one of its lines was changed"


@dataclasses.dataclass(frozen=True, kw_only=True)
class KeptState:
    """State of a fit as a line of its journal. Other attributes are those of `FitState`.

    Attributes:
        cost: cost, which shows whether this machine computes the same value.
        solver: values of the solver by name, as in `_SOLVER`.
        tolerance: tolerance of the integration, or None for a model without one, and for an earlier
            version.
        distances: distances from the lower bounds, which define the coordinates
            (`Bijector.linear_within`). None for an earlier version, whose coordinates are those of
            the start.
        history, step_seconds: entries since the previous line.
        seconds: elapsed time of the fit, s.
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
    """Destination of the states of a fit, with the lines of an earlier call, oldest first."""

    @property
    def lines(self) -> Sequence[Mapping[str, Any]]: ...

    def append(self, line: Mapping[str, Any]) -> None:
        """Store one more line. It must not fail, because a fit does not end for that reason."""

    def bits_differ(self) -> None:
        """Report that a stored point has another cost now, so the result may differ slightly."""


def restored(begun: FitState, journal: FitJournal) -> tuple[FitState, float]:
    """Return the last state in a journal, evaluated again, and the elapsed time of the fit, s.

    Raises:
        InputError, ValueError, LookupError, TypeError: a line does not belong to this fit.
    """
    if not journal.lines:
        return begun, 0.0
    records = [{name: one for name, one in line.items() if name != "fit"} for line in journal.lines]
    remedy = "start again without the journal"
    lines = [from_plain(KeptState, record, CHANGED, remedy) for record in records]
    last = lines[-1]
    coordinate, active = np.asarray(last.coordinate, dtype=float), np.asarray(last.active)
    if coordinate.shape != begun.coordinate.shape or active.shape != coordinate.shape:
        raise ValueError("differs from this fit in the number of free coordinates")
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
    """Return a function that writes each state of a fit to its journal."""
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
    """Return the solver state with its stored values, in the types of the compiled program."""
    values = []
    for name in _SOLVER:
        before = getattr(inner, name)
        value = jnp.asarray(stored[_STORED.get(name, name)], dtype=before.dtype)
        if value.shape != before.shape:
            raise ValueError(f"{name} has a different shape")
        values.append(value)
    return eqx.tree_at(lambda inner: [getattr(inner, name) for name in _SOLVER], inner, values)
