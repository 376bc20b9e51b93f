"""Records of a result: small frozen data classes that can be restored from JSON.

Their fields are those of the objects in `result.json`, which `giajax.runtime.records` writes and
reads.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ..models import AbstractModel
from ..noise import ChannelNoise
from ..recordings import Channel, Run
from ..runtime.records import Numbers
from ..runtime.text import (
    InputError,
    format_bounds,
    format_estimate,
    with_run_column,
    wrapped,
)
from ..schema.parameters import declared, replace
from ._configuration import resolved_ties, tied
from ._coordinates import Layout, members

SuspectKind = Literal[
    "parameter",
    "factor",
    "group",
    "scatter",
    "switch",
    "axes",
    "columns",
    "points",
    "outliers",
    "prior",
]


@dataclasses.dataclass(frozen=True)
class Suspect:
    """Test of an effect that a fit held, disabled or omitted.

    Attributes:
        path: path of the parameter, such as `camera.delay` or `air.wind[2]`. For a group, the paths
            of its elements. For a switch or for axes, the change.
        kind: "parameter"; "factor", an array whose elements change in proportion; "group", several
            elements together; "switch", a choice of the model; "axes", axes of the recording;
            "columns", names, units and signs of its columns; "points", points in it that are
            exchanged, lost or mistaken for others; "outliers", whose estimate is their fraction of
            all cells; "prior", a free parameter without its prior (only in `giajax explain`).
        unit: SI unit of the estimate. It is "" for a factor, and for a switch, whose estimate is
            the fraction, from 0 to 1, of the change that it would make.
        value: value that the fit held: a list for a group, None for axes.
        estimate: value after one step from the fit, within the bounds, in the same form.
        estimate_error: standard error of the estimate, in the same form, or None if it is not
            testable.
        chi_square_drop: decrease of the sum of squared residuals, divided by the noise variance, or
            None if it is not testable.
        degrees_of_freedom: degrees of freedom of the test.
        p_value: p-value of the test, corrected for the number of tests, or None if it is not
            testable.
        testable: whether the data would show the effect in addition to the fitted parameters.
        alike: paths of other suspects that the data can hardly distinguish from this one.
        together: paths of up to three other suspects whose inclusion leaves little of this effect:
            the data show them as one group.
        explained_by: suspect to whose group it belongs, or whose inclusion leaves little of it.
        note: reason why it is not testable, or another remark. It may be empty.
        moves: shifts of fitted parameters due to the step, in their standard errors, by path. Only
            parameters with significant values are included, and none if the test was made at the
            beginning of the fit.
        begun: whether the test was made at the initial values of the fit, because the final values
            may be wrong.
    """

    path: str
    kind: SuspectKind
    unit: str
    value: float | list[float] | None
    estimate: float | list[float] | None
    estimate_error: float | list[float] | None
    chi_square_drop: float | None
    degrees_of_freedom: int
    p_value: float | None
    testable: bool
    alike: tuple[str, ...] = ()
    note: str = ""
    moves: dict[str, float] = dataclasses.field(default_factory=dict)
    together: tuple[str, ...] = ()
    explained_by: str = ""
    begun: bool = False


@dataclasses.dataclass(frozen=True)
class SystematicError:
    """Effect of the uncertainty of one held value on the fitted parameters.

    Attributes:
        path: path of the held parameter.
        unit: SI unit of the held parameter.
        value: held value, or a list if its elements differ.
        uncertainty: standard deviation of the held value as specified, or 1 % of it. If its
            elements differ, it is a fraction of each.
        stated: whether the standard deviation was specified.
        shifts: resulting shift of each fitted parameter, SI units, by path.
        decides: paths of the parameters that shift by more than a standard error.
    """

    path: str
    unit: str
    value: float | list[float]
    uncertainty: float
    stated: bool
    shifts: dict[str, float]
    decides: tuple[str, ...] = ()


Status = Literal["converged", "not_converged", "interrupted"]


@dataclasses.dataclass(frozen=True)
class Iteration:
    """Report to `progress` after each trial step.

    Attributes:
        number: number of the step, 0 for the evaluation of the initial guess.
        cost: half the sum of the losses at the best point so far. Only the rows in use are
            included: for a free oscillation with a poor initial guess, these are the first rows for
            some steps.
        step: largest attempted change of a free coordinate, which is relative for a positive
            parameter, and in its own unit for a parameter without bounds.
        accepted: whether the trial point became the best point.
        parameters: values of the free parameters at the best point, by path.
        part: fraction of the rows in use, counted from the first.
    """

    number: int
    cost: float
    step: float
    accepted: bool
    parameters: dict[str, float]
    part: float = 1.0


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Estimate of one parameter in a result.

    Attributes:
        value: fitted or held value, or a list for an array that was not fitted by element.
        standard_error: standard error, in the unit of the value, or None.
        unit: SI unit.
        lower, upper: bounds, None if there is none.
        free: whether the fit could change the value.
        remark: remark for the reader, which may be empty.
        interval: 95 % interval of the value, from Student's t, within the bounds, or None without a
            standard error.
        freedom: degrees of freedom of the interval, None if they are infinite.
        sandwich_error: standard error that does not assume the noise model (Newey and West), or
            None.
        prior_share: share of the prior in the information on the parameter, from 0 to 1: variance
            of the estimate divided by the variance of the prior. None without a prior.
        sources: for each recording, the factor by which the standard error would be larger without
            it, to first order. None if the parameter would not be determined. Empty for one
            recording.
        noise_error: standard error if the nuisance parameters were known, that is, the part due to
            noise, or None.
    """

    value: Numbers
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
    noise_error: float | None = None

    @property
    def nuisance_error(self) -> float | None:
        """Part of the standard error due to the nuisance parameters of the fit."""
        if self.standard_error is None or self.noise_error is None:
            return None
        return math.sqrt(max(self.standard_error**2 - self.noise_error**2, 0.0))


@dataclasses.dataclass(frozen=True)
class Correlation:
    """Correlations of the estimates.

    Attributes:
        parameters: paths of the free parameters that the data determine.
        matrix: rows of the correlation matrix. A correlation that is not finite is None after
            reading from a file.
    """

    parameters: tuple[str, ...] = ()
    matrix: tuple[tuple[float | None, ...], ...] = ()

    def __post_init__(self) -> None:
        count = len(self.parameters)
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError("must have a row and a column for each parameter")


@dataclasses.dataclass(frozen=True)
class GradientCheck:
    """Comparison of automatic derivatives with finite differences at the optimum.

    Attributes:
        relative_difference: norm of the difference between the two derivatives of the residuals
            along one direction, relative to the norm of the derivative.
        direction: component of each model parameter in the direction, in free coordinates, by path.
        step: step of the difference along the direction.
        left_out: paths of the parameters that are excluded, because they ended at a bound or none
            of the examined runs depends on them.
    """

    relative_difference: float
    direction: dict[str, float]
    step: float
    left_out: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Shift:
    """Shift of a parameter: in its unit, and in its standard errors."""

    shift: float | None
    standard_errors: float | None


@dataclasses.dataclass(frozen=True)
class ToleranceEffect:
    """First-order effect of a finer solver tolerance.

    Attributes:
        factor: factor on the tolerance.
        largest_in_standard_errors: largest shift of a parameter, in its standard errors.
        by_parameter: shift of each parameter, by path.
    """

    factor: float
    largest_in_standard_errors: float | None
    by_parameter: dict[str, Shift]


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """Noise of a fit.

    Attributes:
        model: "correlated" if correlated noise was tested for, or "white".
        estimated: whether any noise was estimated from the residuals.
        widening: standard error divided by that for white noise of the same size, by path. It is
            empty if all noise is white, and at least 1 if there are trends.
        trends: channels whose residuals are correlated over at least half of a record.
    """

    model: str
    estimated: bool
    widening: dict[str, float | None] = dataclasses.field(default_factory=dict)
    trends: list[str] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True)
class Seconds:
    """Wall-clock time of a fit, s: compiling or loading programs, and the rest.

    For several initial guesses, the times are summed, even if the fits ran in parallel.
    """

    compile: float
    run: float


@dataclasses.dataclass(frozen=True)
class Start:
    """One of several initial guesses of a fit, and the result from there.

    Attributes:
        start: initial values of the free parameters, by path.
        status: status of the fit, or "failed" if it could not be evaluated.
        misfit: negative log-likelihood, up to a constant, or None if nothing was evaluated.
        parameters: final values by path, or None if nothing was evaluated.
        message: reason for a failure or for missing convergence, None if it converged.
    """

    start: dict[str, float]
    status: str
    misfit: float | None = None
    parameters: dict[str, float] | None = None
    message: str | None = None


# A remark with fewer columns than this is printed below its row.
_LEAST_REMARK = 36

_NUMBERS = ("value", "error")


def estimate_table(estimates: Mapping[str, Estimate], width: int | None = None) -> str:
    """Return a table with value, standard error, unit, bounds and remark of each estimate.

    Values of single runs have their runs in a column.

    Arguments:
        estimates: estimates by path.
        width: available columns. If the remarks do not fit, each is printed below its row. Without
            a width nothing is wrapped, and each row is one line, for grep and awk.

    Returns:
        The lines, without a newline at the end.
    """
    headings, rows = estimate_cells(estimates)
    sizes = [max(map(len, column)) for column in zip(headings, *rows, strict=True)][:-1]
    before = sum(sizes) + 2 * len(sizes)
    longest = max(len(row[-1]) for row in (headings, *rows))
    below = width is not None and width - before < min(longest, _LEAST_REMARK)
    lines: list[str] = []
    for row in ([*headings[:-1], ""] if below else headings, *rows):
        cells = zip(headings, row, sizes, strict=False)
        start = "  ".join(
            cell.rjust(size) if name in _NUMBERS else cell.ljust(size) for name, cell, size in cells
        )
        if below:
            lines += [start.rstrip(), *wrapped(row[-1], width, "    ", "    ")]
        else:
            lines += wrapped(row[-1], width, start + "  ", " " * before) or [start.rstrip()]
    return "\n".join(lines)


def estimate_cells(estimates: Mapping[str, Estimate]) -> tuple[list[str], list[list[str]]]:
    """Return the headings and the rows of the table of estimates."""
    rows = []
    for path, estimate in estimates.items():
        value, error = format_estimate(estimate.value, estimate.standard_error)
        bounds = format_bounds(estimate.lower, estimate.upper)
        rows.append((path, value, error, estimate.unit or "-", bounds, estimate.remark))
    return with_run_column(("parameter", *_NUMBERS, "unit", "bounds", "remark"), rows)


@dataclasses.dataclass(frozen=True)
class OwnEstimate:
    """Estimate of a parameter of one run or of its group, such as an initial angle."""

    value: float
    standard_error: float | None
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class ChannelFit:
    """Agreement of one channel of a fitted run, in the unit of the recording.

    Attributes:
        unit: unit of the recording.
        rmse: root-mean-square of recorded minus predicted values, or None if it is not finite.
        n: number of measured values.
        noise: standard deviation of a cell with which the values were weighted.
        correlated: standard deviation of the correlated part of the noise.
        correlation_time_s: correlation time of that part, s, 0 if there is none.
        innovation: standard deviation of a cell given the earlier cells, as geometric mean, or None
            if a file does not contain it.
        white: standard deviation of white noise (`giajax.noise.white_deviation`) by which suspects,
            pictures and reports divide residuals, or None if a file does not contain it.
    """

    unit: str
    rmse: float | None
    n: int
    noise: float
    correlated: float = 0.0
    correlation_time_s: float = 0.0
    innovation: float | None = None
    white: float | None = None

    @property
    def compared_noise(self) -> float:
        """Noise by which residuals are divided: `white`, or `noise` if that is unknown."""
        return self.noise if self.white is None else self.white


def recorded_noise(channel: Channel, record: ChannelFit) -> ChannelNoise:
    """Return the noise with which a channel was weighted according to a result, SI units."""
    noise, correlated = channel.to_si([record.noise, record.correlated]).tolist()
    return ChannelNoise.of_cell(noise, correlated, record.correlation_time_s)


@dataclasses.dataclass(frozen=True)
class RunFit:
    """Record of one fitted run.

    Attributes:
        name: name of the run.
        path: path of its file, or None for a run that was created in memory.
        sha256: checksum of the file.
        channels: records of the channels, by name.
        parameters: estimates of the parameters of this run or of its group of runs, by path.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, ChannelFit]
    parameters: dict[str, OwnEstimate] = dataclasses.field(default_factory=dict)

    @property
    def recording(self) -> str:
        """Name of the recording to which the run belongs as a whole or as a window."""
        return self.name if self.path is None else Path(self.path).stem


@dataclasses.dataclass(frozen=True)
class ChannelErrors:
    """Prediction errors of one channel, in the unit of the recording.

    Attributes:
        unit: unit of the recording.
        rmse: root-mean-square error, infinite (None in a file) if the simulation failed.
        largest: largest absolute error, in the same form.
        n: number of measured values.
    """

    unit: str
    rmse: float | None
    largest: float | None
    n: int


@dataclasses.dataclass(frozen=True)
class PredictionErrors:
    """Differences between a prediction and the recording of a run.

    Attributes:
        name: name of the run.
        path: path of its file, or None for a run that was created in memory.
        channels: errors of the channels, by name.
    """

    name: str
    path: str | None
    channels: dict[str, ChannelErrors]


@dataclasses.dataclass(frozen=True)
class HeldChannel:
    """Prediction of the held-out cells of one channel, in the unit of the recording.

    Parameters that only these cells determine, such as the free initial state of a run that was not
    fitted, are fitted to them.

    Attributes:
        unit: unit of the recording.
        rmse: root-mean-square error of the held-out cells, infinite (None in a file) if the
            simulation failed, and None if Ctrl-C was pressed before.
        n: number of these cells.
        size: root-mean-square error, relative to the error expected from noise and the uncertainty
            of the parameters, infinite if the simulation failed. None if the cells determine as
            many parameters as there are cells.
    """

    unit: str
    rmse: float | None
    n: int
    size: float | None


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """Predicted data that were held out of one run.

    Attributes:
        name: name of the run.
        path: path of its file, or None for a run that was created in memory.
        sha256: checksum of the file.
        channels: channels with held-out cells, by name.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, HeldChannel]


_MANY = 12  # maximum number of rows in a table; `runs[].parameters` contains all


def rows_of_runs(runs: Sequence[RunFit], free: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Return the estimates for groups of runs, or an empty dict if they are too many."""
    sharing: dict[tuple[str, OwnEstimate], list[str]] = {}
    for run in runs:
        name = run.recording
        for path, own in run.parameters.items():
            if path in free:
                names = sharing.setdefault((path, own), [])
                names += [] if name in names else [name]
    if len(sharing) > _MANY:
        return {}
    return {
        f"{path} of {', '.join(names)}": dataclasses.replace(
            free[path],
            value=own.value,
            standard_error=own.standard_error,
            remark=own.remark,
        )
        for (path, own), names in sharing.items()
    }


def matching_runs(
    records: Sequence[RunFit], runs: Run | Sequence[Run], *, whole: bool = False
) -> list[Run]:
    """Return the runs of a result in order, after checking that they are the same.

    Runs that were created in memory, and windows of one file, have no distinguishing checksum. For
    them, channels, numbers of measured cells and names must be the same. With `whole`, the runs may
    contain more than was fitted, such as held-out data and other channels.

    Raises:
        InputError: the runs or their order differ.
    """
    several = [runs] if isinstance(runs, Run) else list(runs)
    seen = [record.sha256 for record in records]
    same = [run.sha256 for run in several] == seen and all(
        whole
        or (
            {name: int(np.sum(~np.isnan(cells))) for name, cells in run.observations.items()}
            == {name: channel.n for name, channel in record.channels.items()}
            and (seen.count(record.sha256) == 1 or run.name == record.name)
        )
        for run, record in zip(several, records, strict=True)
    )
    if not same:
        raise InputError(
            "the runs are not those of the result: give the same runs in the same order"
        )
    return several


def layout_of(
    runs: Sequence[RunFit],
    paths: Sequence[str],
    groups: Mapping[str, Sequence[Sequence[str]]],
) -> Layout:
    """Return which values of the parameters belong to one fitted run, to some or to all runs.

    Arguments:
        runs: fitted runs.
        paths: paths of the parameters.
        groups: names of the runs that share a value, by the path of a parameter or of its array.
    """
    shared = {path: groups.get(path, groups.get(path.partition("[")[0])) for path in paths}
    return Layout.of(
        paths,
        {path: members(path, runs, names) for path, names in shared.items() if names},
        len(runs),
    )


def model_of_run(
    model: AbstractModel, runs: Sequence[RunFit], run: Run, ties: Mapping[str, str]
) -> AbstractModel:
    """Return the fitted model with the values of a fitted run or its group, if there are any."""
    for record in runs:
        if (record.name, record.sha256) == (run.name, run.sha256):
            # Parameters of the state of the run do not belong to the model.
            own = {
                path: estimate.value
                for path, estimate in record.parameters.items()
                if path.partition("[")[0] in declared(model)
            }
            return tied(replace(model, own), resolved_ties(model, ties)) if own else model
    return model
