"""How errors name the parts of a run."""

from dataclasses import dataclass
from typing import Any

from ..kinds import RecordedChannel


@dataclass(frozen=True)
class Wording:
    """How errors name the parts of a run: `row 5` and columns of a file, samples of arrays."""

    source: str
    row: str
    first_row: int
    columns: bool

    def at(self, index: Any) -> str:
        """The row of the sample with this index."""
        return f"{self.row} {int(index) + self.first_row}"

    def of(self, channel: RecordedChannel) -> str:
        """The name of the channel in the person's file or arrays."""
        if not self.columns:
            return f"channel {channel.name!r}"
        column = f"{channel.name}_{channel.unit}" if channel.unit else channel.name
        return f"column {column!r}"
