"""What `--model` names, in every command alike: a fit, or a file that states a model."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from .._errors import InputError

if TYPE_CHECKING:
    from ..models import AbstractModel
    from ..runs import Definition, Run


def is_result(path: Path) -> bool:
    """Whether this is a fit: its folder, or its result.json."""
    return path.is_dir() or path.suffix == ".json"


def definition_of(path: Path | None) -> "Definition":
    """What a file that states a model says on top of the sidecars; nothing of a fit.

    Raises:
        InputError: there is no such file, or it is not legal.
    """
    from ..runs import Definition

    if path is not None and not path.exists():
        raise InputError(
            f"{path} does not exist: give the folder of a fit, its result.json, or a TOML file "
            "that states a model"
        )
    if path is None:
        return Definition()
    if is_result(path):
        from ..tasks import stored_result

        # What is no result is told before JAX is imported, which takes seconds.
        stored_result(path)
        return Definition()
    return Definition.load(path)


def model_of(path: Path | None, runs: Sequence["Run"]) -> "AbstractModel":
    """The model of a fit, or else of the runs, which were read with `definition_of` the file."""
    from ..fitting import load_result
    from ..models import model_for

    return model_for(runs) if path is None or not is_result(path) else load_result(path).model
