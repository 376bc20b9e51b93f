"""The normal equations of a fit where it ended, cell by cell: what each part of the data says."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._typing import Bool, Float
from ..noise import Cells, ChannelNoise
from ._loss import scores
from ._noise_statistics import dense_cells, prior_rows, weighted_cells
from ._optimum import Optimum
from ._residual_cells import residual_cells

# Of scaled columns: eigenvalues below this, of the largest, are directions that nothing shows.
_FLAT = 1e-10
# Part of a parameter in such a direction from which it is not determined.
_LOOSE = 0.01


@dataclasses.dataclass(frozen=True)
class Equations:
    """A x = -b, of the step x of some parameters that makes the cost least, to first order.

    Attributes:
        matrix: A, the curvature of the cost, shape (parameter, parameter).
        gradient: b, of the cost, shape (parameter,).
    """

    matrix: Float[np.ndarray, "parameter parameter"]
    gradient: Float[np.ndarray, " parameter"]

    def __add__(self, other: "Equations") -> "Equations":
        return Equations(self.matrix + other.matrix, self.gradient + other.gradient)

    def step(self) -> tuple[np.ndarray, np.ndarray]:
        """The step, and the roots of the diagonal of A^-1; NaN of what is not determined."""
        sizes = np.sqrt(np.maximum(np.diag(self.matrix), 0.0))
        sizes = np.where(sizes > 0, sizes, np.inf)
        values, vectors = np.linalg.eigh(self.matrix / np.outer(sizes, sizes))
        flat = values <= _FLAT * max(float(values[-1]), 1e-300)
        root = vectors[:, ~flat] / np.sqrt(values[~flat]) / sizes[:, None]
        step = -root @ (root.T @ self.gradient)
        errors = np.linalg.norm(root, axis=1)
        loose = np.any(np.abs(vectors[:, flat]) > _LOOSE, axis=1) | np.isinf(sizes)
        return np.where(loose, np.nan, step), np.where(loose, np.nan, errors)


@dataclasses.dataclass(frozen=True)
class CellEquations:
    """What the cells of a fit say of its parameters, by the noise and the weights that it has.

    Attributes:
        positions: of the parameters: those that respond and are at no bound.
        cells: of each channel, by the position of the run and its name, with their derivatives.
        rows: of all samples of a run, which were measured, likewise.
        noise: of each key.
        loss: that is left where weights of cells do not stand for it.
        priors: what is known beforehand.
    """

    positions: tuple[int, ...]
    cells: Mapping[tuple[int, str], Cells]
    rows: Mapping[tuple[int, str], Bool[np.ndarray, " sample"]]
    noise: Mapping[str, ChannelNoise]
    loss: str
    priors: Equations

    @classmethod
    def of(cls, optimum: Optimum) -> "CellEquations":
        """The equations of a fit where it ended."""
        state, statistics = optimum.state, optimum.statistics
        at = [int(i) for i in statistics.alive if int(i) not in statistics.bounds]
        slope = state.problem.bijector.slope(np.asarray(state.coordinate))
        cells = {
            key: dense_cells(weighted_cells(state, key, each), np.asarray(at, dtype=int), slope)
            for key, each in residual_cells(state, together=True).items()
        }
        rows, off = prior_rows(state, np.asarray(at, dtype=int))
        return cls(
            positions=tuple(at),
            cells=cells,
            rows={
                (run, name): ~np.isnan(state.setup.runs[run].observations[name])
                for run, name in cells
            },
            noise=state.noise.by_key(),
            loss=state.problem.loss,
            priors=Equations(rows.T @ rows, rows.T @ off),
        )

    def said(
        self, run: int, name: str, kept: Bool[np.ndarray, " sample"] | None = None
    ) -> Equations:
        """What the cells of a channel say: A and b, made independent among themselves.

        Arguments:
            run: its position.
            name: of the channel.
            kept: of all samples of the run, which count; all by default.
        """
        cells = self.cells[run, name]
        if kept is not None:
            cells = cells.where(kept[self.rows[run, name]])
        noise = self.noise[cells.key]
        if self.loss == "linear":
            width = cells.own.shape[1]
            gram = cells.gram(noise)[0][width:, width:]
            return Equations(gram[:-1, :-1], gram[:-1, -1])
        psi, curvature, _ = scores(self.loss, cells.residual / noise.deviation)
        columns = cells.shared / noise.deviation
        return Equations(columns.T @ (columns * curvature[:, None]), columns.T @ psi)

    def whole(self, said: Sequence[Equations]) -> Equations:
        """What these say together with what is known beforehand."""
        return sum(said, self.priors)
