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
        known: rows of the residual that are priors of what is free in this run alone, and their
            derivatives by it, shape (prior, 1 + own).
    """

    residual: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    own: np.ndarray
    asked: np.ndarray
    timed: bool
    known: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Projected:
    """Residuals and tested columns without what the fit can imitate.

    Attributes:
        residual: shape (row,), a cell each, run by run, and the priors.
        columns: shape (row, test).
        norms: of the columns before the projection, shape (test,).
        parameters: number of fitted ones, those of single runs included.
        lost: degrees of freedom that they take from the measured values: their number, less what
            their priors know of them.
        series: of each run and channel: positions of its cells in the row of values, -1 where
            nothing was measured; one that is not timed has only those that were.
        timed: of each series.
        known: positions of the rows that are priors.
    """

    residual: np.ndarray
    columns: np.ndarray
    norms: np.ndarray
    parameters: int
    lost: float
    series: tuple[np.ndarray, ...]
    timed: tuple[bool, ...]
    known: np.ndarray

    @property
    def values(self) -> int:
        """Number of measured values."""
        return len(self.residual) - len(self.known)

    @property
    def perpendicular(self) -> np.ndarray:
        """Norms of the columns after the projection, shape (test,)."""
        return np.asarray(np.linalg.norm(self.columns, axis=0))


def projected(tables: Sequence[Table], known: np.ndarray | None = None) -> Projected:
    """Residuals and tested columns of all runs, without what the fit can imitate.

    What is free in one run alone is taken out of that run first (Frisch, Waugh and Lovell), so
    that no matrix with the parameters of all runs is ever made. A prior is one more row of the
    residual, to which no tested column responds: what is known of a fitted parameter keeps it from
    imitating what is tested.

    Arguments:
        tables: of the runs.
        known: rows of the residual that are priors of what all runs share, and their derivatives
            by it, shape (prior, 1 + fitted).

    Returns:
        One row a measured value, and one a prior.
    """
    parts, series, timed, priors = [], [], [], []
    first, own, norms, lost = 0, 0, 0.0, 0.0
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
        count, mine = len(cells), table.own[measured]
        if table.known is not None:
            cells = np.concatenate([cells, _rows(table.known[:, :1], cells.shape[1])])
            mine = np.concatenate([mine, table.known[:, 1:]])
        basis = basis_of(mine)
        own += basis.shape[1]
        lost += basis.shape[1] - np.sum(basis[count:] ** 2)
        parts.append(cells - basis @ (basis.T @ cells))
        place = np.full(measured.shape, -1)
        place[measured] = first + np.arange(count)
        priors.append(first + np.arange(count, len(cells)))
        first += len(cells)
        for column in place.T:
            series.append(column if table.timed else column[column >= 0])
            timed.append(table.timed)
    whole = np.concatenate(parts)
    if known is not None:
        priors.append(len(whole) + np.arange(len(known)))
        whole = np.concatenate([whole, _rows(known, whole.shape[1])])
    count = tables[0].fitted.shape[2]
    basis = basis_of(whole[:, 1 : 1 + count])
    of_priors = np.concatenate(priors)
    rest = np.concatenate([whole[:, :1], whole[:, 1 + count :]], axis=1)
    rest = rest - basis @ (basis.T @ rest)
    # Once more: what is nearly imitated has lost most of its digits.
    rest = rest - basis @ (basis.T @ rest)
    return Projected(
        residual=rest[:, 0],
        columns=rest[:, 1:],
        norms=np.sqrt(norms * np.ones(rest.shape[1] - 1)),
        parameters=basis.shape[1] + own,
        lost=float(lost + basis.shape[1] - np.sum(basis[of_priors] ** 2)),
        series=tuple(series),
        timed=tuple(timed),
        known=of_priors,
    )


def _rows(first: np.ndarray, columns: int) -> np.ndarray:
    """Rows with zeros behind their first columns."""
    return np.pad(first, ((0, 0), (0, columns - first.shape[1])))


def basis_of(columns: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the span of columns, shape (row, rank)."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0] / norms[norms > 0]
    if kept.shape[1] == 0:
        return np.zeros((len(columns), 0))
    left, singular, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, singular > _RANK * singular[0]])
