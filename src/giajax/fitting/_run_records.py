"""What a result says of single runs: fitted, held out, or predicted. JSON gives each record back.

As `_records`, field by field they are the objects of `result.json`.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..models import AbstractModel
from ..recordings import Run
from ..runtime.text import InputError
from ..schema.parameters import declared, replace
from ._coordinates import Layout, members
from ._free import resolved_ties, tied
from ._records import Estimate


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
        innovation: deviation of what the cells before do not foretell, their geometric mean;
            None from a file without it.
    """

    unit: str
    rmse: float | None
    n: int
    noise: float
    correlated: float = 0.0
    correlation_time_s: float = 0.0
    innovation: float | None = None


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


# What a result knows of single runs and groups of them: the values that not all runs share.

# More rows than this are no table to read; `runs[].parameters` has all of them.
_MANY = 12


def rows_of_runs(runs: Sequence[RunFit], free: Mapping[str, Estimate]) -> dict[str, Estimate]:
    """Estimates of the parameters that have a value for each group of runs.

    Arguments:
        runs: the fitted ones.
        free: the estimates of the model's free parameters, by path.

    Returns:
        By path and names of the runs; empty where there are too many for a table.
    """
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
    """The runs of a result, checked to be those.

    Of runs that were made in memory, and of windows of one file, there is no checksum that tells
    them apart: channels, numbers of measured cells and names have to be the same.

    Arguments:
        records: of the fitted runs.
        runs: what is said to be them, in their order.
        whole: whether they may have more than was fitted: what was held out, other channels.

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
        raise InputError("the runs are not those of the result: give the same ones in their order")
    return several


def layout_of(
    runs: Sequence[RunFit],
    paths: Sequence[str],
    groups: Mapping[str, Sequence[Sequence[str]]],
) -> Layout:
    """Where a value of a parameter is that of one run, of some, or of all of them.

    Arguments:
        runs: the fitted ones.
        paths: of the free parameters.
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
    """The fitted model with the values that a fitted run has for itself or with its group.

    Arguments:
        model: the fitted one.
        runs: the fitted ones.
        run: one of them; for any other the model is as it is.
        ties: expressions by the paths of what follows from them.
    """
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
