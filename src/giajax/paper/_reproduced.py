"""A figure or a table of the paper, made again: what all of them give."""

import dataclasses
import textwrap
from collections.abc import Iterable, Mapping
from typing import Any

from matplotlib.figure import Figure

from ..report import GREY

# Letters of the small print that fit on an inch.
_LETTERS = 18


@dataclasses.dataclass(frozen=True)
class Sources:
    """Where what a figure shows comes from.

    Attributes:
        printed: what the paper prints, and is used or compared with.
        assumed: numbers that the paper does not give.
        reconstructed: what was made in place of something that is not public.
    """

    printed: str
    assumed: str
    reconstructed: str

    def by_word(self) -> dict[str, str]:
        """The sentences by the word that they stand under."""
        return {
            "Printed in the paper": self.printed,
            "Assumed": self.assumed,
            "Reconstructed": self.reconstructed,
        }


@dataclasses.dataclass(frozen=True)
class Reproduced:
    """A figure or a table of the paper, made again.

    Attributes:
        title: what it shows.
        sources: what of it is printed in the paper, assumed, or reconstructed.
        figure: the picture, with the sources below it.
        headings: of the table.
        rows: of the table, words and numbers.
        columns: the numbers of the picture, by a name with its unit, in columns of equal length.
        facts: further numbers by name, as JSON can hold them.
    """

    title: str
    sources: Sources
    figure: Figure
    headings: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    columns: Mapping[str, Iterable[Any]]
    facts: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        """Write the sources below the picture, in small print."""
        width = self.figure.get_size_inches()[0]
        lines = [
            textwrap.fill(f"{word}: {text}", round(width * _LETTERS), subsequent_indent="    ")
            for word, text in self.sources.by_word().items()
        ]
        self.figure.supxlabel(
            "\n".join(lines), x=0.01, ha="left", fontsize=7, color=GREY, linespacing=1.3
        )
