"""Maps between the free coordinate of a fit and parameters within their bounds."""

import difflib
from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from ..recordings import Run
from ..runtime.arrays import Array, Float, on_device
from ..runtime.text import InputError

# Fraction of the distance between an initial value and its bound within which the coordinate is
# linear. It is so large that a parameter that was driven to its bound by mistake can return. With
# the whole distance, a first step may lead to the bound, and models with kinked operators then miss
# their optimum.
_NEAR = 0.5

# An initial value is at its bound if it is nearer than this fraction of the size of the parameter.
_AT_BOUND = 1e-6


class Bijector(eqx.Module):
    """Smooth increasing map of an interval of coordinates onto the interval between two bounds.

    Far from a bound, the coordinate is a logarithm of the distance from it. A step is then a
    relative change, and a poor model of the cost cannot send a parameter far away. Near the bound,
    the coordinate is linear in the parameter and ends there. A logarithm would never reach an
    optimum at the bound, and would bend every valley on the way. A parameter without bounds is its
    own coordinate.

    Arguments:
        lower, upper: bounds, infinite if there is none, shape (parameter,).
        above_lower, below_upper: distances from a bound up to which the coordinate is linear, shape
            (parameter,). They are not used if there is no bound.
        last: coordinates of the upper bounds, infinite if there is none, shape (parameter,).
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    above_lower: Float[Array, " parameter"]
    below_upper: Float[Array, " parameter"]
    last: Float[Array, " parameter"]

    @classmethod
    def of(
        cls,
        lower: Sequence[float],
        upper: Sequence[float],
        start: Sequence[float],
        size: npt.ArrayLike = 1.0,
    ) -> Self:
        """Return the map for a fit with given bounds and initial values.

        Arguments:
            lower, upper: bounds, infinite if there is none.
            start: initial values.
            size: typical sizes of the parameters, which set the linear range if an initial value is
                at a bound.
        """
        low, high, begun = (np.asarray(each, dtype=float) for each in (lower, upper, start))
        width = np.where(np.isfinite(low) & np.isfinite(high), high - low, np.inf)
        usual = np.minimum(size, width)

        def near(distance: np.ndarray) -> np.ndarray:
            known = np.isfinite(distance) & (distance > _AT_BOUND * usual)
            return np.asarray(_NEAR * np.where(known, distance, usual))

        return cls._linear_near(low, high, near(begun - low), near(high - begun))

    @classmethod
    def _linear_near(
        cls, low: np.ndarray, high: np.ndarray, above: np.ndarray, below: np.ndarray
    ) -> Self:
        """Return the map that is linear within `above` and `below` the lower and upper bounds."""
        width = np.where(np.isfinite(low) & np.isfinite(high), high - low, np.inf)
        with np.errstate(invalid="ignore"):
            both = np.log1p(width / above) + np.log1p(width / below)
        last = np.where(np.isfinite(high), np.where(np.isfinite(low), both, 0), np.inf)
        numbers = [on_device(each, jnp.result_type(float)) for each in (above, below, last)]
        return cls(tuple(low.tolist()), tuple(high.tolist()), *numbers)

    def distances(self) -> np.ndarray:
        """Return the distances of the initial values of this map from the lower bounds.

        Returns:
            Distances, shape (parameter,).
        """
        return np.asarray(self.above_lower, dtype=float) / _NEAR

    def linear_within(self, distances: npt.ArrayLike) -> Self:
        """Return the map for initial values at these distances from their lower bounds."""
        low, high = np.asarray(self.lower), np.asarray(self.upper)
        above = _NEAR * np.asarray(distances, dtype=float)
        return self._linear_near(low, high, above, np.asarray(self.below_upper, dtype=float))

    def at(self, columns: Sequence[int] | np.ndarray) -> "Bijector":
        """Return the map of some of the parameters, by their positions."""
        places = np.asarray(columns, dtype=int)
        return Bijector(
            tuple(self.lower[i] for i in places),
            tuple(self.upper[i] for i in places),
            self.above_lower[places],
            self.below_upper[places],
            self.last[places],
        )

    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        below, above = np.isfinite(lower), np.isfinite(upper)
        # Finite substitutes keep NaN out of the branches that are not taken.
        return below, above, np.where(below, lower, 0.0), np.where(above, upper, 1.0)

    def _near(self, maths: Any = np) -> tuple[Any, Any, Any]:
        """Return the linear ranges, and the influence near / (width + near) of the upper bound."""
        below, above, lower, upper = self._kinds()
        low, high = maths.asarray(self.above_lower), maths.asarray(self.below_upper)
        return low, high, maths.where(below & above, low / (upper - lower + high), 0)

    def forward(self, coordinate: Float[Any, " parameter"]) -> Float[Any, " parameter"]:
        """Return the parameters at coordinates within their ends, with NumPy for a NumPy array."""
        maths = np if isinstance(coordinate, np.ndarray) else jnp
        below, above, lower, upper = self._kinds()
        low, high, bend = self._near(maths)
        # Without such a bound, exp(t) could overflow in the branch that is not taken.
        t = maths.where(below, coordinate, 0)
        up = lower + low * maths.expm1(t) / (1 + bend * maths.exp(t))
        # Rounding must not exceed the bound. The slope there stays that of the map.
        beyond = maths.where(below & above, maths.maximum(up - upper, 0), 0)
        up = up - (beyond if maths is np else jax.lax.stop_gradient(beyond))
        t = maths.where(above & ~below, coordinate, 0)
        down = upper - high * maths.expm1(-t)
        return maths.where(below, up, maths.where(above, down, coordinate))

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Return the coordinates of parameters within the bounds."""
        below, above, lower, upper = self._kinds()
        value = np.asarray(value, dtype=float)
        low, high, bend = self._near()
        with np.errstate(all="ignore"):
            part = (value - lower) / low
            up = np.log1p(part) - np.log1p(-bend * part)
            down = -np.log1p((upper - value) / high)
        return np.where(below, up, np.where(above, down, value))

    def slope(self, coordinate: np.ndarray) -> np.ndarray:
        """Return d(parameter)/d(coordinate), shape (parameter,)."""
        below, above, _, _ = self._kinds()
        coordinate = np.asarray(coordinate, dtype=float)
        low, high, bend = self._near()
        with np.errstate(all="ignore"):
            grown = np.exp(coordinate)
            up = low * grown * (1 + bend) / (1 + bend * grown) ** 2
            down = high / grown
        return np.where(below, up, np.where(above, down, 1.0))

    def ends(self) -> tuple[Float[Any, " parameter"], Float[Any, " parameter"]]:
        """Return the coordinates of the lower and the upper bounds, infinite if there is none."""
        first = np.where(np.isfinite(self.lower), 0.0, -np.inf)
        return np.asarray(first, self.last.dtype), self.last


# A sampler moves along the real line, which is mapped smoothly to a parameter within its bounds.

Row = Float[Array, " parameter"]

_INSIDE = 0.5  # a value nearer to a bound than this number of widths is moved to this distance

# Largest width, as a fraction of the range of a parameter, which keeps the two bounds apart.
_MOST_OF_RANGE = 0.25


class Unbounded(eqx.Module):
    """Increasing map of all real numbers onto the open interval between two bounds.

    A fit may end on a bound, so its map (`Bijector`) includes the bounds. A sampler that reached
    the end of such a map would have to turn back. This map is linear if a bound is many widths
    away, and becomes exponential within one width of it: lower + width softplus(u), and with an
    additional upper bound lower + width (softplus(u) - softplus(u - range / width)).

    Attributes:
        lower, upper: bounds, infinite if there is none, shape (parameter,).
        width: distance from a bound at which the map begins to bend: the standard error, shape
            (parameter,).
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    width: Row

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, width: np.ndarray) -> Self:
        """Return the map for bounds and widths, limited by the ranges of the parameters."""
        limited = np.isfinite(lower) & np.isfinite(upper)
        ranges = np.where(limited, upper - lower, np.inf)
        narrow = np.minimum(width, _MOST_OF_RANGE * ranges)
        return cls(
            tuple(lower.tolist()), tuple(upper.tolist()), on_device(narrow, jnp.result_type(float))
        )

    def forward(self, u: Row) -> tuple[Row, Row, Row, Row]:
        """Return the parameters, the logarithms of their slopes, and the derivatives of these.

        Returns:
            Parameters, logarithms of the slopes d(parameter)/du, and the first and second
            derivatives of these logarithms with respect to u.
        """
        below, above, lower, upper, end = self._kinds()
        plus, minus = jax.nn.softplus, jax.nn.log_sigmoid
        up = lower + self.width * (plus(u) - jnp.where(above, plus(u - end), 0))
        down = upper - self.width * (plus(end - u) - jnp.where(below, plus(-u), 0))
        # The form that belongs to the nearer bound avoids cancellation.
        from_below = below & (~above | (u < end / 2))
        value = jnp.where(from_below, up, jnp.where(above, down, self.width * u))
        # Rounding must not exceed a bound.
        value = jnp.clip(value, np.asarray(self.lower), np.asarray(self.upper))
        slope = jnp.log(self.width) + jnp.where(below, minus(u), 0)
        slope = slope + jnp.where(above, minus(end - u), 0)
        slope = slope + jnp.where(below & above, jnp.log1p(-jnp.exp(-end)), 0)
        near_lower, near_upper = jax.nn.sigmoid(-u), jax.nn.sigmoid(u - end)
        first = jnp.where(below, near_lower, 0) - jnp.where(above, near_upper, 0)
        second = -jnp.where(below, near_lower * (1 - near_lower), 0)
        second = second - jnp.where(above, near_upper * (1 - near_upper), 0)
        return value, slope, first, second

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Return the coordinates of parameters, with NumPy. Values at a bound are moved inside."""
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        width = np.asarray(self.width)
        value = np.clip(value, lower + _INSIDE * width, upper - _INSIDE * width)
        below, above = np.isfinite(lower), np.isfinite(upper)
        with np.errstate(all="ignore"):
            up, down, end = (
                (value - lower) / width,
                (upper - value) / width,
                (upper - lower) / width,
            )
            both = up + np.log(-np.expm1(-up)) - np.log(-np.expm1(up - end))
            up, down = (each + np.log(-np.expm1(-each)) for each in (up, down))
        return np.where(
            below & above, both, np.where(below, up, np.where(above, -down, value / width))
        )

    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Row]:
        """Return which bounds exist, finite substitutes for the missing ones, and the upper end."""
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        below, above = np.isfinite(lower), np.isfinite(upper)
        lower, upper = np.where(below, lower, 0.0), np.where(above, upper, 0.0)
        end = jnp.where(below & above, (upper - lower) / self.width, 0)
        return below, above, lower, upper, end


# Positions of the values of the model's parameters in the free coordinate. A parameter has one
# value for all runs, or one for each group of runs.

Groups = Mapping[str, Sequence[Sequence[int]]]
"""The groups of runs with separate values, by parameter path. Runs are given by position."""


class Named(Protocol):
    """A run, or the entry of a run in a result."""

    @property
    def name(self) -> str:
        """Name of the run."""

    @property
    def recording(self) -> str:
        """Name of the recording to which the run belongs as a whole or as a window."""


class Layout(NamedTuple):
    """Positions in the free coordinate, which begins with the parameters of the model.

    Attributes:
        places: positions of the values of each parameter: one, or one for each group of runs.
        of_runs: positions of the values of all parameters, for each run.
    """

    places: tuple[tuple[int, ...], ...]
    of_runs: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, paths: Sequence[str], groups: Groups, runs: int) -> "Layout":
        """Return the layout of the parameters of a number of runs.

        A parameter without groups has one value for all runs.
        """
        places, first = [], 0
        of_runs = np.zeros((runs, len(paths)), dtype=int)
        for column, path in enumerate(paths):
            sharing = groups.get(path, [range(runs)])
            places.append(tuple(range(first, first + len(sharing))))
            for place, members in zip(places[-1], sharing, strict=True):
                of_runs[list(members), column] = place
            first += len(sharing)
        return cls(tuple(places), tuple(map(tuple, of_runs.tolist())))

    @property
    def size(self) -> int:
        """Number of values."""
        return sum(map(len, self.places))


def names_of(runs: Sequence[Run]) -> str:
    """Return the names of runs that share a value. Windows of one recording are named once."""
    if len(runs) == 1:
        return f"'{runs[0].name}'"
    return ", ".join(dict.fromkeys(f"'{run.recording}'" for run in runs))


def sharing(
    runs: Sequence[Run], per_run: Sequence[str], groups: Mapping[str, Sequence[Sequence[str]]]
) -> dict[str, list[list[str]]]:
    """Return the names of the runs that share a value of a parameter, by path.

    A value is shared by all windows of one recording, or by the runs of a group.

    Raises:
        InputError: a path is in both arguments, or two recordings have the same name.
    """
    recordings: dict[str, object] = {}
    for run in runs if per_run or groups else ():
        name, recording = run.recording, run.path or id(run)
        if recordings.setdefault(name, recording) != recording:
            raise InputError(
                f"two runs are called '{name}', so their results would be ambiguous: "
                "rename one of them"
            )
    alone = [[name] for name in dict.fromkeys(run.recording for run in runs)]
    for path in sorted(set(per_run) & set(groups)):
        raise InputError(
            f"'{path}' is estimated both per run and per group of runs: choose one of them"
        )
    each = {path: [list(names) for names in sharing] for path, sharing in groups.items()}
    return {**dict.fromkeys(per_run, alone), **each}


def members(
    path: str, runs: Sequence[Named], groups: Sequence[Collection[str]]
) -> tuple[tuple[int, ...], ...]:
    """Return the positions of the runs in each group, given by names of runs or recordings.

    Raises:
        InputError: a name that does not belong to a run, or a run that is not in exactly one group.
    """
    known = {name for run in runs for name in (run.name, run.recording)}
    for name in (name for names in groups for name in names):
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            remedy = f"did you mean '{near[0]}'?" if near else "use the file names of the runs"
            raise InputError(
                f"the groups of '{path}' contain '{name}', which is not a run: {remedy}"
            )
    positions = tuple(
        tuple(i for i, run in enumerate(runs) if {run.name, run.recording} & set(names))
        for names in groups
    )
    for index, run in enumerate(runs):
        count = sum(index in group for group in positions)
        if count != 1:
            where = "no group" if count == 0 else "several groups"
            raise InputError(f"run '{run.name}' is in {where} of '{path}': assign it to one group")
    return tuple(group for group in positions if group)
