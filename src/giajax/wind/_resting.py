"""A record of an arm at rest in a wind: what of a run is one, and refused otherwise."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..models import ArmModel, camera_of, clock_of
from ..runs import Run
from ..synthetic import RESOLVED
from ._multitaper import TAPERS

# Fewer bands know no three numbers.
_FEWEST = 8
_MISSING = 0.05
_UNEVEN = 0.01
# What a command may move by, rad: rounding of a file.
_STILL = 1e-6


@dataclasses.dataclass(frozen=True)
class Resting:
    """Evenly sampled channels of an arm whose commands rest.

    Attributes:
        names: of the channels.
        values: SI, shape (sample, channel).
        interval: between two samples, s.
        highest: frequency that is looked at, Hz.
        command: of the joints, rad, shape (joint,).
        delays: of each channel's clock, s.
        quantities: of each channel, whose noise is alike where it is not stated.
        noise: for each channel the deviation of its white noise, and that of its noise with a
            memory with its time (s), SI; None where nothing is stated.
        filled: share of the cells that were empty.
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

    def of(self, chosen: Sequence[int]) -> "Resting":
        """Only some of the channels."""
        return dataclasses.replace(
            self,
            names=tuple(self.names[index] for index in chosen),
            values=self.values[:, chosen],
            delays=self.delays[list(chosen)],
            quantities=tuple(self.quantities[index] for index in chosen),
            noise=tuple(self.noise[index] for index in chosen),
        )


def resting(
    model: ArmModel, run: Run, *, skip: float = 0.0, highest: float | None = None
) -> Resting:
    """The record of a run.

    Arguments:
        model: the arm.
        run: of it.
        skip: what is left out at the beginning, s.
        highest: frequency to look up to, Hz; by default half of what rows resolve.

    Raises:
        InputError: the run or the arm is none of which gusts have spectra.
    """
    if run.model != "arm" or run.times is None:
        raise InputError(f"'{run.name}' is a run of the {run.model} model: give a run of an arm")
    joints = model.arm.joints
    if joints.hysteresis.rows or (joints.friction is not None and np.any(joints.friction)):
        raise InputError(
            "the arm has friction or joints with memory, which hold against small gusts and have "
            "no slope at rest: leave them out of [arm]"
        )
    run.require_observations()
    for name in run.observations:
        if (run.channels[name].index or 0) > model.arm.count:
            raise InputError(
                f"'{run.name}' has {name}, but the arm has {model.arm.count} links: give the arm "
                "that was recorded"
            )
    kept = run.times >= run.times[0] + skip
    times = run.times[kept]
    if not 0 <= skip < np.inf or len(times) < 2:
        raise InputError(
            f"{skip:g} s are to be skipped of '{run.name}', which lasts {np.ptp(run.times):g} s: "
            "give at least 0 s and less than that"
        )
    steps = np.diff(times)
    interval = float(np.ptp(times) / len(steps))
    if np.max(np.abs(steps - interval)) > _UNEVEN * interval:
        raise InputError(
            f"'{run.name}' has steps of {steps.min():.4g} to {steps.max():.4g} s between its rows, "
            "but a spectrum needs even ones: sample it again"
        )
    resolved = RESOLVED / (2 * interval)
    top = resolved if highest is None else highest
    if not 0 < top <= 2 * resolved:
        raise InputError(
            f"the highest frequency is {top:g} Hz: give a positive one of at most "
            f"{2 * resolved:g} Hz, which is half of the rows of '{run.name}' in a second"
        )
    least = (_FEWEST + 1) * (TAPERS + 1) / top
    if np.ptp(times) < least:
        raise InputError(
            f"'{run.name}' rests for {np.ptp(times):.4g} s, too short for spectra up to {top:g} "
            f"Hz: give at least {least:.4g} s, and many times what a gust lasts"
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
    )


def _command(model: ArmModel, run: Run, kept: np.ndarray) -> np.ndarray:
    command = np.zeros(model.arm.count)
    for name, column in run.commands.items():
        channel = run.channels[name]
        moved = float(np.ptp(column[kept]))
        if moved > _STILL:
            raise InputError(
                f"{name} of '{run.name}' moves by {moved:.3g}, but the arm has to rest under "
                "constant commands: cut the run, or leave out its beginning with skip"
            )
        if channel.kind != "joint_command" and np.any(column[kept]):
            raise InputError(
                f"'{run.name}' drives the arm by {name}: give a run that rests under commanded "
                "angles"
            )
        if channel.kind == "joint_command" and channel.index is not None:
            if channel.index > len(command):
                raise InputError(
                    f"'{run.name}' drives joint {channel.index}, but the arm has {len(command)} "
                    "joints: give a longer arm"
                )
            command[channel.index - 1] = column[kept][0]
    return command


def _filled(run: Run, kept: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, float]:
    """The channels with straight lines through their gaps, and the share of those."""
    table = np.stack([column[kept] for column in run.observations.values()], axis=1)
    empty = np.isnan(table)
    for index, name in enumerate(run.observations):
        gaps = empty[:, index]
        if gaps.mean() > _MISSING:
            raise InputError(
                f"{name} of '{run.name}' is empty in {gaps.mean():.0%} of its rows, and a spectrum "
                f"has at most {_MISSING:.0%} filled: leave the channel out, or cut the run"
            )
        table[gaps, index] = np.interp(times[gaps], times[~gaps], table[~gaps, index])
    return table, float(empty.mean())


def _delay(model: ArmModel, run: Run, name: str) -> float:
    channel = run.channels[name]
    if channel.quantity == "pixel":
        delay = clock_of(model.sensors, camera_of(model.sensors, channel))
    else:
        position = channel.quantity == "length"
        delay = (model.sensors.camera if position else model.sensors.encoder).delay
    return 0.0 if delay is None else float(delay)


def _noise(run: Run, name: str) -> tuple[float, float, float] | None:
    deviation, correlated = run.noise(name), run.correlated_noise(name)
    if deviation is None:
        return None
    memory = (0.0, 0.0) if correlated is None else correlated
    return (float(np.sqrt(max(deviation**2 - memory[0] ** 2, 0.0))), *memory)
