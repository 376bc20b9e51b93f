"""How the predictions of a fitted model respond to any of its parameters, free or held.

One compiled program gives the columns of all directions together, without the loss and the noise
of the fit: whoever asks weighs them. A direction changes a whole parameter by a unit, one element
of it, or all of its elements in proportion.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._program import program
from .._shares import Batch, on_all_cores
from .._typing import Array
from ..models import AbstractModel
from ..parameters import get, replace
from ..runs import Run
from ._prepared import in_a_share, prepared_with, sharing_a_program
from ._stack import stacked
from ._ties import Tie, tied


@dataclasses.dataclass(frozen=True)
class Direction:
    """A change of a parameter of a model.

    Attributes:
        path: of the parameter, without an index.
        step: its change for a unit, in its SI unit and of its shape.
    """

    path: str
    step: np.ndarray


@dataclasses.dataclass(frozen=True)
class Response:
    """What a model predicts for one run, and how that responds; all SI.

    Attributes:
        channels: names, in the order of the columns of the tables.
        predicted: shape (sample, channel).
        observed: NaN where not measured, shape (sample, channel).
        columns: predictions by the amounts of the directions, shape (sample, channel, direction).
        own: predictions by what is free in this run alone, shape (sample, channel, own).
    """

    channels: tuple[str, ...]
    predicted: np.ndarray
    observed: np.ndarray
    columns: np.ndarray
    own: np.ndarray


def responses(
    model: AbstractModel,
    runs: Sequence[Run],
    directions: Sequence[Direction],
    own: Sequence[Mapping[str, float]] = (),
    *,
    values: Sequence[Mapping[str, float]] = (),
    ties: Sequence[Tie] = (),
) -> list[Response]:
    """Predictions and their derivatives at one point.

    Arguments:
        model: at the point; it has all parameters of the directions.
        runs: what was recorded.
        directions: what to differentiate by. Without any there are predictions alone, and no
            columns of what is free in one run either.
        own: of each run, values of what is free in it alone, by label; others start as prepared.
        values: of each run, those of the model's parameters that it does not share with all others,
            by path, the same paths for all.
        ties: what follows from other parameters, and moves with them.

    Returns:
        A response for each run, in their order.

    Raises:
        InputError: the model cannot be evaluated at the point.
    """
    answers: dict[int, Response] = {}
    # In an order of their own: what is fitted and what is held changes from fit to fit, and the
    # same directions in another order would be another program.
    order = sorted(range(len(directions)), key=lambda index: _name(directions[index]))
    place = np.argsort(np.asarray(order, dtype=int))
    paths = tuple(directions[index].path for index in order)
    steps = tuple(jnp.asarray(directions[index].step, jnp.result_type(float)) for index in order)
    for members in sharing_a_program(model, runs):
        like = runs[members[0]]
        channels = tuple(like.observations)
        free = model.free_inputs(like)
        inputs = stacked([prepared_with(model, runs[i], own[i] if own else {}) for i in members])
        sizes = tuple((path, get(inputs, path)[0].size) for path in free)
        varied, rows = _varied(values, members)
        shared = (model, paths, steps, channels, sizes, varied, tuple(ties))
        lengths = np.asarray([len(runs[i].observations[channels[0]]) for i in members])
        batch = Batch(_respond, (inputs, rows), shared, lengths, in_a_share(len(members)))
        (answer,) = on_all_cores([batch])
        tables, blocks, successful = answer
        if not np.all(successful):
            first = jax.tree.map(lambda leaf: leaf[0], inputs)
            # Derivatives may take other steps than the motion, which is right by itself then.
            why = model.for_derivatives((*paths, *free)).failure(first)
            why = why or "a derivative of it is not finite"
            raise InputError(f"the fitted model cannot be evaluated: {why}")
        for member, table, block in zip(members, tables, blocks, strict=True):
            observed = np.stack([runs[member].observations[c] for c in channels], axis=-1)
            count = len(observed)
            answers[member] = Response(
                channels=channels,
                predicted=table[:count],
                observed=observed,
                columns=np.moveaxis(block[place, :count], 0, -1),
                own=np.moveaxis(block[len(paths) :, :count], 0, -1),
            )
    return [answers[index] for index in range(len(runs))]


def _varied(
    values: Sequence[Mapping[str, float]], members: Sequence[int]
) -> tuple[tuple[str, ...], Array]:
    """Paths of what is not the same in all runs, and its values, shape (run, path)."""
    paths = tuple(values[0]) if values else ()
    rows = [[values[index][path] for path in paths] for index in members]
    return paths, jnp.asarray(np.asarray(rows, dtype=float), jnp.result_type(float))


def _name(direction: Direction) -> tuple[str, tuple[float, ...]]:
    return direction.path, tuple(np.ravel(direction.step).tolist())


@program
def _respond(
    prepared_runs: tuple[Any, Array],
    model: AbstractModel,
    paths: tuple[str, ...],
    steps: tuple[Array, ...],
    channels: tuple[str, ...],
    own: tuple[tuple[str, int], ...],
    varied: tuple[str, ...],
    ties: tuple[Tie, ...],
) -> tuple[Array, Array, Array]:
    """Tables (run, sample, channel), their derivatives (run, amount, sample, channel), success."""
    inputs, rows = prepared_runs
    count = len(paths) + sum(size for _, size in own) if paths else 0
    differentiated = (*dict.fromkeys(paths), *(path for path, _ in own))
    ready = model.for_derivatives(differentiated) if count else model

    def one(prepared: Any, row: Array) -> tuple[Array, Array, Array]:
        there = replace(ready, {path: row[index] for index, path in enumerate(varied)})
        held = {path: get(there, path) for path in paths}

        def predicted(amounts: Array) -> tuple[Array, Array]:
            values = dict(held)
            for index, path in enumerate(paths):
                values[path] = values[path] + amounts[index] * steps[index]
            moved, start = prepared, len(paths)
            for path, size in own if count else ():
                value = get(prepared, path)
                change = amounts[start : start + size].reshape(value.shape)
                moved = replace(moved, {path: value + change})
                start += size
            table, successful = tied(replace(there, values), ties).predict(moved, channels)
            return jnp.stack([table[name] for name in channels], axis=-1), successful

        def push(tangent: Array) -> tuple[Array, Array, Array]:
            return jax.jvp(predicted, (still,), (tangent,), has_aux=True)

        if not count:
            table, successful = predicted(jnp.zeros(0))
            return table, jnp.zeros((0, *table.shape), table.dtype), successful
        still = jnp.zeros(count, jnp.result_type(float))
        basis = jnp.eye(count, dtype=still.dtype)
        table, block, successful = jax.vmap(push, out_axes=(None, 0, None))(basis)
        return table, block, successful

    if jax.tree.leaves(inputs)[0].shape[0] == 1:
        result = one(*jax.tree.map(lambda leaf: leaf[0], (inputs, rows)))
        return jax.tree.map(lambda leaf: leaf[None], result)
    # One run after the other: each keeps its own steps; the program is compiled once.
    return jax.lax.map(lambda each: one(*each), (inputs, rows))
