"""What a kind of model asks of a run and its definition, which are read above it."""

from collections.abc import Mapping
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from ._section import Section

S = TypeVar("S", bound=Section)


class RecordedChannel(Protocol):
    """What a kind asks of a channel of a run; see `giajax.runs.Channel`."""

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
    """What a kind asks of a definition; see `giajax.runs.Definition`."""

    @property
    def free_motion(self) -> bool | None: ...

    def section(self, of: type[S]) -> S:
        """The section of a class, with its defaults where it is not in the file."""


class Content(Protocol):
    """What a kind asks of a run; see `giajax.runs.Run`."""

    @property
    def times(self) -> npt.NDArray[np.float64] | None: ...
    @property
    def values(self) -> Mapping[str, npt.NDArray[Any]]: ...
    @property
    def channels(self) -> Mapping[str, RecordedChannel]: ...
    @property
    def definition(self) -> Sections: ...


class Wording(Protocol):
    """How errors name the parts of a run: `row 5` and columns of a file, samples of arrays."""

    @property
    def source(self) -> str: ...

    def at(self, index: Any) -> str:
        """The row of the sample with this index."""

    def of(self, channel: RecordedChannel) -> str:
        """The name of the channel in the person's file or arrays."""
