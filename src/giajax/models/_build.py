"""Which model a set of runs, or a stored result, needs."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

import equinox as eqx
import numpy as np

from .._errors import InputError
from ..kinds import KINDS
from ..parameters import declared, replace
from ..runs import Run, upgraded
from ._protocol import AbstractModel


def model_class(kind: str) -> type[AbstractModel]:
    """The class of a kind, or of several as `arm+joint`; imported when a model of it is built."""
    where = "_several:SeveralModels" if "+" in kind else KINDS[kind].model
    module, _, name = where.partition(":")
    model: type[AbstractModel] = getattr(import_module(f".{module}", __package__), name)
    return model


def model_for(runs: Sequence[Run]) -> AbstractModel:
    """The model of some runs, with the constants that their sidecars state.

    Of runs of several kinds it has a model of each, which share the parameters of the same path.

    Raises:
        InputError: the sidecars of runs contradict each other.
    """
    return model_class("+".join(dict.fromkeys(run.model for run in runs))).for_runs(runs)


def build_model(
    kind: str, definition: Mapping[str, Any], parameters: Mapping[str, Any]
) -> AbstractModel:
    """The model that a stored result describes.

    Arguments:
        kind: name of the model.
        definition: what its `definition()` gave.
        parameters: values by path.

    Raises:
        InputError: an unknown kind or path.
    """
    older = upgraded({"model": kind, **definition})
    kind = older.pop("model")
    for name in kind.split("+"):
        if name not in KINDS:
            raise InputError(
                f"there is no kind of model '{name}' in this version: use one of {', '.join(KINDS)}"
            )
    former = KINDS[kind].former_parameters if kind in KINDS else ()
    values = {path: v for path, v in parameters.items() if path.partition("[")[0] not in former}
    # Whole arrays first: an element may belong to an array that the definition has as a number.
    whole = {path: value for path, value in values.items() if "[" not in path}
    return replace(replace(model_class(kind).from_definition(older), whole), values)


def parameter_values(model: eqx.Module) -> dict[str, Any]:
    """All declared parameters of a model or a part of one by path, as numbers and lists of them."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
