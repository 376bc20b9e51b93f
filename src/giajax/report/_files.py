"""A result as a folder of files."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..fitting import FitResult, matching_runs
from ..runs import (
    Run,
    check_output_folder,
    make_folder,
    unique_names,
    write_files,
)
from ..study import begun_where_it_ended
from ._names import PAGE, RESULT, SIGNATURE
from ._prediction import prediction_files


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
        files += _drawn(folder, result, runs, names, predictions, held_out)
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
    return _drawn(Path(folder), result, runs, names, predictions, held_out)


def _drawn(
    folder: Path,
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
    held_out: Sequence[Run],
) -> list[Path]:
    # Who wants no pictures need not wait for matplotlib.
    from ._pictures import picture_files

    return _written(folder, picture_files(result, runs, names, predictions, held_out))


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
