"""The least-squares problem to first order: a block of the Jacobian a run, and their triangle."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ._group import Group
from ._loss import curvature_ratio
from ._problem import Prediction, Problem
from ._residual import over_runs, run_residual, whitened
from ._solver_state import Linearised


def linearise(coordinate: Float[Array, " parameter"], problem: Problem) -> Linearised:
    """Residual, Jacobian in blocks, its triangular factor R, Q^T r, and the predictions.

    Arguments:
        coordinate: free coordinates, shape (parameter,).
        problem: what is minimised.

    Returns:
        As `assembled`.
    """
    return assembled(over_runs(linearise_run, coordinate, problem), coordinate, problem)


def linearise_run(
    values: Array,
    problem: Problem,
    group: Group,
    inputs: Any,
    observed: Array,
    weight: Array,
    whitening: Any,
) -> tuple[Array, ...]:
    """A run's residual, block of the Jacobian, triangle of both, prediction, and success.

    The block, shape (row, shared + own), comes from one vmapped jvp; no derivative of a run by the
    parameters of another one is ever computed. It is reduced to a triangle by itself.

    Arguments:
        values: the coordinates that the run responds to, shape (shared + own,).
        problem, group: what it is a part of.
        inputs, observed, weight, whitening: those of the group for this run.
    """

    def push(tangent: Array) -> tuple[Array, Array, Any]:
        return jax.jvp(
            lambda v: run_residual(v, problem, group, inputs, observed, weight),
            (values,),
            (tangent,),
            has_aux=True,
        )

    basis = jnp.eye(values.shape[0], dtype=values.dtype)
    row, block, aux = jax.vmap(push, out_axes=(None, 1, None))(basis)
    # Linear, so it comes after the derivatives, and costs one pass over all columns.
    whole = whitened(jnp.concatenate([block, row[:, None]], axis=1), whitening)
    block, row = whole[:, :-1], whole[:, -1]
    if problem.loss != "linear":
        measured = (weight > 0).ravel().astype(row.dtype)
        ratio = curvature_ratio(problem.loss, row, measured)[:, None]
        whole = jnp.concatenate([whole[:, :-1] * ratio, whole[:, -1:] / ratio], axis=1)
    # A failed run has NaN here; its step is rejected, and nobody reads the triangle.
    triangle = jnp.linalg.qr(jnp.where(jnp.isfinite(whole), whole, 0), mode="r")
    missing = whole.shape[1] - triangle.shape[0]
    return row, block, jnp.pad(triangle, ((0, missing), (0, 0))), *aux


def assembled(parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem) -> Linearised:
    """What `linearise_run` found of all runs, and the priors, as one problem.

    The triangles together are reduced to R: an orthogonal reduction, as QR of the whole.

    Arguments:
        parts: of each group, what `linearise_run` gives, with a leading run axis.
        coordinate: where that is, shape (parameter,).
        problem: what is minimised.

    Returns:
        residual of shape (residual,); blocks of each group, shape (run, row, shared + own), and the
        derivatives of the priors' rows, shape (prior,), each by its own coordinate; R of shape
        (parameter, parameter); Q^T r; predictions.
    """
    rows, blocks, triangles, tables, successes = zip(*parts, strict=True)
    known, slopes = problem.priors.rows(coordinate, problem.bijector)
    placed = [_placed(t, g, problem) for t, g in zip(triangles, problem.groups, strict=True)]
    whole = jnp.concatenate([*placed, _placed_priors(known, slopes, problem)])
    if whole.shape[0] > whole.shape[1]:
        whole = jnp.linalg.qr(whole, mode="r")
    row = jnp.concatenate([*(part.ravel() for part in rows), known])
    prediction = Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))
    return row, (*blocks, slopes), whole[:-1, :-1], whole[:-1, -1], prediction


def _placed(triangles: Float[Array, "run row column"], group: Group, problem: Problem) -> Array:
    """Triangles of a group's runs, with their columns where they belong in the whole."""
    runs, count, _ = triangles.shape
    whole = jnp.zeros((runs, count, problem.size + 1), triangles.dtype)
    whole = whole.at[:, :, -1].set(triangles[:, :, -1])
    at = np.ix_(np.arange(runs), np.arange(count))
    columns = group.columns()[:, None, :]
    whole = whole.at[at[0][..., None], at[1][..., None], columns].set(triangles[:, :, :-1])
    return whole.reshape(runs * count, -1)


def _placed_priors(rows: Array, slopes: Array, problem: Problem) -> Array:
    """Rows of the priors, with their columns where they belong in the whole."""
    count, columns = len(problem.priors), np.asarray(problem.priors.columns, dtype=int)
    whole = jnp.zeros((count, problem.size + 1), rows.dtype)
    return whole.at[np.arange(count), columns].set(slopes).at[:, -1].set(rows)
