"""Which of many runs are worth a look: those that are described worst."""

from collections.abc import Iterable

from ..fitting import FitResult, RunFit

MOST_RUNS = 6
"""How many are drawn: a picture takes a second, and nobody looks at twenty of them."""


def worth_drawing(result: FitResult) -> list[int]:
    """All runs, or of many those that are described worst, in their order."""
    if len(result.runs) <= MOST_RUNS:
        return list(range(len(result.runs)))
    worst = sorted(range(len(result.runs)), key=lambda index: -times_noise(result.runs[index]))
    return sorted(worst[:MOST_RUNS])


def times_noise(record: RunFit, names: Iterable[str] | None = None) -> float:
    """The largest RMSE over noise of some channels, or of all; infinite where one is not finite."""
    channels = [record.channels[name] for name in (record.channels if names is None else names)]
    return max(
        (
            float("inf") if c.rmse is None else c.rmse / c.noise if c.noise else 0.0
            for c in channels
        ),
        default=0.0,
    )
