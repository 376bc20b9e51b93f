"""The arm with one of its choices made another way: where drag acts, and what floats."""

import dataclasses
from collections.abc import Iterator

from .._errors import InputError
from ..arm import STANDARD_GRAVITY, Arm, Buoyancy, trimmed


def arm_variants(arm: Arm) -> dict[str, Arm]:
    """Arms that differ in one choice of `[arm]`.

    Arguments:
        arm: the arm.

    Returns:
        The other arms, by the key and the value of `[arm]` that make them.
    """
    return dict(_variants(arm))


def _variants(arm: Arm) -> Iterator[tuple[str, Arm]]:
    air = arm.air
    if air.drag == "centre":
        yield "arm.drag = strip", _in(arm, dataclasses.replace(air, drag="strip"))
    else:
        # Drag at the centres has the velocity along a link already.
        centre = dataclasses.replace(air, drag="centre", axial_coefficient=None)
        yield "arm.drag = centre", _in(arm, centre)
    curve = "cylinder" if air.drag_curve == "constant" else "constant"
    yield f"arm.drag_curve = {curve}", _in(arm, dataclasses.replace(air, drag_curve=curve))
    if arm.buoyancy is None:
        still = float(arm.gravity) == 0
        floating = dataclasses.replace(
            arm,
            buoyancy=Buoyancy(trim_position=arm.links.length / 2),
            gravity=STANDARD_GRAVITY if still else arm.gravity,
        )
        try:
            yield "arm.trim = true", trimmed(floating, level=True)
        except InputError:  # It is too heavy to float, as the rods of a pendulum are.
            return


def _in(arm: Arm, air: object) -> Arm:
    return dataclasses.replace(arm, air=air)
