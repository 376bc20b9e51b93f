"""The least-squares problem: weighted differences between predicted and recorded channels."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import replace
from ..runs import Run
from ._bijector import Bijector
from ._group import Group
from ._priors import Priors
from ._ties import Tie, tied


class Problem(eqx.Module):
    """Everything that the residual depends on, apart from the free coordinates.

    The coordinate begins with the values of the model's parameters, one each that all runs share
    or one for each group of runs; then come those of each run alone, which have no bounds. A run
    responds to its values of the former and to its own: the Jacobian is computed and stored in
    these blocks.

    Attributes:
        model: with what is not free.
        groups: of runs that share a program.
        bijector: of the whole coordinate.
        paths: of the model's free parameters.
        loss: how a large residual counts.
        places: positions of each path's values in the coordinate; one each, in their order, where
            it is empty.
        ties: parameters that follow from others.
        priors: what is known of the coordinates before; their rows of the residual come last.
    """

    model: AbstractModel
    groups: tuple[Group, ...]
    bijector: Bijector
    paths: tuple[str, ...] = eqx.field(static=True)
    loss: str = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    ties: tuple[Tie, ...] = eqx.field(static=True, default=())
    priors: Priors = eqx.field(default_factory=Priors.none)

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return self.shared + sum(len(g.members) * g.width for g in self.groups)

    @property
    def positions(self) -> tuple[tuple[int, ...], ...]:
        """Positions of each path's values in the coordinate."""
        return self.places or tuple((index,) for index in range(len(self.paths)))

    @property
    def shared(self) -> int:
        """Number of coordinates before those of single runs."""
        return sum(map(len, self.positions))

    def at(self, coordinate: Float[Array, " own"]) -> AbstractModel:
        """The model at the coordinates of a run, of which one a path counts."""
        bounds = self.bijector.at([place[0] for place in self.positions])
        return self.with_values(bounds.forward(coordinate[: len(self.paths)]))

    def with_values(self, values: Float[Array | np.ndarray, " path"]) -> AbstractModel:
        """The model with a value for each path, and with what follows from them."""
        model = replace(self.model, {path: values[i] for i, path in enumerate(self.paths)})
        return tied(model, self.ties)

    def means(self, values: Array | np.ndarray) -> Array | np.ndarray:
        """A value for each path, of those of all coordinates: of several, the mean."""
        means = [values[np.asarray(place)].mean() for place in self.positions]
        if isinstance(values, np.ndarray):
            return np.asarray(means)
        return jnp.stack(means) if means else jnp.zeros(0)

    def free_paths(self, group: Group) -> tuple[str, ...]:
        """Paths of all that the predictions of a group's runs are differentiated by."""
        following = (tie.path for tie in self.ties)
        return (*self.paths, *following, *(path for path, _ in group.own))


class Prediction(eqx.Module):
    """What comes out beside the residual.

    Attributes:
        channels: predictions of each group (SI), shape (run, sample, channel).
        successful: whether all simulations succeeded.
    """

    channels: tuple[Any, ...]
    successful: Any


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
