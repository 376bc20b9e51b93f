"""What the channels of a run are drawn over: time, or the channel that makes them a curve."""

import numpy as np

from ..runs import Channel, Run


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
