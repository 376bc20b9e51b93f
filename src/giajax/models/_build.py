"""Which model a set of runs, or a stored result, needs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..parameters import declared, replace
from ..runs import Definition, Run
from ._arm import ArmModel, step_limit
from ._definition import arm_from_definition
from ._protocol import AbstractModel


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
        _check_agreement(first, run)
    if first.model != ArmModel.kind:
        raise InputError(
            f"'{first.name}' is a run of the {first.model} model, which this version of giajax "
            "cannot fit yet; it fits runs of an arm"
        )
    durations = [float(np.ptp(run.times)) for run in runs if run.times is not None]
    limit = step_limit(max(durations, default=0.0))
    return ArmModel(arm_from_definition(first.definition), max_steps=limit)


def _check_agreement(first: Run, other: Run) -> None:
    model = ArmModel(arm_from_definition(first.definition)).definition()["arm"]
    theirs = ArmModel(arm_from_definition(other.definition)).definition()["arm"]
    for key, value in model.items():
        if theirs[key] != value:
            raise InputError(
                f"the sidecars of '{first.name}' and '{other.name}' disagree in [arm] {key} "
                f"({value} and {theirs[key]}); correct one, or fit the runs separately"
            )


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
    if kind != ArmModel.kind:
        raise InputError(f"this version of giajax has no model '{kind}'")
    arm = arm_from_definition(Definition.parse({"arm": definition["arm"]}, "stored result"))
    return replace(ArmModel(arm, **definition["simulation"]), parameters)


def parameter_values(model: AbstractModel) -> dict[str, Any]:
    """All declared parameters of a model by path, as numbers and lists of numbers."""
    return {
        path: np.asarray(parameter.value(model), dtype=float).tolist()
        for path, parameter in declared(model).items()
    }
