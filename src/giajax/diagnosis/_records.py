"""What the tests found together, in the order in which a reader should doubt."""

import dataclasses
import json
from collections.abc import Sequence

from ..fitting import Suspect

LEVEL = 0.05
"""A corrected p-value below this is significant."""


def promising(rows: Sequence[Suspect]) -> tuple[Suspect, ...]:
    """Of each quantity that is testable its best row, the most promising first.

    The elements of a vector and the whole of it are one quantity; and what the data can hardly
    tell from a row above is named there, in `alike`, and has no row of its own.

    Arguments:
        rows: in the order of `Suspects.rows`.
    """
    best: dict[str, Suspect] = {}
    covered: set[str] = set()
    for row in rows:
        name = row.path.partition("[")[0]
        if row.testable and name not in best and name not in covered:
            best[name] = row
            covered |= {path.partition("[")[0] for path in row.alike}
    return tuple(best.values())


@dataclasses.dataclass(frozen=True)
class Suspects:
    """What would lower chi-square, the most first.

    Attributes:
        rows: all tests; those that are testable first, the largest drop of chi-square at the top.
        chi_square: sum of squared residuals of the fit, in units of white noise.
        values: number of measured values.
        parameters: number of fitted parameters.
        asked: how many tests the p-values are corrected for.
    """

    rows: tuple[Suspect, ...]
    chi_square: float
    values: int
    parameters: int
    asked: int

    @property
    def promising(self) -> tuple[Suspect, ...]:
        """Of each quantity that is testable its best row, the most promising first."""
        return promising(self.rows)

    @property
    def significant(self) -> tuple[Suspect, ...]:
        """Those of the promising ones that chance does not explain."""
        return tuple(row for row in self.promising if (row.p_value or 0.0) < LEVEL)

    @property
    def untestable(self) -> tuple[Suspect, ...]:
        """What the data cannot tell."""
        return tuple(row for row in self.rows if not row.testable)

    def of(self, path: str) -> Suspect:
        """The row of a path.

        Raises:
            KeyError: there is none.
        """
        for row in self.rows:
            if row.path == path:
                return row
        raise KeyError(path)

    def to_json(self) -> str:
        """As JSON: an object with the attributes."""
        return json.dumps(dataclasses.asdict(self), indent=2, allow_nan=False) + "\n"
