"""What a kind of model declares of itself, without JAX, and which kinds there are: `KINDS`."""

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
    """What a kind asks of a channel of a run; see `giajax.recordings.Channel`."""

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
    """What a kind asks of a definition; see `giajax.recordings.Definition`."""

    @property
    def free_motion(self) -> bool | None: ...

    def section(self, of: type[S]) -> S:
        """The section of a class, with its defaults where it is not in the file."""


class RecordedRun(Protocol):
    """What a kind asks of a run; see `giajax.recordings.Run`."""

    @property
    def times(self) -> npt.NDArray[np.float64] | None: ...
    @property
    def values(self) -> Mapping[str, npt.NDArray[Any]]: ...
    @property
    def channels(self) -> Mapping[str, RecordedChannel]: ...
    @property
    def definition(self) -> Sections: ...


class Naming(Protocol):
    """How errors name the parts of a run: `row 5` and columns of a file, samples of arrays."""

    @property
    def source(self) -> str: ...

    def at(self, index: Any) -> str:
        """The row of the sample with this index."""

    def of(self, channel: RecordedChannel) -> str:
        """The name of the channel in the person's file or arrays."""


NOISE_KEYS = ("position_m", "angle_deg", "rate_deg_per_s", "pixel_px", "acceleration_m_per_s2")
"""Keys of `[noise]` that hold for all columns of some rows."""

Part = Literal["input", "surroundings", "output"]

CAMERA_NAME = "[A-Za-z][A-Za-z0-9_]*"
"""Regular expression of the name of a camera."""


@dataclass(frozen=True)
class ChannelKind:
    """A row of the column table.

    Attributes:
        name: of the row, such as `link_position`.
        column: a channel of the row without its unit, as documentation writes it: `linkNN_x`. NN
            stands for the number of a joint, link or landmark, x at the end for x, y or z, u at
            the end for u or v. Of u and v the name of a camera may go before: `side.linkNN_u`.
        quantity: of its values, as in `runs`' table of quantities; None: any.
        part: what it is to the model: an input, something of the surroundings that acts on it
            as well, or an output, which is what it predicts.
        texts: the values of a channel that holds text.
        noise: key of `[noise]` that holds for it, beside its own column.
    """

    name: str
    column: str
    quantity: str | None
    part: Part
    texts: tuple[str, ...] = ()
    noise: str | None = None

    @property
    def pattern(self) -> str:
        """Regular expression of the channels of this row, with groups `index`, `component` and
        `camera`."""
        numbered = self.column.replace("NN", "(?P<index>[0-9]+)")
        if numbered.endswith("_u"):
            return rf"(?:(?P<camera>{CAMERA_NAME})\.)?{numbered[:-1]}(?P<component>[uv])"
        return re.sub("_x$", "_(?P<component>[xyz])", numbered)

    @functools.cached_property
    def components(self) -> str:
        """What the last letter of a channel may be: one for each component; empty without any."""
        return {"_x": "xyz", "_u": "uv"}.get(self.column[-2:], "")


class SectionTemplate(NamedTuple):
    """A section in the template of a sidecar, with a comment after its name.

    The name is empty for keys before the first section; a key whose value is None is a comment with
    an example.
    """

    section: str
    keys: Mapping[str, Any]
    comment: str = ""


@dataclass(frozen=True)
class Kind:
    """A kind of model: what its runs hold, what its files say, where the model is.

    Attributes:
        name: the `model = "..."` of a sidecar.
        model: module in `giajax.models` and class, as `_arm:ArmModel`; imported when a model is
            built, because that needs JAX. Empty: a registered class has the name.
        channels: rows of the column table, in the order of a written file.
        recognises: whether a run with these rows is of this kind, where no sidecar says which
            it is.
        measured: columns to fit, as an example in messages.
        sections: of a definition, that describe the model -> their classes.
        run_sections: of a definition, that describe one run.
        commands: rows of the table that count as a command in a description of a run.
        uncommanded: what a description says of a run without a command; empty: nothing.
        timed: whether every run has times.
        interpolation: how the commands of a run go between two rows: "linear", "zoh" (held) or
            "band_limited".
        drawn_over: the input over which measured channels of a run are drawn; None: over time.
        check: raises `InputError` for what no model of this kind could use in a run.
        notes: sentences on what is assumed in a run, because its file does not say it. The
            second argument is whether there is a sidecar.
        template: sections to offer for a run with these channels.
        template_heading: the second line of a template.
        former_parameters: paths in results of older versions that no longer exist.
        upgraded: a definition of an older version as one of this version.
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
        """Sections that describe the model, and then those that describe one run."""
        return {**self.sections, **self.run_sections}

    def rows(self, *parts: str) -> tuple[str, ...]:
        """Names of the rows of the column table that play one of these parts."""
        return tuple(row.name for row in self.channels if row.part in parts)

    @functools.cached_property
    def inputs(self) -> tuple[str, ...]:
        """Rows of what the model is driven by, apart from its surroundings."""
        return self.rows("input")

    @functools.cached_property
    def outputs(self) -> tuple[str, ...]:
        """Rows of what the model predicts, and a run measures."""
        return self.rows("output")

    def offers(self, channels: Sequence[RecordedChannel]) -> list[SectionTemplate]:
        """The sections that a template offers: each of the model with all of its keys, unless
        the kind chooses them by the channels of the run."""
        if self.template is not None:
            return self.template(channels)
        return [
            SectionTemplate(
                name,
                dict.fromkeys(section.model_fields),
                "defaults apply to keys that are not stated",
            )
            for name, section in self.sections.items()
        ]


KINDS: dict[str, Kind] = {}
"""The kinds by name; nothing else in the toolkit knows which there are."""

_CACHED: list[Any] = []


def cached_by_kinds(function: Function) -> Function:
    """A function of what the kinds declare, which keeps its results until there is another."""
    cached: Any = functools.cache(function)
    _CACHED.append(cached)
    return cast(Function, cached)


def add_kind(kind: Kind) -> None:
    """Add a kind to `KINDS`, or put it in the place of the one of its name.

    Raises:
        InputError: a row contradicts one of another kind, or is of no quantity.
    """
    rows = [row for other in KINDS.values() if other.name != kind.name for row in other.channels]
    for row in kind.channels:
        _check_row(row, rows)
        rows.append(row)
    KINDS[kind.name] = kind
    for cached in _CACHED:
        cached.cache_clear()


def _check_row(row: ChannelKind, others: Iterable[ChannelKind]) -> None:
    """Refuse a row that no column could be of, or of which others say something else.

    Raises:
        InputError: naming the row.
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
        raise InputError(f"{what} has no part {row.part!r} in a model: use {one_of(parts)}")
    if row.quantity == "text" and not row.texts:
        raise InputError(f"{what} is a text channel without values: state them as strings")
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
                f"there already is a channel {other.column}, the {other.quantity} '{other.name}': "
                f"declare {row.column}, the {row.quantity} '{row.name}', as that, or name it "
                "otherwise"
            )
