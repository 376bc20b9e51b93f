"""Loss functions of the weighted residual, as transformations that keep least squares.

The cost is half the sum of rho(r). With t(r) = sign(r) sqrt(rho(r)) it is half the sum of t^2,
and a least-squares solver needs to know nothing else.
"""

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float

LOSSES = ("linear", "huber", "soft_l1")


def check_loss(loss: str) -> None:
    """Refuse an unknown loss.

    Raises:
        InputError: naming the known ones.
    """
    if loss not in LOSSES:
        raise InputError(f"there is no loss '{loss}': use one of: {', '.join(LOSSES)}")


def mean_square_of_influence(loss: str) -> float:
    """The mean of psi^2 of normal noise of deviation 1, by which a robust chi-square is one."""
    if loss == "linear":
        return 1.0
    r, step = np.linspace(-12.0, 12.0, 24_001, retstep=True)
    density = np.exp(-(r**2) / 2) / np.sqrt(2 * np.pi)
    return float(np.sum(scores(loss, r)[0] ** 2 * density) * step)


def transform(loss: str, r: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """t(r): `huber` is quadratic up to |r| = 1, `soft_l1` is 2 (sqrt(1 + r^2) - 1).

    Arguments:
        loss: one of `LOSSES`.
        r: weighted residuals, any shape.

    Returns:
        t, of the shape of r.
    """
    if loss == "linear":
        return r
    if loss == "soft_l1":
        # r sqrt(2 / (1 + sqrt(1 + r^2))) is the same without the cancellation near 0.
        return r * jnp.sqrt(2 / (1 + jnp.sqrt(1 + r * r)))
    outside = jnp.maximum(jnp.abs(r), 1)
    return jnp.where(jnp.abs(r) <= 1, r, jnp.sign(r) * jnp.sqrt(2 * outside - 1))


def rho(loss: str, r: np.ndarray) -> np.ndarray:
    """Of each residual what it counts as: r^2 with the linear loss, else less.

    Arguments:
        loss: one of `LOSSES`.
        r: weighted residuals, any shape.
    """
    if loss == "linear":
        return np.asarray(r**2)
    if loss == "soft_l1":
        return np.asarray(2 * (np.sqrt(1 + r * r) - 1))
    return np.where(np.abs(r) <= 1, r**2, 2 * np.maximum(np.abs(r), 1) - 1)


def scores(loss: str, r: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """psi = rho'/2, its derivative, and t', each at the residuals: what a covariance needs.

    Arguments:
        loss: one of `LOSSES`.
        r: weighted residuals, any shape.

    Returns:
        psi, psi' and t', each of the shape of r.
    """
    if loss == "linear":
        return r, np.ones_like(r), np.ones_like(r)
    if loss == "soft_l1":
        root = np.sqrt(1 + r * r)
        psi = r / root
        t = r * np.sqrt(2 / (1 + root))
    else:
        root = np.ones_like(r)
        psi = np.clip(r, -1, 1)
        t = np.where(np.abs(r) <= 1, r, np.sign(r) * np.sqrt(2 * np.maximum(np.abs(r), 1) - 1))
    # rho = t^2, so psi = t t'; at 0 every loss is quadratic with t' = 1.
    slope = np.where(t == 0, 1.0, psi / np.where(t == 0, 1.0, t))
    curvature = root**-3 if loss == "soft_l1" else (np.abs(r) <= 1).astype(float)
    return psi, curvature, slope


# Shares of a run's cells outside the quadratic part of a loss: of a third, noise alone is the
# cause; of two thirds, the model is still far from the data.
_NOISE_ALONE, _FAR = 0.35, 0.65

# Part of the curvature of far cells that is kept at an optimum, where they have none or little.
_KEPT = 0.05


def curvature_ratio(
    loss: str, t: Float[Array, " cell"], measured: Float[Array, " cell"]
) -> Float[Array, " cell"]:
    """By what to multiply rows of the Jacobian of t for a good second derivative of the cost.

    Gauss-Newton on t takes t'^2 for the curvature of a cell, which is right for none of the far
    ones. Where the model is off, psi / r is: the step of reweighted least squares, which would
    remove all residuals, where that of t would be twice as long. At the optimum, where outliers
    stay, it is psi'. What is between the two is told by the share of the cells that are far.

    Arguments:
        loss: one of `LOSSES`, not linear.
        t: transformed residuals.
        measured: 1 for measured cells, 0 for others.

    Returns:
        Root of the curvature over t'. With rows of t divided by it the gradient stays the same.
    """
    square = t * t
    if loss == "soft_l1":
        root = 1 + square / 2
        # r^2 / t^2 = 1 + t^2 / 4.
        slope = (1 + square / 4) / root**2
        reweighted, curvature = 1 / root, 1 / root**3
        far = square > 2 * (jnp.sqrt(2.0) - 1)
    else:
        far = square > 1
        slope = 1 / jnp.where(far, square, 1)
        reweighted = jnp.where(far, 2 / (square + 1), 1)
        curvature = jnp.where(far, 0.0, 1.0)
    share = jnp.sum(jnp.where(far, measured, 0)) / jnp.maximum(jnp.sum(measured), 1)
    off = jnp.clip((share - _NOISE_ALONE) / (_FAR - _NOISE_ALONE), _KEPT, 1)
    return jnp.sqrt((off * reweighted + (1 - off) * curvature) / slope)
