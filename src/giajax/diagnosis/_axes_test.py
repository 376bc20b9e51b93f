"""The test of the axes of recorded positions, as a row of the table."""

from collections.abc import Sequence

import numpy as np

from ..fitting import FitResult, Response, Suspect, resolved_ties, tied
from ..parameters import replace
from ..runs import Run
from ..study import begun_where_it_ended
from ._axes import IDENTITY, Axes, coordinates, distinct_axes, name_of, seen_as
from ._ended import models_of_runs
from ._projection import Projected
from ._weights import Weighing


def axes_row(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    weighing: Weighing,
    chi_square: float,
    rest: Projected,
) -> tuple[list[Suspect], int]:
    """The best of the other orders and signs of the axes, and how many were tried."""
    ways = distinct_axes(runs)
    if not ways:
        return [], 0
    points = [models_of_runs(result)]
    if result.history:
        first = replace(result.model, result.history[0].parameters)
        ties = resolved_ties(first, result.config.get("ties", {}))
        points.append([tied(first, ties)] * len(runs))
    begun = begun_where_it_ended(result, runs)
    best: tuple[float, Axes, bool] | None = None
    for number, models in enumerate(points):
        whole = [coordinates(model, run) for model, run in zip(models, begun, strict=True)]
        for way in ways:
            seen = [
                seen_as(way, run, predicted, response.channels)
                for run, predicted, response in zip(runs, whole, at, strict=True)
            ]
            other = weighing.chi_square(at, seen)
            if way != IDENTITY and (best is None or other < best[0]) and np.isfinite(other):
                best = other, way, number > 0
    if best is None:
        return [], len(ways)
    other, way, at_start = best
    drop = max(chi_square - other, 0.0)
    # Of two models without anything free, a likelihood ratio of 1/c has a probability below c.
    scale = max(1.0, other / max(rest.values - rest.parameters, 1))
    row = Suspect(
        path=name_of(way),
        kind="axes",
        unit="",
        value=None,
        estimate=None,
        estimate_error=None,
        chi_square_drop=drop,
        degrees_of_freedom=1,
        p_value=float(min(1.0, np.exp(-drop / scale / 2))),
        testable=True,
        note="with the values that the fit began with" if at_start and drop else "",
    )
    return [row], len(ways)
