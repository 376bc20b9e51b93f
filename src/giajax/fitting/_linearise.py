"""The least-squares problem to first order: a block of the Jacobian a run, and their triangle."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..runtime.arrays import Array, Float
from ..runtime.parallel import Batch, run_on_all_cores
from ..runtime.programs import program
from ._coordinates import Bijector
from ._problem import (
    Prediction,
    Problem,
    RunBatch,
    chunk_size,
    joined,
    over_batch,
    over_runs,
    residual,
    run_residual,
    sample_size,
    whitened,
    whitened_run,
)
from ._solver import Linearised, Marquardt, MarquardtState, with_jacobian

Row = Float[np.ndarray, " residual"]


@dataclasses.dataclass(frozen=True)
class BlockJacobian:
    """Residuals by parameters, run by run.

    Attributes:
        blocks: of each run, shape (row, column).
        columns: which parameters the columns of each block belong to.
        size: number of parameters.
    """

    blocks: Sequence[Float[np.ndarray, "row column"]]
    columns: Sequence[np.ndarray]
    size: int

    @classmethod
    def of(cls, problem: Problem, blocks: Sequence[object]) -> Self:
        """The Jacobian from the blocks of each batch of runs, and the slopes of the priors."""
        *stacks, slopes = blocks
        rows, columns = [], []
        for batch, stacked in zip(problem.batches, stacks, strict=True):
            for block, own in zip(np.asarray(stacked), batch.columns(), strict=True):
                rows.append(np.asarray(block, dtype=float))
                columns.append(own)
        if len(problem.priors.columns):
            rows.append(np.diag(np.asarray(slopes, dtype=float)))
            columns.append(np.asarray(problem.priors.columns))
        return cls(rows, columns, problem.size)

    @classmethod
    def dense(cls, matrix: Float[np.ndarray, "residual parameter"]) -> Self:
        """One block that is the whole matrix."""
        return cls([matrix], [np.arange(matrix.shape[1])], matrix.shape[1])

    def scaled(self, factors: Float[np.ndarray, " parameter"]) -> Self:
        """With each column times a number."""
        blocks = [b * factors[c] for b, c in zip(self.blocks, self.columns, strict=True)]
        return dataclasses.replace(self, blocks=blocks)

    def norms(self) -> Float[np.ndarray, " parameter"]:
        """Norms of the columns."""
        squares = np.zeros(self.size)
        for block, columns in zip(self.blocks, self.columns, strict=True):
            squares[columns] += np.sum(block**2, axis=0)
        return np.sqrt(squares)

    def times(self, vector: Float[np.ndarray, " parameter"]) -> Row:
        """Matrix times a vector."""
        return np.concatenate(
            [block @ vector[c] for block, c in zip(self.blocks, self.columns, strict=True)]
        )

    def transposed_times(self, row: Row) -> Float[np.ndarray, " parameter"]:
        """Transposed matrix times a vector."""
        total = np.zeros(self.size)
        start = 0
        for block, columns in zip(self.blocks, self.columns, strict=True):
            total[columns] += block.T @ row[start : start + len(block)]
            start += len(block)
        return total

    def reduced(self, weights: Row | None = None) -> Float[np.ndarray, "row parameter"]:
        """A small matrix R with R^T R = J^T diag(weights)^2 J, by QR of each block."""
        parts, start = [], 0
        for block, columns in zip(self.blocks, self.columns, strict=True):
            if weights is not None:
                block = block * weights[start : start + len(block), None]
                start += len(block)
            triangle = np.linalg.qr(block, mode="r")
            placed = np.zeros((len(triangle), self.size))
            placed[:, columns] = triangle
            parts.append(placed)
        return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))


def linearise(coordinate: Float[Array, " parameter"], problem: Problem) -> Linearised:
    """Residual, Jacobian in blocks, its triangular factor R, Q^T r, and the predictions."""
    return assembled(over_runs(linearise_run, coordinate, problem), coordinate, problem)


def linearise_run(
    values: Array, problem: Problem, batch: RunBatch, run: tuple[Any, ...]
) -> tuple[Array, ...]:
    """A run's residual, block of the Jacobian, triangle of both, prediction, and success.

    The block, shape (row, shared + own), comes from one vmapped jvp by the run's own coordinates;
    no derivative by the parameters of another one is ever computed. It is reduced to a triangle by
    itself.
    """
    row, block, aux = with_jacobian(lambda v: run_residual(v, problem, batch, run), values)
    # Linear, so it comes after the derivatives, and costs one pass over all columns.
    whole = whitened(jnp.concatenate([block, row[:, None]], axis=1), run[-1])
    block, row = whole[:, :-1], whole[:, -1]
    if not problem.loss.is_linear:
        _, observed, weight, _ = run
        difference = jnp.where(weight > 0, (aux[0] - observed) * weight, 0).ravel()
        measured = (weight > 0).ravel().astype(row.dtype)
        ratio = problem.loss.curvature_ratio(difference, measured)[:, None]
        whole = jnp.concatenate([whole[:, :-1] * ratio, whole[:, -1:] / ratio], axis=1)
    # A failed run has NaN here; its step is rejected, and nobody reads the triangle.
    triangle = jnp.linalg.qr(jnp.where(jnp.isfinite(whole), whole, 0), mode="r")
    missing = whole.shape[1] - triangle.shape[0]
    return row, block, jnp.pad(triangle, ((0, missing), (0, 0))), *aux


def assembled(parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem) -> Linearised:
    """What `linearise_run` found of the runs of each batch, and the priors, as one problem.

    The triangles together are reduced to R: an orthogonal reduction, as QR of the whole. Beside it
    blocks of each batch, (run, row, shared + own), and derivatives of the priors' rows, (prior,).
    """
    rows, blocks, triangles, tables, successes = zip(*parts, strict=True)
    known, slopes = problem.priors.rows(coordinate, problem.bijector)
    placed = [_placed(t, g, problem) for t, g in zip(triangles, problem.batches, strict=True)]
    priors = jnp.zeros((len(known), problem.size + 1), known.dtype).at[:, -1].set(known)
    columns = np.asarray(problem.priors.columns, dtype=int)
    priors = priors.at[np.arange(len(known)), columns].set(slopes)
    whole = jnp.concatenate([*placed, priors])
    if whole.shape[0] > whole.shape[1]:
        whole = jnp.linalg.qr(whole, mode="r")
    row = jnp.concatenate([*(part.ravel() for part in rows), known])
    prediction = Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))
    return row, (*blocks, slopes), whole[:-1, :-1], whole[:-1, -1], prediction


def _placed(triangles: Float[Array, "run row column"], batch: RunBatch, problem: Problem) -> Array:
    """Triangles of a batch's runs, with their columns where they belong in the whole."""
    runs, count, _ = triangles.shape
    whole = jnp.zeros((runs, count, problem.size + 1), triangles.dtype)
    whole = whole.at[:, :, -1].set(triangles[:, :, -1])
    at = np.ix_(np.arange(runs), np.arange(count))
    columns = batch.columns()[:, None, :]
    whole = whole.at[at[0][..., None], at[1][..., None], columns].set(triangles[:, :, :-1])
    return whole.reshape(runs * count, -1)


# The compiled programs of a fit.
#
# At module level: a fresh closure would be compiled again for every fit.

Stepped = tuple[Array, MarquardtState, Any, Any]
"""Where the solver is, its state there, whether it is done, and whether at an optimum."""


@program
def step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> Stepped:
    options = _options(problem.bijector, active) | {"linearise": linearise}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    return _ended(solver, coordinate, problem, state, options)


@program
def propose(
    solver: Marquardt, coordinate: Array, bijector: Bijector, state: MarquardtState, active: Array
) -> Array:
    return solver.propose(coordinate, _options(bijector, active), state)


@program
def judge(
    solver: Marquardt,
    coordinate: Array,
    trial: Array,
    parts: Any,
    problem: Problem,
    state: MarquardtState,
    active: Array,
) -> Stepped:
    options = _options(problem.bijector, active)
    there = assembled(parts, trial, problem)
    coordinate, state = solver.judge(coordinate, options, state, trial, there)
    return _ended(solver, coordinate, problem, state, options)


@program
def linearised(runs: tuple[Array, RunBatch], problem: Problem) -> tuple[Array, ...]:
    values, batch = runs
    return over_batch(linearise_run, values, batch, problem)


@program
def predicted(runs: tuple[Array, RunBatch], problem: Problem) -> tuple[Array, ...]:
    values, batch = runs
    return over_batch(whitened_run, values, batch, problem)


def result_row(coordinate: Array, problem: Problem) -> Any:
    count = sum(batch.observed.size for batch in problem.batches) + len(problem.priors.columns)
    return jax.ShapeDtypeStruct((count,), coordinate.dtype)


@program
def residual_row(coordinate: Array, problem: Problem) -> Array:
    row, prediction = residual(coordinate, problem)
    return jnp.where(prediction.successful, row, jnp.nan)


@program
def joined_row(parts: Any, coordinate: Array, problem: Problem) -> Array:
    row, prediction = joined(parts, coordinate, problem)
    return jnp.where(prediction.successful, row, jnp.nan)


def _moving_row(y: Array, args: tuple[Problem, Array, Array]) -> Array:
    """The residual by the coordinates that move, on a side of the box where they leave it."""
    problem, coordinate, places = args
    there = coordinate.at[places].set(y)
    lower, upper = problem.bijector.ends()
    # On a side itself the derivative is that of the inside, so that what begins there comes back.
    inside = (there >= lower) & (there <= upper)
    return residual_row(jnp.where(inside, there, jnp.clip(there, lower, upper)), problem)


_of_moving = eqx.filter_custom_jvp(_moving_row)


@_of_moving.def_jvp
def _of_moving_jvp(primals: tuple[Array, Any], tangents: tuple[Any, Any]) -> tuple[Array, Array]:
    # A matrix, which has a transpose, where the loop of an integrator has none.
    y, args = primals
    row, matrix, _ = with_jacobian(lambda y: (_moving_row(y, args), ()), y)
    return row, matrix @ tangents[0]


class _AtMost(optx.AbstractLeastSquaresSolver[Any, Any, Any, Any]):
    """A solver that ends after so many steps, by the same program however many those are."""

    rtol: Any
    atol: Any
    norm: Any
    solver: Any
    most: Array

    def init(self, fn: Any, y: Any, *rest: Any) -> Any:
        return self.solver.init(fn, y, *rest), jnp.zeros_like(self.most)

    def step(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        y, inner, aux = self.solver.step(fn, y, args, options, state[0], tags)
        return y, (inner, state[1] + 1), aux

    def terminate(self, fn: Any, y: Any, args: Any, options: Any, state: Any, tags: Any) -> Any:
        done, result = self.solver.terminate(fn, y, args, options, state[0], tags)
        late = ~done & (state[1] >= self.most)
        reached = optx.RESULTS.nonlinear_max_steps_reached
        return done | late, optx.RESULTS.where(late, reached, result)

    def postprocess(
        self, fn: Any, y: Any, aux: Any, args: Any, options: Any, state: Any, *rest: Any
    ) -> Any:
        return self.solver.postprocess(fn, y, aux, args, options, state[0], *rest)


@program
def minimised(
    optimiser: optx.AbstractLeastSquaresSolver, y: Array, args: Any, most: Array
) -> tuple[Array, Array, Array]:
    """Where a solver of optimistix ends, whether at an optimum, and after how many steps."""
    own: Any = optimiser
    limited = _AtMost(own.rtol, own.atol, own.norm, own, most)
    end: Any = optx.least_squares(_of_moving, limited, y, args, max_steps=None, throw=False)
    return end.value, end.result == optx.RESULTS.successful, end.stats["num_steps"]


def _options(bijector: Bijector, active: Array) -> dict[str, Any]:
    """What the solver has to know beside the problem."""
    lower, upper = bijector.ends()
    return {"active": active, "lower": lower, "upper": upper}


def _ended(
    solver: Marquardt,
    coordinate: Array,
    problem: Problem,
    state: MarquardtState,
    options: dict[str, Any],
) -> Stepped:
    done, result = solver.terminate(residual, coordinate, problem, options, state, frozenset())
    return coordinate, state, done, done & (result == optx.RESULTS.successful)


# Steps and residuals of a least-squares problem by compiled programs, on all cores.
#
# A problem of one run is one program. Of several, the runs are dealt out over the cores, and what
# they have in common, the step itself, is a program of its own before and after them; so it is on
# one core, too, whose numbers are the same.


def stepped(
    solver: Marquardt,
    coordinate: Array,
    problem: Problem,
    state: MarquardtState,
    active: Array,
    *,
    sample: bool = False,
) -> Stepped:
    """One step of the solver, by the same programs wherever it is.

    Of several runs a `sample` has one or a few evaluated, and zeros for the others.
    """
    if not _several(problem):
        return step(solver, coordinate, problem, state, active)
    trial = propose(solver, coordinate, problem.bijector, state, active)
    parts = tuple(_of_runs(linearised, trial, problem, sample))
    return judge(solver, coordinate, trial, parts, problem, state, active)


def residuals(
    coordinate: Array, problem: Problem, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Residuals at a point within the bounds, without derivatives; NaN where the model fails."""
    if not _several(problem):
        return np.asarray(residual_row(coordinate, problem))
    parts = tuple(_of_runs(predicted, coordinate, problem, sample))
    return np.asarray(joined_row(parts, coordinate, problem))


def blank(solver: Marquardt, problem: Problem, coordinate: Array) -> MarquardtState:
    """The solver's state before its first evaluation."""
    batches, dtype = problem.batches, coordinate.dtype
    prediction = Prediction(
        tuple(jax.ShapeDtypeStruct(batch.observed.shape, dtype) for batch in batches),
        jax.ShapeDtypeStruct((), bool),
    )
    shape = result_row(coordinate, problem)
    sizes = [(len(g.members), math.prod(g.observed.shape[1:])) for g in batches]
    widths = [len(g.shared[0]) + g.width for g in batches]
    # By numpy, as in the solver: each operation of JAX here would be a program of its own.
    blocks = [np.zeros((*n, w), dtype) for n, w in zip(sizes, widths, strict=True)]
    options = {"jacobian": (*blocks, np.zeros(len(problem.priors.columns), dtype))}
    return solver.init(residual, coordinate, problem, options, shape, prediction, frozenset())


def _several(problem: Problem) -> bool:
    """Whether there are runs to deal out: another device than a CPU takes them as one program."""
    return jax.default_backend() == "cpu" and sum(len(g.members) for g in problem.batches) > 1


def _of_runs(
    call: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem, sample: bool
) -> Iterable[tuple[np.ndarray, ...]]:
    """What a program gives of the runs of each batch, with a leading run axis."""
    whole = np.asarray(coordinate)
    # The runs come with the batch that they are in, and only those of a share.
    common = dataclasses.replace(problem, batches=())
    batches, places = [], []
    for batch in problem.batches:
        measured = np.count_nonzero(np.any(np.asarray(batch.weight) > 0, axis=-1), axis=-1)
        length = chunk_size(len(measured))
        runs = dataclasses.replace(batch, members=(), first=0, shared=())
        items = whole[batch.columns()], runs
        if sample:
            # Those that tell most, as few as check a derivative.
            place = np.argsort(-measured, kind="stable")[: sample_size(len(measured))]
            places.append((place, len(measured)))
            items = jax.tree.map(lambda leaf, at=place: np.asarray(leaf)[at], items)
            measured = measured[place]
        batches.append(Batch(call, items, (common,), measured, length))
    found = run_on_all_cores(batches)
    if not sample:
        return found
    return [_among(part, *at) for part, at in zip(found, places, strict=True)]


def _among(part: tuple[np.ndarray, ...], place: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """What was found of some runs among all of them: zero for the others, which do not fail."""
    whole = [np.full((count, *leaf.shape[1:]), leaf.dtype == bool, leaf.dtype) for leaf in part]
    for leaf, known in zip(whole, part, strict=True):
        leaf[place] = known
    return tuple(whole)
