"""What a fit knows of a model (it predicts named channels), and which model a run needs."""

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

# What is seen is numbers only, so that whatever draws needs neither JAX nor the model.


@dataclasses.dataclass(frozen=True)
class Line:
    """A polyline that moves: the axis of a round body, or a thread; lines of one name look alike.

    Attributes:
        points: m.
        radii: of the round body about it at each point, m; 0 for a thread.
        loose: where a thread hangs slack; None where it never does.
        pressure: inside, above the surroundings, Pa; None where it has none.
        swelling: factor of the radii over time; None where they stay.
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
    """Vectors of a unit that act at origins (m): forces of the air, or of what is touched."""

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
    """A solid box, a part of the obstacle of that name, that stays where it is.

    Its centre and its size along its own axes are in m; the axes are unit vectors, as columns.
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
        markers: points by name, m; NaN where there is none.
        times: of the samples, s; None where they are not in time.
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
                f"the parts of a scene have {sorted(lengths)} samples: give all parts the same "
                f"number of samples"
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


Channels = dict[str, Float[Array, " sample"]]
Prediction = tuple[Channels, Bool[Array, ""]]
"""Channels (SI) at the samples of a run, and whether the prediction succeeded."""


class AbstractModel(ShownAsTable, eqx.Module):
    """A model whose declared parameters can be fitted to runs.

    A fit needs what it predicts, how a run is prepared for it, and what it is made from; it never
    asks which model it has. Everything else is optional: `giajax.models.capabilities` has one
    function for each method that a model may have, and says what holds for a model without it.

    A class of one's own that says which `channels` its runs have is a kind of runs and files once
    it is registered (`giajax.register`): a sidecar names it, and every command takes it.
    """

    registered_as: ClassVar[str] = "model"
    names_of_giajax: ClassVar[Sequence[str]] = tuple(KINDS)

    channels: ClassVar[tuple[ChannelKind, ...]] = ()
    """Of a class of one's own: the rows of its runs, its own or those that other kinds have."""
    section: ClassVar[type[Section] | None] = None
    """Of a class of one's own: the section of its name in files, where it has one."""
    timed: ClassVar[bool] = True
    """Of a class of one's own: whether its runs have times."""

    @classmethod
    def on_registration(cls) -> None:
        """Add the kind of a class that says which channels it has.

        Raises:
            InputError: it has no constant kind, or one that names no section of its own in files;
                or a channel is not a row, or contradicts that of another kind.
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
            raise InputError(f"there already is a section [{name}]: give the model another kind")
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
        """Its name, in `giajax.schema.KINDS` where it is a kind: a constant of its class."""

    @classmethod
    @optional
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The model of some runs, with the constants that their sidecars state, if it has any."""
        return made_by_default(cls, f"the model {cls.__name__}")

    @abc.abstractmethod
    def definition(self) -> dict[str, Any]:
        """What it is made from, its parameters apart, as plain data."""

    @classmethod
    @optional
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The model that `definition()` described, with any values of its parameters."""
        if definition:
            raise InputError(
                f"{cls.__name__} has a definition but no method from_definition: write this method"
            )
        return made_by_default(cls, f"the model {cls.__name__}")

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
    def predict(self, inputs: Any, channels: tuple[str, ...]) -> Prediction:
        """Predicted channels (SI) at the samples of a prepared run, and whether that succeeded.

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
    """Channels (SI) that a model predicts for a run, and whether that succeeded.

    There is one program for all that predict, whose traced form is kept between processes.

    Arguments:
        inputs: the prepared run.
    """
    samples = len(next(iter(run.values.values())))
    table, successful = _table_of(model, inputs, channels, samples)
    columns = np.array(table).T
    return dict(zip(channels, columns, strict=True)), bool(successful)


def model_class(kind: str) -> Any:
    """The class of a kind, or of several as `arm+joint`; imported when a model of it is built."""
    if "+" not in kind and kind not in AbstractModel.names_of_giajax:
        return registered(AbstractModel.registered_as, kind)
    where = "_several:SeveralModels" if "+" in kind else KINDS[kind].model
    module, _, name = where.partition(":")
    return getattr(import_module(f".{module}", __package__), name)


def model_for(runs: Sequence[Run]) -> AbstractModel:
    """The model of some runs, with the constants that their sidecars state.

    Of runs of several kinds it has a model of each, which share the parameters of the same path.

    Raises:
        InputError: the sidecars of runs contradict each other.
    """
    kinds = "+".join(dict.fromkeys(run.model for run in runs))
    model: AbstractModel = model_class(kinds).for_runs(runs)
    return model


def build_model(
    kind: str, definition: Mapping[str, Any], parameters: Mapping[str, Any]
) -> AbstractModel:
    """The model that a stored result describes: a kind, what its `definition()` gave, values by
    path.

    Raises:
        InputError: an unknown kind or path.
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
    # Whole arrays first: an element may belong to an array that the definition has as a number.
    whole = {path: value for path, value in values.items() if "[" not in path}
    return replace(replace(model_class(kind).from_definition(older), whole), values)


def parameter_values(model: eqx.Module) -> dict[str, Any]:
    """All declared parameters of a model or a part of one by path, as numbers and lists of them."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
