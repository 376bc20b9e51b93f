"""Which model a set of runs, or a stored result, needs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..parameters import declared, replace
from ..runs import Run
from ._arm import ArmModel
from ._hysteresis import HysteresisModel
from ._joint import JointModel
from ._muscle import MuscleModel
from ._protocol import AbstractModel

MODELS: dict[str, type[AbstractModel]] = {
    ArmModel.kind: ArmModel,
    HysteresisModel.kind: HysteresisModel,
    JointModel.kind: JointModel,
    MuscleModel.kind: MuscleModel,
}
"""The models by name; nothing else in the toolkit knows which there are."""


def model_for(runs: Sequence[Run]) -> AbstractModel:
    """The model of some runs, with the constants that their sidecars state.

    Raises:
        InputError: runs of several models, of a model that this version cannot fit, or whose
            sidecars contradict each other.
    """
    first, *others = runs
    for run in others:
        if run.model != first.model:
            raise InputError(
                f"'{first.name}' is a run of the {first.model} model and '{run.name}' of the "
                f"{run.model} model; fit them separately"
            )
    if first.model not in MODELS:
        raise InputError(
            f"'{first.name}' is a run of the {first.model} model, which this version of giajax "
            f"cannot fit yet; it fits runs of: {', '.join(MODELS)}"
        )
    return MODELS[first.model].for_runs(runs)


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
    if kind not in MODELS:
        raise InputError(f"this version of giajax has no model '{kind}'")
    # Whole arrays first: an element may belong to an array that the definition has as a number.
    whole = {path: value for path, value in parameters.items() if "[" not in path}
    return replace(replace(MODELS[kind].from_definition(definition), whole), parameters)


def parameter_values(model: AbstractModel) -> dict[str, Any]:
    """All declared parameters of a model by path, as numbers and lists of numbers."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
