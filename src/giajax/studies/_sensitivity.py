"""How strongly the channels of a run respond to parameters, and what that is worth to a fit."""

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

_FLAT = 1e-8  # column-normalised singular values below this are directions that no channel shows


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Derivatives of predicted channels by parameters, along a run.

    Attributes:
        times: s, shape (sample,); None for a static run.
        channels: what is predicted, without unit (`link06_z`).
        parameters: scalar parameters by path.
        units: of the parameters.
        values: of the parameters at which the derivatives hold, shape (parameter,).
        predicted: SI, shape (sample, channel).
        derivatives: SI, shape (parameter, sample, channel).
    """

    times: Float[np.ndarray, " sample"] | None
    channels: tuple[str, ...]
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    values: Float[np.ndarray, " parameter"]
    predicted: Float[np.ndarray, "sample channel"]
    derivatives: Float[np.ndarray, "parameter sample channel"]

    def bodies(self) -> dict[str, list[int]]:
        """Positions of the channels of each body (`link06`: its x, y and z), by its name."""
        bodies: dict[str, list[int]] = {}
        for index, name in enumerate(self.channels):
            bodies.setdefault(body_of(name), []).append(index)
        return bodies

    def lengths(self) -> tuple[tuple[str, ...], Float[np.ndarray, "parameter sample body"]]:
        """Names of the bodies, and how far each moves with a parameter: |d position / d p|.

        Of a body with one channel, the size of that channel's derivative.
        """
        bodies = self.bodies()
        sizes = [np.linalg.norm(self.derivatives[:, :, rows], axis=2) for rows in bodies.values()]
        return tuple(bodies), np.stack(sizes, axis=-1)

    def information(self, noise: npt.ArrayLike) -> Float[np.ndarray, "body parameter parameter"]:
        """Fisher information that each body carries, in 1 over the units of the parameters.

        The sum over its channels and samples of s s^T / noise^2; informations of bodies add. The
        noise is the standard deviation of white noise, SI: one positive number, or one per channel.
        """
        deviations = np.broadcast_to(np.asarray(noise, dtype=float), (len(self.channels),))
        if not np.all(deviations > 0):
            raise InputError(f"the noise is {deviations.min():g}: give a positive number")
        weighted = self.derivatives / deviations
        parts = (weighted[:, :, rows] for rows in self.bodies().values())
        return np.stack([np.einsum("itc,jtc->ij", part, part) for part in parts])

    def standard_errors(self, noise: npt.ArrayLike) -> Float[np.ndarray, " parameter"]:
        """Errors to expect of a fit of all these parameters to all these channels (Cramer-Rao).

        Infinite where only a combination of parameters is determined.
        """
        return expected_errors(self.information(noise).sum(axis=0))

    def errors_by_body(self, noise: npt.ArrayLike) -> Float[np.ndarray, "body parameter"]:
        """Errors to expect where only one body is recorded and the other parameters are known."""
        alone = np.diagonal(self.information(noise), axis1=1, axis2=2)
        with np.errstate(divide="ignore"):
            return 1 / np.sqrt(alone)


def body_of(channel: str) -> str:
    """What a channel is a component of: `link06` of `link06_z`; itself, if of nothing."""
    return channel[:-2] if Channel.named(channel).component is not None else channel


def expected_errors(information: Float[np.ndarray, "parameter parameter"]) -> np.ndarray:
    """Square roots of the diagonal of the inverse; infinite in directions without information."""
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
    """Derivatives of the channels that a model predicts for a run, all by one vmapped jvp.

    Arguments:
        model: at the values of interest.
        run: gives what drives the model, and when it is sampled; what it recorded is not used.
        parameters: paths; an array stands for each of its elements, and what the model leaves
            out is switched on at its default.
        channels: names without unit (`link06_z`); those that the run recorded by default.

    Raises:
        InputError: an unknown parameter or channel, or none.
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
