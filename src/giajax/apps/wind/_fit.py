"""The wind that an arm at rest undulates in, from the spectra of its recording."""

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

# Standard error of a logarithm beyond which nothing is known: a factor of e.
OPEN = 1.0
_TOGETHER = 0.9
_OFF = 5.0
_ASIDE = 3.0
_SWINGS = 0.3
_GUSTS = 30


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
        converged: whether the optimiser ended at a maximum.
        log_likelihood: at the end, but for a constant.
        misfit: square of the transforms over what is expected, with its standard error; 1 is good.
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
    notes: tuple[str, ...] = ()


def _notes(found: WindFit, covariance: np.ndarray, expects: WindModel) -> tuple[str, ...]:
    """Sentences on a fit, by the covariance of logarithms and of angles."""
    notes = []
    errors = np.sqrt(np.diag(covariance))
    if not found.converged:
        notes.append(
            "the fit did not end at a maximum, so its standard errors are not reliable: start with "
            "better initial values, or fix more parameters"
        )
    for name, error in zip(found.free, errors, strict=True):
        if error > OPEN:
            notes.append(
                f"{name} is not determined by the data: fix it, record longer, or record more links"
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
            f"the spectra are {found.misfit[0]:.2f} times their expected value, {much} than by "
            "chance: the arm, the noise or the wind differs from the model, and the standard "
            "errors do not include this"
        )
    if expects.use_mean:
        off = np.abs(found.means[0] - found.means[1]) / found.means[2]
        if np.max(off) > _ASIDE:
            notes.append(
                f"the mean of a channel differs from the model by {np.max(off):.0f} standard "
                "errors: the direction of the wind or the rest position of the model is wrong; "
                "free the direction, or do not use the means"
            )
    else:
        notes.append(
            "the rest position was not used, so the mean wind is estimated only from the speed "
            "at which gusts pass the arm"
        )
    gusts = expects.lasts * found.wind.speed / found.wind.length_scale
    if gusts < _GUSTS:
        notes.append(
            f"the record lasts only {gusts:.0f} times as long as a gust, and the standard errors "
            f"are approximate below {_GUSTS}"
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
            f"the first {settled:.3g} s, which differ from the rest or precede the last command, "
            "were omitted: set skip to 0 to keep them"
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
    """The result of an optimiser's end."""
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


_BENT = 0.25  # a channel that bends by more than this of what it moves is none of a linear response
_TIMES = 3  # fits until no channel bends any more


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

    The arm is linearised statistically about its rest in the wind, gusts have von Karman's
    spectra and the coherence of `giajax.gusts`, and Whittle's likelihood of sine-tapered spectra
    is maximised. Standard errors are from Fisher's information. Recorded winds of the run are not
    used.

    Arguments:
        model: the arm and its sensors, all of whose parameters are held.
        run: of the arm under constant commands, evenly sampled.
        mean: velocity of the mean flow to begin with, m/s; its direction is held unless `heading`
            or `climb` are free. By default that of the run's [wind], or the arm's own.
        intensity: to begin with; of three the ratios are held.
        length_scale: to begin with, m.
        decay: of the coherence; 0 for one wind but for its lag along the mean flow.
        free: of `speed`, `deviation`, `length_scale`, `decay`, `heading` and `climb`.
        use_mean: whether the mean of each channel counts, too, which needs an arm whose pose
            without wind is right.
        skip: what is left out at the beginning, s; by default until the arm has come to rest.
        highest: frequency to look up to, Hz; by default half of what rows resolve.
        progress: called with a sentence after each step.

    Raises:
        InputError: a run that moves, is uneven or too short, an arm with friction or memory, no
            mean flow to begin with, or an arm without a rest in it.

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
            "the arm has a wind field, but a wind is to be fitted: remove the wind field"
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
    """The record without channels that bend more than a linear response allows."""
    bent = WindModel(model, record, use_mean=False).bent(wind) > _BENT
    if bent.all():
        raise InputError(
            "no channel has a linear response in this wind: record other channels, or start from a "
            "weaker wind"
        )
    return record.of(np.flatnonzero(~bent).tolist())
