"""The least-squares problem: weighted differences between predicted and recorded channels."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import replace
from ..runs import Run
from ._bijector import Bijector
from ._loss import transform

Sigmas = list[dict[str, float]]
"""Standard deviation of each channel (SI) of each run."""


class Group(eqx.Module):
    """Runs with the same channels, stacked along a first axis so that they share a program.

    Attributes:
        inputs: what the model prepared, each leaf with a leading run axis.
        observed: recorded values, 0 where not measured.
        weight: 1 / standard deviation, 0 where not measured.
        channels: names, in the order of the third axis of `observed`.
        members: positions of the runs in the list that was fitted.
    """

    inputs: Any
    observed: Float[Array, "run sample channel"]
    weight: Float[Array, "run sample channel"]
    channels: tuple[str, ...] = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)


class Problem(eqx.Module):
    """Everything that the residual depends on, apart from the free coordinates."""

    model: AbstractModel
    groups: tuple[Group, ...]
    bijector: Bijector
    paths: tuple[str, ...] = eqx.field(static=True)
    loss: str = eqx.field(static=True)

    def at(self, coordinate: Float[Array, " parameter"]) -> AbstractModel:
        """The model at free coordinates."""
        values = self.bijector.forward(coordinate)
        return replace(self.model, {path: values[i] for i, path in enumerate(self.paths)})


class Prediction(eqx.Module):
    """What comes out beside the residual.

    Attributes:
        channels: predictions of each group (SI), shape (run, sample, channel).
        successful: whether all simulations succeeded.
    """

    channels: tuple[Any, ...]
    successful: Any


def residual(
    coordinate: Float[Array, " parameter"], problem: Problem
) -> tuple[Float[Array, " residual"], Prediction]:
    """Transformed weighted residuals of all runs in one row, and the predictions.

    A module-level function: a fresh closure would be compiled again for every fit.
    """
    model = problem.at(coordinate)
    rows, predictions, successes = [], [], []
    for group in problem.groups:
        predicted, successful = _predict_group(model, group)
        difference = (predicted - group.observed) * group.weight
        # An unmeasured cell must not carry the NaN of a failed simulation times zero.
        rows.append(jnp.where(group.weight > 0, difference, 0).ravel())
        predictions.append(predicted)
        successes.append(jnp.all(successful))
    row = transform(problem.loss, jnp.concatenate(rows))
    return row, Prediction(tuple(predictions), jnp.all(jnp.stack(successes)))


def _predict_group(model: AbstractModel, group: Group) -> tuple[Array, Array]:
    def one(inputs: Any) -> tuple[Array, Array]:
        predicted, successful = model.predict(inputs, group.channels)
        return jnp.stack([predicted[name] for name in group.channels], axis=-1), successful

    if len(group.members) == 1:
        first = jax.tree.map(lambda leaf: leaf[0], group.inputs)
        predicted, successful = one(first)
        return predicted[None], successful[None]
    # One run after the other: each keeps its own step sizes, and the program is compiled once.
    return jax.lax.map(one, group.inputs)


def build_groups(model: AbstractModel, runs: Sequence[Run], sigmas: Sigmas) -> tuple[Group, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them."""
    members: dict[Any, list[int]] = {}
    prepared = [model.prepare(run) for run in runs]
    for index, run in enumerate(runs):
        structure = jax.tree.structure(prepared[index])
        members.setdefault((tuple(run.observations), structure), []).append(index)
    groups = []
    for (channels, _), indices in members.items():
        observed = [np.stack([runs[i].observations[c] for c in channels], -1) for i in indices]
        weight = [
            np.where(np.isnan(cells), 0.0, 1 / np.asarray([sigmas[i][c] for c in channels]))
            for i, cells in zip(indices, observed, strict=True)
        ]
        length = max(len(cells) for cells in observed)
        groups.append(
            Group(
                inputs=_stack([prepared[i] for i in indices]),
                observed=_padded([np.nan_to_num(cells) for cells in observed], length),
                weight=_padded(weight, length),
                channels=channels,
                members=tuple(indices),
            )
        )
    return tuple(groups)


def _padded(arrays: Sequence[np.ndarray], length: int) -> Array:
    rows = [np.pad(a, ((0, length - len(a)), (0, 0))) for a in arrays]
    return jnp.asarray(np.stack(rows), dtype=jnp.result_type(float))


def _stack(trees: Sequence[Any]) -> Any:
    """Stack pytrees, repeating last rows where the first axes differ (see `prepare`)."""

    def stack(*leaves: Array) -> Array:
        length = max(leaf.shape[0] if leaf.ndim else 0 for leaf in leaves)
        return jnp.stack(
            [
                jnp.concatenate([leaf, jnp.repeat(leaf[-1:], length - leaf.shape[0], axis=0)])
                if leaf.ndim and leaf.shape[0] < length
                else leaf
                for leaf in leaves
            ]
        )

    return jax.tree.map(stack, *trees)


def predictions_by_run(
    problem: Problem, prediction: Prediction, runs: Sequence[Run]
) -> list[dict[str, np.ndarray]]:
    """Predicted channels (SI) of each run, without the padding."""
    by_run: list[dict[str, np.ndarray]] = [{} for _ in runs]
    for group, predicted in zip(problem.groups, prediction.channels, strict=True):
        table = np.asarray(predicted)
        for row, member in enumerate(group.members):
            count = len(next(iter(runs[member].observations.values())))
            by_run[member] = {
                name: table[row, :count, column] for column, name in enumerate(group.channels)
            }
    return by_run


def stated_sigmas(runs: Sequence[Run]) -> list[Mapping[str, float | None]]:
    """What the sidecars say of each channel's noise, SI; None where they say nothing."""
    return [{name: run.noise(name) for name in run.observations} for run in runs]
