"""Estimates of the parameters: value, standard error, and what a reader must know of them."""

from typing import Any

import numpy as np
from scipy.special import stdtrit

from ..models import AbstractModel, parameter_values
from ..parameters import Parameter, declared
from ._identifiability import largest_correlations
from ._records import Estimate, finite_or_none
from ._run_records import OwnEstimate
from ._state import FitState
from ._statistics import Statistics

# Parameters that are more correlated than this are worth a remark.
_NEARLY_THE_SAME = 0.98

# A prior that says more than this of a parameter is worth a remark.
_MOSTLY = 0.5
_LEVEL = 0.95

# Degrees of freedom from which Student's t is a normal distribution.
_NORMAL = 1e9


def estimates(state: FitState, statistics: Statistics, model: AbstractModel) -> dict[str, Estimate]:
    """Estimates by path of the parameters: the free ones, then those that the fitted model held.

    Arguments:
        state: the last one.
        statistics: of the fit.
        model: the fitted one.
    """
    free = {
        parameter.path: _free(state, statistics, parameter, places)
        for parameter, places in zip(state.setup.parameters, state.problem.positions, strict=True)
    }
    return {**free, **_held(model, tuple(free))}


def _free(
    state: FitState, statistics: Statistics, parameter: Parameter, places: tuple[int, ...]
) -> Estimate:
    """The estimate of a parameter; of one with a value for each group of runs, their mean."""
    index, declaration = places[0], parameter.declaration
    common: dict[str, Any] = {
        "unit": declaration.unit,
        "lower": finite_or_none(declaration.lower),
        "upper": finite_or_none(declaration.upper),
        "free": True,
    }
    if len(places) > 1:
        runs = "run" if len(places) == len(state.setup.runs) else "group of runs"
        return Estimate(
            value=float(np.mean(statistics.values[list(places)])),
            standard_error=_error_of_mean(statistics, places),
            remark=f"mean of {len(places)} values, one for each {runs}; result.json has them",
            **common,
        )
    return Estimate(
        value=float(statistics.values[index]),
        standard_error=finite_or_none(statistics.standard_errors.get(index)),
        remark=_remark(state, statistics, index),
        interval=interval(statistics, index, parameter),
        freedom=finite_or_none(statistics.freedom.get(index)),
        sandwich_error=finite_or_none(statistics.sandwich.get(index)),
        prior_share=finite_or_none(statistics.prior_shares.get(index)),
        sources=statistics.sources.get(index, {}),
        **common,
    )


def _error_of_mean(statistics: Statistics, places: tuple[int, ...]) -> float | None:
    if not set(places) <= set(statistics.determined):
        return None
    weights = np.isin(statistics.alive, places) / len(places)
    return finite_or_none(float(np.sqrt(weights @ statistics.covariance @ weights)))


def student_reach(freedom: float, level: float = _LEVEL) -> float:
    """Half of an interval by Student's t of some degrees of freedom, in standard errors."""
    return float(stdtrit(min(freedom, _NORMAL), (1 + level) / 2))


def interval(
    statistics: Statistics, index: int, parameter: Parameter
) -> tuple[float, float] | None:
    """The interval that holds a parameter by 95 %; None without a standard error.

    By Student's t with the degrees of freedom that the estimated noise leaves, and within the
    bounds: an interval that a bound cuts is one-sided.

    Arguments:
        statistics: of the fit.
        index: position of the parameter.
        parameter: its declaration.
    """
    error = finite_or_none(statistics.standard_errors.get(index))
    if error is None:
        return None
    reach = student_reach(statistics.freedom[index]) * error
    value = float(statistics.values[index])
    declaration = parameter.declaration
    return max(value - reach, declaration.lower), min(value + reach, declaration.upper)


def own_estimates(state: FitState, statistics: Statistics) -> list[dict[str, OwnEstimate]]:
    """What was fitted of each run alone or of its group of runs, by path.

    Arguments:
        state: the last one.
        statistics: of the fit.

    Returns:
        An estimate by path for each run, in their order.
    """
    problem = state.problem
    varied = [index for index, places in enumerate(problem.positions) if len(places) > 1]
    estimates: list[dict[str, OwnEstimate]] = [{} for _ in state.setup.runs]
    for group in problem.groups:
        names = [*(problem.paths[index] for index in varied), *group.own_labels()]
        for member, columns in zip(group.members, group.columns(), strict=True):
            own = [*columns[varied], *columns[len(problem.paths) :]]
            for name, column in zip(names, map(int, own), strict=True):
                error = finite_or_none(statistics.standard_errors.get(column))
                value = float(statistics.values[column])
                said = _remark(state, statistics, column)
                estimates[member][name] = OwnEstimate(value, error, said)
    return estimates


def _remark(state: FitState, statistics: Statistics, index: int) -> str:
    return remark(statistics, index, moves=bool(np.asarray(state.active)[index]))


def remark(statistics: Statistics, index: int, *, moves: bool) -> str:
    """What a reader must know before using the value of a free parameter; may be empty.

    Arguments:
        statistics: of the fit.
        index: position of the parameter.
        moves: whether any channel responded to it where the fit started.

    Returns:
        The remark of the parameter's `Estimate`.
    """
    if not moves:
        return "not determined: no channel responds to it; left at its start"
    for group in statistics.together:
        if index in group:
            others = ", ".join(statistics.labels[i] for i in group if i != index)
            return f"not determined alone: only a combination with {others} is"
    error = finite_or_none(statistics.standard_errors.get(index))
    if error is None:
        return "not determined: no channel responds to it where it ended"
    if index in statistics.bounds:
        return (
            f"at its {statistics.bounds[index]} bound: the best value is the bound itself, and "
            "the standard error says how far from it the data allow"
        )
    share = statistics.prior_shares.get(index, 0.0)
    if share > _MOSTLY:
        return f"its value is mostly that of its prior ({share:.0%} of what is known of it)"
    if error > abs(statistics.values[index]):
        return "barely determined: the standard error exceeds the value"
    partners = largest_correlations(statistics.correlation, _NEARLY_THE_SAME)
    row = statistics.determined.index(index)
    if row in partners:
        partner, correlation = partners[row]
        other = statistics.labels[statistics.determined[partner]]
        return f"correlation {correlation:+.3f} with {other}"
    return ""


def _held(model: AbstractModel, free: tuple[str, ...]) -> dict[str, Estimate]:
    """The declared parameters that were not free, with their declarations."""
    values = parameter_values(model)
    return {
        path: _held_estimate(parameter, values[path])
        for path, parameter in declared(model).items()
        if path not in free
    }


def _held_estimate(parameter: Parameter, value: object) -> Estimate:
    declaration = parameter.declaration
    return Estimate(
        value=value,
        standard_error=None,
        unit=declaration.unit,
        lower=finite_or_none(declaration.lower),
        upper=finite_or_none(declaration.upper),
        free=False,
        remark="held",
    )
