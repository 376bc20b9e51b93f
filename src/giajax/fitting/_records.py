"""What a result is made of: small frozen records, each of which JSON gives back.

Field by field they are the objects of `result.json`. What is not finite is null there, and None
here once a file was read. The classmethods `of_json` take such objects, also those of earlier
versions, which lack what was added since. Those of single runs are in `_run_records`.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, Self

Status = Literal["converged", "not_converged", "interrupted"]


@dataclasses.dataclass(frozen=True)
class Iteration:
    """What `progress` hears of after each trial step.

    Attributes:
        number: 0 for the evaluation of the start.
        cost: half the sum of the loss, at the best point so far.
        step: largest change of a free coordinate that was tried: relative for a positive
            parameter, in its own unit for one without bounds.
        accepted: whether the trial point became the best one.
        parameters: values of the free parameters at the best point, by path.
    """

    number: int
    cost: float
    step: float
    accepted: bool
    parameters: dict[str, float]


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter of a result.

    Attributes:
        value: fitted, or held; a list for an array that was not fitted element by element.
        standard_error: one standard deviation, in the unit of the value; None if there is none.
        unit: SI unit.
        lower, upper: bounds; None where there is none.
        free: whether the fit was allowed to move it.
        remark: what a reader must know before using the value; may be empty.
        interval: where the value is by 95 %, by Student's t, within the bounds; None without a
            standard error.
        freedom: degrees of freedom of it; None where they are infinite.
        sandwich_error: standard error that does not trust the noise model (Newey and West); None
            where there is none.
        prior_share: how much of what is known of it is its prior's, from 0 to 1: the variance of
            the estimate over that of the prior; None without a prior.
        sources: by recording, how many times larger the standard error would be without it, to
            first order; None where the parameter would not be determined. Empty for one recording.
    """

    value: Any
    standard_error: float | None
    unit: str
    lower: float | None
    upper: float | None
    free: bool
    remark: str = ""
    interval: tuple[float, float] | None = None
    freedom: float | None = None
    sandwich_error: float | None = None
    prior_share: float | None = None
    sources: Mapping[str, float | None] = dataclasses.field(default_factory=dict)

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        ends = record.get("interval")
        return cls(**{**record, "interval": None if ends is None else (ends[0], ends[1])})


@dataclasses.dataclass(frozen=True)
class Correlation:
    """Correlations of the estimates.

    Attributes:
        parameters: paths of the free parameters that the data determine.
        matrix: its rows; None from a file where a correlation is not finite.
    """

    parameters: tuple[str, ...] = ()
    matrix: tuple[tuple[float | None, ...], ...] = ()

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(tuple(record["parameters"]), tuple(map(tuple, record["matrix"])))


@dataclasses.dataclass(frozen=True)
class GradientCheck:
    """Derivatives by automatic differentiation against central differences, at the optimum.

    Attributes:
        relative_difference: norm of the difference between the two derivatives of the residuals
            along one direction, relative to the norm of the derivative.
        direction: part of each parameter of the model in it, in free coordinates, by path.
        step: length of the difference along it.
        left_out: paths of the parameters that take no part, because they ended at a bound or
            nothing responds to them; of several runs, none of those that were looked at.
    """

    relative_difference: float
    direction: dict[str, float]
    step: float
    left_out: tuple[str, ...] = ()

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        return cls(**{**record, "left_out": tuple(record.get("left_out", ()))})


@dataclasses.dataclass(frozen=True)
class Shift:
    """How far a parameter moves: in its unit, and in its standard errors."""

    shift: float | None
    standard_errors: float | None


@dataclasses.dataclass(frozen=True)
class ToleranceEffect:
    """What a finer tolerance of the solver would change, to first order.

    Attributes:
        factor: on the tolerance.
        largest_in_standard_errors: the largest shift of a parameter.
        by_parameter: all of them, by path.
    """

    factor: float
    largest_in_standard_errors: float | None
    by_parameter: dict[str, Shift]

    @classmethod
    def of_json(cls, record: Mapping[str, Any]) -> Self:
        """The record that an object of `result.json` holds."""
        shifts = {path: Shift(**item) for path, item in record["by_parameter"].items()}
        return cls(record["factor"], record["largest_in_standard_errors"], shifts)


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """What a fit took for noise.

    Attributes:
        model: "correlated" where a memory was looked for, or "white".
        estimated: whether the size of any of it comes from the residuals.
        widening: standard error over that with white noise of the same size, by path; empty
            where all noise is white.
    """

    model: str
    estimated: bool
    widening: dict[str, float | None] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Seconds:
    """Wall time of a fit, s: what its programs took to compile or load, and all else.

    Of several starts, those of all of them together, also where they ran side by side.
    """

    compile: float
    run: float


@dataclasses.dataclass(frozen=True)
class Start:
    """One of several starts of a fit, and where it ended.

    Attributes:
        start: values of the free parameters, by path.
        status: of the fit from there, or "failed" where it could not be evaluated.
        misfit: minus the logarithm of the likelihood, up to a constant; None where nothing was
            evaluated.
        parameters: where it ended, by path; likewise.
        message: why it failed or did not converge; None where it did.
    """

    start: dict[str, float]
    status: str
    misfit: float | None = None
    parameters: dict[str, float] | None = None
    message: str | None = None


def finite_or_none(value: float | None) -> float | None:
    """A finite number, or None."""
    return float(value) if value is not None and math.isfinite(value) else None
