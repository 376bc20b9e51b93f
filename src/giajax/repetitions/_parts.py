"""Parts of the data of a fit that may be left out: runs, channels, markers and spans of time."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np

from ..runs import Channel, Run

Kind = Literal["run", "marker", "channel", "span"]


@dataclasses.dataclass(frozen=True)
class Part:
    """Cells that are left out together.

    Attributes:
        kind: "run"; "marker": all coordinates of a point in all runs; "channel", in all runs; or
            "span": a stretch of one run.
        name: of it.
        runs: positions of the runs that have a part of it.
        channels: names of its channels; None for all.
        rows: its first sample and the one after its last; None for all.
    """

    kind: Kind
    name: str
    runs: tuple[int, ...]
    channels: tuple[str, ...] | None = None
    rows: tuple[int, int] | None = None

    def of(self, index: int, name: str, samples: int) -> np.ndarray | None:
        """Which samples of a channel of a run are left out; None where none is."""
        if index not in self.runs or (self.channels is not None and name not in self.channels):
            return None
        first, last = self.rows or (0, samples)
        places = np.arange(samples)
        return (places >= first) & (places < last)


def parts_of(runs: Sequence[Run], spans: int) -> list[Part]:
    """Everything that may be left out of some runs, apart from all of them.

    A channel that is a marker by itself is listed as the marker.

    Arguments:
        runs: of a fit.
        spans: into how many stretches of equal time, or number of samples, each run is cut.
    """
    everywhere = tuple(range(len(runs)))
    parts = [Part("run", run.name, (i,)) for i, run in enumerate(runs) if len(runs) > 1]
    names = list(dict.fromkeys(name for run in runs for name in run.observations))
    markers: dict[str, list[str]] = {}
    for name in names:
        if Channel.named(name).component is not None:
            markers.setdefault(name[:-2], []).append(name)
    if len(names) > 1:
        several = [(body, tuple(of)) for body, of in markers.items() if len(of) < len(names)]
        parts += [Part("marker", body, everywhere, of) for body, of in several]
        alone = {of[0] for _, of in several if len(of) == 1}
        parts += [Part("channel", n, everywhere, (n,)) for n in names if n not in alone]
    return parts + [span for i, run in enumerate(runs) for span in _spans(i, run, spans)]


def _spans(index: int, run: Run, count: int) -> list[Part]:
    samples = len(next(iter(run.observations.values())))
    over = np.arange(samples, dtype=float) if run.times is None else run.times
    edges = np.linspace(over[0], over[-1], count + 1)
    places = [0, *np.searchsorted(over, edges[1:-1]).tolist(), samples]
    unit = "" if run.times is None else " s"
    return [
        Part(
            "span",
            f"{run.name}, {edges[i]:.4g} to {edges[i + 1]:.4g}{unit}",
            (index,),
            rows=(places[i], places[i + 1]),
        )
        for i in range(count if count > 1 else 0)
        if places[i] < places[i + 1]
    ]
