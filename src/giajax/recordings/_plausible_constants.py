"""Check constants for errors by powers of ten and wrong units, and the force of a muscle."""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from ..schema import (
    AIR,
    AT_REST,
    BASE,
    BRAIDED,
    INITIAL,
    JOINTS,
    LINKS,
    NECK,
    PINHOLE,
    PISTON,
    ArmSection,
    MuscleSection,
    braid_area,
    collapse,
    crushed,
    largest_pull,
    straight_compression,
)
from ._plausible_columns import (
    PAPER,
    Look,
    Oddity,
    arm_values,
    is_balanced,
    number_of_links,
    wrong_unit,
)

wrong_constant = partial(Oddity, "constants")

_USUAL: Mapping[str, tuple[float, float]] = {
    LINKS.length.path: (2e-3, 100.0),
    LINKS.diameter.path: (1e-4, 10.0),
    LINKS.mass.path: (1e-7, 1e4),
    BASE.gravity.path: (1.0, 30.0),
    AIR.density.path: (0.05, 10.0),
    AT_REST.length.path: (5e-3, 20.0),
    BRAIDED.diameter.path: (2e-4, 0.5),
    BRAIDED.braid_angle.path: (np.deg2rad(3), np.deg2rad(60)),
    BRAIDED.pressure_limit.path: (5e3, 5e6),
    PISTON.bore.path: (1e-3, 1.0),
    INITIAL.angle.path: (0.0, 4 * np.pi),
    PINHOLE.focal_length.path: (30.0, 1e5),
}
"""Usual ranges of constants, SI; 0 is always accepted."""


def constants(look: Look) -> Iterator[Oddity]:
    """Report constants that are wrong by powers of ten, alone or in relation to others."""
    for name, of in look.run.kind.all_sections.items():
        section = look.section(of)
        for key, stated in section.contents().items():
            for part in section.quantities.get(key, ()) if stated is not None else ():
                low, high = _USUAL.get(part.path, (0.0, np.inf))
                place = None if part.key is None else part.key.place
                number = np.ravel(stated if place is None else stated[place])
                sizes = np.abs(np.multiply(number, part.factor))
                bad = (sizes > 0) & ((sizes < low) | (sizes > high))
                # The density of water is accepted, too, because an arm may move under water.
                bad &= ~((part.path == AIR.density.path) & (sizes > 900) & (sizes < 1100))
                if bad.any():
                    yield wrong_constant(
                        f"{name}.{key} is {number[bad][0]:g}, but the usual range is from "
                        f"{low / part.factor:.3g} to {high / part.factor:.3g} in the unit of its "
                        "key, so the unit may be wrong",
                        "correct the value in the sidecar",
                    )
    if look.run.model == "arm":
        yield from _constants_of_arm(look)


def _constants_of_arm(look: Look) -> Iterator[Oddity]:
    section = look.section(ArmSection)
    known = arm_values(section)
    links = (LINKS.length, LINKS.mass, LINKS.diameter)
    length, mass, diameter = (known.get(each.path) for each in links)
    if section.muscles is not None and diameter is not None:
        yield from _collapse(section, known, diameter)
    floats, gravity = section.preset in PAPER, known.get(BASE.gravity.path)
    if length is None or mass is None:
        return
    inertia = known.get(LINKS.inertia_transverse.path)
    if inertia is not None and np.any(inertia > 10 * mass * length**2):
        yield wrong_constant(
            f"arm.link_inertia_transverse_kg_m2 is {np.max(inertia):.3g}, more than ten times "
            f"the product of mass and squared length ({np.max(mass * length**2):.3g})",
            "correct the inertia, or its unit",
        )
    # An arm that only yaws does not deflect under its weight.
    axes = section.joint_axes
    axes = ["pitch"] if axes in (None, "pitch_yaw") else axes
    pitched = any(axis == "pitch" if isinstance(axis, str) else axis[1] for axis in axes)
    if floats and pitched and diameter is not None and not np.any(gravity or 0.0):
        displaced = 1.204 * np.pi / 4 * diameter**2 * length
        ratio = float(np.max(mass / displaced))
        if not 1e-2 < ratio < 10:
            yield wrong_constant(
                f"a link weighs {ratio:.3g} times the air that it displaces, but without gravity, "
                "buoyancy must balance its weight, so the mass or a dimension may be wrong by a "
                "power of ten",
                "correct link_mass_kg, link_diameter_m or link_length_m in [arm], or set "
                "gravity_m_per_s2",
            )
    stiffness = known.get(JOINTS.pitch_stiffness.path)
    hangs = section.preset == "pendulum" or is_balanced(section)
    if gravity is not None and not hangs and pitched and stiffness is not None:
        count = number_of_links(look) or 1
        whole = np.broadcast_to(mass, (count,)), np.broadcast_to(length, (count,))
        lever = np.cumsum(whole[1]) - whole[1] / 2
        torque = float(np.max(gravity)) * float(np.sum(whole[0] * lever))
        least = float(np.min(stiffness))
        upright = np.any(np.abs(known.get(BASE.base_rotation.path, np.zeros(3))) > 0.5)
        if least > 0 and torque > np.pi / 2 * least and not upright and section.muscles is None:
            yield wrong_constant(
                f"with gravity and without buoyancy, the weight of the arm exerts {torque:.3g} N "
                f"m about its base, which a joint with a stiffness of {least:.3g} N m/rad cannot "
                "support",
                "set buoyancy = true and trim = true in [arm], or gravity_m_per_s2 = 0 if "
                "buoyancy balances the weight",
            )


def _collapse(section: ArmSection, known: Mapping[str, Any], diameter: Any) -> Iterator[Oddity]:
    """Report links and necks of joints that cannot carry the force of their muscles."""
    pressure = known.get(LINKS.pressure.path, LINKS.pressure.default)
    sentence = collapse(pressure, diameter, largest_pull(known, section.muscle_law))
    if sentence is not None:
        yield wrong_constant(
            sentence,
            "correct link_pressure_kPa in [arm], or give the muscles a lower pressure_limit",
        )
    if NECK.radius.path in known:
        joint, gas = _least_gas(section, np.ravel(pressure))
        held = gas * np.pi * float(known[NECK.radius.path]) ** 2
        sentence = crushed(straight_compression(known), held, joint=joint)
        if sentence is not None:
            yield wrong_constant(sentence, "correct link_pressure_kPa in [arm], or neck.radius")


def _least_gas(section: ArmSection, pressure: Any) -> tuple[int, float]:
    """Return the joint with muscles whose neck has the lowest link pressure, and this pressure."""
    numbers = np.arange(1, pressure.size + 1)
    if isinstance(section.muscles, list):
        numbers = np.asarray(section.muscles)
    elif section.muscles == "pitch" and section.joint_axes in (None, "pitch_yaw"):
        numbers = numbers[::2]
    if pressure.size == 1:
        return int(numbers[0]), float(pressure[0])
    # A neck is between two links and has the lower of their pressures.
    between = np.minimum(pressure, np.concatenate([pressure[:1], pressure[:-1]]))
    least = int(numbers[np.argmin(between[numbers - 1])])
    return least, float(between[least - 1])


def force(look: Look) -> Iterator[Oddity]:
    """Compare the force of a braided muscle with that of the ideal law at zero contraction."""
    if look.run.model != "muscle" or "force" not in look.measured:
        return
    stated = look.section(MuscleSection).values()
    needed = (BRAIDED.diameter.path, BRAIDED.braid_angle.path)
    pressure = look.run.values.get("pressure")
    if any(path not in stated for path in needed) or pressure is None:
        return
    diameter, angle = (float(stated[path]) for path in needed)
    most = float(np.nanmax(pressure))
    ideal = braid_area(diameter, angle)
    cells = look.measured["force"]
    size, pressures = np.abs(cells.values), pressure[cells.rows]
    ratio = float(np.quantile(size, 0.95)) / max(ideal * most, 1e-300)
    # Without contraction data the muscle may be contracted, which reduces its force to zero.
    contraction = look.run.values.get("contraction", np.full(len(pressure), np.inf))
    held = (contraction[cells.rows] < 0.05) & (pressures > most / 2)
    weak = ideal > 0 and held.any() and np.median(size[held] / pressures[held]) < 1e-2 * ideal
    if ratio > 20 or (weak and ratio < 1e-2):
        yield wrong_unit(
            f"the force is {ratio:.2g} times the force of an ideal muscle of this size and "
            "pressure, so force, pressure or diameter may have a wrong unit",
            "correct the unit in the name of the column, or the key in [muscle]",
            ("force", "pressure"),
        )
    limit = stated.get(BRAIDED.pressure_limit.path)
    if limit is not None and not 0.01 < most / float(limit) < 5:
        yield wrong_unit(
            f"the pressure reaches {most / float(limit):.2g} times the specified limit, so one of "
            "the two may have a wrong unit",
            "correct the unit in the name of the column, or pressure_limit_kPa",
            ("pressure",),
        )
