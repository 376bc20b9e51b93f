"""What each body of an experiment tells, and how that changes with the command.

The information is the sum of J^T J over the channels of a body, J the derivatives of its channels
over their noise by the scaled parameters. Both derivatives, by parameters and by the numbers of the
command, are forward, one within the other: no reverse pass through a solver of adaptive steps, and
exact to the solver's tolerance.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._program import program
from .._shares import Batch, on_all_cores
from .._typing import Array, Float
from ..fitting import Tie, tied
from ..models import AbstractModel
from ..parameters import get, replace
from ._command import Command, knotted

# Paths that a command disturbs an arm as: the model then takes the steps that this needs.
_DISTURBANCE = ("initial.angle",)


@dataclasses.dataclass(frozen=True)
class Experiment:
    """What is recorded of an arm, and what a fit of it would have free.

    Attributes:
        model: the arm; its parameters are replaced.
        inputs: a prepared run, whose command is replaced.
        joints: of the arm.
        paths: scalar parameters of the model, free in the fit.
        scales: what each is counted in, SI, shape (parameter,).
        own: what is free in the run alone, by path, and how many numbers that is.
        ties: parameters that follow from others.
        channels: all that may be recorded.
        noise: of each channel, SI, shape (channel,).
        bodies: which body each channel is of, shape (channel,).
    """

    model: AbstractModel
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
    """Information of each draw and body, by the numbers of the command.

    Attributes:
        values: shape (draw, body, parameter, parameter).
        slopes: derivatives, shape (draw, number, body, parameter, parameter).
        predicted: SI, shape (draw, sample, channel).
        successful: whether each draw could be simulated, shape (draw,).
    """

    values: Float[np.ndarray, "draw body parameter parameter"]
    slopes: Float[np.ndarray, "draw number body parameter parameter"]
    predicted: Float[np.ndarray, "draw sample channel"]
    successful: np.ndarray


def informed(
    experiment: Experiment,
    command: Command,
    draws: Float[np.ndarray, "draw parameter"],
) -> Informed:
    """The information of an experiment with a command, and its derivatives; draws on all cores.

    Arguments:
        experiment: what is recorded.
        command: that is given.
        draws: values of the parameters, SI.
    """
    dtype = jnp.result_type(float)
    arrays = (
        experiment.scales,
        1 / experiment.noise,
        command.numbers,
        command.times,
        command.limits.angle,
    )
    scales, weights, at, times, angle = (jnp.asarray(array, dtype) for array in arrays)
    places = np.asarray(experiment.bodies)
    bodies = jnp.asarray(places[None, :] == np.arange(places.max() + 1)[:, None], dtype)
    shared = (
        (at, times, angle, scales, weights, bodies, experiment.inputs),
        experiment.model,
        (command.limits.joints, experiment.joints),
        (experiment.paths, experiment.own, experiment.ties, experiment.channels),
    )
    batch = Batch(_informed, np.asarray(draws, dtype), shared, np.ones(len(draws)), 1)
    (answer,) = on_all_cores([batch])
    return Informed(*answer)


@program
def _informed(
    draws: Float[Array, "1 parameter"],
    arrays: tuple[Any, ...],
    model: AbstractModel,
    moving: tuple[tuple[int, ...], int],
    names: tuple[Any, ...],
) -> tuple[Array, Array, Array, Array]:
    numbers, times, angle, scales, weights, bodies, inputs = arrays
    joints, count = moving
    paths, own, ties, channels = names
    ready = model.for_derivatives((*paths, *_DISTURBANCE))
    size = len(paths) + sum(each for _, each in own)
    still = jnp.zeros(size, draws.dtype)

    def recorded(amounts: Array, at: Array) -> tuple[Array, Array]:
        values = draws[0] + amounts[: len(paths)] * scales
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
        return jnp.stack([predicted[name] for name in channels], axis=-1) * weights[
            None
        ], successful

    def information(at: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        def push(tangent: Array) -> tuple[Array, Array, Array]:
            return jax.jvp(lambda a: recorded(a, at), (still,), (tangent,), has_aux=True)

        basis = jnp.eye(size, dtype=still.dtype)
        table, columns, successful = jax.vmap(push, out_axes=(None, 0, None))(basis)
        found = jnp.einsum("isc,jsc,bc->bij", columns, columns, bodies)
        return found, (found, table / weights[None], successful)

    def turn(tangent: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        _, slope, aux = jax.jvp(information, (numbers,), (tangent,), has_aux=True)
        return slope, aux

    basis = jnp.eye(len(numbers), dtype=numbers.dtype)
    slopes, (values, predicted, successful) = jax.vmap(turn, out_axes=(0, None))(basis)
    return values[None], slopes[None], predicted[None], successful[None]
