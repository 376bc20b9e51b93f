"""A result as a folder of files, and whether a folder may take it."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from .._files import read_bytes
from .._limits import RESULT_BYTES
from .._syntax import parse_json
from ..fitting import FitResult, RunFit
from ..runs import Run, check_output_folder, make_folder, write_files
from ._correlation import correlation_figure
from ._names import unique_names
from ._prediction import prediction_files
from ._recorded import recorded_figure
from ._residuals import residuals_figure
from ._style import SIGNATURE, to_png

RESULT = "result.json"

# A figure takes a second, and nobody looks at twenty of them.
_MOST_RUNS = 6

# What makes two fits the same fit; the iterations allowed and the folder do not.
_SAME = ("definition", "runs", "free", "start", "fix", "loss")
_WORDS = {"definition": "the model's constants", "runs": "what the sidecar states", "loss": "loss"}


def check_folder(
    folder: str | Path, runs: Sequence[Run], config: Mapping[str, Any], *, force: bool = False
) -> None:
    """Refuse a folder that cannot take a result, or holds one of something else.

    To be called before the fit: nobody wants to hear this after it.

    Arguments:
        folder: where `write_result` is to write; need not exist.
        runs: the runs to be fitted.
        config: of the fit: `Setup.config`, which `giajax.fitting.set_up` makes.
        force: write over any result that is there.

    Raises:
        InputError: the folder is a file, cannot be written, or (without `force`) holds the
            result of other data, of another configuration, or of another program.
    """
    folder = Path(folder)
    check_output_folder(folder)
    path = folder / RESULT
    if force or not path.exists():
        return
    remedy = "give another --out, or --force to write over it"
    try:
        record = parse_json(read_bytes(path, RESULT_BYTES).decode(), path)
        checksums = [run["sha256"] for run in record["runs"]]
        before = record["config"]
        differing = [key for key in _SAME if before.get(key) != _as_json(config.get(key))]
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {remedy}") from None
    except (ValueError, LookupError, TypeError, AttributeError):
        raise InputError(f"{path} is not a result of giajax; {remedy}") from None
    if checksums != [run.sha256 for run in runs]:
        names = ", ".join(str(run.get("name")) for run in record["runs"])
        raise InputError(f"{folder} holds the result of other data ({names}); {remedy}")
    if differing:
        what = ", ".join(_WORDS.get(key, key) for key in differing)
        raise InputError(
            f"{folder} holds the result of another configuration (it differs in {what}); {remedy}"
        )


def write_result(
    result: FitResult,
    runs: Run | Sequence[Run],
    folder: str | Path,
    *,
    figures: bool = True,
) -> list[Path]:
    """Write a result to a folder, which is made if it is missing; returns the files.

    `result.json` is the result itself (`giajax.load_result`). `prediction.csv` has the columns of
    the recording with the fitted in place of the recorded values, at every time; for one run it is
    a run itself, with its sidecar, and for several it has a leading column `run`. Each file appears
    whole or not at all, `result.json` first: what takes longest to compute is on disk before
    anything else can fail. Figures of an earlier fit are removed.

    Arguments:
        result: the result of `fit` or `load_result`.
        runs: the runs that were fitted, in the same order.
        folder: written over without asking; `check_folder` asks.
        figures: whether to draw the figures too; `write_figures` draws them later.

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
    _remove_stale_figures(folder)
    files += _written(folder, prediction_files(result, runs, names, predictions))
    return files + (write_figures(result, runs, folder) if figures else [])


def write_figures(result: FitResult, runs: Run | Sequence[Run], folder: str | Path) -> list[Path]:
    """Draw a result into the folder that `write_result` wrote; returns the files.

    Recorded against fitted values of each run (of many runs, of those that are described worst),
    the residuals and the correlations.

    Arguments:
        result: the result of `fit` or `load_result`.
        runs: the runs that were fitted, in the same order.
        folder: of the result.

    Raises:
        InputError: other runs than those of the result, or the folder cannot be written.
    """
    runs, names, predictions = _parts(result, runs)
    return _written(Path(folder), _figure_files(result, runs, names, predictions))


def _parts(
    result: FitResult, runs: Run | Sequence[Run]
) -> tuple[list[Run], list[str], Sequence[Mapping[str, np.ndarray]]]:
    """The runs of a result, their names as files, and what it predicts for each."""
    runs = [runs] if isinstance(runs, Run) else list(runs)
    if [run.sha256 for run in runs] != [record.sha256 for record in result.runs]:
        raise InputError("the runs are not those of the result: give the same ones in their order")
    # A result that was loaded has no predictions with it.
    predictions = result.predictions or [result.predict(run) for run in runs]
    return runs, unique_names(runs), predictions


def _written(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    paths = {folder / name: data for name, data in contents.items()}
    write_files(paths, force=True)
    return list(paths)


def _as_json(value: Any) -> Any:
    """What becomes of a value that is written as JSON and read again."""
    return json.loads(json.dumps(value))


def _worth_drawing(result: FitResult) -> list[int]:
    """All runs, or of many those that are described worst, in their order."""
    if len(result.runs) <= _MOST_RUNS:
        return list(range(len(result.runs)))

    def misfit(record: RunFit) -> float:
        ratios = [c.rmse / c.noise for c in record.channels.values() if c.rmse]
        return max(ratios, default=0.0)

    worst = sorted(range(len(result.runs)), key=lambda index: -misfit(result.runs[index]))
    return sorted(worst[:_MOST_RUNS])


def _figure_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
) -> dict[str, bytes]:
    files = {}
    drawn = _worth_drawing(result)
    everything = list(zip(runs, names, predictions, result.runs, strict=True))
    for run, name, predicted, record in (everything[index] for index in drawn):
        file = "recorded.png" if len(runs) == 1 else f"recorded_{name}.png"
        files[file] = to_png(recorded_figure(result, run, predicted, record))
    files["residuals.png"] = to_png(residuals_figure(result, runs, predictions))
    files["correlation.png"] = to_png(correlation_figure(result))
    return files


def _remove_stale_figures(folder: Path) -> None:
    """Remove the figures of an earlier fit, which do not show this one."""
    for pattern in ("recorded.png", "recorded_*.png", "residuals.png", "correlation.png"):
        for path in folder.glob(pattern):
            try:
                # A person's own figure of such a name does not carry the signature.
                if SIGNATURE.encode() in path.read_bytes()[:200]:
                    path.unlink()
            except OSError:
                continue
