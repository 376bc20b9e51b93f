"""What the channels of a run are drawn over: time, or the channel that makes them a curve."""

import numpy as np

from ..runs import Channel, Run

# Of each kind, from the best; the first that a run has and that varies.
_CURVES = {
    "hysteresis": ("input", "command"),
    "joint": ("angle",),
    "muscle": ("contraction", "position", "pressure"),
}


def drawn_over(run: Run) -> str | None:
    """The input channel that measured ones of a run are drawn over; None: over time."""
    if run.definition.hysteresis.operator == "bouc_wen_oscillator":
        return None  # which moves in time
    names = (name for name in _CURVES.get(run.model, ()) if name in run.values)
    return next((name for name in names if np.ptp(run.values[name]) > 0), None)


def abscissa(run: Run) -> tuple[np.ndarray, str]:
    """What the channels of a run are drawn over, in the unit of the file, and its label."""
    name = drawn_over(run)
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
