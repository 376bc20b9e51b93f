"""The arm with one of its choices made another way: where drag acts, and what floats."""

import dataclasses
from collections.abc import Iterator

import jax.numpy as jnp

from .._errors import InputError
from ..arm import STANDARD_GRAVITY, Air, Arm, Buoyancy, bodies, trimmed
from ..parameters import declared, get, replace
from ..quantities import BUOYANCY, DRIVE, JOINT_MEMORY
from ._arm_conditions import MASSES, SCALE, STRENGTHS


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
    if arm.joints.hysteresis.memory.strength is None:
        strength = JOINT_MEMORY.strength
        name = f"{strength.path} = {strength.default:g} {strength.unit}"
        yield name, replace(arm, {strength.path: strength.default})
    if arm.pneumatics is not None and arm.pneumatics.drive.lag is None:
        name = f"{DRIVE.lag.path} = {DRIVE.lag.default:g} {DRIVE.lag.unit}"
        yield name, replace(arm, {DRIVE.lag.path: DRIVE.lag.default})
    if air.added_mass_coefficient is not None:
        other = "inertia" if air.added_mass == "kirchhoff" else "kirchhoff"
        yield f"arm.added_mass = {other}", _in(arm, dataclasses.replace(air, added_mass=other))
    if arm.buoyancy is None:
        for depth in (None, BUOYANCY.trim_depth.default):
            try:
                floating = _floating(arm, depth)
            except InputError:  # It is too heavy to float, as the rods of a pendulum are.
                return
            below = "" if depth is None else f", trim_depth = {depth:g} m"
            yield f"arm.trim = true{below}", floating


def _floating(arm: Arm, depth: float | None) -> Arm:
    """The arm with trim weights that make each link float.

    It is heavier then. Positions do not show that: all that moves it grows by as much, so that
    only what floats and hangs is different. Without buoyancy nothing fixes the scale of an arm.
    """
    still = float(arm.gravity) == 0
    below = None if depth is None else jnp.asarray(depth, jnp.result_type(float))
    other = dataclasses.replace(
        arm,
        buoyancy=Buoyancy(trim_position=arm.links.length / 2, trim_depth=below),
        gravity=jnp.asarray(STANDARD_GRAVITY) if still else arm.gravity,
    )
    other = trimmed(other, level=True)
    ratio = float(jnp.sum(bodies(other).mass) / jnp.sum(bodies(arm).mass))
    # One strength of muscles is enough: the first that their law has.
    strength = [path for path in STRENGTHS if path in declared(arm)][:1]
    forces = [path for path in (*SCALE, *strength) if path not in MASSES and path in declared(arm)]
    return replace(other, {path: ratio * get(arm, path) for path in (forces if still else [])})


def _in(arm: Arm, air: Air) -> Arm:
    return dataclasses.replace(arm, air=air)
