"""Whittle's likelihood of a record's spectra and mean, with its gradient and information.

Transforms of a stationary record through tapers are independent complex normal variables in bands
apart (Whittle, Estimation and information in stationary time series, Arkiv for Matematik 2, 1953,
p. 423), whose covariance is the spectrum that the tapers see. The mean of the record is normal,
with the spectrum about zero.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import OptimizeResult, minimize

from .._errors import InputError
from ._multitaper import TAPERS


class Expected(NamedTuple):
    """What a model says of a record.

    Attributes:
        spectra: one-sided, as the tapers see them, SI^2/Hz, shape (band, channel, channel).
        mean: of the channels, shape (channel,); None where nothing is said of it.
        covariance: of that mean, shape (channel, channel).
    """

    spectra: np.ndarray
    mean: np.ndarray | None
    covariance: np.ndarray | None


class Recorded(NamedTuple):
    """What a record is: transforms, shape (band, taper, channel), and means, shape (channel,)."""

    transforms: np.ndarray
    mean: np.ndarray


Model = Callable[[np.ndarray], Expected]

# In logarithms and radians.
_STEP = 1e-3
_FARTHEST = 0.7


def log_likelihood(expected: Expected, recorded: Recorded) -> float:
    """Logarithm of the likelihood, but for a constant."""
    sizes = np.linalg.slogdet(expected.spectra)[1]
    total = -TAPERS * np.sum(sizes) - np.sum(np.abs(whitened(expected, recorded)) ** 2)
    if expected.mean is not None and expected.covariance is not None:
        off = recorded.mean - expected.mean
        total -= 0.5 * off @ np.linalg.solve(expected.covariance, off)
        total -= 0.5 * np.linalg.slogdet(expected.covariance)[1]
    return float(total)


def whitened(expected: Expected, recorded: Recorded) -> np.ndarray:
    """The transforms as independent numbers of size 1, shape (band, channel, taper)."""
    lower = np.linalg.cholesky(expected.spectra)
    return np.linalg.solve(lower, recorded.transforms.swapaxes(1, 2))


def slopes(model: Model, at: np.ndarray) -> list[Expected]:
    """Derivatives of what a model says by each of its numbers, by central differences."""
    found = []
    for index in range(len(at)):
        step = np.zeros(len(at))
        step[index] = _STEP
        up, down = model(at + step), model(at - step)
        parts: Any = [
            None if a is None or b is None else (a - b) / (2 * _STEP)
            for a, b in zip(up, down, strict=True)
        ]
        found.append(Expected(*parts))
    return found


def gradient_and_information(
    expected: Expected, by: list[Expected], recorded: Recorded
) -> tuple[np.ndarray, np.ndarray]:
    """Gradient of the log-likelihood, and Fisher's information.

    Arguments:
        expected: what the model says.
        by: its derivatives by each number.
        recorded: the record.
    """
    count = len(by)
    inverse = np.linalg.inv(expected.spectra)
    shares = [inverse @ part.spectra for part in by]
    seen = recorded.transforms @ inverse.swapaxes(1, 2)  # rows are S^-1 y
    gradient = np.array(
        [
            -TAPERS * np.trace(share, axis1=1, axis2=2).real.sum()
            + np.einsum("bkc,bcd,bkd->", seen.conj(), part.spectra, seen).real
            for share, part in zip(shares, by, strict=True)
        ]
    )
    information = np.array(
        [[TAPERS * np.einsum("bij,bji->", one, other).real for one in shares] for other in shares]
    ).reshape(count, count)
    if expected.mean is None or expected.covariance is None:
        return gradient, information
    precision = np.linalg.inv(expected.covariance)
    pull = precision @ (recorded.mean - expected.mean)
    moves = np.array([part.mean for part in by])
    widths = [precision @ np.asarray(part.covariance) for part in by]
    gradient += moves @ pull
    gradient += [
        0.5 * pull @ np.asarray(part.covariance) @ pull - 0.5 * np.trace(width)
        for part, width in zip(by, widths, strict=True)
    ]
    information += moves @ precision @ moves.T
    information += [[0.5 * np.trace(one @ other) for one in widths] for other in widths]
    return gradient, information


def most_likely(model: Model, start: np.ndarray, recorded: Recorded) -> OptimizeResult:
    """The numbers that make a record most likely, by SciPy's exact trust region.

    Fisher's information stands for the second derivatives.

    Returns:
        Of SciPy; `x` are the numbers, `fun` is minus the log-likelihood, `hess` the information.

    Raises:
        InputError: the model says nothing at the start.
    """
    model(start)
    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def cost(at: np.ndarray) -> float:
        try:
            return -log_likelihood(model(at), recorded)
        except (InputError, np.linalg.LinAlgError):
            return np.inf  # a step too far, and a shorter one follows

    def slopes_at(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = at.tobytes()
        if key not in known:
            known.clear()
            known[key] = gradient_and_information(model(at), slopes(model, at), recorded)
        return known[key]

    return minimize(
        cost,
        start,
        jac=lambda at: -slopes_at(at)[0],
        hess=lambda at: slopes_at(at)[1],
        method="trust-exact",
        options={
            "initial_trust_radius": 0.3,
            "max_trust_radius": _FARTHEST,
            "gtol": 0.1,
            "maxiter": 40,
        },
    )
