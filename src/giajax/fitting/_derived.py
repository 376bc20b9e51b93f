"""Quantities that follow from the parameters, with standard errors of their own.

A quantity may be determined where its parameters are not: of two parameters that count only as a
product, the product is. To first order it is when its gradient has no part in the directions
that leave every residual unchanged; then any generalised inverse of J^T J gives its variance
(C. R. Rao, "Linear Statistical Inference", 2nd ed., 1973, section 4a).
"""

from collections.abc import Mapping, Sequence

import jax
import numpy as np

from .._typing import Array
from ..models import AbstractModel
from ..parameters import get, replace
from ._identifiability import COLLINEAR
from ._records import Estimate, finite_or_none

# Part of a gradient in undetermined directions that is rounding of the Jacobian.
_ROUNDING = 1e-5


def derived_estimates(
    model: AbstractModel,
    paths: Sequence[str],
    alive: np.ndarray,
    jacobian: np.ndarray,
    covariance: np.ndarray,
) -> dict[str, Estimate]:
    """Estimates of the model's derived quantities that depend on fitted parameters.

    Arguments:
        model: at the optimum.
        paths: the free parameters that are shared by all runs.
        alive: those that the residuals respond to, by position; from the number of the shared
            ones on they belong to single runs, and nothing is derived from them.
        jacobian: weighted residuals by them, or the R of its QR factorisation.
        covariance: of them, from any generalised inverse, shape (alive, alive).

    Returns:
        By name; empty where nothing depends on a free parameter that responds.
    """
    names = [paths[i] for i in alive if i < len(paths)]
    if not names or not model.derived():
        return {}
    own = np.zeros(len(alive) - len(names))
    values = {path: get(model, path) for path in names}

    def quantities(values: Mapping[str, Array]) -> dict[str, Array]:
        return {name: d.value for name, d in replace(model, values).derived().items()}

    slopes = jax.jacfwd(quantities)(values)
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian / norms, mode="r"))
    loose = right[singular < COLLINEAR * singular[0]]
    estimates = {}
    for name, quantity in model.derived().items():
        slope = np.concatenate([[float(slopes[name][path]) for path in names], own])
        if not np.any(slope):
            continue
        along = loose @ (slope / norms)
        determined = np.linalg.norm(along) <= _ROUNDING * np.linalg.norm(slope / norms)
        error = float(np.sqrt(slope @ covariance @ slope)) if determined else None
        others = ", ".join(path for path, part in zip(names, slope, strict=False) if part)
        estimates[name] = Estimate(
            value=float(quantity.value),
            standard_error=finite_or_none(error),
            unit=quantity.unit,
            lower=None,
            upper=None,
            free=True,
            remark=f"follows from {others}" if determined else f"not determined by {others}",
        )
    return estimates
