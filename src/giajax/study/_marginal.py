"""What draws say of one parameter, beside what its fit says."""

import dataclasses
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from scipy.special import stdtrit

from ..fitting import FitResult, Optimum
from ._mixing import mixing

_LEVEL = 0.95

# Degrees of freedom from which Student's t is a normal distribution.
_NORMAL = 1e9


@dataclasses.dataclass(frozen=True)
class Marginal:
    """What is known of one parameter, SI.

    Attributes:
        unit: SI unit.
        fitted: where the fit ended.
        mean, deviation: of the draws.
        interval: from 2.5 to 97.5 % of them.
        linear: the interval of the fit, from its Jacobian alone; None where it has none.
        r_hat: 1 where the chains agree; None where all draws are equal.
        ess_bulk, ess_tail: how many independent draws the mean and the ends are worth; likewise.
    """

    unit: str
    fitted: float
    mean: float
    deviation: float
    interval: tuple[float, float]
    linear: tuple[float, float] | None
    r_hat: float | None
    ess_bulk: float | None
    ess_tail: float | None

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `posterior.json` holds."""
        linear = record["linear"]
        pairs = {"interval": tuple(record["interval"]), "linear": linear and tuple(linear)}
        return cls(**{**record, **pairs})

    def times(self, factor: float, unit: str) -> Self:
        """The same in another unit."""

        def scaled(ends: tuple[float, float]) -> tuple[float, float]:
            low, high = sorted(end * factor for end in ends)
            return low, high

        return dataclasses.replace(
            self,
            unit=unit,
            fitted=self.fitted * factor,
            mean=self.mean * factor,
            deviation=self.deviation * abs(factor),
            interval=scaled(self.interval),
            linear=None if self.linear is None else scaled(self.linear),
        )


def marginal(result: FitResult, optimum: Optimum, index: int, draws: np.ndarray) -> Marginal:
    """What draws say of a parameter.

    Arguments:
        result: of the fit.
        optimum: where it ended.
        index: position of the parameter.
        draws: shape (chain, draw).
    """
    low, high = np.percentile(draws, (2.5, 97.5))
    path = optimum.labels[index].partition(" of ")[0]
    known = [float(each) if np.isfinite(each) else None for each in mixing(draws)]
    return Marginal(
        unit=result.parameters[path].unit if path in result.parameters else "",
        fitted=float(optimum.values[index]),
        mean=float(np.mean(draws)),
        deviation=float(np.std(draws, ddof=1)),
        interval=(float(low), float(high)),
        linear=_linear(optimum, index),
        r_hat=known[0],
        ess_bulk=known[1],
        ess_tail=known[2],
    )


def _linear(optimum: Optimum, index: int) -> tuple[float, float] | None:
    """The interval that the fit reports, by Student's t and within the bounds."""
    statistics = optimum.statistics
    error = statistics.standard_errors.get(index)
    if error is None or not np.isfinite(error):
        return None
    freedom = min(statistics.freedom.get(index, _NORMAL), _NORMAL)
    reach = float(stdtrit(freedom, 1 - (1 - _LEVEL) / 2)) * error
    value, lower, upper = optimum.values[index], *(each[index] for each in optimum.bounds)
    return float(max(value - reach, lower)), float(min(value + reach, upper))
