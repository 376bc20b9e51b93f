"""What a stored result says of how it was fitted and of where it ended. Imports no JAX."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from .._files import check_path, read_bytes
from .._limits import RESULT_BYTES
from .._syntax import parse_json

if TYPE_CHECKING:
    from ..fitting import FitResult

# What makes two fits the same; what ended one early is none of it.
_WORDS = {"definition": "the model's constants", "runs": "what the sidecars state"}


def stored_result(path: str | Path) -> tuple[Path, dict[str, Any]]:
    """A `result.json` as plain data, and the folder it is in.

    Arguments:
        path: of the file, or of its folder.

    Raises:
        InputError: there is no such file, or it is no result.
    """
    path = Path(path)
    check_path(path)
    path = path / "result.json" if path.is_dir() else path
    try:
        record = parse_json(read_bytes(path, RESULT_BYTES).decode(), path)
        record["config"].items(), record["parameters"].items(), record["status"], record["runs"]
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give the folder of a finished fit") from None
    except InputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        raise InputError(f"{path} is not a result of giajax: give the folder of a fit") from None
    return path.parent, record


def repeatable(path: str | Path) -> tuple[Path, dict[str, Any]]:
    """As `stored_result`, of a fit that can be done again.

    Raises:
        InputError: it does not say how it was fitted, or ended when its time was up.
    """
    folder, record = stored_result(path)
    if not record.get("task"):
        raise InputError(
            f"{folder / 'result.json'} does not say how to fit it again, because an earlier "
            "version wrote it or it was fitted from Python without a task: fit its data anew"
        )
    timed = record["status"] == "not_converged" and "budget_s" in record["config"]
    if record["status"] == "interrupted" or timed:
        raise InputError(
            f"{folder / 'result.json'} is of a fit that was stopped when its time was up, which no "
            f"fit meets again: go on with giajax fit --resume {folder}, or begin from there with "
            "--from"
        )
    return folder, record


def check_config(before: Mapping[str, Any], now: Mapping[str, Any], where: Path) -> None:
    """Refuse settings that are resolved differently here.

    Arguments:
        before: `config` of a result or a journal.
        now: `Setup.config`.
        where: the file that has the former, for an error.
    """
    plain = json.loads(json.dumps(now))
    differing = [_WORDS.get(key, key) for key, value in plain.items() if before.get(key) != value]
    if differing:
        raise InputError(
            f"this version of giajax resolves the settings of {where} differently (in "
            f"{', '.join(differing)}): go on with the version that wrote it, or fit anew"
        )


def compared(result: "FitResult", before: Mapping[str, Any]) -> str:
    """A sentence on whether a fit that was done again gave the same numbers.

    Arguments:
        result: of now.
        before: the stored one, as plain data.
    """
    now = json.loads(result.to_json())
    keys = ("parameters", "correlation", "cost", "reduced_chi_square", "history")
    if not any("sources" in estimate for estimate in before["parameters"].values()):
        # An earlier version did not say what each recording is worth.
        for estimate in now["parameters"].values():
            del estimate["sources"]
    same = all(now[key] == before[key] for key in keys)
    for key, what in (("runs", "runs fitted"), ("held_out", "runs with a part held out")):
        ours, theirs = now[key], before.get(key, [])
        if len(ours) != len(theirs):
            return f"it is not the same fit: {len(ours)} {what} now, and {len(theirs)} before"
        for one, other in zip(ours, theirs, strict=True):
            # Their files may be elsewhere now.
            same = same and one["channels"] == other["channels"]
            same = same and one.get("parameters", {}) == other.get("parameters", {})
    if same:
        return "the numbers are the same, bit for bit"
    moved = {}
    for path, estimate in now["parameters"].items():
        value, other = estimate["value"], before["parameters"].get(path, {}).get("value")
        if estimate["free"] and value != other and other:
            moved[path] = abs(value / other - 1)
    if not moved:
        return "the estimates are the same bit for bit, and what follows from them is not"
    path = max(moved, key=lambda path: moved[path])
    return f"the numbers are not the same: {path} differs by {moved[path]:.1e} of its value"


def reached_by(result: "str | Path | FitResult") -> dict[str, Any]:
    """Where a fit ended, as another one begins: `giajax.fitting.Beginning` as plain data.

    Arguments:
        result: a result, its file or its folder.

    Raises:
        InputError: it is no result.
    """
    if isinstance(result, str | Path):
        return _beginning(stored_result(result)[1])
    return _beginning(json.loads(result.to_json()))


def _beginning(record: Mapping[str, Any]) -> dict[str, Any]:
    try:
        estimates = record["parameters"]
        fixed = {path.partition("[")[0] for path in record["config"].get("fix", {})}
        values = {
            path: estimate["value"]
            for path, estimate in estimates.items()
            if estimate["free"] or path in fixed
        }
        own = {
            run["name"]: {path: item["value"] for path, item in run["parameters"].items()}
            for run in record["runs"]
            if run.get("parameters")
        }
        return {"model": record["model"], "values": values, "own": own}
    except (LookupError, TypeError, AttributeError):
        raise InputError("this is not a result of giajax: give the folder of a fit") from None


def without(beginning: Mapping[str, Any], paths: Iterable[str]) -> dict[str, Any]:
    """A beginning without the values that others have replaced, of the whole or of an element."""
    replaced = set(paths)
    kept = {
        path: value
        for path, value in beginning["values"].items()
        if not {path, path.partition("[")[0]} & replaced
    }
    return {**beginning, "values": kept}
