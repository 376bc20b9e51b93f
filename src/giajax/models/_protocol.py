"""What a fit knows of a model: it predicts named channels for a run."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, Self

import equinox as eqx

from .._typing import Array, Bool, Float
from ..runs import Run

Channels = dict[str, Float[Array, " sample"]]


class AbstractModel(eqx.Module):
    """A model whose declared parameters can be fitted to runs.

    Everything a fit does goes through these methods; it never asks which model it has.
    """

    kind: ClassVar[str]

    @abc.abstractmethod
    def prepare(self, run: Run) -> Any:
        """What the model needs of a run, as a pytree of arrays.

        The first axis of each leaf that belongs to time may be extended by repeating its last
        row without changing a prediction at the rows before: runs of several lengths then share
        one compiled program. Other leaves must have the same shape for every run.

        Raises:
            InputError: the run is not one of this model.
        """

    @abc.abstractmethod
    def predict(self, inputs: Any, channels: tuple[str, ...]) -> tuple[Channels, Bool[Array, ""]]:
        """Predicted channels (SI) at the samples of a prepared run, and whether that succeeded.

        Must be differentiable in forward mode with respect to the declared parameters.
        """

    @abc.abstractmethod
    def refined(self, factor: float) -> Self:
        """The same model with its numerical tolerances multiplied by a factor."""

    @abc.abstractmethod
    def conditions(self, free: Sequence[str]) -> list[str]:
        """Sentences: on what the given fitted parameters are conditional."""

    @abc.abstractmethod
    def definition(self) -> dict[str, Any]:
        """Plain data from which `build_model` makes this model again, its parameters apart."""
