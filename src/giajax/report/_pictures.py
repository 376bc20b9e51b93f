"""The pictures that a fit leaves: recorded and fitted values, residuals, correlations."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import FitResult
from ..runs import Run, observing, unique_names
from ._correlation import correlation_figure
from ._recorded import recorded_figure
from ._residuals import residuals_figure
from ._style import to_png
from ._worst import MOST_RUNS, worth_drawing


def picture_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
    held_out: Sequence[Run],
) -> dict[str, bytes]:
    """The pictures of a fit by the names of their files.

    Arguments:
        result: of the fit.
        runs: that were fitted.
        names: of the runs, as parts of names of files.
        predictions: for each run, in its units.
        held_out: what was held out of the runs.
    """
    files = {}
    drawn = worth_drawing(result)
    everything = list(zip(runs, names, predictions, result.runs, strict=True))
    held = {(run.name, run.sha256): run for run in held_out}
    for run, name, predicted, record in (everything[index] for index in drawn):
        file = "recorded.png" if len(runs) == 1 else f"recorded_{name}.png"
        partly = held.get((run.name, run.sha256))
        files[file] = to_png(recorded_figure(result, run, predicted, record, partly))
    files |= _held_out_files(result, runs, held_out)
    files["residuals.png"] = to_png(residuals_figure(result, runs, predictions))
    files["correlation.png"] = to_png(correlation_figure(result))
    return files


def _held_out_files(
    result: FitResult, runs: Sequence[Run], held_out: Sequence[Run]
) -> dict[str, bytes]:
    """Pictures of the runs and channels that were held out as a whole, and so are in no other."""
    fitted = {(run.name, run.sha256): run.observations for run in runs}
    files: dict[str, bytes] = {}
    if len(result.held_predictions) != len(held_out):  # A result that was loaded has none.
        return files
    names = unique_names(held_out)
    several = zip(held_out, names, result.held_out, result.held_predictions, strict=True)
    for run, name, record, predicted in several:
        whole = run.observations.keys() - fitted.get((run.name, run.sha256), {}).keys()
        if whole and whole <= predicted.keys() and len(files) < MOST_RUNS:
            only = observing(run, [channel for channel in run.observations if channel in whole])
            figure = recorded_figure(result, only, predicted, record, only)
            files[f"held_out_{name}.png"] = to_png(figure)
    return files
