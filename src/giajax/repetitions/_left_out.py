"""The task of an exact influence: fits without some of the data, one after the other."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..fitting import Optimum, Recorded
from ..study import Fitted
from ._parts import Part


def left_out(fitted: Fitted, parts: Sequence[Part]) -> list[dict[str, Any]]:
    """Fit again without each of some parts.

    Arguments:
        fitted: the fit.
        parts: what is left out, one at a time.

    Returns:
        Of each: `converged`, `reason`, and by label `values` and `errors` of what the rest
        determines.
    """
    optimum = fitted.optimum()
    rows = []
    for part in parts:
        again = optimum.refit(recorded=without(optimum, part))
        row: dict[str, Any] = {"converged": again.converged, "reason": again.reason}
        if again.state.evaluated:
            known = again.statistics
            places = [i for i in known.determined if np.isfinite(known.standard_errors[i])]
            row["values"] = {known.labels[i]: float(known.values[i]) for i in places}
            row["errors"] = {known.labels[i]: known.standard_errors[i] for i in places}
        rows.append(row)
    return rows


def without(optimum: Optimum, part: Part) -> Recorded:
    """What the runs recorded, without a part of it."""
    recorded = []
    for index, run in enumerate(optimum.state.setup.runs):
        values = dict(run.observations)
        for name, row in values.items():
            gone = part.of(index, name, len(row))
            if gone is not None:
                values[name] = np.where(gone, np.nan, row)
        recorded.append(values)
    return recorded
