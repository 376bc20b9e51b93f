"""The arm and the sensors that the sidecars of some runs state, which must agree."""

from collections.abc import Sequence
from typing import Any

from .._errors import InputError
from ..arm import Arm
from ..kinds import ArmSection, SensorsSection
from ..runs import Run
from ._definition import (
    arm_from_definition,
    arm_to_definition,
    sensors_from_definition,
    sensors_to_definition,
)
from ._sensors import Sensors


def agreed_parts(runs: Sequence[Run]) -> tuple[Arm, Sensors]:
    """The arm and the sensors of some runs.

    Raises:
        InputError: the sidecars disagree in [arm] or [sensors].
    """
    first, *others = runs
    arm = arm_from_definition(first.definition)
    sensors = sensors_from_definition(first.definition)
    sections = [first.definition.section(of) for of in (ArmSection, SensorsSection)]
    for other in others:
        if [other.definition.section(type(of)) for of in sections] == sections:
            continue
        their_arm = arm_from_definition(other.definition)
        their_sensors = sensors_from_definition(other.definition)
        for section, ours, theirs in (
            ("arm", arm_to_definition(arm), arm_to_definition(their_arm)),
            ("sensors", sensors_to_definition(sensors), sensors_to_definition(their_sensors)),
        ):
            _check_agreement(section, (first, ours), (other, theirs))
    return arm, sensors


def _check_agreement(
    section: str, first: tuple[Run, dict[str, Any]], other: tuple[Run, dict[str, Any]]
) -> None:
    (one, ours), (two, theirs) = first, other
    for key in {**ours, **theirs}:
        if ours.get(key) != theirs.get(key):
            said = " and ".join(
                "nothing" if values.get(key) is None else str(values[key])
                for values in (ours, theirs)
            )
            raise InputError(
                f"the sidecars of '{one.name}' and '{two.name}' disagree in [{section}] "
                f"{key} ({said}); correct one, or fit the runs separately"
            )
