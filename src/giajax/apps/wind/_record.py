"""Record of an arm at rest in a wind, and its spectra with sine tapers.

The tapers are those of Riedel and Sidorenko (Minimum bias multiple taper spectral estimation, IEEE
Transactions on Signal Processing 43, 1995, p. 188). The k-th taper has its spectral window at k
half bins, k / 2T, on either side of a frequency. K tapers therefore cover a band of width
(K + 1) / T, and bands at this distance are almost independent.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from ...models import ArmModel, camera_of, clock_of
from ...recordings import Run
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ..synthetic import RESOLVED

TAPERS = 5

# Of a long record, the first bands are all used, and then a selection of the further bands, because
# the spectra are smooth at high frequencies.
_ALL, _MORE = 150, 150


class Bands(NamedTuple):
    """Frequency bands of a record.

    Attributes:
        middles: centre frequencies of the bands, Hz, shape (band,).
        frequencies: frequencies at which a model must be evaluated, Hz, shape (frequency,).
        members: indices of the frequencies that the tapers of each band average with equal weights,
            shape (band, 2 TAPERS).
    """

    middles: Float[np.ndarray, " band"]
    frequencies: Float[np.ndarray, " frequency"]
    members: np.ndarray


def bands(samples: int, interval: float, highest: float) -> Bands:
    """Return the bands of a record, from just above zero up to the frequency `highest`, Hz.

    The interval between two samples is in s.
    """
    half = 1 / (2 * (samples + 1) * interval)
    apart = 2 * (TAPERS + 1)
    # Begin above the first bin, which is empty because the mean is subtracted.
    steps = np.arange(apart // 2 + 2, int(highest / half) - TAPERS, apart)
    if len(steps) > _ALL + _MORE:
        chosen = np.geomspace(_ALL, len(steps) - 1, _MORE).astype(int)
        steps = np.concatenate([steps[:_ALL], steps[np.unique(chosen)]])
    seen = np.concatenate([np.arange(-TAPERS, 0), np.arange(1, TAPERS + 1)])
    needed, members = np.unique(steps[:, None] + seen, return_inverse=True)
    return Bands(steps * half, needed * half, members.reshape(len(steps), len(seen)))


def tapered(
    values: Float[np.ndarray, "sample channel"], interval: float, middles: np.ndarray
) -> np.ndarray:
    """Return tapered transforms of evenly sampled values; their products are one-sided spectra.

    The interval is in s. The centre frequencies of the bands are multiples of half a bin, Hz. The
    mean is subtracted first. The transforms are complex, with the shape (band, taper, channel), in
    units per sqrt(Hz).
    """
    samples = len(values)
    about = values - values.mean(axis=0)
    order = np.arange(1, TAPERS + 1)
    turns = np.pi * np.outer(np.arange(1, samples + 1), order) / (samples + 1)
    tapers = np.sqrt(2 / (samples + 1)) * np.sin(turns)
    # Zero-padding to twice the length plus two gives a transform with half bins.
    length = 2 * (samples + 1)
    at = np.rint(middles * length * interval).astype(int)
    transformed = np.fft.rfft(tapers[:, :, None] * about[:, None, :], length, axis=0)
    return np.sqrt(2 * interval) * transformed[at]


# Smallest number of bands from which three numbers can be estimated.
_FEWEST = 8
_MISSING = 0.05
_UNEVEN = 0.01
_STILL = 1e-6  # largest range of a constant command, rad; allows for the rounding of a file


@dataclasses.dataclass(frozen=True)
class Resting:
    """Evenly sampled channels of an arm under constant commands.

    Attributes:
        names: names of the channels.
        values: values of the channels, SI units, shape (sample, channel).
        interval: interval between two samples, s.
        highest: highest frequency used, Hz.
        command: commanded angles of the joints, rad.
        delays: delay of the clock of each channel, s.
        quantities: quantity of each channel; channels of one quantity have the same noise if it is
            not given.
        noise: standard deviation of the white noise of each channel, and standard deviation and
            correlation time, s, of its correlated noise, SI units; None if the noise is not given.
        filled: fraction of the cells that were empty.
        settled: duration until the arm came to rest, s, if it was detected.
    """

    names: tuple[str, ...]
    values: np.ndarray
    interval: float
    highest: float
    command: np.ndarray
    delays: np.ndarray
    quantities: tuple[str, ...]
    noise: tuple[tuple[float, float, float] | None, ...]
    filled: float
    settled: float = 0.0

    def of(self, chosen: Sequence[int]) -> "Resting":
        """Return the record with only the chosen channels."""
        return dataclasses.replace(
            self,
            names=tuple(self.names[index] for index in chosen),
            values=self.values[:, chosen],
            delays=self.delays[list(chosen)],
            quantities=tuple(self.quantities[index] for index in chosen),
            noise=tuple(self.noise[index] for index in chosen),
        )


def resting(
    model: ArmModel, run: Run, *, skip: float | None = None, highest: float | None = None
) -> Resting:
    """Return the record of a run of the arm; `skip`, s, and `highest`, Hz, are as in `fit_wind`."""
    if run.model != "arm" or run.times is None:
        raise InputError(f"'{run.name}' is a run of the {run.model} model: give a run of an arm")
    joints = model.arm.joints
    if joints.further_laws.rows or (joints.friction is not None and np.any(joints.friction)):
        raise InputError(
            "the arm has friction or joints with memory, which stick in small gusts and cannot be "
            "linearised at rest: remove them from [arm]"
        )
    run.require_observations()
    for name in run.observations:
        if (run.channels[name].index or 0) > model.arm.count:
            raise InputError(
                f"'{run.name}' has {name}, but the arm has only {model.arm.count} links: give the "
                "arm that was recorded"
            )
        if model.sensors.of_row(run.channels[name].kind) is not None:
            raise InputError(
                f"'{run.name}' has {name}, for which no spectrum can be computed: exclude it with "
                "--channels"
            )
    settled = _settled(run, run.times) if skip is None else 0.0
    skip = settled if skip is None else skip
    kept = run.times >= run.times[0] + skip
    times = run.times[kept]
    if not 0 <= skip < np.inf or len(times) < 2:
        raise InputError(
            f"skip is {skip:g} s, but '{run.name}' lasts {np.ptp(run.times):g} s: "
            "give at least 0 s and less than the duration"
        )
    steps = np.diff(times)
    interval = float(np.ptp(times) / len(steps))
    if np.max(np.abs(steps - interval)) > _UNEVEN * interval:
        raise InputError(
            f"the sampling intervals of '{run.name}' are {steps.min():.4g} to {steps.max():.4g} s, "
            "but a spectrum needs equal intervals: resample the run"
        )
    resolved = RESOLVED / (2 * interval)
    top = resolved if highest is None else highest
    if not 0 < top <= 2 * resolved:
        raise InputError(
            f"the highest frequency is {top:g} Hz: give a positive frequency of at most "
            f"{2 * resolved:g} Hz, half the sampling rate of '{run.name}'"
        )
    least = (_FEWEST + 1) * (TAPERS + 1) / top
    if np.ptp(times) < least:
        raise InputError(
            f"'{run.name}' rests for {np.ptp(times):.4g} s, too short for spectra up to {top:g} "
            f"Hz: give at least {least:.4g} s, and many times the duration of a gust"
        )
    values, filled = _filled(run, kept, times)
    return Resting(
        names=tuple(run.observations),
        values=values,
        interval=interval,
        highest=top,
        command=_command(model, run, kept),
        delays=np.array([_delay(model, run, name) for name in run.observations]),
        quantities=tuple(run.channels[name].quantity for name in run.observations),
        noise=tuple(_noise(run, name) for name in run.observations),
        filled=filled,
        settled=settled,
    )


_BLOCKS = 32
_BY_CHANCE = 1e-3  # probability that the beginning of a record without a transient is left out


def _settled(run: Run, times: np.ndarray) -> float:
    """Return the duration after which a record resembles its second half, s.

    The beginning differs, for example, if the arm is still coming to rest. After the last command,
    the record is divided into blocks. The mean and the standard deviation of each channel in each
    block are compared with the blocks of the second half, with Student's t distribution. There is
    no comparison if a block is shorter than two correlation times, because dependent blocks differ
    too often.
    """
    moving = [np.abs(column - column[-1]) > _STILL for column in run.commands.values()]
    rows = np.flatnonzero(np.any(moving, axis=0)) if moving else np.array([], dtype=int)
    first = int(rows[-1]) + 1 if rows.size and rows[-1] < len(times) // 2 else 0
    length = (len(times) - first) // _BLOCKS
    begun = float(times[first] - times[0])
    if length < 4:
        return begun
    table = np.stack([*run.observations.values()], axis=1)[first : first + _BLOCKS * length]
    # The limit is two correlation times. They are computed from the sum of squared correlations,
    # which noise makes a quarter too large.
    if length < 1.6 * _correlation(table[len(table) // 2 :], 2 * length):
        return begun
    blocks = np.ma.masked_invalid(table.reshape(_BLOCKS, length, -1))
    spread = np.log(np.maximum(blocks.std(axis=1), 1e-300))
    told = np.ma.concatenate([blocks.mean(axis=1), spread], axis=1)
    half = _BLOCKS // 2
    later = told[half:]
    deviation = np.maximum(later.std(axis=0, ddof=1) * np.sqrt(1 + 1 / half), 1e-300)
    # A quantile of Student's distribution; `scipy.stats` takes half a second to import.
    highest = stdtrit(half - 1, 1 - _BY_CHANCE / (2 * told.shape[1]))
    odd = np.any((np.abs(told - later.mean(axis=0)) / deviation).filled(0) > highest, axis=1)
    if not odd[0]:
        return begun
    # Leave out the same duration once more, in which the rest of the transient decays.
    until = min(2 * int(np.argmin(np.append(odd[:half], False))), half)
    return float(times[first + until * length] - times[0])


def _correlation(table: np.ndarray, lags: int) -> float:
    """Return the largest correlation time of the channels, in rows."""
    known = np.ma.masked_invalid(table)
    about = (known - known.mean(axis=0)).filled(0.0)
    power = np.abs(np.fft.rfft(about, 2 * len(about), axis=0)) ** 2
    alike = np.fft.irfft(power, axis=0)[:lags]
    return float(np.max(2 * np.sum((alike / np.maximum(alike[0], 1e-300)) ** 2, axis=0) - 1))


def _command(model: ArmModel, run: Run, kept: np.ndarray) -> np.ndarray:
    command = np.zeros(model.arm.count)
    for name, column in run.commands.items():
        channel = run.channels[name]
        moved = float(np.ptp(column[kept]))
        if moved > _STILL:
            raise InputError(
                f"{name} of '{run.name}' moves by {moved:.3g}, but the arm must rest under "
                "constant commands: shorten the run, or omit its beginning with skip"
            )
        if channel.kind != "joint_command" and np.any(column[kept]):
            raise InputError(
                f"'{run.name}' drives the arm by {name}: give a run that rests under commanded "
                "angles"
            )
        if channel.kind == "joint_command" and channel.index is not None:
            if channel.index > len(command):
                raise InputError(
                    f"'{run.name}' drives joint {channel.index}, but the arm has only "
                    f"{len(command)} joints: give a longer arm"
                )
            command[channel.index - 1] = column[kept][0]
    return command


def _filled(run: Run, kept: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the channels with linearly interpolated gaps, and the fraction of these cells."""
    table = np.stack([column[kept] for column in run.observations.values()], axis=1)
    empty = np.isnan(table)
    for index, name in enumerate(run.observations):
        gaps = empty[:, index]
        if gaps.mean() > _MISSING:
            raise InputError(
                f"{name} of '{run.name}' is empty in {gaps.mean():.0%} of its rows, but at most "
                f"{_MISSING:.0%} may be filled for a spectrum: omit the channel, or shorten the run"
            )
        table[gaps, index] = np.interp(times[gaps], times[~gaps], table[~gaps, index])
    return table, float(empty.mean())


def _delay(model: ArmModel, run: Run, name: str) -> float:
    channel, sensors = run.channels[name], model.sensors
    of = sensors.camera if channel.quantity in ("length", "pixel") else sensors.encoder
    if of.clock_rate is not None and float(of.clock_rate):
        raise InputError(
            f"the clock of {name} has a rate of {float(of.clock_rate):g}, but spectra need exact "
            "clocks: correct time_s, and remove clock_rate"
        )
    delay = of.delay
    if channel.quantity == "pixel":
        delay = clock_of(sensors, camera_of(sensors, channel))
    return 0.0 if delay is None else float(delay)


def _noise(run: Run, name: str) -> tuple[float, float, float] | None:
    deviation, correlated = run.noise(name), run.correlated_noise(name)
    if deviation is None:
        return None
    memory = (0.0, 0.0) if correlated is None else correlated
    return (float(np.sqrt(max(deviation**2 - memory[0] ** 2, 0.0))), *memory)
