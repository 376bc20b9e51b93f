"""One fit of a sweep, as a worker does it: from plain data to plain data."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._errors import InputError
from ..runs import Definition
from ..tasks import FitTask, checksums_of


def fitted(
    definition: Mapping[str, Any],
    inputs: Mapping[str, Sequence[Sequence[str | None]]],
    rename: Mapping[str, str],
    begin: Mapping[str, Any] | None,
    paths: Mapping[str, Sequence[str]],
) -> dict[str, Any]:
    """Fit, without the checks that end a single fit: gradient, tolerance and suspects.

    Arguments:
        definition: all settings, as `Definition.contents` has them.
        inputs: name of each file of `data` and `validation` with the SHA-256 of its content and of
            its sidecar, which is None where there is none.
        rename, begin: as of `FitTask`.
        paths: where the files are, in the same order.

    Returns:
        How it ended, and what it found.

    Raises:
        InputError: a file has changed, or the fit cannot be done.
        KeyboardInterrupt: it was stopped.
    """
    for part, files in inputs.items():
        for (_, *before), path in zip(files, paths[part], strict=True):
            if list(checksums_of([Path(path)]).values()) != before:
                raise InputError(f"{path} has changed since the sweep began: sweep again")
    task = FitTask(
        Definition.parse(definition, "the plan"),
        data=tuple(map(Path, paths["data"])),
        validation=tuple(map(Path, paths["validation"])),
        rename=rename,
        begin=begin,
    )
    result = task.run(check=False)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    estimates: dict[str, Any]
    estimates = {path: item for path, item in result.parameters.items() if item.free}
    for run in result.runs:
        own = run.parameters.keys() - result.parameters.keys()
        estimates |= {f"{path} of {run.name}": run.parameters[path] for path in sorted(own)}
    return {
        "status": result.status,
        "message": result.message,
        "values": {path: item.value for path, item in estimates.items()},
        "errors": {path: item.standard_error for path, item in estimates.items()},
        "cost": result.cost,
        "reduced_chi_square": result.reduced_chi_square,
        "verdict": result.verdict.status,
        "iterations": result.iterations,
    }
