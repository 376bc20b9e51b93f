"""Write a result to a folder of files."""

import dataclasses
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..fitting import Estimate, FitResult, matching_runs
from ..models import AbstractModel, capabilities, preset_of
from ..recordings import (
    Definition,
    Figure,
    Run,
    check_output_folder,
    make_folder,
    run_keys,
    unique_names,
    write_files,
)
from ..runtime.files import parse_json, read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.pictures import CAPTION, FORMATS, remove_own
from ..runtime.records import plain_data
from ..runtime.text import InputError, format_estimate
from ..schema.parameters import find, switched_on
from ..studies import with_fitted_states
from ._text import PAGE, RESULT

# Settings that must agree for two fits to be the same. The iteration limit and the folder need not.
_SAME = (
    *("definition", "runs", "free", "start", "fix", "loss", "begin"),
    *("priors", "bounds", "ties", "groups", "hold_out"),
)
_WORDS = {
    "definition": "the constants of the model",
    "runs": "the content of the sidecar",
    "loss": "loss",
    "hold_out": "the held-out data",
}


def check_folder(
    folder: str | Path, runs: Sequence[Run], config: Mapping[str, Any], *, force: bool = False
) -> None:
    """Refuse a folder that cannot be written, or that contains a different result.

    Call it before the fit, which may take hours.

    Arguments:
        folder: folder for `write_result`; it need not exist.
        config: configuration of the fit, `Setup.config` from `giajax.fitting.set_up`.

    Raises:
        InputError: the folder is a file, cannot be written, or (without `force`) contains a
            result computed from other data, with another configuration, or by another program.
    """
    folder = Path(folder)
    check_output_folder(folder)
    path = folder / RESULT
    if force or not path.exists():
        return
    remedy = "give another --out, or --force to overwrite it"
    try:
        record = parse_json(read_bytes(path, RESULT_BYTES).decode(), path)
        checksums = [run["sha256"] for run in record["runs"]]
        before = record["config"]
        differing = [key for key in _SAME if before.get(key) != plain_data(config.get(key))]
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): {remedy}") from None
    except (ValueError, LookupError, TypeError, AttributeError):
        raise InputError(f"{path} is not a giajax result: {remedy}") from None
    if checksums != [run.sha256 for run in runs]:
        names = ", ".join(str(run.get("name")) for run in record["runs"])
        raise InputError(f"{folder} contains a result computed from other data ({names}): {remedy}")
    if differing:
        what = ", ".join(_WORDS.get(key, key) for key in differing)
        raise InputError(
            f"{folder} contains a result computed with another configuration (it differs in "
            f"{what}): {remedy}"
        )


@dataclasses.dataclass(frozen=True)
class Reached:
    """Comparison of a result with one figure: whether it is reached, and a sentence on it."""

    path: str
    reached: bool
    sentence: str


def check_figures(model: AbstractModel, definition: Definition) -> None:
    """Refuse `[figures]` of parameters that the model does not have, before anything is fitted.

    Raises:
        InputError: a path is unknown; the message names it and the nearest known path.
    """
    asked = definition.fit
    model = switched_on(model, (*(asked.free or ()), *(asked.start or ()), *(asked.fix or ())))
    derived = capabilities.derived(model)
    for path in definition.figures:
        if path not in derived:
            find(model, path)


def reached(result: FitResult, definition: Definition) -> list[Reached]:
    """Compare a result with each of the `[figures]` of a fit definition, in order."""
    estimates = {**result.parameters, **result.derived}
    return [
        Reached(path, *_compare(estimates.get(path), figure))
        for path, figure in definition.figures.items()
    ]


def _compare(estimate: Estimate | None, figure: Figure) -> tuple[bool, str]:
    value, allowed, relative = figure.value, figure.standard_errors, figure.relative_error
    if estimate is None or not estimate.free:
        return False, "was not fitted"
    error = estimate.standard_error
    # An error larger than the value means that the parameter is barely determined.
    determined = error is not None and error <= abs(estimate.value)
    if figure.determined is False:
        return not determined, "is not determined" if not determined else "is determined"
    if error is None or not error > 0:
        return False, "has no standard error"
    shown = " +- ".join(format_estimate(estimate.value, error))
    sentences, good = [], True
    if value is not None and allowed is not None:
        away = abs(estimate.value - value) / error
        good &= away <= allowed
        sentences.append(f"{away:.2g} standard errors from {value:g} (limit: {allowed:g})")
    if value is not None and figure.within is not None:
        off = abs(estimate.value / value - 1) if value else abs(estimate.value)
        good &= off <= figure.within
        sentences.append(f"{off:.2%} from {value:g} (limit: {figure.within:.2%})")
    if relative is not None:
        achieved = error / abs(estimate.value) if estimate.value else float("inf")
        good &= achieved <= relative
        sentences.append(f"standard error {achieved:.2%} (limit: {relative:.2%})")
    return good, f"{shown}: {', '.join(sentences)}"


def _prediction_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
) -> dict[str, bytes]:
    """Return the contents of `prediction.csv` and, if it is a run, its sidecar, by file name."""
    tables = [_table(run, predicted) for run, predicted in zip(runs, predictions, strict=True)]
    if len(runs) == 1:
        data = _csv(tables[0])
        sidecar = _sidecar(result, runs[0], hashlib.sha256(data).hexdigest())
        return {"prediction.csv": data, "prediction.toml": sidecar.to_toml().encode()}
    columns = list(dict.fromkeys(column for table in tables for column in table))
    together: dict[str, list[str]] = {"run": [], **{column: [] for column in columns}}
    for name, table in zip(names, tables, strict=True):
        count = len(next(iter(table.values())))
        together["run"] += [name] * count
        for column in columns:
            together[column] += table.get(column, [""] * count)
    return {"prediction.csv": _csv(together)}


def _table(run: Run, predicted: Mapping[str, np.ndarray]) -> dict[str, list[str]]:
    """Return cells by column, with predicted values in place of measured ones."""
    columns = {}
    if run.times is not None:
        columns["time_s"] = _cells(run.times, 12)
    for name, channel in run.channels.items():
        values = predicted.get(name, run.values[name])
        if channel.quantity == "text":
            columns[channel.column] = ["" if text is None else str(text) for text in values]
        else:
            columns[channel.column] = _cells(channel.from_si(values), 9)
    return columns


def _cells(values: np.ndarray, digits: int) -> list[str]:
    # Adding zero turns -0.0 into 0.0.
    return [f"{v:.{digits}g}" if np.isfinite(v) else "" for v in (values + 0.0).tolist()]


def _csv(columns: Mapping[str, list[str]]) -> bytes:
    lines = [",".join(columns), *map(",".join, zip(*columns.values(), strict=True))]
    return ("\n".join(lines) + "\n").encode()


def _sidecar(result: FitResult, run: Run, checksum: str) -> Definition:
    """Return a sidecar for the prediction, so it can be read, checked and fitted as a run."""
    sidecar = run.definition.contents()
    # A prediction does not have the noise of the recording.
    about = [key for key in run_keys(model=False) if key != "noise"]
    definition = result.model.definition()
    model = {key: definition[key] for key in run.kind.sections if key in definition}
    begun: dict[str, Any] = {"arm": preset_of(run.definition)} if "arm" in model else {}
    if capabilities.uncertain(result.model, [run]):
        # A prediction was not recorded by a device, so it has no uncertain device parameters.
        begun["uncertainty"] = {"defaults": False}
    return Definition.parse(begun).merged_with(
        Definition.parse(
            {
                "model": run.model,
                "origin": f"predicted by giajax from a fit to {run.name}",
                "sha256": checksum,
                **model,
                **{key: sidecar[key] for key in about if key in sidecar},
            },
            "prediction.toml",
        )
    )


def write_result(
    result: FitResult,
    runs: Run | Sequence[Run],
    folder: str | Path,
    *,
    figures: bool = True,
    held_out: Sequence[Run] = (),
) -> list[Path]:
    """Write a result to a folder, which is made if it does not exist.

    `result.json` is the result itself (`giajax.load_result`). `prediction.csv` has the columns of
    the recording, with fitted values in place of recorded ones, at every time. For one run it is
    itself a run with a sidecar; for several it has a leading column `run`. Each file is written
    completely or not at all. `result.json` is written first, because it takes longest to compute,
    and a later step may fail. Pictures of an earlier fit are removed.

    Arguments:
        runs: the fitted runs, in the same order.
        folder: the folder, whose files are overwritten; use `check_folder` to refuse that.
        figures: True to draw pictures, too; `write_figures` draws them later.
        held_out: the held-out parts of the runs, for the pictures.

    Raises:
        InputError: the runs are not those of the result, or the folder cannot be written.

    Example:
        >>> write_result(result, runs, "giajax-out/base_step")  # doctest: +SKIP
    """
    folder = Path(folder)
    runs, names, predictions = _parts(result, runs)
    check_output_folder(folder)
    make_folder(folder)
    files = _written(folder, {RESULT: result.to_json().encode()})
    _remove_stale_pictures(folder)
    files += _written(folder, _prediction_files(result, runs, names, predictions))
    if figures:
        # Imported only for pictures, because the import of matplotlib is slow.
        from ._pictures import picture_files

        files += _written(folder, picture_files(result, runs, names, predictions, held_out))
    return files


def write_figures(
    result: FitResult,
    runs: Run | Sequence[Run],
    folder: str | Path,
    *,
    held_out: Sequence[Run] = (),
) -> list[Path]:
    """Draw pictures of a result in the folder that `write_result` wrote.

    The pictures show recorded and fitted values of each run (with many runs, of those with the
    largest residuals), the residuals and the correlations. `runs` and `held_out`, their held-out
    parts, are in the order of the result.

    Raises:
        InputError: the runs are not those of the result, or the folder cannot be written.
    """
    from ._pictures import picture_files

    return _written(Path(folder), picture_files(result, *_parts(result, runs), held_out))


def _parts(
    result: FitResult, runs: Run | Sequence[Run]
) -> tuple[list[Run], list[str], Sequence[Mapping[str, np.ndarray]]]:
    """Return the runs of a result, their names in file names, and the predictions for each."""
    runs = matching_runs(result.runs, runs, whole=True)
    # A loaded result does not contain its predictions.
    begun = runs if result.predictions else with_fitted_states(result, runs)
    predictions = result.predictions or [result.predict(run) for run in begun]
    return runs, unique_names(runs), predictions


def _written(folder: Path, contents: Mapping[str, bytes]) -> list[Path]:
    paths = {folder / name: data for name, data in contents.items()}
    write_files(paths, force=True)
    return list(paths)


def _remove_stale_pictures(folder: Path) -> None:
    """Remove the pictures and the page of an earlier fit, which are no longer valid."""
    of_runs = ("recorded", "recorded_*", "held_out_*")
    whole = ("residuals", "correlation", "left_over", "bootstrap", "influence")
    endings = (*FORMATS, CAPTION)
    pictures = (f"{name}.{each}" for name in (*of_runs, *whole) for each in endings)
    for pattern in (*pictures, PAGE):
        for path in folder.glob(pattern):
            # A PDF has the signature at its end, and a page may have it anywhere.
            remove_own(path, 200 if pattern == PAGE else None)
