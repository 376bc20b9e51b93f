"""What a result knows of single runs and groups of them: the values that not all runs share."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from ..models import AbstractModel
from ..parameters import declared, replace
from ..runs import Run
from ._layout import Layout, members
from ._records import Estimate
from ._run_records import OwnEstimate, RunFit
from ._ties import resolved_ties, tied

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
