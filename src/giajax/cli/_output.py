"""Tables on standard output: bold headings on a terminal, plain text elsewhere."""

from collections.abc import Sequence
from typing import Any


def print_table(headings: Sequence[str], rows: Sequence[Sequence[Any]], *, left: int = 1) -> None:
    """Print a table without rules; all but the first `left` columns are aligned to the right.

    Floats are shown with 5 significant digits, None as `-`. Empty headings are left out. Where
    standard output is not a terminal nothing is wrapped: a row is a line, for grep and awk.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(headings))
    for position, heading in enumerate(headings):
        shown.add_column(Text(heading), justify="left" if position < left else "right")
    for row in rows:
        shown.add_row(*(Text(_cell(value)) for value in row))
    console = Console(highlight=False)
    if console.is_terminal:
        console.print(shown)
        return
    wide = Console(highlight=False, width=10_000, color_system=None)
    with wide.capture() as captured:
        wide.print(shown)
    print("\n".join(line.rstrip() for line in captured.get().splitlines()))


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
