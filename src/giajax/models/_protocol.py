"""What a fit knows of a model: it predicts named channels for a run."""

import abc
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import equinox as eqx
import numpy as np
import numpy.typing as npt

from .._typing import Array, Bool, Float, Scalar
from ..runs import Run
from ._scene import Scene

Channels = dict[str, Float[Array, " sample"]]


class Derived(NamedTuple):
    """A quantity that follows from the parameters: its value and its unit."""

    value: Scalar
    unit: str


class Integration(NamedTuple):
    """How a model is integrated: its solver by name, and the tolerance of a step.

    The tolerance is None where nobody stated one: a fit then chooses it.
    """

    solver: str
    tolerance: float | None


class AbstractModel(eqx.Module):
    """A model whose declared parameters can be fitted to runs.

    Everything a fit does goes through these methods; it never asks which model it has. A model
    without a solver to choose, whose runs have no state of their own, derives from
    `AbstractDirectModel`, which has the last six of them.
    """

    @property
    @abc.abstractmethod
    def kind(self) -> str:
        """Its name in `giajax.kinds.KINDS`: a constant of its class."""

    @classmethod
    @abc.abstractmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The model of some runs, with the constants that their sidecars state.

        Raises:
            InputError: the sidecars contradict each other.
        """

    @classmethod
    @abc.abstractmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The model that `definition()` described, its parameters apart."""

    @abc.abstractmethod
    def definition(self) -> dict[str, Any]:
        """Plain data from which `build_model` makes this model again, its parameters apart."""

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
    def failure(self, inputs: Any) -> str:
        """Why the prediction of a prepared run did not succeed, and what to do: one sentence."""

    @abc.abstractmethod
    def at_start(self, runs: Sequence[Run], free: Sequence[str]) -> Self:
        """The model from which a fit of some parameters to some runs may start.

        Another one where a parameter has, by default, a value at which nothing responds to it;
        most models have no such parameter.

        Arguments:
            runs: what is fitted to.
            free: paths of the elements to fit that have no start.
        """

    @abc.abstractmethod
    def derived(self) -> dict[str, Derived]:
        """Quantities that follow from the parameters and may be determined where those are not.

        Such as the products of parameters that show only together. Differentiable; a fit gives
        each a standard error. By name, which is no path of a parameter.
        """

    @abc.abstractmethod
    def conditions(self, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
        """Sentences: on what the parameters, fitted to these runs, are conditional.

        Of the runs some may be of another kind, and tell the same parameters something else.
        """

    @abc.abstractmethod
    def refined(self, factor: float) -> Self:
        """The same model with its numerical tolerances multiplied by a factor."""

    @abc.abstractmethod
    def scene(self, run: Run) -> Scene | None:
        """What is seen of the model as it follows a run; None where nothing is.

        Raises:
            InputError: the run is not one of this model.
            SimulationError: the model cannot be evaluated.
        """

    # `AbstractDirectModel` says what follows for its models.

    @abc.abstractmethod
    def unseen(self, inputs: Any, channels: tuple[str, ...]) -> dict[str, npt.NDArray[np.bool_]]:
        """Samples of a prepared run at which an experiment could not record a channel.

        By channel, each of shape (sample,), such as where a point is out of a camera's picture;
        what it does not name is always recorded.
        """

    @abc.abstractmethod
    def variants(self) -> dict[str, Self]:
        """The same model with one of its choices made another way, by what that is called.

        Choices are what no parameter blends, such as where drag acts. Whoever asks what a fit
        leaves out (`giajax.suspects`) tries each of them; most models have none.
        """

    @abc.abstractmethod
    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """Declared parameters of the prepared inputs that are free in this run, by path.

        They belong to the run alone, such as its initial state; most models have none.
        """

    @abc.abstractmethod
    def initial_section(self, inputs: Any) -> dict[str, Any]:
        """Keys of `[initial]` that state how a prepared run begins; none where no state does.

        A run that says `first_row = true` can then be recorded again with another first row.
        """

    @abc.abstractmethod
    def integration(self) -> Integration | None:
        """How the model is integrated; None where it is in closed form or has steps of its own."""

    @abc.abstractmethod
    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """The same model with another solver or tolerance; None leaves the one it has.

        Raises:
            InputError: the model has none, the solver does not exist, or the tolerance is not a
                positive number.
        """

    @abc.abstractmethod
    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """The same model, as exact in derivatives by some parameters as in its predictions.

        A model that integrates may need shorter steps for them. Its predictions do not depend on
        whether they are differentiated, so that a fit and a sensitivity study ask for this.

        Arguments:
            paths: of parameters of the model, or of the prepared inputs (`free_inputs`).
        """
