"""What a result is made of: small frozen records, each of which JSON gives back.

Field by field they are the objects of `result.json`, as `giajax.runtime.records` writes and reads
them.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ..models import AbstractModel
from ..noise import ChannelNoise
from ..recordings import Channel, Run
from ..runtime.records import Numbers
from ..runtime.text import InputError, format_bounds, format_estimate, wrapped
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
    """One test of something that a fit held, switched off or left out.

    Attributes:
        path: of the parameter, such as `camera.delay` or `air.wind[2]`; of a group that of its
            elements; of a switch or of axes what is changed.
        kind: "parameter"; "factor", of an array whose elements change in proportion; "group",
            several elements together; "switch", a choice of the model; "axes", of the recording;
            "columns", their names, units and signs;
            "points" that are exchanged, lost or taken for others in it;
            "outliers", whose estimate is their share of all cells; "prior", a free parameter
            without what is known of it (`giajax explain` alone).
        unit: SI unit of the estimate; "" for a factor and for a switch, whose estimate is the
            share, from 0 to 1, of the change that it would make.
        value: what the fit held; a list for a group, None for axes.
        estimate: what one step from the fit leads to, within the bounds; likewise.
        estimate_error: its standard error; likewise, and None where it is not testable.
        chi_square_drop: by how much that would lower the sum of squared residuals, in units of
            the noise; None where it is not testable.
        degrees_of_freedom: of the test.
        p_value: of the test, corrected for how many were asked; None where it is not testable.
        testable: whether the data would show it, beside what the fit moved.
        alike: paths of other suspects that the data can hardly tell from this one.
        together: paths of up to three others in whose presence little of it is left: a group that
            the data tell as one.
        explained_by: the suspect that it is in the group of, or that leaves little of it.
        note: why it is not testable, or what a reader must know; may be empty.
        moves: by how many of their standard errors the step moves fitted parameters, by path; of
            parameters that are significant; nothing where it was tested where the fit began.
        begun: whether it was tested with the initial values of the fit, because those where
            it ended may have gone astray.
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
    """What one held number does to the fitted ones.

    Attributes:
        path: of the held parameter.
        unit: its SI unit.
        value: what it is held at; a list where its elements differ.
        uncertainty: its standard deviation, as stated, or 1 % of it; of elements that differ, a
            fraction of each.
        stated: whether it was stated.
        shifts: what that does to each fitted parameter, SI, by path.
        decides: paths of the parameters that it moves by more than a standard error.
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
    """What `progress` hears of after each trial step.

    Attributes:
        number: 0 for the evaluation of the start.
        cost: half the sum of the loss, at the best point so far, of the rows that count: of a free
            motion that swings and a start far off these are the first ones for a while.
        step: largest change of a free coordinate that was tried: relative for a positive
            parameter, in its own unit for one without bounds.
        accepted: whether the trial point became the best one.
        parameters: values of the free parameters at the best point, by path.
        part: of the rows, from the first, that count.
    """

    number: int
    cost: float
    step: float
    accepted: bool
    parameters: dict[str, float]
    part: float = 1.0


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
        noise_error: what the standard error would be if the nuisances of the fit were known, which
            is the noise's part; None where it has none.
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
        """The part of the standard error that comes from the nuisances of the fit."""
        if self.standard_error is None or self.noise_error is None:
            return None
        return math.sqrt(max(self.standard_error**2 - self.noise_error**2, 0.0))


@dataclasses.dataclass(frozen=True)
class Correlation:
    """Correlations of the estimates.

    Attributes:
        parameters: paths of the free parameters that the data determine.
        matrix: its rows; None from a file where a correlation is not finite.
    """

    parameters: tuple[str, ...] = ()
    matrix: tuple[tuple[float | None, ...], ...] = ()

    def __post_init__(self) -> None:
        count = len(self.parameters)
        if len(self.matrix) != count or any(len(row) != count for row in self.matrix):
            raise ValueError("must have a row and a column for each parameter")


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


@dataclasses.dataclass(frozen=True)
class NoiseFit:
    """What a fit took for noise.

    Attributes:
        model: "correlated" where correlated noise was looked for, or "white".
        estimated: whether the size of any of it comes from the residuals.
        widening: standard error over that with white noise of the same size, by path; empty
            where all noise is white. Where there are trends, it is at least 1.
        trends: channels whose residuals are correlated over half of a record or more.
    """

    model: str
    estimated: bool
    widening: dict[str, float | None] = dataclasses.field(default_factory=dict)
    trends: list[str] = dataclasses.field(default_factory=list)


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


# A remark that would be squeezed into fewer columns than this goes below its row instead.
_LEAST_REMARK = 36

_NUMBERS = ("value", "error")


class EstimateRow(NamedTuple):
    """The cells of one estimate; their names are the headings."""

    parameter: str
    value: str
    error: str
    unit: str
    bounds: str
    remark: str


def estimate_table(estimates: Mapping[str, Estimate], width: int | None = None) -> str:
    """Value, standard error, unit, bounds and remark of each estimate, a line each.

    Arguments:
        estimates: by path.
        width: columns that there are. Where the remarks do not fit, each goes below its row.
            Without a width nothing is wrapped: a row is a line, for grep and awk.

    Returns:
        The lines, without a newline at the end.
    """
    headings = EstimateRow(*EstimateRow._fields)
    rows = estimate_rows(estimates)
    sizes = [max(map(len, column)) for column in zip(headings, *rows, strict=True)][:-1]
    before = sum(sizes) + 2 * len(sizes)
    longest = max(len(row.remark) for row in (headings, *rows))
    below = width is not None and width - before < min(longest, _LEAST_REMARK)
    lines: list[str] = []
    for row in (headings._replace(remark="") if below else headings, *rows):
        cells = zip(EstimateRow._fields, row, sizes, strict=False)
        start = "  ".join(
            cell.rjust(size) if name in _NUMBERS else cell.ljust(size) for name, cell, size in cells
        )
        if below:
            lines += [start.rstrip(), *wrapped(row.remark, width, "    ", "    ")]
        else:
            lines += wrapped(row.remark, width, start + "  ", " " * before) or [start.rstrip()]
    return "\n".join(lines)


def estimate_rows(estimates: Mapping[str, Estimate]) -> list[EstimateRow]:
    """The cells of that table."""
    rows = []
    for path, estimate in estimates.items():
        value, error = format_estimate(estimate.value, estimate.standard_error)
        bounds = format_bounds(estimate.lower, estimate.upper)
        rows.append(EstimateRow(path, value, error, estimate.unit or "-", bounds, estimate.remark))
    return rows


@dataclasses.dataclass(frozen=True)
class OwnEstimate:
    """What one run has for itself, such as an initial angle, or with its group: as `Estimate`."""

    value: float
    standard_error: float | None
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class ChannelFit:
    """How well one channel of a fitted run is described, in the unit of the recording.

    Attributes:
        unit: of the recording.
        rmse: root mean square of recorded minus predicted; None where that is not finite.
        n: number of measured values.
        noise: standard deviation of a cell that the values were weighted with.
        correlated: standard deviation of the correlated part of it.
        correlation_time_s: of that part, s; 0 where there is none.
        innovation: deviation of what the cells before do not predict, their geometric mean;
            None from a file without it.
        white: deviation of white noise (`giajax.noise.white_deviation`), which suspects,
            pictures and reports measure residuals by; None from a file without it.
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
        """What residuals are measured by: `white`, or `noise` where that is not known."""
        return self.noise if self.white is None else self.white


def recorded_noise(channel: Channel, record: ChannelFit) -> ChannelNoise:
    """The noise that a result says a channel was weighted with, SI."""
    noise, correlated = channel.to_si([record.noise, record.correlated]).tolist()
    return ChannelNoise.of_cell(noise, correlated, record.correlation_time_s)


@dataclasses.dataclass(frozen=True)
class RunFit:
    """One fitted run.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        sha256: checksum of the file.
        channels: by name.
        parameters: what was free in this run alone, or in its group of runs, by path.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, ChannelFit]
    parameters: dict[str, OwnEstimate] = dataclasses.field(default_factory=dict)

    @property
    def recording(self) -> str:
        """Name of the recording that it is, or is a window of."""
        return self.name if self.path is None else Path(self.path).stem


@dataclasses.dataclass(frozen=True)
class ChannelErrors:
    """Errors of prediction of one channel, in the unit of the recording.

    Attributes:
        unit: of the recording.
        rmse: root mean square error; infinite (None from a file) where the simulation failed.
        largest: largest absolute error; likewise.
        n: number of measured values.
    """

    unit: str
    rmse: float | None
    largest: float | None
    n: int


@dataclasses.dataclass(frozen=True)
class PredictionErrors:
    """How far a prediction is from what a run recorded.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        channels: by name.
    """

    name: str
    path: str | None
    channels: dict[str, ChannelErrors]


@dataclasses.dataclass(frozen=True)
class HeldChannel:
    """How well what was held out of one channel is predicted, in the unit of the recording.

    What these cells alone know, such as the free initial state of a run of which nothing was
    fitted, is fitted to them.

    Attributes:
        unit: of the recording.
        rmse: root mean square error of the held-out cells; infinite (None from a file) where the
            simulation failed; None where Ctrl-C came before.
        n: number of these cells.
        size: how many times as far off they are as noise and the uncertainty of the parameters
            allow, in the root mean square; infinite likewise. None where there is nothing to judge,
            because as many parameters are known from these cells alone.
    """

    unit: str
    rmse: float | None
    n: int
    size: float | None


@dataclasses.dataclass(frozen=True)
class HeldOut:
    """What was held out of one run, and is predicted.

    Attributes:
        name: of the run.
        path: of its file; None for a run that was made in memory.
        sha256: checksum of the file.
        channels: those of which cells were held out, by name.
    """

    name: str
    path: str | None
    sha256: str | None
    channels: dict[str, HeldChannel]


_MANY = 12  # more rows than this are no table to read; `runs[].parameters` has all of them


def rows_of_runs(runs: Sequence[RunFit], free: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Estimates of what has a value for each group of runs; none where those are too many."""
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
    """The runs of a result, in their order, checked to be those.

    Of runs that were made in memory, and of windows of one file, there is no checksum that
    distinguishes them: channels, numbers of measured cells and names have to be the same; unless
    they may be the whole runs, with more than was fitted: what was held out, other channels.

    Raises:
        InputError: they are others, or in another order.
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
    """Where a value of a parameter is that of one fitted run, of some, or of all of them.

    Groups, names of the runs that share a value, are by the path of a parameter or of its array.
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
    """The fitted model with what a fitted run has for itself or with its group; else as it is."""
    for record in runs:
        if (record.name, record.sha256) == (run.name, run.sha256):
            # What belongs to the state of the run is no parameter of the model.
            own = {
                path: estimate.value
                for path, estimate in record.parameters.items()
                if path.partition("[")[0] in declared(model)
            }
            return tied(replace(model, own), resolved_ties(model, ties)) if own else model
    return model
