"""The Jacobian of a fit as it is: blocks, one a run, of a matrix that is zero elsewhere."""

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np

from .._typing import Float
from ._problem import Problem

Row = Float[np.ndarray, " residual"]


@dataclasses.dataclass(frozen=True)
class BlockJacobian:
    """Residuals by parameters, run by run.

    Attributes:
        blocks: of each run, shape (row, column).
        columns: which parameters the columns of each block belong to.
        size: number of parameters.
    """

    blocks: Sequence[Float[np.ndarray, "row column"]]
    columns: Sequence[np.ndarray]
    size: int

    @classmethod
    def of(cls, problem: Problem, blocks: Sequence[object]) -> Self:
        """The Jacobian from the blocks of each group of runs, and the slopes of the priors."""
        *stacks, slopes = blocks
        rows, columns = [], []
        for group, stacked in zip(problem.groups, stacks, strict=True):
            for block, own in zip(np.asarray(stacked), group.columns(), strict=True):
                rows.append(np.asarray(block, dtype=float))
                columns.append(own)
        if len(problem.priors):
            rows.append(np.diag(np.asarray(slopes, dtype=float)))
            columns.append(np.asarray(problem.priors.columns))
        return cls(rows, columns, problem.size)

    @classmethod
    def dense(cls, matrix: Float[np.ndarray, "residual parameter"]) -> Self:
        """One block that is the whole matrix."""
        return cls([matrix], [np.arange(matrix.shape[1])], matrix.shape[1])

    def scaled(self, factors: Float[np.ndarray, " parameter"]) -> Self:
        """With each column times a number."""
        blocks = [b * factors[c] for b, c in zip(self.blocks, self.columns, strict=True)]
        return dataclasses.replace(self, blocks=blocks)

    def norms(self) -> Float[np.ndarray, " parameter"]:
        """Norms of the columns."""
        squares = np.zeros(self.size)
        for block, columns in zip(self.blocks, self.columns, strict=True):
            squares[columns] += np.sum(block**2, axis=0)
        return np.sqrt(squares)

    def times(self, vector: Float[np.ndarray, " parameter"]) -> Row:
        """Matrix times a vector."""
        return np.concatenate(
            [block @ vector[c] for block, c in zip(self.blocks, self.columns, strict=True)]
        )

    def transposed_times(self, row: Row) -> Float[np.ndarray, " parameter"]:
        """Transposed matrix times a vector."""
        total = np.zeros(self.size)
        start = 0
        for block, columns in zip(self.blocks, self.columns, strict=True):
            total[columns] += block.T @ row[start : start + len(block)]
            start += len(block)
        return total

    def reduced(self, weights: Row | None = None) -> Float[np.ndarray, "row parameter"]:
        """A small matrix R with R^T R = J^T diag(weights)^2 J, by QR of each block."""
        parts, start = [], 0
        for block, columns in zip(self.blocks, self.columns, strict=True):
            if weights is not None:
                block = block * weights[start : start + len(block), None]
                start += len(block)
            triangle = np.linalg.qr(block, mode="r")
            placed = np.zeros((len(triangle), self.size))
            placed[:, columns] = triangle
            parts.append(placed)
        return np.asarray(np.linalg.qr(np.concatenate(parts), mode="r"))
