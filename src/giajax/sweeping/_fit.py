"""One fit of a sweep, as a worker does it: from plain data to plain data."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ..runs import Definition
from ..tasks import FitTask, checksums_of

if TYPE_CHECKING:
    from ..fitting import FitResult, HeldOut, PredictionErrors, RunFit


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
        InputError: a file has changed, 32-bit, or the fit cannot be done.
        KeyboardInterrupt: it was stopped.
    """
    check_precision()
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
    for run, name in zip(result.runs, _names(result.runs), strict=True):
        estimates |= {f"{path} of {name}": item for path, item in run.parameters.items()}
    return {
        "status": result.status,
        "message": result.message,
        "values": {path: item.value for path, item in estimates.items()},
        "errors": {path: item.standard_error for path, item in estimates.items()},
        "cost": result.cost,
        "reduced_chi_square": result.reduced_chi_square,
        "verdict": result.verdict.status,
        "iterations": result.iterations,
        "rmse": _prediction(result),
    }


def _prediction(result: "FitResult") -> dict[str, float | None]:
    """RMSE of what was not fitted, in the unit of the recording, by channel and run."""
    parts: dict[str, Sequence[PredictionErrors | HeldOut]]
    parts = {"validation": result.validation, "held_out": result.held_out}
    return {
        f"{part}.{channel} of {name}": errors.rmse
        for part, runs in parts.items()
        for run, name in zip(runs, _names(runs), strict=True)
        for channel, errors in run.channels.items()
    }


def _names(runs: "Sequence[RunFit | PredictionErrors | HeldOut]") -> list[str]:
    """Of each run; of several that are called the same, with their paths."""
    several = Counter(run.name for run in runs)
    return [run.name if several[run.name] == 1 else f"{run.name} ({run.path})" for run in runs]


def check_precision() -> None:
    """Refuse 32-bit: what is kept of a fit does not say how precise it is.

    Raises:
        InputError: JAX computes in 32-bit.
    """
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            "JAX computes in 32-bit, in which no sweep is kept: call "
            'jax.config.update("jax_enable_x64", True) first'
        )
