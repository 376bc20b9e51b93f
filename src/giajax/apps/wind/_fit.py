"""Fit of a wind to the spectra of a recording of an arm at rest."""

import dataclasses
import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import OptimizeResult

from ...models import ArmModel
from ...noise import from_differences
from ...recordings import Run
from ...runtime.text import InputError
from ...schema import WindSection
from ...schema.parameters import replace
from ..synthetic import DECAY
from ._model import (
    NUMBERS,
    TURNS,
    UNITS,
    USUALLY,
    Expected,
    Numbers,
    Recorded,
    WindModel,
    first_guess,
    most_likely,
    whitened,
)
from ._record import Resting, resting, tapered
from ._response import Turbulence

# Standard error of a logarithm (a factor of e) above which a parameter counts as not determined.
OPEN = 1.0
_TOGETHER = 0.9
_OFF = 5.0
_ASIDE = 3.0
_SWINGS = 0.3
_GUSTS = 30


@dataclasses.dataclass(frozen=True)
class WindNumber:
    """Fitted number of a wind.

    Attributes:
        value: value in the unit.
        standard_error: standard error; None if the number was fixed or is not determined.
        unit: unit of the value.
        free: whether the number was fitted.
    """

    value: float
    standard_error: float | None
    unit: str
    free: bool


@dataclasses.dataclass(frozen=True)
class WindFit:
    """Wind fitted to the spectra of an arm at rest.

    Attributes:
        numbers: speed, deviation, length_scale, decay, heading and climb; the standard deviation of
            the noise if it was not given; and the derived numbers `intensity` and `lasting` (the
            length scale divided by the speed, s).
        wind: wind with these numbers, as an object that computes spectra.
        correlation: correlation of the free numbers (logarithms, except for angles), shape
            (free, free).
        free: names of the free numbers.
        converged: whether the optimiser ended at a maximum.
        log_likelihood: logarithm of the likelihood at the end, up to a constant.
        misfit: ratio of the squared transforms to their expected values, and its standard error; 1
            is expected.
        channels: names of the fitted channels.
        left_out: channels that were left out because their response is not linear.
        frequencies: centre frequencies of the bands, Hz.
        measured, fitted: one-sided spectra of each channel, SI units squared per Hz, shape
            (band, channel).
        means: recorded mean, fitted mean, and standard error of the mean of each channel, SI units,
            shape (3, channel); NaN if the mean was not used.
        swing: largest standard deviation of a joint angle, rad.
        notes: warnings about the fit, each a sentence.
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
    notes: tuple[str, ...] = ()


def _notes(found: WindFit, covariance: np.ndarray, expects: WindModel) -> tuple[str, ...]:
    """Return warnings about a fit, from the covariance of the logarithms and of the angles."""
    notes = []
    errors = np.sqrt(np.diag(covariance))
    if not found.converged:
        notes.append(
            "the fit did not converge to a maximum of the likelihood, so its standard errors are "
            "not reliable: start with better initial values, or hold more parameters fixed"
        )
    for name, error in zip(found.free, errors, strict=True):
        if error > OPEN:
            notes.append(
                f"{name} is not determined by the data: hold it fixed, record longer, or record "
                "more links"
            )
    for one, other in itertools.combinations(range(len(found.free)), 2):
        together = covariance[one, other] / (errors[one] * errors[other])
        if abs(together) > _TOGETHER:
            sign = np.sign(together)
            left = covariance[one, one] + covariance[other, other]
            known = np.sqrt(max(left - 2 * sign * covariance[one, other], 0.0))
            what = "ratio" if sign > 0 else "product"
            notes.append(
                f"{found.free[one]} and {found.free[other]} are correlated (correlation "
                f"{together:.2f}): their {what} has a relative uncertainty of {known:.1%}"
            )
    if abs(found.misfit[0] - 1) > _OFF * found.misfit[1]:
        much = "larger" if found.misfit[0] > 1 else "smaller"
        notes.append(
            f"the spectra are {found.misfit[0]:.2f} times their expected value, significantly "
            f"{much} than 1: the arm, the noise or the wind differs from the model, and the "
            "standard errors do not include this difference"
        )
    if expects.use_mean:
        off = np.abs(found.means[0] - found.means[1]) / found.means[2]
        if np.max(off) > _ASIDE:
            notes.append(
                f"the mean of a channel differs from the model by {np.max(off):.0f} times its "
                "standard error, so the direction of the wind or the rest position of the model is "
                "wrong: free the direction, or do not use the means"
            )
    else:
        notes.append(
            "the rest position was not used, so the mean wind is estimated only from the speed "
            "at which gusts pass the arm"
        )
    gusts = expects.lasts * found.wind.speed / found.wind.length_scale
    if gusts < _GUSTS:
        notes.append(
            f"the recording lasts only {gusts:.0f} times as long as a gust: below {_GUSTS} times, "
            "the standard errors are only approximate"
        )
    if found.swing > _SWINGS:
        notes.append(
            f"a joint swings by {np.rad2deg(found.swing):.0f} deg, so its response is not linear"
        )
    if found.left_out:
        notes.append(
            f"channels omitted because their response is not linear: {', '.join(found.left_out)}"
        )
    if settled := expects.record.settled:
        notes.append(
            f"the first {settled:.3g} s, which differ from the rest of the recording or precede "
            "the last command, were omitted: set skip to 0 to keep them"
        )
    if filled := expects.record.filled:
        notes.append(
            f"{filled:.1%} of the cells were empty and were filled by linear interpolation"
        )
    return tuple(notes)


def wind_result(
    expects: WindModel,
    numbers: Numbers,
    recorded: Recorded,
    found: OptimizeResult,
    left_out: tuple[str, ...],
) -> WindFit:
    """Return the fitted wind from the result of the optimiser."""
    wind, white = numbers.at(found.x)
    expected = expects.expected(wind, white)
    # Directions without any information get a large variance, not infinity.
    values, vectors = np.linalg.eigh(np.asarray(found.hess))
    covariance = (vectors / np.maximum(values, 1e-6)) @ vectors.T
    errors = np.sqrt(np.diag(covariance))
    whites = np.abs(whitened(expected, recorded)) ** 2
    covariances = expects.about(wind)[1]
    means = np.full((3, len(expects.record.names)), np.nan)
    if expected.mean is not None and expected.covariance is not None:
        means = np.stack([recorded.mean, expected.mean, np.sqrt(np.diag(expected.covariance))])
    result = WindFit(
        numbers=_numbers(numbers, wind, white, covariance),
        wind=wind,
        correlation=covariance / np.outer(errors, errors),
        free=numbers.names,
        converged=bool(found.success),
        log_likelihood=-float(found.fun),
        misfit=(float(whites.mean()), float(whites.size**-0.5)),
        channels=expects.record.names,
        left_out=left_out,
        frequencies=expects.bands.middles,
        measured=np.mean(np.abs(recorded.transforms) ** 2, axis=1),
        fitted=np.diagonal(expected.spectra, axis1=1, axis2=2).real,
        means=means,
        swing=float(np.sqrt(np.max(np.diag(covariances)))),
    )
    return dataclasses.replace(result, notes=_notes(result, covariance, expects))


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
        """Return the ratio of two positive numbers, with its error from their logarithms."""
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


_BENT = 0.25  # largest ratio of the quadratic to the linear response of a channel that is used
_TIMES = 3  # largest number of fits until the responses of all used channels are linear


def fit_wind(
    model: ArmModel,
    run: Run,
    *,
    mean: Sequence[float] | None = None,
    intensity: float | Sequence[float] = 0.2,
    length_scale: float = 5.0,
    decay: float = DECAY,
    free: Sequence[str] = USUALLY,
    use_mean: bool = True,
    skip: float | None = None,
    highest: float | None = None,
    progress: Callable[[str], object] | None = None,
) -> WindFit:
    """Fit mean flow and turbulence to the spectra and the mean of a resting arm.

    The arm is linearised statistically about its equilibrium in the wind. The gusts have von Karman
    spectra and the coherence of `giajax.gusts`. The fit maximises Whittle's likelihood of
    sine-tapered spectra. Standard errors follow from the Fisher information. Recorded winds of the
    run are not used.

    Arguments:
        model: arm and its sensors; all their parameters are fixed.
        run: evenly sampled run of the arm under constant commands.
        mean: initial velocity of the mean flow, m/s; its direction is fixed unless `heading` or
            `climb` is free. Defaults to the [wind] of the run, or to the wind of the arm.
        intensity: initial turbulence intensity; if three numbers are given, their ratios are fixed.
        length_scale: initial length scale, m.
        decay: initial decay coefficient of the coherence; 0 for the same wind at all places, apart
            from its delay along the mean flow.
        free: free numbers, from `speed`, `deviation`, `length_scale`, `decay`, `heading` and
            `climb`.
        use_mean: also use the mean of each channel, which requires an arm whose pose without wind
            is correct.
        skip: duration that is left out at the beginning, s; defaults to the time until the arm has
            come to rest.
        highest: highest frequency used, Hz; defaults to half of the Nyquist frequency.
        progress: function that is called with a message after each step.

    Raises:
        InputError: the commands of the run move, or it is unevenly sampled or too short; the arm
            has friction or hysteresis; the initial mean flow is missing; or the arm has no stable
            equilibrium in the wind.

    Example:
        >>> found = fit_wind(model, run, mean=[0.0, 0.2, 0.0])  # doctest: +SKIP
    """
    strange = [name for name in free if name not in NUMBERS]
    if strange or not free:
        raise InputError(
            f"the free parameters are {', '.join(free) or 'none'}: give at least one of "
            f"{', '.join(NUMBERS)}"
        )
    if "decay" in free and not decay > 0:
        raise InputError(
            "the decay is free, but its initial value is 0: give a positive initial value"
        )
    if model.arm.air.wind_field is not None:
        raise InputError(
            "the arm has a wind field, but the wind is to be fitted: remove the wind field"
        )
    own = model.arm.air.wind
    if mean is None:
        mean = run.definition.section(WindSection).velocity_m_per_s
    if mean is None and own is not None:
        mean = [float(part) for part in own]
    wind = first_guess(mean, intensity, length_scale, decay)
    if own is not None:
        model = replace(model, {"air.wind": np.zeros(3)})
    whole = resting(model, run, skip=skip, highest=highest)
    record = _straight(model, whole, wind)
    for _ in range(_TIMES):
        expects = WindModel(model, record, use_mean)
        expects.places = expects.about(wind)[2]
        numbers = Numbers(wind, free, record)
        recorded = Recorded(
            tapered(record.values, record.interval, expects.bands.middles),
            record.values.mean(axis=0),
        )
        noise = np.array([from_differences(column) for column in record.values.T])
        start = numbers.start(noise)
        found = most_likely(_expectation(expects, numbers), start, recorded, progress)
        wind = numbers.at(found.x)[0]
        still = _straight(model, record, wind)
        if len(still.names) == len(record.names):
            break
        record = still
    left_out = tuple(name for name in whole.names if name not in record.names)
    return wind_result(expects, numbers, recorded, found, left_out)


def _expectation(expects: WindModel, numbers: Numbers) -> Callable[[np.ndarray], Expected]:
    return lambda at: expects.expected(*numbers.at(at))


def _straight(model: ArmModel, record: Resting, wind: Turbulence) -> Resting:
    """Return the record without the channels whose response is not linear."""
    bent = WindModel(model, record, use_mean=False).bent(wind) > _BENT
    if bent.all():
        raise InputError(
            "no channel has a linear response in this wind: record other channels, or start from a "
            "weaker wind"
        )
    return record.of(np.flatnonzero(~bent).tolist())
