"""Score tests: what one more column of the Jacobian would take from the residuals of a fit.

With the weighted residuals r of a fit, its Jacobian J and the column z of what it held,
z_perp = z - J (J^+ z) is what the fitted parameters cannot imitate. A step of
-z_perp.r / z_perp.z_perp along it lowers the sum of squares by (z_perp.r)^2 / z_perp.z_perp
(Rao's score test; Cook & Weisberg 1982, sec. 2.2). At a bound the step ends there.

Plain numpy; nothing here knows of models.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import fdtrc, stdtr

from ._projection import Projected, basis_of

# A column of which the fit can imitate all but this is not testable: only a ratio shows.
IMITATED = 1e-4


@dataclasses.dataclass(frozen=True)
class Score:
    """The test of one column, or of several together.

    Attributes:
        step: from the held value, within its bounds, shape (column,).
        error: standard error of the step, with the noise that it leaves, shape (column,).
        drop: of the sum of squares.
        p_value: not corrected for how many tests there are.
    """

    step: np.ndarray
    error: np.ndarray
    drop: float
    p_value: float


def score(
    rest: Projected,
    tests: Sequence[int],
    lower: Sequence[float],
    upper: Sequence[float],
) -> Score:
    """The test of one column, or of several together.

    The p-value is that of the whole step, from the noise that it leaves: white, of the size that
    was stated or more, and correlated along each channel of a run as its neighbours are. Missing
    physics is such a correlation itself, which is why the noise is taken after the step.

    Arguments:
        rest: what the fit cannot imitate.
        tests: positions of the columns.
        lower, upper: bounds of the step of each, not above and not below 0. A bound that is 0
            makes the test of one column one-sided.

    Returns:
        Step, drop and p-value.
    """
    columns = rest.columns[:, list(tests)]
    gram = columns.T @ columns
    gradient = columns.T @ rest.residual
    inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    step = np.clip(-inverse @ gradient, lower, upper)
    # A quadratic function of the step, which ends at the bounds.
    drop = max(float(-2 * gradient @ step - step @ gram @ step), 0.0)
    left = rest.residual + columns @ step
    spread, effective = _spread(rest, left, columns, len(tests))
    errors = np.sqrt(np.diag(inverse @ spread @ inverse))
    if len(tests) == 1:
        ratio = float(np.sqrt(drop * gram[0, 0] / spread[0, 0]))
        one_sided = lower[0] == 0 or upper[0] == 0
        p_value = float(stdtr(effective, -ratio)) * (1 if one_sided else 2)
        if one_sided and step[0] == 0:
            p_value = 1.0
    else:
        count = int(np.linalg.matrix_rank(gram, tol=1e-10 * float(np.max(np.abs(gram)))))
        wald = float(gradient @ np.linalg.pinv(spread, rcond=1e-10, hermitian=True) @ gradient)
        whole = float(gradient @ inverse @ gradient)
        wald *= drop / whole if whole > 0 else 0.0
        p_value = float(fdtrc(count, effective, wald / count))
    return Score(step, errors, drop, p_value)


def _spread(
    rest: Projected, left: np.ndarray, columns: np.ndarray, tests: int
) -> tuple[np.ndarray, float]:
    """Covariance of the score under the noise that is left, and its degrees of freedom."""
    # Slow to import, and only a fit whose model is inadequate comes here.
    from scipy.signal import lfilter

    spread = np.zeros((columns.shape[1],) * 2)
    effective = 0.0
    # A prior has the deviation that it states, and no neighbour.
    of_priors = columns[rest.known]
    spread += of_priors.T @ of_priors
    share = 1 - (rest.lost + tests) / max(rest.values, 1)
    for place, timed in zip(rest.series, rest.timed, strict=True):
        measured = place >= 0
        count = int(np.sum(measured))
        if not count:
            continue
        noise = np.where(measured, left[place], 0.0)
        variance = max(float(np.sum(noise**2)) / max(share * count, 1.0), 1.0)
        rho = _neighbours(noise, measured) if timed else 0.0
        part = np.where(measured[:, None], columns[place], 0.0)
        # What each value has in common with all that came before it.
        before = lfilter([0.0, rho], [1.0, -rho], part, axis=0)
        common = part.T @ before
        spread += variance * (part.T @ part + common + common.T)
        effective += count * (1 - rho) / (1 + rho)
    return spread, max(effective - rest.lost - tests, 3.0)


def _neighbours(noise: np.ndarray, measured: np.ndarray) -> float:
    """Correlation of neighbouring samples, not below 0; corrected for its bias (Kendall 1954)."""
    pairs = int(np.sum(measured[1:] & measured[:-1]))
    power = float(np.sum(noise**2))
    if pairs < 8 or power == 0:
        return 0.0
    rho = float(np.sum(noise[1:] * noise[:-1])) / pairs / (power / int(np.sum(measured)))
    return float(np.clip(rho + (1 + 3 * rho) / pairs, 0.0, 0.99))


def alike(rest: Projected, one: Sequence[int], other: Sequence[int]) -> float:
    """Cosine of the largest angle from the span of some columns to that of others."""
    a, b = basis_of(rest.columns[:, list(one)]), basis_of(rest.columns[:, list(other)])
    return float(np.min(np.linalg.svd(a.T @ b, compute_uv=False), initial=1.0))
