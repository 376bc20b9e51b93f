"""Profile-likelihood intervals of parameters and derived quantities of a fit.

The interval of a standard error assumes that the residuals are linear in the parameters. A profile
does not: it holds a quantity at a value, fits all other parameters, and moves on until the cost is
too large (Venzon and Moolgavkar 1988; Bates and Watts, "Nonlinear Regression Analysis", 1988,
section 6.1).
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Unpack

import numpy as np

from ..fitting import FitResult, Optimum
from ..recordings import Run
from ..runtime.execution import Execution
from ..runtime.records import finite_or_none
from ..runtime.tasks import Outcome
from ..runtime.text import InputError, keywords_listed
from ._profile_records import Ending, Profile, ProfilePoint, Profiles, interval_end, remarks_on
from ._profiled import Followed, Profiled, profiled_of, quantity_names, tangent
from ._refit import Fitted, fit_key

# Desired and maximum increase of the square root of the deviance per step.
_STEP, _LARGEST = 0.4, 1.0

# Step, in standard errors, below which a jump of the deviance is treated as a wall and not resolved
# further.
_SHORTEST = 0.05

# Maximum and minimum ratio of a step to the previous step.
_GROWTH, _SHRINKING = 2.0, 0.25

_MOST_POINTS, _RETRIES = 40, 5

# The profile is flat if, at this many interval widths from the estimate, three steps raised the
# square root by less than this.
_FAR, _RISE = 15.0, 0.05

# A decrease of the square root by more than this is not rounding: the points before it are not the
# best ones.
_FALL = 0.02
# A parameter is at its bound within this fraction of its magnitude.
_AT_BOUND = 1e-6


class PathPoint(NamedTuple):
    """A fit with the quantity held.

    `root` is the signed square root of the deviance: negative if the cost is lower than in the fit.
    """

    at: float
    root: float
    fit: Followed


class Side(NamedTuple):
    """One side of a profile: its points outwards, and why it ended.

    The point at the estimate is included only if a better fit with this value was found.
    """

    points: list[PathPoint]
    ended: Ending
    reason: str


@dataclasses.dataclass(frozen=True)
class _Walk:
    """Data shared by all steps of a side."""

    optimum: Optimum
    profiled: Profiled
    side: int

    def point(self, at: float, before: PathPoint) -> PathPoint:
        """Fit with the quantity held at `at`, starting along the tangent of another point."""
        start = before.fit.values
        if before.fit.jacobian is not None:
            gradient = self.profiled.quantity(start)[1]
            side = 1 if at > before.at else -1
            along = tangent(before.fit.jacobian, gradient, start, self.optimum.bounds, side)
            moved = np.clip(start + (at - before.at) * along, *self.optimum.bounds)
            start = moved if np.all(np.isfinite(moved)) else start
        fit = self.profiled.held(self.optimum, at, start)
        deviance = 2 * (fit.cost - self.optimum.cost) / self.profiled.factor
        root = np.inf if not np.isfinite(deviance) else np.sign(deviance) * np.sqrt(abs(deviance))
        return PathPoint(at, float(root), fit)

    def improved(self, points: list[PathPoint]) -> list[PathPoint]:
        """Fit the points before the last one again, each from the point after it.

        A profile that jumps has followed an optimum that was not the best.
        """
        better = list(points)
        for index in range(len(points) - 2, -1, -1):
            again = self.point(points[index].at, better[index + 1])
            if not again.fit.cost < points[index].fit.cost:
                break
            better[index] = again
        return better


def walked(optimum: Optimum, profiled: Profiled, side: int, reach: float) -> Side:
    """Return the profile above (side 1) or below (-1) the optimum, to just beyond `reach`.

    If the side ended by the level, its last but one point is next to the end of the interval.
    """
    walk = _Walk(optimum, profiled, side)
    here = optimum.at(optimum.values)
    begun = Followed(optimum.values, optimum.cost, here.jacobian, "optimum", True)
    first = PathPoint(profiled.value, 0.0, begun)
    points = [first]

    def side_of(points: list[PathPoint], ended: Ending, reason: str = "") -> Side:
        return Side(points[1:] if points[0] is first else points, ended, reason)

    bound = profiled.upper if side > 0 else profiled.lower
    if profiled.fixed:
        return side_of(points, "flat", "no channel responds to this quantity")
    step, retries = _STEP * profiled.size, 0
    near = _AT_BOUND * max(profiled.size, abs(profiled.value))
    while len(points) <= _MOST_POINTS:
        last = points[-1]
        if side * (bound - last.at) <= near:
            return side_of(points, "bound")
        at = last.at + side * step
        if side * (bound - at) <= near:
            at = bound
        new = walk.point(at, last)
        jumped = np.isfinite(new.root) and new.root - last.root > _LARGEST
        jumped = jumped and abs(at - last.at) > _SHORTEST * profiled.size
        if (not new.fit.converged or jumped) and retries < _RETRIES:
            retries += 1
            rise = new.root - last.root if jumped else np.inf
            step = abs(at - last.at) * max(_SHRINKING, min(0.5, _STEP / rise))
            continue
        if not new.fit.converged:
            return side_of(points, "failed", new.fit.reason)
        retries = 0
        points.append(new)
        if new.root < last.root - _FALL:
            points = walk.improved(points)
        rise = points[-1].root - points[-2].root
        if _above(points[-1].root, points) >= reach:
            return side_of(_refined(walk, points, reach), "level")
        far = abs(points[-1].at - profiled.value) > _FAR * reach * profiled.size
        if far and len(points) > 3 and points[-1].root - points[-4].root < _RISE:
            return side_of(points, "flat")
        growth = _GROWTH if rise <= 0 else np.clip(_STEP / rise, _SHRINKING, _GROWTH)
        step = abs(points[-1].at - points[-2].at) * float(growth)
    return side_of(points, "unfinished")


def _above(root: float, points: list[PathPoint]) -> float:
    """Return the square root of the deviance above the lowest of some points, or the optimum."""
    lowest = min(0.0, *(point.root for point in points))
    return float(np.sqrt(max(np.sign(root) * root**2 + lowest**2, 0.0)))


def _refined(walk: _Walk, points: list[PathPoint], reach: float) -> list[PathPoint]:
    """Add a point near the end of the interval, interpolated between its neighbours."""
    inner, outer = points[-2:]
    low, high = _above(inner.root, points), _above(outer.root, points)
    part = (reach - low) / (high - low)
    at = inner.at + part * (outer.at - inner.at)
    if not (part > 1e-6 and 1 - part > 1e-6):
        return points
    between = walk.point(at, inner if part < 0.5 else outer)
    if not between.fit.converged:
        return points
    return [*points[:-1], between, outer]


SIDES = (-1, 1)


def one_side(fitted: Fitted, name: str, side: int, level: float) -> dict[str, Any]:
    """Task: compute one side of the profile of one quantity, as plain data."""
    optimum = fitted.optimum()
    profiled = profiled_of(fitted.result, optimum, name)
    found = walked(optimum, profiled, side, profiled.reach(level))
    points = [
        _point(optimum, one.at, float(np.sign(one.root) * one.root**2), one.fit.values, name)
        for one in found.points
    ]
    return {"points": points, "ended": found.ended, "reason": found.reason}


def combined(
    optimum: Optimum, profiled: Profiled, level: float, pair: tuple[Outcome, Outcome]
) -> Profile:
    """Combine the outcomes of the two sides, in the order of `SIDES`, to a profile."""
    points = [_point(optimum, profiled.value, 0.0, optimum.values, profiled.name)]
    ended, reasons = [], []
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
    ends = []
    for side, one, bound in zip(SIDES, ended, (profiled.lower, profiled.upper), strict=True):
        crossed = interval_end(points, side, reach)
        ends.append(bound if crossed is None and one == "bound" else crossed)
    interval, how = (ends[0], ends[1]), (ended[0], ended[1])
    return Profile(
        name=profiled.name,
        unit=profiled.unit,
        value=profiled.value,
        standard_error=profiled.error,
        linear=profiled.linear(level),
        reach=reach,
        lower=finite_or_none(profiled.lower),
        upper=finite_or_none(profiled.upper),
        interval=interval,
        ended=how,
        points=tuple(points),
        lowest=min(point.deviance for point in points),
        remarks=remarks_on(points, interval, how, (reasons[0], reasons[1]), profiled.value),
    )


def _best_at_each(points: Sequence[ProfilePoint]) -> list[ProfilePoint]:
    """Return the points in ascending order of the value; for equal values only the best one."""
    best: dict[float, ProfilePoint] = {}
    for point in points:
        known = best.setdefault(point.value, point)
        if point.deviance < known.deviance:
            best[point.value] = point
    return [best[value] for value in sorted(best)]


def _point(
    optimum: Optimum, at: float, deviance: float, values: np.ndarray, name: str
) -> ProfilePoint:
    """Return a point with the names of the other parameters that are at a bound."""
    lower, upper = optimum.bounds
    near = _AT_BOUND * np.asarray(optimum.state.sizes)
    there = np.flatnonzero((values - lower <= near) | (upper - values <= near))
    names = tuple(optimum.labels[i] for i in there if optimum.labels[i] != name)
    shared = tuple(map(float, values[: optimum.state.problem.shared]))
    return ProfilePoint(at, deviance, shared, names)


LEVEL = 0.95


@keywords_listed()
def profile(
    result: FitResult,
    runs: Run | Sequence[Run],
    paths: Sequence[str] | None = None,
    *,
    level: float = LEVEL,
    known: Profiles | None = None,
    **how: Unpack[Execution],
) -> Profiles:
    """Compute profile-likelihood intervals of parameters and derived quantities of a fit.

    Each quantity is held at values increasingly far from its estimate, on both sides, while all
    other parameters are fitted. A side ends when the fit is worse than `level` allows, when a bound
    is reached, or when the data do not limit the quantity. For a linear problem the interval equals
    the interval of the standard error.

    Arguments:
        result, runs: result of a fit that converged and the fitted runs, in the same order.
        paths: paths of free parameters (also those of single runs, such as `initial.angle`), or
            names of `result.derived`; defaults to all free parameters of the model.
        level: confidence level of the intervals.
        known: existing profiles of this fit and level, which are not computed again. Requested ones
            are returned together with the new ones.
        how: execution of the sides, each of which is a task, as for
            `giajax.runtime.execution.Execution`; after Ctrl-C, sides that were not completed are
            "stopped".

    Raises:
        InputError: a path was not free; the level is invalid; the fit has not converged; or the
            runs do not match the result.

    Example:
        >>> profiles = giajax.profile(result, run, ["air.drag_coefficient"])  # doctest: +SKIP
        >>> profiles["air.drag_coefficient"].interval  # doctest: +SKIP
    """
    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give a value between 0 and 1, such as 0.95")
    fitted = Fitted.of(result, runs, converged=True)
    if known is not None and not (known.is_of(result) and known.level == level):
        raise InputError("the known profiles belong to another fit or level: omit them")
    optimum = fitted.optimum()
    asked = quantity_names(result, optimum, paths)
    there = {} if known is None else known.profiles
    names = [name for name in asked if name not in there]
    sides = [{"name": name, "side": side, "level": level} for name in names for side in SIDES]
    outcomes = fitted.study(one_side, sides, **how)
    profiles = {}
    for index, name in enumerate(names):
        profiled = profiled_of(result, optimum, name)
        pair = outcomes[2 * index], outcomes[2 * index + 1]
        profiles[name] = combined(optimum, profiled, level, pair)
    return Profiles(
        fit=fit_key(result),
        level=level,
        labels=optimum.labels[: optimum.state.problem.shared],
        profiles={name: there[name] if name in there else profiles[name] for name in asked},
    )
