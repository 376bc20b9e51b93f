"""Steps and residuals of a least-squares problem by compiled programs, on all cores.

A problem of one run is one program. Of several, the runs are dealt out over the cores, and what
they have in common, the step itself, is a program of its own before and after them; so it is on one
core, too, whose numbers are the same.
"""

import dataclasses
from collections.abc import Callable, Iterable

import jax
import numpy as np

from .._shares import Batch, on_all_cores
from .._typing import Array, Float
from ._prepared import in_a_sample, in_a_share
from ._problem import Prediction, Problem
from ._programs import (
    Stepped,
    joined_row,
    judge,
    linearised,
    predicted,
    propose,
    residual_row,
    result_row,
    step,
)
from ._residual import residual
from ._solver import Marquardt
from ._solver_state import MarquardtState


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

    Arguments:
        solver: of the least-squares problem.
        coordinate: the best point so far, shape (parameter,).
        problem: what is minimised.
        state: of the solver there.
        active: parameters that may move, shape (parameter,).
        sample: where runs are dealt out, evaluate one or a few, and have zeros for the others.
    """
    if not _several(problem):
        return step(solver, coordinate, problem, state, active)
    trial = propose(solver, coordinate, problem.bijector, state, active)
    parts = tuple(_of_runs(linearised, trial, problem, sample))
    return judge(solver, coordinate, trial, parts, problem, state, active)


def residuals(
    coordinate: Array, problem: Problem, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Residuals at a point within the bounds, without derivatives; NaN where the model fails.

    Arguments:
        coordinate: the point, shape (parameter,).
        problem: what is minimised.
        sample: of several runs evaluate one or a few, and have zeros for the others.
    """
    if not _several(problem):
        return np.asarray(residual_row(coordinate, problem))
    parts = tuple(_of_runs(predicted, coordinate, problem, sample))
    return np.asarray(joined_row(parts, coordinate, problem))


def blank(solver: Marquardt, problem: Problem, coordinate: Array) -> MarquardtState:
    """The solver's state before its first evaluation."""
    groups, dtype = problem.groups, coordinate.dtype
    prediction = Prediction(
        tuple(jax.ShapeDtypeStruct(group.observed.shape, dtype) for group in groups),
        jax.ShapeDtypeStruct((), bool),
    )
    shape = result_row(coordinate, problem)
    # By numpy, as in the solver: each operation of JAX here would be a program of its own.
    blocks = tuple(
        np.zeros((len(g.members), g.observed.size // len(g.members), g.columns().shape[1]), dtype)
        for g in groups
    )
    options = {"jacobian": (*blocks, np.zeros(len(problem.priors), dtype))}
    return solver.init(residual, coordinate, problem, options, shape, prediction, frozenset())


def _several(problem: Problem) -> bool:
    """Whether there are runs to deal out: another device than a CPU takes them as one program."""
    return jax.default_backend() == "cpu" and sum(len(g.members) for g in problem.groups) > 1


def _of_runs(
    call: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem, sample: bool
) -> Iterable[tuple[np.ndarray, ...]]:
    """What a program gives of the runs of each group, with a leading run axis."""
    whole = np.asarray(coordinate)
    # The runs come with the group that they are in, and only those of a share.
    common = dataclasses.replace(problem, groups=())
    batches, places = [], []
    for group in problem.groups:
        measured = np.count_nonzero(np.any(np.asarray(group.weight) > 0, axis=-1), axis=-1)
        length = in_a_share(len(measured))
        runs = dataclasses.replace(group, members=(), first=0, shared=())
        items = whole[group.columns()], runs
        if sample:
            # Those that tell most, as few as check a derivative.
            place = np.argsort(-measured, kind="stable")[: in_a_sample(len(measured))]
            places.append((place, len(measured)))
            items = jax.tree.map(lambda leaf, at=place: np.asarray(leaf)[at], items)
            measured = measured[place]
        batches.append(Batch(call, items, (common,), measured, length))
    found = on_all_cores(batches)
    if not sample:
        return found
    return [_among(part, *at) for part, at in zip(found, places, strict=True)]


def _among(part: tuple[np.ndarray, ...], place: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """What was found of some runs among all of them: zero for the others, which do not fail."""
    whole = [np.full((count, *leaf.shape[1:]), leaf.dtype == bool, leaf.dtype) for leaf in part]
    for leaf, known in zip(whole, part, strict=True):
        leaf[place] = known
    return tuple(whole)
