"""Coefficients of an additive Runge-Kutta method as a W-method."""

from typing import NamedTuple

import diffrax
import numpy as np


class Tableau(NamedTuple):
    """The coefficients of an additive Runge-Kutta method as a W-method.

    Attributes:
        combine: of which slopes h f(Y) and h J (Y - y0) of each stage a stage is made, shape
            (stage, stage, 2), the first being the start and the last the end of the step.
        times: of the stages, as fractions of the step.
        error: of which slopes the error of the step is made.
        gamma: the diagonal of the implicit method.
    """

    combine: np.ndarray
    times: np.ndarray
    error: np.ndarray
    gamma: float


def tableau() -> Tableau:
    """The coefficients of ARK5(4)8L[2]SA."""
    explicit, implicit = diffrax.KenCarp5.tableau.tableaus
    combine = _rows(explicit)
    # The rows of both have the same sums, so that J y0 drops out of their difference.
    springs = _rows(implicit) - combine
    gamma = float(springs[1, 1])
    np.fill_diagonal(springs, 0)
    return Tableau(
        np.stack([combine, springs], axis=2),
        np.concatenate([[0], explicit.c, [1]]),
        np.append(explicit.b_error, 0),
        gamma,
    )


def _rows(tableau: diffrax.ButcherTableau) -> np.ndarray:
    """The matrix of a method as a square, and below it the weights of the end of the step."""
    size = len(tableau.b_sol)
    matrix = np.zeros((size + 1, size + 1))
    for row, lower in enumerate((*tableau.a_lower, tableau.b_sol), start=1):
        matrix[row, : len(lower)] = lower
    if tableau.a_diagonal is not None:
        matrix[range(size), range(size)] = tableau.a_diagonal
    return matrix
