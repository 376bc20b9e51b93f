"""Where the other parameters go, to first order, when a quantity is moved."""

import numpy as np

from ..fitting import BlockJacobian

# Singular values of the normalised Jacobian below this part of the largest are rounding: what they
# belong to costs nothing, but is not to run away.
_LEAST = 1e-7


def weights(jacobian: BlockJacobian, movable: np.ndarray) -> np.ndarray:
    """The inverse of J^T J, of the columns that may move; zero elsewhere.

    Arguments:
        jacobian: of the residuals by the parameters.
        movable: which may move, shape (parameter,).

    Returns:
        Shape (parameter, parameter). What leaves all residuals unchanged has a large, finite part.
    """
    norms = jacobian.norms()
    columns = np.flatnonzero(movable & (norms > 0))
    inverse = np.zeros((jacobian.size, jacobian.size))
    if not len(columns):
        return inverse
    root = jacobian.reduced()[:, columns] / norms[columns]
    _, singular, right = np.linalg.svd(np.linalg.qr(root, mode="r"))
    half = right.T / np.maximum(singular, _LEAST * singular[0]) / norms[columns][:, None]
    inverse[np.ix_(columns, columns)] = half @ half.T
    return inverse


def tangent(
    jacobian: BlockJacobian,
    gradient: np.ndarray,
    values: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    side: int,
) -> np.ndarray:
    """The change of all parameters that costs least where a quantity moves by one.

    Arguments:
        jacobian: of the residuals by the parameters.
        gradient: of the quantity by them.
        values: of the parameters, shape (parameter,); those at a bound do not move beyond it.
        bounds: of the parameters.
        side: 1 where the quantity is to grow, -1 where it is to fall.

    Returns:
        Shape (parameter,); zero where nothing that may move changes the quantity.
    """
    movable = np.ones(len(values), dtype=bool)
    for _ in range(len(values) + 1):
        steepest = weights(jacobian, movable) @ gradient
        length = float(gradient @ steepest)
        if not length > 0:
            break
        direction = steepest / length
        leaves = movable & beyond(values, bounds, side * direction)
        if not np.any(leaves):
            return direction
        movable &= ~leaves
    return np.zeros(len(values))


def beyond(
    values: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], step: np.ndarray
) -> np.ndarray:
    """Which of the parameters are at a bound that a step would lead beyond, shape (parameter,)."""
    lower, upper = bounds
    return ((values <= lower) & (step < 0)) | ((values >= upper) & (step > 0))
