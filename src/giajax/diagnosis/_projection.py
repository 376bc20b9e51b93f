"""What a fit cannot imitate: residuals and tested columns without the span of its Jacobian.

Plain numpy; nothing here knows of models.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

# Columns of a fit that add less than this to the span of the others, relative to their size.
_RANK = 1e-9


@dataclasses.dataclass(frozen=True)
class Table:
    """One run, weighted: every row is divided by its noise; what was not measured is 0.

    Attributes:
        residual: predicted less recorded, shape (sample, channel).
        measured: which cells count, same shape.
        fitted: columns of the fitted parameters, shape (sample, channel, parameter).
        own: columns of what is free in this run alone, shape (sample, channel, own).
        asked: columns to be tested, shape (sample, channel, test).
        timed: whether the samples follow each other in time.
    """

    residual: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    own: np.ndarray
    asked: np.ndarray
    timed: bool


@dataclasses.dataclass(frozen=True)
class Projected:
    """Residuals and tested columns without what the fit can imitate.

    Attributes:
        residual: shape (value,), a cell each, run by run.
        columns: shape (value, test).
        norms: of the columns before the projection, shape (test,).
        parameters: number of fitted ones, those of single runs included.
        series: of each run and channel: positions of its cells in the row of values, -1 where
            nothing was measured; one that is not timed has only those that were.
        timed: of each series.
    """

    residual: np.ndarray
    columns: np.ndarray
    norms: np.ndarray
    parameters: int
    series: tuple[np.ndarray, ...]
    timed: tuple[bool, ...]

    @property
    def values(self) -> int:
        """Number of measured values."""
        return len(self.residual)

    @property
    def perpendicular(self) -> np.ndarray:
        """Norms of the columns after the projection, shape (test,)."""
        return np.asarray(np.linalg.norm(self.columns, axis=0))


def projected(tables: Sequence[Table]) -> Projected:
    """Residuals and tested columns of all runs, without what the fit can imitate.

    What is free in one run alone is taken out of that run first (Frisch, Waugh and Lovell), so
    that no matrix with the parameters of all runs is ever made.

    Arguments:
        tables: of the runs.

    Returns:
        One row a measured value.
    """
    parts, series, timed = [], [], []
    first, own, norms = 0, 0, 0.0
    for table in tables:
        measured = table.measured
        cells = np.concatenate(
            [
                table.residual[measured][:, None],
                table.fitted[measured],
                table.asked[measured],
            ],
            axis=1,
        )
        norms = norms + np.sum(table.asked[measured] ** 2, axis=0)
        basis = basis_of(table.own[measured])
        own += basis.shape[1]
        parts.append(cells - basis @ (basis.T @ cells))
        place = np.full(measured.shape, -1)
        place[measured] = first + np.arange(len(cells))
        first += len(cells)
        for column in place.T:
            series.append(column if table.timed else column[column >= 0])
            timed.append(table.timed)
    whole = np.concatenate(parts)
    count = tables[0].fitted.shape[2]
    basis = basis_of(whole[:, 1 : 1 + count])
    rest = np.concatenate([whole[:, :1], whole[:, 1 + count :]], axis=1)
    rest = rest - basis @ (basis.T @ rest)
    # Once more: what is nearly imitated has lost most of its digits.
    rest = rest - basis @ (basis.T @ rest)
    return Projected(
        residual=rest[:, 0],
        columns=rest[:, 1:],
        norms=np.sqrt(norms * np.ones(rest.shape[1] - 1)),
        parameters=basis.shape[1] + own,
        series=tuple(series),
        timed=tuple(timed),
    )


def basis_of(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the span of columns, shape (row, rank)."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0] / norms[norms > 0]
    if kept.shape[1] == 0:
        return np.zeros((len(columns), 0))
    left, singular, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, singular > _RANK * singular[0]])
