"""The arm with one choice made another way: where drag acts, what floats, and what air moves."""

import dataclasses
from collections.abc import Iterator

import jax.numpy as jnp

from .._errors import InputError
from ..arm import STANDARD_GRAVITY, Air, Arm, Buoyancy, bodies, trimmed
from ..parameters import declared, get, replace
from ..quantities import AIR, BUOYANCY, DRIVE, JOINT_MEMORY
from ._arm_conditions import MASSES, SCALE, STRENGTHS

_ADDED = AIR.added_mass_coefficient


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
    else:
        # The coefficient is tested as a parameter, with all terms that follow from it. In other
        # engines it is inertia alone; and drag that is wrong along a link hides what it does.
        inertia = f"arm.added_mass = inertia, {_ADDED.path} = {_ADDED.default:g}"
        yield inertia, _displacing(arm, dataclasses.replace(air, added_mass="inertia"))
        if air.drag == "centre":
            both = dataclasses.replace(air, drag="strip", added_mass="inertia")
            yield f"arm.drag = strip, {inertia}", _displacing(arm, both)
    if arm.buoyancy is None:
        for depth in (None, BUOYANCY.trim_depth.default):
            try:
                floating = _floating(arm, depth)
            except InputError:  # It is too heavy to float, as the rods of a pendulum are.
                return
            below = "" if depth is None else f", trim_depth = {depth:g} m"
            yield f"arm.trim = true{below}", floating


def _displacing(arm: Arm, air: Air) -> Arm:
    """The arm in that air, of which its links move as much as they displace."""
    coefficient = jnp.asarray(_ADDED.default, jnp.result_type(float))
    other = _in(arm, dataclasses.replace(air, added_mass_coefficient=coefficient))
    mass = float(jnp.sum(bodies(arm).mass))
    moved = _ADDED.default * float(jnp.sum(arm.air.density * arm.links.volume))
    return _moved_alike(other, arm, 1 + moved / mass)


def _floating(arm: Arm, depth: float | None) -> Arm:
    """The arm with trim weights that make each link float."""
    still = float(arm.gravity) == 0
    below = None if depth is None else jnp.asarray(depth, jnp.result_type(float))
    other = dataclasses.replace(
        arm,
        buoyancy=Buoyancy(trim_position=arm.links.length / 2, trim_depth=below),
        gravity=jnp.asarray(STANDARD_GRAVITY) if still else arm.gravity,
    )
    other = trimmed(other, level=True)
    ratio = float(jnp.sum(bodies(other).mass) / jnp.sum(bodies(arm).mass))
    return _moved_alike(other, arm, ratio)


def _moved_alike(other: Arm, arm: Arm, ratio: float) -> Arm:
    """An arm that is so many times as heavy as another one, and moves as that one does.

    Positions do not show how heavy an arm is: all that moves it grows by as much, so that only
    what is new is different. Where an arm has weight, that fixes the scale, and nothing grows.
    """
    if float(arm.gravity) != 0:
        return other
    # One strength of muscles is enough: the first that their law has.
    strength = [path for path in STRENGTHS if path in declared(arm)][:1]
    forces = [path for path in (*SCALE, *strength) if path not in MASSES and path in declared(arm)]
    return replace(other, {path: ratio * get(arm, path) for path in forces})


def _in(arm: Arm, air: Air) -> Arm:
    return dataclasses.replace(arm, air=air)
