"""Interface between a fit and a model, and the choice of the model for a run."""

import abc
import dataclasses
import re
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..recordings import Definition, Run, upgraded
from ..runtime.arrays import Array, Bool, Float
from ..runtime.plugins import made_by_default, optional, registered
from ..runtime.programs import program
from ..runtime.text import InputError, ShownAsTable, one_of
from ..schema import KINDS, ChannelKind, Kind, Section, add_kind
from ..schema.parameters import declared, parameter_rows, replace

# A scene contains only numbers, so code that draws it needs neither JAX nor the model.


@dataclasses.dataclass(frozen=True)
class Line:
    """A moving polyline: the axis of a round body, or a thread. Lines of one name look alike.

    Attributes:
        points: points of the line, m.
        radii: radius of the round body at each point, m; 0 for a thread.
        loose: True where a thread is slack; None if it never is.
        pressure: gauge pressure inside, Pa; None if there is none.
        swelling: factor of the radii over time; None if they are constant.
    """

    name: str
    points: Float[np.ndarray, "sample point 3"]
    radii: Float[np.ndarray, " point"]
    loose: Bool[np.ndarray, " sample"] | None = None
    pressure: Float[np.ndarray, " sample"] | None = None
    swelling: Float[np.ndarray, " sample"] | None = None

    def __post_init__(self) -> None:
        if self.points.shape[1:] != (len(self.radii), 3):
            raise InputError(
                f"the line '{self.name}' has points of shape {self.points.shape} and "
                f"{len(self.radii)} radii: give one radius for each point"
            )


@dataclasses.dataclass(frozen=True)
class Arrows:
    """Vectors of one unit that act at origins (m), such as forces of air or contact."""

    name: str
    unit: str
    origins: Float[np.ndarray, "sample arrow 3"]
    vectors: Float[np.ndarray, "sample arrow 3"]

    def __post_init__(self) -> None:
        if self.origins.shape != self.vectors.shape:
            raise InputError(
                f"the arrows '{self.name}' have origins of shape {self.origins.shape} and vectors "
                f"of shape {self.vectors.shape}: give one origin for each vector"
            )


@dataclasses.dataclass(frozen=True)
class Block:
    """A fixed solid box, which is a part of the obstacle with this name.

    Centre, and size along its own axes, are in m. The axes are unit vectors, as columns.
    """

    name: str
    centre: Float[np.ndarray, "3"]
    size: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "3 3"]


@dataclasses.dataclass(frozen=True)
class Scene:
    """All visible parts of a model in one frame: x ahead, y to the left, z upwards.

    Attributes:
        lines: bodies and threads.
        markers: points by name, m; NaN where a point is missing.
        times: times of the samples, s; None if they are not a time series.
        arrows: forces.
        blocks: obstacles.
        channels: values that a page can plot over time, SI, by channel name.
    """

    lines: tuple[Line, ...]
    markers: dict[str, Float[np.ndarray, "sample 3"]]
    times: Float[np.ndarray, " sample"] | None = None
    arrows: tuple[Arrows, ...] = ()
    blocks: tuple[Block, ...] = ()
    channels: Mapping[str, Float[np.ndarray, " sample"]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        lengths = {len(line.points) for line in self.lines}
        lengths |= {len(points) for points in self.markers.values()}
        lengths |= {len(arrows.origins) for arrows in self.arrows}
        lengths |= {len(values) for values in self.channels.values()}
        if self.times is not None:
            lengths.add(len(self.times))
        if len(lengths) != 1:
            raise InputError(
                f"the parts of a scene have {sorted(lengths)} samples: give all parts the same "
                f"number of samples"
            )

    @property
    def samples(self) -> int:
        """Number of samples."""
        parts = [*(line.points for line in self.lines), *self.markers.values()]
        return len(parts[0])

    def extent(self) -> Float[np.ndarray, "2 3"]:
        """Minimum and maximum coordinates of all bodies and markers over all samples, m."""
        corners = [points.reshape(-1, 3) for points in self.markers.values()]
        for line in self.lines:
            reach = line.radii[:, None]
            corners += [(line.points + sign * reach).reshape(-1, 3) for sign in (-1, 1)]
        everything = np.concatenate(corners)
        return np.stack([np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)])


Channels = dict[str, Float[Array, " sample"]]
Prediction = tuple[Channels, Bool[Array, ""]]
"""Channels (SI) at the samples of a run, and whether the prediction succeeded."""


class AbstractModel(ShownAsTable, eqx.Module):
    """A model whose declared parameters can be fitted to runs.

    A fit uses only the methods that prepare a run, predict its channels, and define the model, and
    never depends on the class of the model. All other methods are optional:
    `giajax.models.capabilities` has one function for each of them, which also defines the result
    for a model without it.

    A user-defined class that declares the `channels` of its runs becomes a kind of runs and files
    when it is registered (`giajax.register`): sidecars can name it, and every command accepts it.
    """

    registered_as: ClassVar[str] = "model"
    names_of_giajax: ClassVar[Sequence[str]] = tuple(KINDS)

    channels: ClassVar[tuple[ChannelKind, ...]] = ()
    """For a user-defined class: rows of the column table for its runs, new or of other kinds."""
    section: ClassVar[type[Section] | None] = None
    """For a user-defined class: the section of files with the name of its kind, if there is one."""
    timed: ClassVar[bool] = True
    """For a user-defined class: True if its runs have times."""

    @classmethod
    def on_registration(cls) -> None:
        """Register the kind of a class that declares channels.

        Raises:
            InputError: the kind is not a constant, or cannot be the name of a new section in files;
                or a channel is not a row, or contradicts a channel of another kind.
        """
        name: Any = cls.kind
        rows: Any = cls.channels
        if not isinstance(name, str):
            raise InputError(
                f"{cls.__name__}.kind is {name!r}: make it a string, such as kind = 'kite'"
            )
        if not rows:
            return
        if name in Definition.model_fields and name not in KINDS:
            raise InputError(f"a section [{name}] already exists: give the model another kind")
        if hasattr(Definition, name) or not re.fullmatch("[A-Za-z][A-Za-z0-9_-]*", name):
            raise InputError(f"no section can have the name {name!r}: give the model another kind")
        if not isinstance(rows, tuple | list) or {*map(type, rows)} != {ChannelKind}:
            raise InputError(
                f"{cls.__name__}.channels is {rows!r}: make it a tuple of giajax.schema.ChannelKind"
            )
        others = {row.name for kind in KINDS.values() if kind.name != name for row in kind.channels}
        own = {row.name for row in rows} - others
        measured = [row.column for row in rows if row.part == "output"]
        add_kind(
            Kind(
                name=name,
                model="",
                channels=tuple(rows),
                recognises=lambda rows: not own.isdisjoint(rows),
                measured=" or ".join(measured),
                sections={} if cls.section is None else {name: cls.section},
                timed=cls.timed,
            )
        )

    @property
    @abc.abstractmethod
    def kind(self) -> str:
        """Name of the kind, constant for a class; in `giajax.schema.KINDS` if registered."""

    @classmethod
    @optional
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the model of some runs, with the constants in their sidecars, if any."""
        return made_by_default(cls, f"the model {cls.__name__}")

    @abc.abstractmethod
    def definition(self) -> dict[str, Any]:
        """Return plain data from which the model can be made again, without its parameters."""

    @classmethod
    @optional
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the model that `definition()` described, with any parameter values."""
        if definition:
            raise InputError(
                f"{cls.__name__} has a definition but no method from_definition: write this method"
            )
        return made_by_default(cls, f"the model {cls.__name__}")

    @abc.abstractmethod
    def prepare(self, run: Run) -> Any:
        """Return the inputs of the model in a run, as a pytree of arrays.

        The first axis of each time-dependent leaf may be extended by repetition of its last row,
        which must not change the prediction at earlier rows. Runs of several lengths then share one
        compiled program. Other leaves must have the same shape for every run.

        Raises:
            InputError: the run does not belong to this model.
        """

    @abc.abstractmethod
    def predict(self, inputs: Any, channels: tuple[str, ...]) -> Prediction:
        """Return predicted channels (SI) at the samples of a run, and whether it succeeded.

        Must be differentiable in forward mode with respect to the declared parameters.
        """

    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        rows: dict[str, str] = {}
        for part in vars(self).values():
            if isinstance(part, ShownAsTable):
                rows |= {row[0]: row[1] for row in part._table()[2]}
        return type(self).__name__, ("", ""), list({**rows, **parameter_rows(self)}.items())


@program
def _table_of(
    model: AbstractModel, inputs: Any, channels: tuple[str, ...], samples: int
) -> tuple[Array, Array]:
    predicted, successful = model.predict(inputs, channels)
    columns = [jnp.asarray(predicted[channel], jnp.result_type(float)) for channel in channels]
    table = jnp.stack(columns, axis=1) if columns else jnp.zeros((samples, 0))
    return table, jnp.asarray(successful, bool)


def predicted_channels(
    model: AbstractModel, inputs: Any, channels: tuple[str, ...], run: Run
) -> tuple[dict[str, Float[np.ndarray, " sample"]], bool]:
    """Return the channels (SI) that a model predicts for a run, and whether it succeeded.

    All predictions use one program, whose traced form is stored between processes.

    Arguments:
        inputs: the prepared run.
    """
    samples = len(next(iter(run.values.values())))
    table, successful = _table_of(model, inputs, channels, samples)
    columns = np.array(table).T
    return dict(zip(channels, columns, strict=True)), bool(successful)


def model_class(kind: str) -> Any:
    """Import and return the class of a kind, or of several kinds such as `arm+joint`."""
    if "+" not in kind and kind not in AbstractModel.names_of_giajax:
        return registered(AbstractModel.registered_as, kind)
    where = "_several:SeveralModels" if "+" in kind else KINDS[kind].model
    module, _, name = where.partition(":")
    return getattr(import_module(f".{module}", __package__), name)


def model_for(runs: Sequence[Run]) -> AbstractModel:
    """Return the model of some runs, with the constants in their sidecars.

    For runs of several kinds it combines a model of each kind. Parameters with the same path are
    shared.

    Raises:
        InputError: the sidecars of the runs contradict each other.
    """
    kinds = "+".join(dict.fromkeys(run.model for run in runs))
    model: AbstractModel = model_class(kinds).for_runs(runs)
    return model


def build_model(
    kind: str, definition: Mapping[str, Any], parameters: Mapping[str, Any]
) -> AbstractModel:
    """Return the model of a stored result from its kind, `definition()` and values by path.

    Raises:
        InputError: a kind or path is unknown.
    """
    older = upgraded({"model": kind, **definition})
    kind = older.pop("model")
    for name in kind.split("+"):
        if name not in KINDS and registered(AbstractModel.registered_as, name) is None:
            raise InputError(
                f"there is no kind of model '{name}': use {one_of(KINDS)}, or register the class "
                f"of the model"
            )
    former = KINDS[kind].former_parameters if kind in KINDS else ()
    values = {path: v for path, v in parameters.items() if path.partition("[")[0] not in former}
    # Set whole arrays first, because an element may belong to an array that is still one number.
    whole = {path: value for path, value in values.items() if "[" not in path}
    return replace(replace(model_class(kind).from_definition(older), whole), values)


def parameter_values(model: eqx.Module) -> dict[str, Any]:
    """Return all declared parameters of a model or a part by path, as numbers and lists."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
