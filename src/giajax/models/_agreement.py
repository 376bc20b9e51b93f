"""Whether the sidecars of runs that are fitted together agree."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from .._errors import InputError
from ..arm import Arm
from ..kinds import ArmSection, CamerasSection, LandmarksSection, Section, SensorsSection
from ..runs import Run
from ._definition import arm_from_definition, arm_to_definition
from ._sensors import Sensors
from ._sensors_definition import SECTIONS, sensors_from_definition, sensors_to_definition

S = TypeVar("S", bound=Section)

_SECTIONS = (ArmSection, SensorsSection, CamerasSection, LandmarksSection)


def agreed_parts(runs: Sequence[Run]) -> tuple[Arm, Sensors]:
    """The arm and the sensors of some runs.

    Raises:
        InputError: the sidecars disagree in [arm], [sensors], [camera] or [landmark].
    """
    first, *others = runs
    arm = arm_from_definition(first.definition)
    sensors = sensors_from_definition(first.definition)
    sections = [first.definition.section(of) for of in _SECTIONS]
    for other in others:
        if [other.definition.section(type(of)) for of in sections] == sections:
            continue
        their_arm = arm_from_definition(other.definition)
        their_sensors = sensors_from_definition(other.definition)
        check_agreement(
            "arm", (first, arm_to_definition(arm)), (other, arm_to_definition(their_arm))
        )
        ours, theirs = sensors_to_definition(sensors), sensors_to_definition(their_sensors)
        for name in SECTIONS:
            check_agreement(name, (first, ours.get(name, {})), (other, theirs.get(name, {})))
    return arm, sensors


def agreed_section(runs: Sequence[Run], name: str, of: type[S]) -> S:
    """The section that the sidecars of some runs have alike.

    Arguments:
        runs: that are fitted together.
        name: of the section.
        of: its class.

    Raises:
        InputError: the sidecars disagree in it.
    """
    first, *others = runs
    section = first.definition.section(of)
    for other in others:
        if other.definition.section(of) != section:
            raise InputError(
                f"the sidecars of '{first.name}' and '{other.name}' disagree in [{name}]: "
                "correct one, or fit the runs separately"
            )
    return section


def check_agreement(
    section: str, first: tuple[Run, Mapping[str, Any]], other: tuple[Run, Mapping[str, Any]]
) -> None:
    """Refuse two runs whose sidecars state a key of a section differently.

    Arguments:
        section: its name.
        first: a run, and what it states in the section, by key; None where it states nothing.
        other: another one.

    Raises:
        InputError: naming the runs, the key and both values.
    """
    (one, ours), (two, theirs) = first, other
    for key in {**ours, **theirs}:
        if ours.get(key) != theirs.get(key):
            both = " and ".join(
                "nothing" if values.get(key) is None else str(values[key])
                for values in (ours, theirs)
            )
            raise InputError(
                f"the sidecars of '{one.name}' and '{two.name}' disagree in [{section}] "
                f"{key} ({both}): correct one, or fit the runs separately"
            )
