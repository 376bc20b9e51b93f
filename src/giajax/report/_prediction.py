"""What a fitted model predicts, as files: tables of its channels, and the sidecar of a run."""

import hashlib
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import FitResult
from ..runs import Definition, Run, run_keys


def prediction_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
) -> dict[str, bytes]:
    """`prediction.csv`, and its sidecar where it is a run: contents by name of the file.

    Arguments:
        result: the fit.
        runs: the runs that were fitted.
        names: of the runs, each another one.
        predictions: what the fitted model predicts for each run, SI, by channel.

    Returns:
        The contents, encoded.
    """
    tables = [_table(run, predicted) for run, predicted in zip(runs, predictions, strict=True)]
    if len(runs) == 1:
        data = _csv(tables[0])
        checksum = hashlib.sha256(data).hexdigest()
        return {
            "prediction.csv": data,
            "prediction.toml": _sidecar(result, runs[0], checksum).to_toml().encode(),
        }
    columns = list(dict.fromkeys(column for table in tables for column in table))
    together: dict[str, list[str]] = {"run": []}
    together |= {column: [] for column in columns}
    for name, table in zip(names, tables, strict=True):
        count = len(next(iter(table.values())))
        together["run"] += [name] * count
        for column in columns:
            together[column] += table.get(column, [""] * count)
    return {"prediction.csv": _csv(together)}


def _table(run: Run, predicted: Mapping[str, np.ndarray]) -> dict[str, list[str]]:
    """Cells by column: those of the recording, with predictions in place of measurements."""
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
    """What the prediction was made with, so that it can be read, checked and fitted as a run."""
    sidecar = run.definition.contents()
    # The noise is that of the recording, which a prediction does not have.
    about = [key for key in run_keys(model=False) if key != "noise"]
    definition = result.model.definition()
    model = {key: definition[key] for key in run.kind.sections if key in definition}
    return Definition.parse(
        {
            "model": run.model,
            "origin": f"predicted by giajax from a fit to {run.name}",
            "sha256": checksum,
            **model,
            **{key: sidecar[key] for key in about if key in sidecar},
        },
        "prediction.toml",
    )
