"""The runs of a stored result, those that were held out too, read again from their files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .._errors import InputError
from ..runs import Definition, Parted, Run, observing, parted, read_run, rows_of, run_keys

if TYPE_CHECKING:
    from ..fitting import FitResult, HeldOut, RunFit


def fitted_runs(
    result: "FitResult",
    data: Sequence[str | Path] = (),
    *,
    rename: Mapping[str, str] | None = None,
) -> list[Run]:
    """The runs that a result was fitted to, as they were: channels, windows and what was stated.

    Arguments:
        result: of `giajax.load_result`.
        data: the files, where they lie elsewhere now; in any order.
        rename: the files' column name -> the name it has in the column table.

    Returns:
        The runs, in the order of the result, without what was held out of them.

    Raises:
        InputError: a file is missing, or is not the one that was fitted; or a run was made in
            memory.
    """
    parts = _read_again(result.model.kind, _described(result, "runs"), data, rename)
    return [run for part in parts if (run := part.fitted) is not None]


def held_out_runs(
    result: "FitResult",
    data: Sequence[str | Path] = (),
    *,
    rename: Mapping[str, str] | None = None,
) -> list[Run]:
    """What was held out of a fit, run by run: only these cells are in them.

    Arguments:
        result, data, rename: as of `fitted_runs`.

    Returns:
        The runs, in the order of `result.held_out`.

    Raises:
        InputError: as `fitted_runs`.
    """
    parts = _read_again(result.model.kind, _described(result, "hold_out"), data, rename)
    return [run for part in parts if (run := part.held) is not None]


def _described(result: "FitResult", key: str) -> "list[tuple[RunFit | HeldOut, Mapping[str, Any]]]":
    """The records of runs, or of what was held out, with what the configuration says of each."""
    records = result.runs if key == "runs" else result.held_out
    several = result.config.get(key, [])
    try:
        rows = [row for about in several for row in about.get("held_from", {}).values()]
        if all(isinstance(row, int) for row in rows):
            return list(zip(records, several, strict=True))
    except (AttributeError, TypeError, ValueError):
        pass
    raise InputError(
        "the result does not say of all its runs what was fitted: fit the data anew to ask about it"
    )


def _read_again(
    kind: str,
    several: "Sequence[tuple[RunFit | HeldOut, Mapping[str, Any]]]",
    data: Sequence[str | Path],
    rename: Mapping[str, str] | None,
) -> list[Parted]:
    """The runs of some records, each with what the configuration of the fit says of it."""
    read: dict[tuple[str, str], Run] = {}
    renamed = dict(rename or {})
    others = {} if not data else {read_run(path, rename=renamed).sha256: path for path in data}
    parts = []
    for record, about in several:
        path = others.get(record.sha256, record.path if not data else None)
        if path is None:
            raise InputError(_missing(record, data))
        if not data and not Path(path).exists():
            raise InputError(f"{path}, which was fitted, does not exist: give the file with --data")
        known = {key: item for key, item in about.items() if key in run_keys(model=False)}
        of = about.get("model", kind)
        definition = Definition.parse({"model": of, **known}, str(path))
        key = str(path), definition.to_toml()
        if key not in read:
            read[key] = read_run(path, rename=renamed, definition=definition)
        run = read[key]
        if run.sha256 != record.sha256:
            raise InputError(
                f"{path} is not the file that was fitted: its content has changed, so run the fit "
                "again or give the file that was"
            )
        whole = _rows_as_before(run, record.name, about)
        parts.append(parted(whole, about.get("held_from", {})))
    return parts


def _missing(record: "RunFit | HeldOut", data: Sequence[str | Path]) -> str:
    if record.path is None:
        return (
            f"'{record.name}' was made in memory and has no file: use Python, "
            "whose functions take the run itself"
        )
    named = ", ".join(map(str, data))
    return f"{named} have not the content of {record.path}, which was fitted: give that file"


def _rows_as_before(run: Run, name: str, about: Mapping[str, Any]) -> Run:
    """The channels and the window of a run that a fit had."""
    if "channels" in about:
        run = observing(run, about["channels"])
    if run.times is None or about.get("rows") in (None, len(run.times)):
        return run
    first = int(np.searchsorted(run.times, about["from_s"] - 1e-9))
    return rows_of(run, slice(first, first + int(about["rows"])), name)
