"""Sensitivity of the channels of a run to parameters, and the resulting Fisher information."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..models import AbstractModel, capabilities
from ..recordings import Channel, Run
from ..runtime.arrays import Array, Float
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema.parameters import elements, replace, switched_on
from ..simulation import SimulationError

# Relative eigenvalues of the normalised information below this belong to directions that no channel
# shows.
_FLAT = 1e-8


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Derivatives of predicted channels with respect to parameters, along a run.

    Attributes:
        times: times of the samples, s, shape (sample,); None for a static run.
        channels: names of the predicted channels, without unit (`link06_z`).
        parameters: paths of the scalar parameters.
        units: units of the parameters.
        values: values of the parameters at which the derivatives are evaluated, shape (parameter,).
        predicted: predictions, SI, shape (sample, channel).
        derivatives: derivatives of the predictions, SI, shape (parameter, sample, channel).
    """

    times: Float[np.ndarray, " sample"] | None
    channels: tuple[str, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, " parameter"]
    predicted: Float[np.ndarray, "sample channel"]
    derivatives: Float[np.ndarray, "parameter sample channel"]

    def bodies(self) -> dict[str, list[int]]:
        """Return the indices of the channels of each body (`link06`: its x, y and z) by name."""
        bodies: dict[str, list[int]] = {}
        for index, name in enumerate(self.channels):
            bodies.setdefault(body_of(name), []).append(index)
        return bodies

    def lengths(self) -> tuple[tuple[str, ...], Float[np.ndarray, "parameter sample body"]]:
        """Return the names of the bodies and the norm of each derivative, |d position / d p|.

        For a body with one channel, it is the absolute value of that channel's derivative.
        """
        bodies = self.bodies()
        sizes = [np.linalg.norm(self.derivatives[:, :, rows], axis=2) for rows in bodies.values()]
        return tuple(bodies), np.stack(sizes, axis=-1)

    def information(self, noise: npt.ArrayLike) -> Float[np.ndarray, "body parameter parameter"]:
        """Return the Fisher information of each body, in inverse units of the parameters.

        It is the sum over the channels and samples of the body of s s^T / noise^2. The information
        matrices of several bodies add up. `noise` is the standard deviation of white noise, SI: one
        positive number, or one per channel.
        """
        deviations = np.broadcast_to(np.asarray(noise, dtype=float), (len(self.channels),))
        if not np.all(deviations > 0):
            raise InputError(f"the noise is {deviations.min():g}: give a positive number")
        weighted = self.derivatives / deviations
        parts = (weighted[:, :, rows] for rows in self.bodies().values())
        return np.stack([np.einsum("itc,jtc->ij", part, part) for part in parts])

    def standard_errors(self, noise: npt.ArrayLike) -> Float[np.ndarray, " parameter"]:
        """Return the expected errors if all parameters are fitted to all channels (Cramer-Rao).

        An error is infinite if only a combination of parameters is determined.
        """
        return expected_errors(self.information(noise).sum(axis=0))

    def errors_by_body(self, noise: npt.ArrayLike) -> Float[np.ndarray, "body parameter"]:
        """Return expected errors if one body is recorded and the other parameters are known."""
        alone = np.diagonal(self.information(noise), axis1=1, axis2=2)
        with np.errstate(divide="ignore"):
            return 1 / np.sqrt(alone)


def body_of(channel: str) -> str:
    """Return the body of a channel: `link06` for `link06_z`; the channel itself if it has none."""
    return channel[:-2] if Channel.named(channel).component is not None else channel


def expected_errors(information: Float[np.ndarray, "parameter parameter"]) -> np.ndarray:
    """Return the square roots of the diagonal of the inverse; infinite without information."""
    sizes = np.sqrt(np.diag(information))
    errors = np.full(len(sizes), np.inf)
    informed = np.flatnonzero(sizes > 0)
    if len(informed) == 0:
        return errors
    scaled = information[np.ix_(informed, informed)] / np.outer(sizes[informed], sizes[informed])
    values, vectors = np.linalg.eigh(scaled)
    flat = values < _FLAT * values[-1]
    variances = np.sum(vectors[:, ~flat] ** 2 / values[~flat], axis=1)
    loose = np.any(np.abs(vectors[:, flat]) > 0.01, axis=1)
    errors[informed] = np.where(loose, np.inf, np.sqrt(variances) / sizes[informed])
    return errors


def sensitivity(
    model: AbstractModel, run: Run, parameters: Sequence[str], channels: Sequence[str] | None = None
) -> Sensitivity:
    """Return derivatives of predicted channels with respect to parameters, by a vmapped jvp.

    Arguments:
        model: model at the values of interest.
        run: run that provides the inputs and sampling times; its recorded values are not used.
        parameters: paths of parameters. An array stands for each of its elements. An omitted part
            is switched on at its default.
        channels: names without unit (`link06_z`); defaults to the recorded channels of the run.

    Raises:
        InputError: a parameter or channel is unknown, or none is given.
        SimulationError: the model cannot be evaluated.

    Example:
        >>> import giajax, numpy as np
        >>> from giajax.studies import sensitivity
        >>> command = {"joint01_command": np.full(51, 0.3)}
        >>> run = giajax.apps.synthetic.planned(np.linspace(0.0, 5.0, 51), command, links=4)
        >>> result = sensitivity(giajax.model_for([run]), run, ["air.drag_coefficient"])
        >>> result.derivatives.shape
        (1, 51, 12)
    """
    names = tuple(run.observations if channels is None else channels)
    if not names:
        raise InputError(f"'{run.name}' has no measured channel: give the channels of interest")
    if not parameters:
        raise InputError("no parameter is given: give the path of at least one")
    model = capabilities.for_derivatives(switched_on(model, parameters), parameters)
    parts = {part.path: part for path in parameters for part in elements(model, path)}
    values = jnp.stack([jnp.asarray(part.value(model)) for part in parts.values()])
    inputs = model.prepare(run)
    predicted, derivatives, successful = _push(model, inputs, values, tuple(parts), names)
    if not successful:
        raise SimulationError(capabilities.failure(model, inputs))
    return Sensitivity(
        times=run.times,
        channels=names,
        parameters=tuple(parts),
        units=tuple(part.declaration.unit for part in parts.values()),
        values=np.asarray(values),
        predicted=np.asarray(predicted),
        derivatives=np.asarray(derivatives),
    )


@program
def _push(
    model: AbstractModel,
    inputs: Any,
    values: Float[Array, " parameter"],
    paths: tuple[str, ...],
    channels: tuple[str, ...],
) -> tuple[Array, Array, Array]:
    def table(row: Array) -> tuple[Array, Array]:
        changed = replace(model, {path: row[i] for i, path in enumerate(paths)})
        predicted, successful = changed.predict(inputs, channels)
        return jnp.stack([predicted[name] for name in channels], axis=-1), successful

    def push(tangent: Array) -> tuple[Array, Array, Array]:
        return jax.jvp(table, (values,), (tangent,), has_aux=True)

    basis = jnp.eye(len(paths), dtype=values.dtype)
    return jax.vmap(push, out_axes=(None, 0, None))(basis)
