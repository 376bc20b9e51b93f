"""What a worker does for a profile, one side of one quantity, and what becomes of two of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..execution import Outcome
from ..fitting import Optimum
from ._fitted import Fitted
from ._profile_ends import interval_end, remarks_on
from ._profile_path import walked
from ._profile_records import Ending, Profile, ProfilePoint
from ._profiled import Profiled, profiled_of

SIDES = (-1, 1)

# A parameter this near to its bound, in its own size, is at it.
_AT_BOUND = 1e-6


def one_side(fitted: Fitted, name: str, side: int, level: float) -> dict[str, Any]:
    """A task: one side of the profile of one quantity, as plain data."""
    optimum = fitted.optimum()
    profiled = profiled_of(fitted.result, optimum, name)
    found = walked(optimum, profiled, side, profiled.reach(level))
    points = [
        ProfilePoint(
            value=point.at,
            deviance=float(np.sign(point.root) * point.root**2),
            values=_shared(optimum, point.fit.values),
            at_bounds=_at_bounds(optimum, point.fit.values, name),
        )
        for point in found.points
    ]
    return {"points": points, "ended": found.ended, "reason": found.reason}


def combined(
    optimum: Optimum, profiled: Profiled, level: float, pair: tuple[Outcome, Outcome]
) -> Profile:
    """The profile of a quantity.

    Arguments:
        optimum: of the fit.
        profiled: the quantity.
        level: of the interval.
        pair: what came of its two sides, by `SIDES`.
    """
    centre = ProfilePoint(
        profiled.value,
        0.0,
        _shared(optimum, optimum.values),
        _at_bounds(optimum, optimum.values, profiled.name),
    )
    points, ended, reasons = [centre], [], []
    for outcome in pair:
        found: Mapping[str, Any] = outcome.value or {}
        points += [
            ProfilePoint(one["value"], one["deviance"], tuple(one["values"]), tuple(names))
            for one in found.get("points", ())
            for names in [one["at_bounds"]]
        ]
        missing = "stopped" if outcome.status == "stopped" else "failed"
        ended.append(found.get("ended", missing))
        reasons.append(found.get("reason", outcome.message))
    points = _best_at_each(points)
    reach = profiled.reach(level)
    ends = [
        _end(points, side, reach, how, bound)
        for side, how, bound in zip(SIDES, ended, (profiled.lower, profiled.upper), strict=True)
    ]
    interval, how = (ends[0], ends[1]), (ended[0], ended[1])
    return Profile(
        name=profiled.name,
        unit=profiled.unit,
        value=profiled.value,
        standard_error=profiled.error,
        linear=profiled.linear(level),
        reach=reach,
        lower=profiled.lower if np.isfinite(profiled.lower) else None,
        upper=profiled.upper if np.isfinite(profiled.upper) else None,
        interval=interval,
        ended=how,
        points=tuple(points),
        lowest=min(point.deviance for point in points),
        remarks=remarks_on(points, interval, how, (reasons[0], reasons[1]), profiled.value),
    )


def _best_at_each(points: Sequence[ProfilePoint]) -> list[ProfilePoint]:
    """The points by value, ascending; of those at the same one, the best."""
    best: dict[float, ProfilePoint] = {}
    for point in points:
        known = best.setdefault(point.value, point)
        if point.deviance < known.deviance:
            best[point.value] = point
    return [best[value] for value in sorted(best)]


def _end(
    points: Sequence[ProfilePoint], side: int, reach: float, ended: Ending, bound: float
) -> float | None:
    crossed = interval_end(points, side, reach)
    return bound if crossed is None and ended == "bound" else crossed


def _shared(optimum: Optimum, values: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, values[: optimum.state.problem.shared]))


def _at_bounds(optimum: Optimum, values: np.ndarray, name: str) -> tuple[str, ...]:
    """The parameters that are at a bound, apart from the one of this name."""
    lower, upper = optimum.bounds
    near = _AT_BOUND * np.asarray(optimum.state.sizes)
    there = (values - lower <= near) | (upper - values <= near)
    return tuple(optimum.labels[i] for i in np.flatnonzero(there) if optimum.labels[i] != name)
