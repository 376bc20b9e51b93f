"""Linearised least-squares problem: one block of the Jacobian per run, and its QR factor."""

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
    """Jacobian of the residuals with respect to the parameters, by run.

    Attributes:
        blocks: block of each run, shape (row, column).
        columns: parameter to which each column of each block belongs.
        size: number of parameters.
    """

    blocks: Sequence[Float[np.ndarray, "row column"]]
    columns: Sequence[np.ndarray]
    size: int

    @classmethod
    def of(cls, problem: Problem, blocks: Sequence[object]) -> Self:
        """Return the Jacobian from the blocks of each batch and the slopes of the priors."""
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
        """Return the Jacobian with one block that is the whole matrix."""
        return cls([matrix], [np.arange(matrix.shape[1])], matrix.shape[1])

    def scaled(self, factors: Float[np.ndarray, " parameter"]) -> Self:
        """Return the Jacobian with each column multiplied by a factor."""
        blocks = [b * factors[c] for b, c in zip(self.blocks, self.columns, strict=True)]
        return dataclasses.replace(self, blocks=blocks)

    def norms(self) -> Float[np.ndarray, " parameter"]:
        """Return the norms of the columns."""
        squares = np.zeros(self.size)
        for block, columns in zip(self.blocks, self.columns, strict=True):
            squares[columns] += np.sum(block**2, axis=0)
        return np.sqrt(squares)

    def times(self, vector: Float[np.ndarray, " parameter"]) -> Row:
        """Return the product with a vector."""
        return np.concatenate(
            [block @ vector[c] for block, c in zip(self.blocks, self.columns, strict=True)]
        )

    def transposed_times(self, row: Row) -> Float[np.ndarray, " parameter"]:
        """Return the product of the transpose with a vector."""
        total = np.zeros(self.size)
        start = 0
        for block, columns in zip(self.blocks, self.columns, strict=True):
            total[columns] += block.T @ row[start : start + len(block)]
            start += len(block)
        return total

    def reduced(self, weights: Row | None = None) -> Float[np.ndarray, "row parameter"]:
        """Return a small matrix R with R^T R = J^T diag(weights)^2 J, by QR of each block."""
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
    """Return residual, block Jacobian, triangular factor R, Q^T r and predictions."""
    return assembled(over_runs(linearise_run, coordinate, problem), coordinate, problem)


def linearise_run(
    values: Array, problem: Problem, batch: RunBatch, run: tuple[Any, ...]
) -> tuple[Array, ...]:
    """Return residual, Jacobian block, triangular factor, prediction and success of a run.

    The block, shape (row, shared + own), is computed by one vmapped jvp with respect to the
    coordinates of the run. Derivatives with respect to the parameters of other runs are never
    computed. The block is reduced to a triangle by itself.
    """
    row, block, aux = with_jacobian(lambda v: run_residual(v, problem, batch, run), values)
    # Whitening is linear. After the derivatives it costs one pass over all columns.
    whole = whitened(jnp.concatenate([block, row[:, None]], axis=1), run[-1])
    block, row = whole[:, :-1], whole[:, -1]
    if not problem.loss.is_linear:
        _, observed, weight, _ = run
        difference = jnp.where(weight > 0, (aux[0] - observed) * weight, 0).ravel()
        measured = (weight > 0).ravel().astype(row.dtype)
        ratio = problem.loss.curvature_ratio(difference, measured)[:, None]
        whole = jnp.concatenate([whole[:, :-1] * ratio, whole[:, -1:] / ratio], axis=1)
    # The block of a failed run contains NaN. Its step is rejected, and the triangle is not used.
    triangle = jnp.linalg.qr(jnp.where(jnp.isfinite(whole), whole, 0), mode="r")
    missing = whole.shape[1] - triangle.shape[0]
    return row, block, jnp.pad(triangle, ((0, missing), (0, 0))), *aux


def assembled(parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem) -> Linearised:
    """Assemble the results of `linearise_run` of all batches and the priors as one problem.

    QR reduces all triangles together to R, with the same result as QR of the whole matrix. The
    Jacobian consists of the blocks of each batch, (run, row, shared + own), and the derivatives of
    the rows of the priors, (prior,).
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
    """Return the triangles of the runs of a batch, with their columns placed in the whole."""
    runs, count, _ = triangles.shape
    whole = jnp.zeros((runs, count, problem.size + 1), triangles.dtype)
    whole = whole.at[:, :, -1].set(triangles[:, :, -1])
    at = np.ix_(np.arange(runs), np.arange(count))
    columns = batch.columns()[:, None, :]
    whole = whole.at[at[0][..., None], at[1][..., None], columns].set(triangles[:, :, :-1])
    return whole.reshape(runs * count, -1)


# Compiled programs of a fit. They are at module level, because a new closure would be compiled
# again for every fit.

Stepped = tuple[Array, MarquardtState, Any, Any]
"""Point and state of a solver, and whether the solver has ended and has reached an optimum."""


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
    """Return the residual by the moving coordinates, which are clipped to the bounds."""
    problem, coordinate, places = args
    there = coordinate.at[places].set(y)
    lower, upper = problem.bijector.ends()
    # On a bound, the derivative is that of the inside, so a point that starts there can leave it.
    inside = (there >= lower) & (there <= upper)
    return residual_row(jnp.where(inside, there, jnp.clip(there, lower, upper)), problem)


_of_moving = eqx.filter_custom_jvp(_moving_row)


@_of_moving.def_jvp
def _of_moving_jvp(primals: tuple[Array, Any], tangents: tuple[Any, Any]) -> tuple[Array, Array]:
    # A matrix has a transpose, while the loop of an integrator has none.
    y, args = primals
    row, matrix, _ = with_jacobian(lambda y: (_moving_row(y, args), ()), y)
    return row, matrix @ tangents[0]


class _AtMost(optx.AbstractLeastSquaresSolver[Any, Any, Any, Any]):
    """Solver that ends after `most` steps. One program serves any number of steps."""

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
    """Return the end of an optimistix solver, whether it is an optimum, and the number of steps."""
    own: Any = optimiser
    limited = _AtMost(own.rtol, own.atol, own.norm, own, most)
    end: Any = optx.least_squares(_of_moving, limited, y, args, max_steps=None, throw=False)
    return end.value, end.result == optx.RESULTS.successful, end.stats["num_steps"]


def _options(bijector: Bijector, active: Array) -> dict[str, Any]:
    """Return the options of the solver."""
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


# Steps and residuals of a least-squares problem by compiled programs on all cores.
#
# A problem with one run is one program. Several runs are distributed over the cores. The common
# part, the step itself, is a separate program before and after them. One core uses the same
# programs, so the numbers are the same.


def stepped(
    solver: Marquardt,
    coordinate: Array,
    problem: Problem,
    state: MarquardtState,
    active: Array,
    *,
    sample: bool = False,
) -> Stepped:
    """Make one step of the solver, with the same programs on any number of cores.

    With `sample`, only one or a few of several runs are evaluated, and the others are zero.
    """
    if not _several(problem):
        return step(solver, coordinate, problem, state, active)
    trial = propose(solver, coordinate, problem.bijector, state, active)
    parts = tuple(_of_runs(linearised, trial, problem, sample))
    return judge(solver, coordinate, trial, parts, problem, state, active)


def residuals(
    coordinate: Array, problem: Problem, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Return the residuals at a point within the bounds, without derivatives.

    The residuals are NaN where the model fails.
    """
    if not _several(problem):
        return np.asarray(residual_row(coordinate, problem))
    parts = tuple(_of_runs(predicted, coordinate, problem, sample))
    return np.asarray(joined_row(parts, coordinate, problem))


def blank(solver: Marquardt, problem: Problem, coordinate: Array) -> MarquardtState:
    """Return the state of the solver before its first evaluation."""
    batches, dtype = problem.batches, coordinate.dtype
    prediction = Prediction(
        tuple(jax.ShapeDtypeStruct(batch.observed.shape, dtype) for batch in batches),
        jax.ShapeDtypeStruct((), bool),
    )
    shape = result_row(coordinate, problem)
    sizes = [(len(g.members), math.prod(g.observed.shape[1:])) for g in batches]
    widths = [len(g.shared[0]) + g.width for g in batches]
    # NumPy is used as in the solver: each operation of JAX would be a separate program.
    blocks = [np.zeros((*n, w), dtype) for n, w in zip(sizes, widths, strict=True)]
    options = {"jacobian": (*blocks, np.zeros(len(problem.priors.columns), dtype))}
    return solver.init(residual, coordinate, problem, options, shape, prediction, frozenset())


def _several(problem: Problem) -> bool:
    """Return whether runs are distributed over cores. Only a CPU does so."""
    return jax.default_backend() == "cpu" and sum(len(g.members) for g in problem.batches) > 1


def _of_runs(
    call: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem, sample: bool
) -> Iterable[tuple[np.ndarray, ...]]:
    """Return the results of a program for the runs of each batch, with a leading run axis."""
    whole = np.asarray(coordinate)
    # Each item carries its run, so a core receives only the runs of its share.
    common = dataclasses.replace(problem, batches=())
    batches, places = [], []
    for batch in problem.batches:
        measured = np.count_nonzero(np.any(np.asarray(batch.weight) > 0, axis=-1), axis=-1)
        length = chunk_size(len(measured))
        runs = dataclasses.replace(batch, members=(), first=0, shared=())
        items = whole[batch.columns()], runs
        if sample:
            # The runs with the most measured cells are used, as few as a check of a derivative
            # needs.
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
    """Return the results of some runs among all runs. The others are zero and successful."""
    whole = [np.full((count, *leaf.shape[1:]), leaf.dtype == bool, leaf.dtype) for leaf in part]
    for leaf, known in zip(whole, part, strict=True):
        leaf[place] = known
    return tuple(whole)
