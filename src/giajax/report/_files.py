"""A result as a folder of files."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..fitting import FitResult, RunFit, matching_runs
from ..runs import (
    Run,
    check_output_folder,
    make_folder,
    observing,
    unique_names,
    write_files,
)
from ..study import begun_where_it_ended
from ._correlation import correlation_figure
from ._prediction import prediction_files
from ._recorded import recorded_figure
from ._residuals import residuals_figure
from ._style import SIGNATURE, to_png

RESULT = "result.json"
PAGE = "report.html"

# A picture takes a second, and nobody looks at twenty of them.
_MOST_RUNS = 6


def write_result(
    result: FitResult,
    runs: Run | Sequence[Run],
    folder: str | Path,
    *,
    figures: bool = True,
    held_out: Sequence[Run] = (),
) -> list[Path]:
    """Write a result to a folder, which is made if it is missing.

    `result.json` is the result itself (`giajax.load_result`). `prediction.csv` has the columns of
    the recording with the fitted in place of the recorded values, at every time; for one run it is
    a run itself, with its sidecar, and for several it has a leading column `run`. Each file appears
    whole or not at all, `result.json` first: what takes longest to compute is on disk before
    anything else can fail. Pictures of an earlier fit are removed.

    Arguments:
        result: the result of `fit` or `load_result`.
        runs: the runs that were fitted, in the same order.
        folder: its files are written over; `check_folder` is what refuses.
        figures: whether to draw pictures, too; `write_figures` draws them later.
        held_out: what was held out of the runs, for the pictures.

    Returns:
        The files, `result.json` first.

    Raises:
        InputError: other runs than those of the result, or the folder cannot be written.

    Example:
        >>> write_result(result, runs, "giajax-out/base_step")  # doctest: +SKIP
    """
    folder = Path(folder)
    runs, names, predictions = _parts(result, runs)
    check_output_folder(folder)
    make_folder(folder)
    files = _written(folder, {RESULT: result.to_json().encode()})
    _remove_stale_pictures(folder)
    files += _written(folder, prediction_files(result, runs, names, predictions))
    if figures:
        files += _written(folder, _picture_files(result, runs, names, predictions, held_out))
    return files


def write_figures(
    result: FitResult,
    runs: Run | Sequence[Run],
    folder: str | Path,
    *,
    held_out: Sequence[Run] = (),
) -> list[Path]:
    """Draw a result into the folder that `write_result` wrote.

    The pictures show recorded against fitted values of each run (of many runs, of those that are
    described worst), the residuals and the correlations.

    Arguments:
        result: the result of `fit` or `load_result`.
        runs: the runs that were fitted, in the same order.
        folder: of the result.
        held_out: what was held out of the runs, in the order of `result.held_out`.

    Returns:
        The files.

    Raises:
        InputError: other runs than those of the result, or the folder cannot be written.
    """
    runs, names, predictions = _parts(result, runs)
    return _written(Path(folder), _picture_files(result, runs, names, predictions, held_out))


def _parts(
    result: FitResult, runs: Run | Sequence[Run]
) -> tuple[list[Run], list[str], Sequence[Mapping[str, np.ndarray]]]:
    """The runs of a result, their names as files, and what it predicts for each."""
    runs = matching_runs(result.runs, runs, whole=True)
    # A result that was loaded has no predictions with it.
    begun = runs if result.predictions else begun_where_it_ended(result, runs)
    predictions = result.predictions or [result.predict(run) for run in begun]
    return runs, unique_names(runs), predictions


def _written(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    paths = {folder / name: data for name, data in contents.items()}
    write_files(paths, force=True)
    return list(paths)


def worth_drawing(result: FitResult) -> list[int]:
    """All runs, or of many those that are described worst, in their order."""
    if len(result.runs) <= _MOST_RUNS:
        return list(range(len(result.runs)))
    worst = sorted(range(len(result.runs)), key=lambda index: -times_noise(result.runs[index]))
    return sorted(worst[:_MOST_RUNS])


def times_noise(record: RunFit, names: Iterable[str] | None = None) -> float:
    """The largest RMSE over noise of some channels, or of all; infinite where one is not finite."""
    channels = [record.channels[name] for name in (record.channels if names is None else names)]
    return max(
        (
            float("inf") if c.rmse is None else c.rmse / c.noise if c.noise else 0.0
            for c in channels
        ),
        default=0.0,
    )


def _picture_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
    held_out: Sequence[Run],
) -> dict[str, bytes]:
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
        if whole and whole <= predicted.keys() and len(files) < _MOST_RUNS:
            only = observing(run, [channel for channel in run.observations if channel in whole])
            figure = recorded_figure(result, only, predicted, record, only)
            files[f"held_out_{name}.png"] = to_png(figure)
    return files


def _remove_stale_pictures(folder: Path) -> None:
    """Remove the pictures and the page of an earlier fit, which do not show this one."""
    for pattern in (
        "recorded.png",
        "recorded_*.png",
        "held_out_*.png",
        "residuals.png",
        "correlation.png",
        "bootstrap.png",
        "influence.png",
        PAGE,
    ):
        for path in folder.glob(pattern):
            try:
                # A person's own picture of such a name does not carry the signature.
                if SIGNATURE.encode() in path.read_bytes()[:200]:
                    path.unlink()
            except OSError:
                continue
