"""What is profiled: a free parameter or a derived quantity, and how a fit holds it."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from .._text import one_of
from ..fitting import FitResult, Optimum, student_reach
from ._constrained import Followed, Quantity, constrained

# Of the size of what has no standard error: as far as a first step goes.
_UNKNOWN = 0.1


@dataclasses.dataclass(frozen=True)
class Profiled:
    """A quantity of a fit, with what the fit says of it.

    Attributes:
        name: label of a free parameter, or name of a derived quantity.
        unit: SI unit.
        value: at the optimum.
        error: standard error; None if it has none.
        freedom: degrees of freedom of Student's t for its interval.
        factor: deviance of the cost over that which is meant: a parabola of the cost is one of
            `error` once it is divided by this. It is above 1 where the residuals exceed the noise,
            or the noise was estimated from them.
        lower, upper: bounds, infinite where there is none.
        size: of the first step.
        position: of the free parameter; None for a derived quantity.
        quantity: of the free parameters.
        fixed: whether nothing of the data responds to it.
    """

    name: str
    unit: str
    value: float
    error: float | None
    freedom: float
    factor: float
    lower: float
    upper: float
    size: float
    position: int | None
    quantity: Quantity
    fixed: bool = False

    def reach(self, level: float) -> float:
        """Root of the deviance at which an interval ends."""
        return student_reach(self.freedom, level)

    def linear(self, level: float) -> tuple[float, float] | None:
        """The interval of the standard error, within the bounds."""
        if self.error is None:
            return None
        width = self.reach(level) * self.error
        return max(self.value - width, self.lower), min(self.value + width, self.upper)

    def held(self, optimum: Optimum, value: float, start: np.ndarray) -> Followed:
        """The best fit with it held, from a start of all free parameters."""
        if self.position is None:
            return constrained(optimum, self.quantity, value, start)
        ended = optimum.refit(held={self.name: value}, start=start)
        known = ended.state.evaluated
        # What is held has a column, too: it says where the others go when it is moved.
        everything = dataclasses.replace(ended.state, active=optimum.state.active)
        return Followed(
            values=ended.values,
            cost=ended.cost if known else np.inf,
            jacobian=everything.natural_jacobian() if known else None,
            reason=ended.reason,
            converged=ended.converged,
        )


def quantity_names(result: FitResult, optimum: Optimum, asked: Sequence[str] | None) -> list[str]:
    """What is to be profiled, by the names that `profiled_of` takes.

    Arguments:
        result: of the fit.
        optimum: its optimum.
        asked: labels, paths (of an array, or of what has a value for each run, all of its values)
            or names of derived quantities; None for all free parameters of the model.

    Raises:
        InputError: there is no such quantity.
    """
    shared = optimum.labels[: optimum.state.problem.shared]
    names: list[str] = []
    for path in shared if asked is None else asked:
        found = [
            label
            for label in optimum.labels
            if path in (label, label.partition(" of ")[0], label.partition("[")[0])
        ]
        if path in result.derived:
            found = [path]
        if not found:
            known = one_of([*shared, *result.derived])
            raise InputError(
                f"'{path}' was not free in this fit, and does not follow from what was: use one of "
                f"{known}"
            )
        names += found
    return list(dict.fromkeys(names))


def profiled_of(result: FitResult, optimum: Optimum, name: str) -> Profiled:
    """A quantity by its name.

    Arguments:
        result: of the fit.
        optimum: its optimum.
        name: one of `quantity_names`.
    """
    statistics = optimum.statistics
    if name in result.derived:
        return _derived(result, optimum, name)
    index = optimum.position(name)
    gradient = np.eye(len(optimum.labels))[index]
    error = statistics.standard_errors.get(index)
    error = error if error is not None and np.isfinite(error) else None
    lower, upper = (float(bound[index]) for bound in optimum.bounds)
    path = name.partition(" of ")[0]
    unit = result.parameters[path].unit if path in result.parameters else "SI"
    factor = statistics.scale
    if error is not None:
        factor = (error / _spread(optimum, gradient)) ** 2
    size = float(optimum.state.sizes[index])
    return Profiled(
        name=name,
        unit=unit,
        value=float(optimum.values[index]),
        error=error,
        freedom=statistics.freedom.get(index, np.inf),
        factor=factor,
        lower=lower,
        upper=upper,
        size=_UNKNOWN * size if error is None else error,
        position=index,
        quantity=lambda values: (float(values[index]), gradient),
        fixed=index not in statistics.alive,
    )


def _derived(result: FitResult, optimum: Optimum, name: str) -> Profiled:
    statistics, estimate = optimum.statistics, result.derived[name]
    quantity = optimum.derived(name)
    value, gradient = quantity(optimum.values)
    error, factor = estimate.standard_error, statistics.scale
    if error is not None:
        factor = (error / _spread(optimum, gradient)) ** 2
    # As few degrees of freedom as any parameter that it follows from.
    known = [statistics.freedom.get(int(i), np.inf) for i in np.flatnonzero(gradient)]
    return Profiled(
        name=name,
        unit=estimate.unit,
        value=value,
        error=error,
        freedom=min(known, default=np.inf),
        factor=factor,
        lower=-np.inf if estimate.lower is None else estimate.lower,
        upper=np.inf if estimate.upper is None else estimate.upper,
        size=_UNKNOWN * (abs(value) or 1.0) if error is None else error,
        position=None,
        quantity=quantity,
        fixed=not np.any(gradient[statistics.alive]),
    )


def _spread(optimum: Optimum, gradient: np.ndarray) -> float:
    """Standard error of a quantity if the cost were all there is to know."""
    statistics = optimum.statistics
    slope = gradient[statistics.alive]
    return float(np.sqrt(slope @ statistics.bread @ slope))
