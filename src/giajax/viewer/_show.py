"""What is shown: a scene with its recorded markers, and several of them on one clock."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..models import Scene


@dataclasses.dataclass(frozen=True)
class Show:
    """A scene, and what a camera saw of it.

    Attributes:
        name: what a legend says.
        scene: of a model.
        recorded: recorded points by the names of the scene's markers, m, shape (sample, 3).
        notes: what is not shown, and why.
    """

    name: str
    scene: Scene
    recorded: Mapping[str, Float[np.ndarray, "sample 3"]] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        wrong = [name for name, points in self.recorded.items() if len(points) != self.samples]
        if wrong:
            raise InputError(
                f"the recorded marker '{wrong[0]}' has {len(self.recorded[wrong[0]])} samples and "
                f"the scene {self.samples}: give as many"
            )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.scene.samples

    @property
    def clock(self) -> Float[np.ndarray, " sample"]:
        """Times of the samples, s; where they are not in time, ten of them are a second."""
        if self.scene.times is None:
            return np.arange(self.samples) / 10
        return self.scene.times

    def sample_at(self, time: float) -> int:
        """The last sample that is not after a time (s); the first one before all."""
        # Half a nanosecond: times that were added up are samples still.
        after = int(np.searchsorted(self.clock, time + 5e-10, side="right"))
        return max(after - 1, 0)

    def marker_error(self, sample: int) -> float | None:
        """Root mean square distance of recorded from shown markers at a sample, m."""
        off = [
            self.recorded[name][sample] - self.scene.markers[name][sample] for name in self.recorded
        ]
        known = [each for each in off if np.all(np.isfinite(each))]
        return float(np.sqrt(np.mean(np.sum(np.square(known), axis=1)))) if known else None


def span(shows: Sequence[Show]) -> tuple[float, float]:
    """First and last time of several shows, s."""
    return min(float(show.clock[0]) for show in shows), max(float(show.clock[-1]) for show in shows)


def frames(shows: Sequence[Show], rate: float, most: int) -> Float[np.ndarray, " frame"]:
    """Times at which to draw, s: every sample, but no more than a rate and a number.

    Arguments:
        shows: at least one.
        rate: most frames in a second.
        most: most frames.
    """
    first, last = span(shows)
    finest = min(float(np.min(np.diff(show.clock), initial=np.inf)) for show in shows)
    count = int(np.ceil((last - first) / max(finest, 1 / rate) - 1e-9)) + 1 if last > first else 1
    return np.linspace(first, last, min(count, most))
