"""What a fit of a wind says: numbers with standard errors, spectra, and sentences."""

import dataclasses

import numpy as np
from scipy.optimize import OptimizeResult

from ._model import WindModel
from ._numbers import NUMBERS, TURNS, UNITS, Numbers
from ._response import Turbulence
from ._whittle import Recorded, whitened
from ._words import OPEN, wind_notes


@dataclasses.dataclass(frozen=True)
class WindNumber:
    """One number of a wind: its value, standard error (None where held or open), unit."""

    value: float
    standard_error: float | None
    unit: str
    free: bool


@dataclasses.dataclass(frozen=True)
class WindFit:
    """A wind fitted to the spectra of a resting arm.

    Attributes:
        numbers: speed, deviation, length_scale, decay, heading and climb; the deviation of noise
            that was not stated; and derived from them `intensity` and `lasting`, the length scale
            over the speed, s.
        wind: the same as an object that has spectra.
        correlation: between the free numbers (logarithms, but for angles), shape (free, free).
        free: their names.
        converged: whether the optimiser ended at a maximum.
        log_likelihood: at the end, but for a constant.
        misfit: square of the transforms over what is expected, with its standard error; 1 is good.
        channels: what was fitted.
        left_out: channels that bend more than they move, and were left out.
        frequencies: middles of the bands, Hz.
        measured, fitted: one-sided spectra of each channel, SI^2/Hz, shape (band, channel).
        means: recorded and fitted mean of each channel and its standard error, SI, shape
            (3, channel); NaN where the mean was not used.
        swing: largest standard deviation of a joint, rad.
        notes: sentences on what the recording cannot tell.
    """

    numbers: dict[str, WindNumber]
    wind: Turbulence
    correlation: np.ndarray
    free: tuple[str, ...]
    converged: bool
    log_likelihood: float
    misfit: tuple[float, float]
    channels: tuple[str, ...]
    left_out: tuple[str, ...]
    frequencies: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    means: np.ndarray
    swing: float
    notes: tuple[str, ...]


def wind_result(
    expects: WindModel,
    numbers: Numbers,
    recorded: Recorded,
    found: OptimizeResult,
    left_out: tuple[str, ...],
) -> WindFit:
    """The result of an optimiser's end."""
    wind, white = numbers.at(found.x)
    expected = expects.expected(wind, white)
    covariance = _covariance(np.asarray(found.hess))
    errors = np.sqrt(np.diag(covariance))
    converged = bool(found.success)
    whites = np.abs(whitened(expected, recorded)) ** 2
    misfit = (float(whites.mean()), float(whites.size**-0.5))
    covariances = expects.about(wind)[1]
    swing = float(np.sqrt(np.max(np.diag(covariances))))
    means = np.full((3, len(expects.record.names)), np.nan)
    if expected.mean is not None and expected.covariance is not None:
        means = np.stack([recorded.mean, expected.mean, np.sqrt(np.diag(expected.covariance))])
    return WindFit(
        numbers=_numbers(numbers, wind, white, covariance),
        wind=wind,
        correlation=covariance / np.outer(errors, errors),
        free=numbers.names,
        converged=converged,
        log_likelihood=-float(found.fun),
        misfit=misfit,
        channels=expects.record.names,
        left_out=left_out,
        frequencies=expects.bands.middles,
        measured=np.mean(np.abs(recorded.transforms) ** 2, axis=1),
        fitted=np.diagonal(expected.spectra, axis1=1, axis2=2).real,
        means=means,
        swing=swing,
        notes=wind_notes(
            wind,
            names=numbers.names,
            covariance=covariance,
            converged=converged,
            misfit=misfit,
            means=means,
            left_out=left_out,
            swing=swing,
            lasts=expects.lasts,
            filled=expects.record.filled,
            followed=expects.use_mean,
        ),
    )


def _covariance(information: np.ndarray) -> np.ndarray:
    """Inverse of the information; directions without any get a large variance, not infinity."""
    values, vectors = np.linalg.eigh(information)
    return (vectors / np.maximum(values, 1e-6)) @ vectors.T


def _numbers(
    numbers: Numbers, wind: Turbulence, white: np.ndarray, covariance: np.ndarray
) -> dict[str, WindNumber]:
    where = {name: index for index, name in enumerate(numbers.names)}
    errors = np.sqrt(np.diag(covariance))

    def one(name: str, value: float, unit: str) -> WindNumber:
        if name not in where:
            return WindNumber(value, None, unit, free=False)
        error = errors[where[name]]
        told = None if error > OPEN else float(error if name in TURNS else error * value)
        return WindNumber(value, told, unit, free=True)

    def ratio(above: str, below: str, value: float, unit: str) -> WindNumber:
        """Of two positive numbers, whose logarithms are subtracted."""
        sides = np.zeros(len(errors))
        for name, sign in ((above, 1.0), (below, -1.0)):
            if name in where:
                sides[where[name]] = sign
        error = float(np.sqrt(sides @ covariance @ sides))
        told = None if error > OPEN or not sides.any() else error * value
        return WindNumber(value, told, unit, free=bool(sides.any()))

    table = {name: one(name, numbers.value(name, wind), UNITS[name]) for name in NUMBERS}
    for name, which in zip(numbers.names[len(numbers.free) :], numbers.which, strict=True):
        table[name] = one(name, float(white[which][0]), "SI")
    table["intensity"] = ratio("deviation", "speed", wind.deviation / wind.speed, "")
    table["lasting"] = ratio("length_scale", "speed", wind.length_scale / wind.speed, "s")
    return table
