"""Standard errors and correlations from the Jacobian at the optimum."""

from typing import NamedTuple

import numpy as np

from ._identifiability import COLLINEAR
from ._jacobian import BlockJacobian
from ._loss import mean_square_of_influence, scores

# Fraction of residuals within the corner of a robust loss below which its covariance is noise.
_FEW = 0.1


class Uncertainty(NamedTuple):
    """Covariance of the parameters and what scaled it.

    Attributes:
        covariance: shape (parameter, parameter).
        scale: factor on the covariance, 1 unless the residuals exceed the stated noise.
        as_stated: the covariance were the noise as it is stated, of the same shape.
        bread: inverse of the second derivative of the cost, as Gauss and Newton have it, likewise.
    """

    covariance: np.ndarray
    scale: float
    as_stated: np.ndarray
    bread: np.ndarray


def uncertainty(
    residual: np.ndarray,
    jacobian: BlockJacobian,
    *,
    loss: str,
    measured: np.ndarray,
    columns: np.ndarray,
    priors: int = 0,
    known: float = 0.0,
    scaled: bool = True,
) -> Uncertainty:
    """Covariance of least-squares and M-estimates.

    Linear loss: (J^T J)^-1, times the reduced chi-square where that is above 1, because then the
    stated noise does not cover the residuals (the scale factor of the Particle Data Group).
    Robust losses: the sandwich A^-1 B A^-1 with A = sum psi' j j^T and B = sum psi^2 j j^T
    (Huber 1981, ch. 6), which needs no further scale. What the residuals say of the noise says
    nothing of a prior: in either, its rows keep the variance that they state.

    Arguments:
        residual: weighted, whitened residuals before the loss transforms them, shape (residual,).
        jacobian: derivative of the transformed residuals by the parameters.
        loss: name of the loss.
        measured: which residuals stand for a measured cell, shape (residual,).
        columns: the parameters that the covariance is for.
        priors: how many of the last rows are those of priors, which no loss transforms.
        known: how many of the parameters' degrees of freedom the priors know.
        scaled: whether residuals beyond the noise scale the covariance; not where cells have
            weights, because outliers are in the residuals still.

    Returns:
        Covariance, and what scaled it.
    """
    data = np.arange(len(residual)) < len(residual) - priors
    count, size = int(np.sum(measured & data)), len(columns)
    # How far a prior is off says nothing of the noise.
    freedom = max(count - (size - known), 1)
    reduced = float(np.sum(residual[measured & data] ** 2) / freedom)
    psi, curvature, slope = scores(loss, residual)

    def root_of_gram(weights: np.ndarray | float) -> np.ndarray:
        # Unmeasured cells have zero rows; their slope is that of a residual of zero.
        return jacobian.reduced(np.where(data, weights / slope, 1.0))[:, columns]

    plain = root_of_gram(1.0)
    mean_curvature = float(np.mean(curvature[measured & data])) if count else 1.0
    if loss == "linear" or mean_curvature < _FEW:
        # With a robust loss: almost every residual is an outlier, and the sandwich has no bread.
        scale = max(1.0, reduced) if scaled else 1.0
        bread = inverse_gram(plain)
        if not priors or scale == 1:
            return Uncertainty(bread * scale, scale, bread, bread)
        root = root_of_gram(np.sqrt(scale))
        return Uncertainty(bread @ (root.T @ root) @ bread, scale, bread, bread)
    # A residual beyond the corner of the loss has no curvature; the mean keeps A positive.
    bread = inverse_gram(root_of_gram(np.sqrt(mean_curvature)))
    root = root_of_gram(psi * np.sqrt(count / freedom))
    covariance = bread @ (root.T @ root) @ bread
    return Uncertainty(covariance, 1.0, covariance, bread)


def reduced_chi_square(
    residual: np.ndarray, *, loss: str, measured: np.ndarray, parameters: float
) -> float:
    """Squared residuals over the noise, per degree of freedom.

    With a robust loss that of psi, whose mean square over normal noise is taken for 1, so that a
    few outliers are not taken for more noise (Huber 1981, section 7.6).

    Arguments:
        residual: residuals over the deviation of their cell, shape (residual,).
        loss: name of the loss.
        measured: which of them stand for a measured cell.
        parameters: number of fitted ones, less what priors know of them.
    """
    psi = scores(loss, residual[measured])[0]
    freedom = max(int(np.sum(measured)) - parameters, 1)
    return float(np.sum(psi**2) / freedom / mean_square_of_influence(loss))


def correlation_matrix(covariance: np.ndarray) -> np.ndarray:
    """Correlations of a covariance; NaN where a variance is not finite."""
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(all="ignore"):
        correlation = covariance / np.outer(deviations, deviations)
    return np.clip(correlation, -1, 1)


def inverse_gram(jacobian: np.ndarray) -> np.ndarray:
    """(J^T J)^-1 through QR with scaled columns, which does not square the condition.

    A matrix R of the same R^T R will do for J.

    Directions that leave the residuals unchanged are left out: what takes no part in them keeps
    its own variance, and the others have none that means anything.
    """
    if jacobian.shape[1] == 0:
        return np.zeros((0, 0))
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian / norms, mode="r"))
    kept = singular > COLLINEAR * singular[0]
    inverse = right[kept].T / singular[kept] / norms[:, None]
    return inverse @ inverse.T
