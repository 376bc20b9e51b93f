"""What the channels of a run are drawn over, and which of them together."""

from typing import Any

import numpy as np

from ..runs import Channel, Run

# A step of this many times the usual one, and of this part of the range, is no motion.
_JUMP, _FAR = 20, 0.3


def abscissa(run: Run) -> tuple[np.ndarray, str]:
    """What the channels of a run are drawn over, in the unit of the file, and its label."""
    name = run.drawn_over
    if name is None:
        return sample_times(run), time_label(run)
    return run.channels[name].from_si(run.values[name]), channel_label(run.channels[name])


def channel_label(channel: Channel) -> str:
    """Name and unit of a channel."""
    return channel.name + (f" ({channel.unit.replace('_per_', '/')})" if channel.unit else "")


def sample_times(run: Run) -> np.ndarray:
    """Times of the samples, s; their numbers where a run has no times."""
    if run.times is not None:
        return run.times
    return np.arange(len(next(iter(run.values.values()))), dtype=float)


def time_label(run: Run) -> str:
    """What `sample_times` are."""
    return "time (s)" if run.times is not None else "sample"


def sweep_starts(over: np.ndarray) -> np.ndarray:
    """Samples at which a run of sweeps starts another one, having jumped there."""
    steps = np.abs(np.diff(over))
    usual = np.median(steps[steps > 0]) if np.any(steps > 0) else 0.0
    return np.flatnonzero((steps > _JUMP * usual) & (steps > _FAR * np.ptp(over))) + 1


def channels_together(run: Run, most: int) -> list[list[str]]:
    """Names of the channels that share a panel.

    One channel each; the components of a link or of the tip share one where there would be more
    than `most`.
    """
    names = list(run.observations)
    if len(names) <= most:
        return [[name] for name in names]
    together: dict[Any, list[str]] = {}
    for name in names:
        channel = run.channels[name]
        together.setdefault((channel.kind, channel.index, channel.unit), []).append(name)
    return list(together.values())
