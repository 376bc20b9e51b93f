"""The wind that an arm at rest undulates in, from the spectra of its recording."""

from collections.abc import Callable, Sequence

import numpy as np

from .._errors import InputError
from ..kinds import WindSection
from ..models import ArmModel
from ..noise import from_differences
from ..parameters import replace
from ..runs import Run
from ..synthetic import DECAY
from ._model import WindModel
from ._multitaper import tapered
from ._numbers import NUMBERS, USUALLY, Numbers, first_guess
from ._response import Turbulence
from ._resting import Resting, resting
from ._result import WindFit, wind_result
from ._whittle import Expected, Recorded, most_likely

# A channel that bends by more than this of what it moves is none of a linear response.
_BENT = 0.25

# Fits until no channel bends any more.
_TIMES = 3


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
    skip: float = 0.0,
    highest: float | None = None,
) -> WindFit:
    """Fit mean flow and turbulence to the spectra and the mean of a resting arm.

    The arm is linearised statistically about its rest in the wind, gusts have von Karman's
    spectra and the coherence of `giajax.gusts`, and Whittle's likelihood of sine-tapered spectra
    is maximised. Recorded winds of the run are not used.

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
        skip: what is left out at the beginning, s.
        highest: frequency to look up to, Hz; by default half of what rows resolve.

    Returns:
        The wind with standard errors from Fisher's information.

    Raises:
        InputError: a run that moves, is uneven or too short, an arm with friction or memory, no
            mean flow to begin with, or an arm without a rest in it.

    Example:
        >>> found = fit_wind(model, run, mean=[0.0, 0.2, 0.0])  # doctest: +SKIP
    """
    strange = [name for name in free if name not in NUMBERS]
    if strange or not free:
        raise InputError(
            f"free is {', '.join(free) or 'empty'}: give at least one of {', '.join(NUMBERS)}"
        )
    if "decay" in free and not decay > 0:
        raise InputError("the decay is free and begins at 0: give a positive one")
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
        found = most_likely(_expectation(expects, numbers), numbers.start(noise), recorded)
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
            "every channel bends more than it moves in such a wind, and is none of a linear "
            "response: record others, or begin with a weaker wind"
        )
    return record.of(np.flatnonzero(~bent).tolist())
