"""What a fit knows of a model (it predicts named channels), and which model a run needs."""

import abc
import dataclasses
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, NamedTuple, Self

import equinox as eqx
import numpy as np
import numpy.typing as npt

from ..recordings import Run, upgraded
from ..runtime.arrays import Array, Bool, Float, Scalar
from ..runtime.text import InputError
from ..schema import KINDS
from ..schema.parameters import declared, replace

# Numbers only, so that whatever draws needs neither JAX nor the model.


@dataclasses.dataclass(frozen=True)
class Line:
    """A polyline that moves: the axis of a round body, or a thread.

    Attributes:
        name: what it is (`link`, `muscle`); lines of one name look alike.
        points: m, shape (sample, point, 3).
        radii: of the round body about it at each point, m, shape (point,); 0 for a thread.
        loose: where a thread hangs slack, shape (sample,); None where it never does.
        pressure: inside, above the surroundings, Pa, shape (sample,); None where it has none.
    """

    name: str
    points: Float[np.ndarray, "sample point 3"]
    radii: Float[np.ndarray, " point"]
    loose: Bool[np.ndarray, " sample"] | None = None
    pressure: Float[np.ndarray, " sample"] | None = None

    def __post_init__(self) -> None:
        if self.points.shape[1:] != (len(self.radii), 3):
            raise InputError(
                f"the line '{self.name}' has points of shape {self.points.shape} and "
                f"{len(self.radii)} radii: give a radius to each point"
            )


@dataclasses.dataclass(frozen=True)
class Arrows:
    """Vectors that act somewhere: forces of the air, or of what is touched.

    Attributes:
        name: what they are (`air`, `contact`).
        unit: of their length (`N`).
        origins: where they act, m, shape (sample, arrow, 3).
        vectors: shape (sample, arrow, 3).
    """

    name: str
    unit: str
    origins: Float[np.ndarray, "sample arrow 3"]
    vectors: Float[np.ndarray, "sample arrow 3"]

    def __post_init__(self) -> None:
        if self.origins.shape != self.vectors.shape:
            raise InputError(
                f"the arrows '{self.name}' have origins of shape {self.origins.shape} and vectors "
                f"of shape {self.vectors.shape}: give an origin to each vector"
            )


@dataclasses.dataclass(frozen=True)
class Block:
    """A solid box that stays where it is.

    Attributes:
        name: of the obstacle that it is a part of.
        centre: m, shape (3,).
        size: along its own axes, m, shape (3,).
        axes: unit vectors along its sizes, as columns, shape (3, 3).
    """

    name: str
    centre: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """Everything that is seen of a model, in one frame: x ahead, y to the left, z upwards.

    Attributes:
        lines: bodies and threads.
        markers: points by name, m, each of shape (sample, 3); NaN where there is none.
        times: of the samples, s, shape (sample,); None where they are not in time.
        arrows: forces.
        blocks: what stands around.
    """

    lines: tuple[Line, ...]
    markers: dict[str, Float[np.ndarray, "sample 3"]]
    times: Float[np.ndarray, " sample"] | None = None
    arrows: tuple[Arrows, ...] = ()
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        lengths = {len(line.points) for line in self.lines}
        lengths |= {len(points) for points in self.markers.values()}
        lengths |= {len(arrows.origins) for arrows in self.arrows}
        if self.times is not None:
            lengths.add(len(self.times))
        if len(lengths) != 1:
            raise InputError(
                f"the parts of a scene have {sorted(lengths)} samples: give all of them as many"
            )

    @property
    def samples(self) -> int:
        """Number of samples."""
        parts = [*(line.points for line in self.lines), *self.markers.values()]
        return len(parts[0])

    def extent(self) -> Float[np.ndarray, "2 3"]:
        """Least and greatest coordinates of all bodies and markers over all samples, m."""
        corners = [points.reshape(-1, 3) for points in self.markers.values()]
        for line in self.lines:
            reach = line.radii[:, None]
            corners += [(line.points + sign * reach).reshape(-1, 3) for sign in (-1, 1)]
        everything = np.concatenate(corners)
        return np.stack([np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)])


# What a fit knows of a model: it predicts named channels for a run.

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
        """Its name in `giajax.schema.KINDS`: a constant of its class."""

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


# Models without a solver to choose, whose runs have no state of their own.


class AbstractDirectModel(AbstractModel):
    """A model without a solver to choose, whose runs have no state of their own.

    Says for all such models what they would say alike; the arm is the one that has both.
    """

    def unseen(self, inputs: Any, channels: tuple[str, ...]) -> dict[str, npt.NDArray[np.bool_]]:
        """None: whatever it has can be recorded at any time."""
        return {}

    def variants(self) -> dict[str, Self]:
        """None: it has no choice that parameters do not make."""
        return {}

    def free_inputs(self, run: Run) -> tuple[str, ...]:
        """None: a run has no state of its own."""
        return ()

    def initial_section(self, inputs: Any) -> dict[str, Any]:
        """Nothing: a run has no state of its own."""
        return {}

    def integration(self) -> Integration | None:
        """None: there is no solver to choose."""
        return None

    def with_integration(self, *, solver: str | None, tolerance: float | None) -> Self:
        """Refused: there is no solver to choose.

        Raises:
            InputError: always.
        """
        raise InputError(
            f"the {self.kind} model has neither a solver nor a tolerance: leave both out"
        )

    def for_derivatives(self, paths: Sequence[str]) -> Self:
        """The same: no step of it depends on what is differentiated."""
        return self


# Which model a set of runs, or a stored result, needs.


def model_class(kind: str) -> type[AbstractModel]:
    """The class of a kind, or of several as `arm+joint`; imported when a model of it is built."""
    where = "_several:SeveralModels" if "+" in kind else KINDS[kind].model
    module, _, name = where.partition(":")
    model: type[AbstractModel] = getattr(import_module(f".{module}", __package__), name)
    return model


def model_for(runs: Sequence[Run]) -> AbstractModel:
    """The model of some runs, with the constants that their sidecars state.

    Of runs of several kinds it has a model of each, which share the parameters of the same path.

    Raises:
        InputError: the sidecars of runs contradict each other.
    """
    return model_class("+".join(dict.fromkeys(run.model for run in runs))).for_runs(runs)


def build_model(
    kind: str, definition: Mapping[str, Any], parameters: Mapping[str, Any]
) -> AbstractModel:
    """The model that a stored result describes.

    Arguments:
        kind: name of the model.
        definition: what its `definition()` gave.
        parameters: values by path.

    Raises:
        InputError: an unknown kind or path.
    """
    older = upgraded({"model": kind, **definition})
    kind = older.pop("model")
    for name in kind.split("+"):
        if name not in KINDS:
            raise InputError(
                f"there is no kind of model '{name}' in this version: use one of {', '.join(KINDS)}"
            )
    former = KINDS[kind].former_parameters if kind in KINDS else ()
    values = {path: v for path, v in parameters.items() if path.partition("[")[0] not in former}
    # Whole arrays first: an element may belong to an array that the definition has as a number.
    whole = {path: value for path, value in values.items() if "[" not in path}
    return replace(replace(model_class(kind).from_definition(older), whole), values)


def parameter_values(model: eqx.Module) -> dict[str, Any]:
    """All declared parameters of a model or a part of one by path, as numbers and lists of them."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
