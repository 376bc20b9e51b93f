"""Declarations of the kinds of models, without JAX, and the list of all kinds: `KINDS`."""

import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol, TypeVar, cast, get_args

import numpy as np
import numpy.typing as npt

from ..runtime.text import InputError, one_of
from ._declaration import QUANTITIES, Section

S = TypeVar("S", bound=Section)
Function = TypeVar("Function", bound=Callable[..., Any])


class RecordedChannel(Protocol):
    """The attributes of a channel that kinds use; see `giajax.recordings.Channel`."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def index(self) -> int | None: ...
    @property
    def quantity(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def camera(self) -> str | None: ...


class Sections(Protocol):
    """The attributes of a definition that kinds use; see `giajax.recordings.Definition`."""

    @property
    def free_motion(self) -> bool | None: ...

    def section(self, of: type[S]) -> S:
        """Return the section of a class, with its defaults if it is not in the file."""


class RecordedRun(Protocol):
    """The attributes of a run that kinds use; see `giajax.recordings.Run`."""

    @property
    def times(self) -> npt.NDArray[np.float64] | None: ...
    @property
    def values(self) -> Mapping[str, npt.NDArray[Any]]: ...
    @property
    def channels(self) -> Mapping[str, RecordedChannel]: ...
    @property
    def definition(self) -> Sections: ...


class Naming(Protocol):
    """How error messages name rows and columns: `row 5` of a file, `sample 5` of arrays."""

    @property
    def source(self) -> str: ...

    def at(self, index: Any) -> str:
        """Return the name of the row of the sample with this index."""

    def of(self, channel: RecordedChannel) -> str:
        """Return the name of the channel in the user's file or arrays."""


NOISE_KEYS = ("position_m", "angle_deg", "rate_deg_per_s", "pixel_px", "acceleration_m_per_s2")
"""Keys of `[noise]` that apply to all columns of some rows of the column table."""

Part = Literal["input", "surroundings", "output"]

CAMERA_NAME = "[A-Za-z][A-Za-z0-9_]*"
"""Regular expression of the name of a camera."""


@dataclass(frozen=True)
class ChannelKind:
    """A row of the column table.

    Attributes:
        name: name of the row, such as `link_position`.
        column: a channel of the row without its unit, as written in documentation: `linkNN_x`. NN
            stands for the number of a joint, link or landmark, x at the end for x, y or z, and u at
            the end for u or v. The name of a camera may precede u and v: `side.linkNN_u`.
        quantity: quantity of the values, from the table `QUANTITIES`; None for any quantity.
        part: role in the model: an input, a part of the surroundings that also acts on the model,
            or an output, which the model predicts.
        texts: legal values of a channel that contains text.
        noise: key of `[noise]` that applies to the row, besides the names of its columns.
    """

    name: str
    column: str
    quantity: str | None
    part: Part
    texts: tuple[str, ...] = ()
    noise: str | None = None

    @property
    def pattern(self) -> str:
        """Regular expression of the channels of this row.

        Its groups are `index`, `component` and `camera`.
        """
        numbered = self.column.replace("NN", "(?P<index>[0-9]+)")
        if numbered.endswith("_u"):
            return rf"(?:(?P<camera>{CAMERA_NAME})\.)?{numbered[:-1]}(?P<component>[uv])"
        return re.sub("_x$", "_(?P<component>[xyz])", numbered)

    @functools.cached_property
    def components(self) -> str:
        """Possible last letters of a channel, one for each component; empty without components."""
        return {"_x": "xyz", "_u": "uv"}.get(self.column[-2:], "")


class SectionTemplate(NamedTuple):
    """A section in the template of a sidecar, with a comment after its name.

    The name is empty for keys before the first section. A key whose value is None becomes a comment
    with an example.
    """

    section: str
    keys: Mapping[str, Any]
    comment: str = ""


@dataclass(frozen=True)
class Kind:
    """A kind of model: the contents of its runs and files, and the class of the model.

    Attributes:
        name: the `model = "..."` of a sidecar.
        model: module in `giajax.models` and class, such as `_arm:ArmModel`. It is imported when a
            model is built, because it imports JAX. Empty if a registered class has the name.
        channels: rows of the column table, in the order of a written file.
        recognises: function that returns whether a run with these rows is of this kind, for runs
            without a sidecar that gives it.
        measured: columns to fit, as an example in messages.
        sections: names of the sections of a definition that describe the model -> their classes.
        run_sections: the same for sections that describe one run.
        commands: rows of the table that count as a command in a description of a run.
        uncommanded: text for a description of a run without a command, or empty.
        timed: True if every run has times.
        interpolation: function that returns the interpolation of the commands of a run between
            two rows: "linear", "zoh" (held) or "band_limited".
        drawn_over: function that returns the input over which measured channels of a run are
            plotted, or None for time.
        check: function that raises `InputError` if a run is unusable for all models of this kind.
        notes: function that returns sentences on assumptions that replace missing information
            about a run. Its second argument is True if there is a sidecar.
        template: function that returns the sections to offer for a run with these channels.
        template_heading: second line of a template.
        former_parameters: paths in results of older versions that no longer exist.
        upgraded: function that converts a definition of an older version to this version.
    """

    name: str
    model: str
    channels: tuple[ChannelKind, ...]
    recognises: Callable[[frozenset[str]], bool]
    measured: str
    sections: Mapping[str, type[Section]] = field(default_factory=dict)
    run_sections: Mapping[str, type[Section]] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    uncommanded: str = ""
    timed: bool = False
    interpolation: Callable[[RecordedRun], str] = lambda run: "linear"
    drawn_over: Callable[[RecordedRun], str | None] = lambda run: None
    check: Callable[[RecordedRun, Naming], None] = lambda run, naming: None
    notes: Callable[[RecordedRun, bool], list[str]] = lambda run, sidecar: []
    template: Callable[[Sequence[RecordedChannel]], list[SectionTemplate]] | None = None
    template_heading: str = "# is assumed or unknown."
    former_parameters: frozenset[str] = frozenset()
    upgraded: Callable[[dict[str, Any]], dict[str, Any]] = lambda definition: definition

    @property
    def all_sections(self) -> dict[str, type[Section]]:
        """Sections that describe the model, followed by those that describe one run."""
        return {**self.sections, **self.run_sections}

    def rows(self, *parts: str) -> tuple[str, ...]:
        """Return the names of the rows of the column table with one of these roles."""
        return tuple(row.name for row in self.channels if row.part in parts)

    @functools.cached_property
    def inputs(self) -> tuple[str, ...]:
        """Rows of the inputs that drive the model, without its surroundings."""
        return self.rows("input")

    @functools.cached_property
    def outputs(self) -> tuple[str, ...]:
        """Rows that the model predicts and a run measures."""
        return self.rows("output")

    def offers(self, channels: Sequence[RecordedChannel]) -> list[SectionTemplate]:
        """Return the sections that a template offers.

        They are all sections of the model with all keys, unless the kind selects them by the
        channels of the run.
        """
        if self.template is not None:
            return self.template(channels)
        return [
            SectionTemplate(
                name,
                dict.fromkeys(section.model_fields),
                "defaults apply to keys that are not set",
            )
            for name, section in self.sections.items()
        ]


KINDS: dict[str, Kind] = {}
"""Kinds by name. This is the only list of kinds in giajax."""

_CACHED: list[Any] = []


def cached_by_kinds(function: Function) -> Function:
    """Cache a function of the declarations of kinds until another kind is added."""
    cached: Any = functools.cache(function)
    _CACHED.append(cached)
    return cast(Function, cached)


def add_kind(kind: Kind) -> None:
    """Add a kind to `KINDS`, or replace the kind with its name.

    Raises:
        InputError: a row contradicts a row of another kind, or has no known quantity.
    """
    rows = [row for other in KINDS.values() if other.name != kind.name for row in other.channels]
    for row in kind.channels:
        _check_row(row, rows)
        rows.append(row)
    KINDS[kind.name] = kind
    for cached in _CACHED:
        cached.cache_clear()


def _check_row(row: ChannelKind, others: Iterable[ChannelKind]) -> None:
    """Refuse a row that cannot have columns, or that contradicts another row.

    Raises:
        InputError: the row is refused; the message names it.
    """
    what = f"the channel {row.column}"
    if row.quantity not in {None, *QUANTITIES}:
        raise InputError(
            f"{what} has the unknown quantity {row.quantity!r}: use {one_of(QUANTITIES)}"
        )
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", row.column) or row.column.count("NN") > 1:
        raise InputError(
            f"{what} is not a valid name: use letters, digits and _, and NN at most once"
        )
    if "time" in (row.name, row.column):
        raise InputError(
            f"{what} of the row '{row.name}' must not be time, which every model has: rename it"
        )
    if row.part not in (parts := get_args(Part)):
        raise InputError(f"{what} has the unknown part {row.part!r}: use {one_of(parts)}")
    if row.quantity == "text" and not row.texts:
        raise InputError(f"{what} is a text channel without values: give them as strings")
    units = QUANTITIES[row.quantity].suffixes if row.quantity else ()
    keys = [each for each in NOISE_KEYS if not units or each.partition("_")[2] in units]
    if row.noise not in (None, *keys):
        either = f"use {one_of(keys)}, or omit it" if keys else "omit it"
        raise InputError(f"{what} refers to the unknown noise key {row.noise!r}: {either}")
    ours = row.name, row.column, row.quantity, row.texts
    for other in others:
        theirs = other.name, other.column, other.quantity, other.texts
        if ours != theirs and (row.name == other.name or row.column == other.column):
            raise InputError(
                f"a channel {other.column} already exists, the {other.quantity} '{other.name}': "
                f"declare {row.column}, the {row.quantity} '{row.name}', in the same way, or "
                "rename it"
            )
