"""Whether a folder may take the result of a fit."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .._errors import InputError
from .._files import read_bytes
from .._limits import RESULT_BYTES
from .._syntax import parse_json
from ..runs import Run, check_output_folder
from ._names import RESULT

# What makes two fits the same fit; the iterations allowed and the folder do not.
_SAME = (
    *("definition", "runs", "free", "start", "fix", "loss", "begin"),
    *("priors", "bounds", "ties", "groups", "hold_out"),
)
_WORDS = {
    "definition": "the model's constants",
    "runs": "what the sidecar states",
    "loss": "loss",
    "hold_out": "what is held out",
}


def check_folder(
    folder: str | Path, runs: Sequence[Run], config: Mapping[str, Any], *, force: bool = False
) -> None:
    """Refuse a folder that cannot take a result, or holds one of something else.

    Call it before the fit, which may take hours.

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
        raise InputError(f"{path} cannot be read ({error.strerror}): {remedy}") from None
    except (ValueError, LookupError, TypeError, AttributeError):
        raise InputError(f"{path} is not a result of giajax: {remedy}") from None
    if checksums != [run.sha256 for run in runs]:
        names = ", ".join(str(run.get("name")) for run in record["runs"])
        raise InputError(f"{folder} holds the result of other data ({names}): {remedy}")
    if differing:
        what = ", ".join(_WORDS.get(key, key) for key in differing)
        raise InputError(
            f"{folder} holds the result of another configuration (it differs in {what}): {remedy}"
        )


def _as_json(value: Any) -> Any:
    """What becomes of a value that is written as JSON and read again."""
    return json.loads(json.dumps(value))
