"""One side of a profile: from the optimum outwards, each fit begun from the one before."""

import dataclasses
from typing import NamedTuple

import numpy as np

from ..fitting import Optimum
from ._constrained import Followed
from ._profile_records import Ending
from ._profiled import Profiled
from ._tangent import tangent

# The root of the deviance is to rise by this in a step, and may rise by so much.
_STEP, _LARGEST = 0.4, 1.0

# In standard errors: a rise within less is a wall, which need not be known any better.
_SHORTEST = 0.05

# A step is at most so many times the one before, and at least this part of it.
_GROWTH, _SHRINKING = 2.0, 0.25

_MOST_POINTS, _RETRIES = 40, 5

# So many intervals away, where three steps raised the root by less than this: it is flat.
_FAR, _RISE = 15.0, 0.05

# A fall of the root that is no rounding: the points before it are not the best.
_FALL = 0.02

# A parameter this near to its bound, in its own size, is at it.
_AT_BOUND = 1e-6


class PathPoint(NamedTuple):
    """A fit with the quantity held.

    Attributes:
        at: value of the quantity.
        root: of the deviance from the optimum, signed: negative where the cost is lower.
        fit: how it ended.
    """

    at: float
    root: float
    fit: Followed


class Side(NamedTuple):
    """A side of a profile: its points outwards, without that of the fit, and what ended it.

    Where a better fit with the value of the fit itself was found, that is the first of them.
    """

    points: list[PathPoint]
    ended: Ending
    reason: str


@dataclasses.dataclass(frozen=True)
class _Walk:
    """What all steps of a side have in common."""

    optimum: Optimum
    profiled: Profiled
    side: int

    def point(self, at: float, before: PathPoint) -> PathPoint:
        """The fit there, begun along the tangent of another one."""
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
        """The points, of which those before the last are fitted again from the one after each.

        A profile that jumps has followed a valley that was not the deepest.
        """
        better = list(points)
        for index in range(len(points) - 2, -1, -1):
            again = self.point(points[index].at, better[index + 1])
            if not again.fit.cost < points[index].fit.cost:
                break
            better[index] = again
        return better


def walked(optimum: Optimum, profiled: Profiled, side: int, reach: float) -> Side:
    """The profile on one side of the optimum, to a little beyond a deviance.

    Arguments:
        optimum: of the fit.
        profiled: the quantity.
        side: 1 upwards, -1 downwards.
        reach: root of the deviance at which the interval ends.

    Returns:
        The points and what ended them. The one before the last is next to the interval's end,
        where the side ended by the level.
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
        return side_of(points, "flat", "no channel responds to it")
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
        lowest = min(point.root for point in points)
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
            lowest = min(point.root for point in points)
        rise = points[-1].root - points[-2].root
        if _above(points[-1].root, lowest) >= reach:
            return side_of(_refined(walk, points, reach), "level")
        if _is_flat(points, profiled, reach):
            return side_of(points, "flat")
        growth = _GROWTH if rise <= 0 else np.clip(_STEP / rise, _SHRINKING, _GROWTH)
        step = abs(points[-1].at - points[-2].at) * float(growth)
    return side_of(points, "unfinished")


def _above(root: float, lowest: float) -> float:
    """Root of the deviance from the lowest point, which is the optimum or below it."""
    lowest = min(lowest, 0.0)
    return float(np.sqrt(max(np.sign(root) * root**2 + lowest**2, 0.0)))


def _is_flat(points: list[PathPoint], profiled: Profiled, reach: float) -> bool:
    """Whether the deviance does not rise any more, far from the optimum."""
    far = abs(points[-1].at - profiled.value) > _FAR * reach * profiled.size
    return far and len(points) > 3 and points[-1].root - points[-4].root < _RISE


def _refined(walk: _Walk, points: list[PathPoint], reach: float) -> list[PathPoint]:
    """With a point where the interval ends, as nearly as its neighbours tell."""
    inner, outer = points[-2:]
    lowest = min(point.root for point in points)
    low, high = _above(inner.root, lowest), _above(outer.root, lowest)
    part = (reach - low) / (high - low)
    at = inner.at + part * (outer.at - inner.at)
    if not (part > 1e-6 and 1 - part > 1e-6):
        return points
    between = walk.point(at, inner if part < 0.5 else outer)
    if not between.fit.converged:
        return points
    return [*points[:-1], between, outer]
