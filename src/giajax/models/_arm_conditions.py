"""Conditions of the fit of an arm: the scale of all forces, and the references of sensors."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import (
    STANDARD_GRAVITY,
    Air,
    Arm,
    Buoyancy,
    Hardening,
    PointMasses,
    bodies,
    named_axes,
    structural_points,
    trimmed,
)
from ..recordings import Run
from ..runtime.arrays import Array, Scalar
from ..runtime.text import InputError
from ..schema import (
    AIR,
    BUOYANCY,
    CAMERA,
    DRIVE,
    INITIAL,
    JOINT_MEMORY,
    LINKS,
    POINT_MASSES,
    ArmSection,
    InitialSection,
    Prior,
    from_default_preset,
    preset_sentence,
)
from ..schema.parameters import declared, elements, find, get, replace
from ._arm_sensors import Sensors
from ._protocol import AbstractModel

# Multiplying all of these by one factor leaves every motion unchanged: only ratios are determined.
SCALE = (
    "links.mass",
    "links.inertia_transverse",
    "links.inertia_axial",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
    "joints.friction",
    "joints.memory.strength",
    "joints.stops.strength",
    "joints.armature",
    "joints.laws.hardening.cubic",
    "joints.laws.hardening.quintic",
    "joints.laws.end_stops.stiffness",
    "torque",
    "alpha.offset",
    "alpha.curvature",
    "beta.offset",
    "beta.curvature",
    "drive.passive_stiffness",
    "drive.stop_stiffness",
    "air.drag_coefficient",
    "air.axial_coefficient",
    "air.added_mass_coefficient",
    "buoyancy.helium_density",
    "buoyancy.trim_mass",
    "buoyancy.imbalance",
    "buoyancy.imbalance_drift",
    "point_masses.mass",
    "point_masses.drag_area",
)

# Powers of the length of a second in parameters whose units contain seconds. C_D has no such unit.
IN_SECONDS = {
    "joints.pitch_stiffness": -2,
    "joints.yaw_stiffness": -2,
    "joints.damping": -1,
    "joints.memory.strength": -2,
    "joints.stops.strength": -2,
    "joints.laws.hardening.cubic": -2,
    "joints.laws.hardening.quintic": -2,
    "joints.laws.end_stops.stiffness": -2,
}

# Parameters that fix the unit of time: drive lag, friction (regularised by a rate), and drifts.
_BY_THE_SECOND = ("joints.drive_lag", "joints.friction", "joints.stiffness_drift")
_SECONDS = ("angular_velocity", "velocity", "acceleration", "force", "torque")  # quantities

# Parameters that scale the force of a muscle at a given pressure. If they are held, they fix the
# scale; if not, they belong to it. The diameter enters squared. With commanded angles they have no
# effect, because the controller divides by them.
STRENGTHS = ("muscle.effectiveness", "muscle.force_limit", "muscle.diameter")

# Parameters besides `STRENGTHS` by which the controller converts a commanded angle to pressures.
_OF_THE_CONTROLLER = ("geometry.", "alpha.", "beta.", "torque", "muscle.", "drive.passive")

# Parameters of `SCALE` that are inertia rather than forces.
MASSES = (
    "links.mass",
    "links.inertia_transverse",
    "links.inertia_axial",
    "buoyancy.helium_density",
    "buoyancy.trim_mass",
    "buoyancy.imbalance",
    "point_masses.mass",
)

# Prefixes of user-defined laws, and of those that are part of giajax.
_OWN = ("air.law.", "joints.laws.")
_KNOWN = ("joints.laws.hardening.", "joints.laws.end_stops.")

_DRAG_AREA = ("air.density", "links.length", "links.diameter")  # C_D refers to these (eq. 1)
_COMMANDED = "relative to the clock of the commands, so a lag of the drives has the same effect"
_LENS = (
    "relative to the middle of the straight arm and to half of its length, because recorded "
    "positions do not contain the distance from the camera"
)
_SENSORS: dict[str, str] = {
    "camera.delay": _COMMANDED,
    "camera.clock_rate": "relative to the clock of the commands",
    "camera.lens_k1": _LENS,
    "camera.lens_k2": _LENS,
    "encoder.delay": _COMMANDED,
    "encoder.clock_rate": "relative to the clock of the commands",
    "encoder.offset": "relative to the commanded angle 0, at which the joints are straight",
}


def preset_conditions(arm: Arm, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
    """Return a sentence on held values that come from a preset, because no sidecar names one."""
    fitted = {path.partition("[")[0] for path in free}
    taken = from_default_preset(runs[0].definition.section(ArmSection)) if runs else {}

    def is_taken(path: str, value: Any) -> bool:
        # A model that was not made from these sidecars may have other values.
        if path == "joint_axes":
            return arm.joints.axes == named_axes(value, arm.count)
        return path not in fitted and bool(np.all(np.asarray(get(arm, path)) == value))

    held = [path for path, value in taken.items() if is_taken(path, value)]
    return [preset_sentence(held)] if held else []


# Uncertainties of an uncalibrated camera and arm. Exposure, transmission and a manual start of the
# recording add at most one frame and 50 ms. A nominal rate of 30 frames per second may be 29.97. A
# scale from a known length and the width of a balloon are measured to one per cent.
_LATEST = 0.05
_FRAME = 0.1  # rows farther apart than this do not contain all frames
_CLOCK_RATE = 1e-3
_SIZE = 1e-2


def usual_uncertainty(arm: Arm, sensors: Sensors, runs: Sequence[Run]) -> dict[str, Prior]:
    """Return priors for the uncertain parameters of camera and links that no sidecar gives.

    The expected delay is the middle of the possible range, half a frame plus 25 ms. The standard
    deviation has the same value.
    """
    frames, positions = [], False
    for run in runs:
        channels = [run.channels[name] for name in run.observations]
        rows = sensors.rows({channel.kind for channel in channels}).values()
        recorded = any(shows is sensors.camera for _, shows in rows)
        positions = positions or recorded
        pictures = any(channel.quantity == "pixel" for channel in channels)
        if (recorded or pictures) and run.times is not None and len(run.times) > 1:
            frames.append(min(float(np.median(np.diff(run.times))), _FRAME))
    known: dict[str, Prior] = {}
    # A camera with its own delay has no uncertain common clock.
    own = any(pinhole.delay is not None for pinhole in sensors.camera.pinholes.values())
    if frames and not own:
        half = round((max(frames) + _LATEST) / 2, 6)
        known[CAMERA.delay.path] = Prior(half, deviation=half)
        known[CAMERA.clock_rate.path] = Prior(0.0, deviation=_CLOCK_RATE)
    if positions:
        known[CAMERA.scale.path] = Prior(1.0, deviation=_SIZE)
    stated = declared(sensors)
    known = {path: prior for path, prior in known.items() if path not in stated}
    if arm.buoyancy is not None or float(arm.air.drag_coefficient) > 0:
        diameter = float(np.asarray(arm.links.diameter).flat[0])
        known[LINKS.diameter.path] = Prior(diameter, deviation=_SIZE * diameter)
    return known


def scale_conditions(
    model: AbstractModel, arm: Arm, free: Sequence[str], runs: Sequence[Run]
) -> list[str]:
    """Return a sentence on the scale that motion cannot determine, and one on the area of C_D."""
    fitted = {path.partition("[")[0] for path in free}
    kinds = {channel.kind for run in runs for channel in run.channels.values()}
    present = declared(model)
    if arm.air.law is not None:
        del present["air.drag_coefficient"]
    strengths = [p for p in STRENGTHS if p in present and "joint_pressure_first" in kinds]
    scaled = [path for path in free if path.partition("[")[0] in (*SCALE, *strengths)]
    # A known force fixes the scale: the torque of a drive, the buoyancy of displaced air, the force
    # of a changing wind on the displaced air, or forces measured on a test bench.
    driven = "joint_torque" in kinds
    lifted = arm.buoyancy is not None and float(arm.gravity) != 0
    changing = any(run.winds for run in runs) or arm.air.wind_field is not None
    blown = arm.air.added_mass_coefficient is not None and changing
    measured = any(
        channel.quantity in ("force", "torque")
        for run in runs
        if run.model != model.kind
        for channel in run.channels.values()
    )
    sentences = []
    if scaled and not (driven or lifted or blown or measured):
        if strengths and not fitted & set(strengths):
            sentences.append(
                f"{', '.join(scaled)}: valid for {_values(model, strengths)}, because the "
                "strength of the muscles converts pressures to forces"
            )
        else:
            held = [path for path in SCALE if path in present and path not in fitted]
            inside = _links_in_points(arm)
            if len(inside) == arm.count:
                held = [path for path in held if path not in MASSES[:3]]
            other = "stiffness, strength of muscles" if strengths else "stiffness"
            sentences.append(
                f"{', '.join(scaled)}: determined only per unit of mass, because scaling masses, "
                f"inertias, drag, {other} and damping together leaves the motion unchanged"
                + (
                    f", and the scale is fixed by {_values(model, held)}"
                    if held
                    else ", and no parameter fixes the scale"
                )
                + (
                    f" (structural point masses give the mass of link{'s' * (len(inside) > 1)} "
                    f"{', '.join(map(str, inside))})"
                )
                * bool(inside)
            )
    area = [path for path in _DRAG_AREA if path not in fitted]
    if "air.drag_coefficient" in fitted and area:
        sentences.append(f"air.drag_coefficient: valid for {_values(model, area)}")
    own = sorted(p for p in fitted if p.startswith(_OWN) and not p.startswith(_KNOWN))
    if own:
        sentences.append(
            f"{', '.join(own)}: not checked, because it is unknown how the force of a "
            "user-defined law depends on them (as in every model, the motion depends only on the "
            "ratios of masses, inertias and forces)"
        )
    if "point_masses.drag_area" in fitted and "air.density" not in fitted:
        density = _values(model, ["air.density"])
        sentences.append(f"point_masses.drag_area: valid for {density}")
    return sentences


def clock_conditions(
    model: AbstractModel, arm: Arm, free: Sequence[str], runs: Sequence[Run]
) -> list[str]:
    """Return the condition on the clock of the runs if nothing else fixes the unit of time.

    A held parameter whose unit contains seconds fixes it, and so does a recorded quantity such as a
    rate.
    """
    names = {path: path.partition("[")[0] for path in free}
    counted = {path: IN_SECONDS[name] for path, name in names.items() if name in IN_SECONDS}
    channels = [channel for run in runs for channel in run.channels.values()]
    present = declared(model)
    parts = [part for path in IN_SECONDS if path in present for part in elements(model, path)]
    held = [part.path for part in parts if not {part.path, part.path.partition("[")[0]} & {*free}]
    initial = [run.definition.section(InitialSection).values() for run in runs]
    known = [
        float(arm.gravity) != 0 or arm.buoyancy is not None,
        arm.air.wind_field is not None or any(run.winds for run in runs) or "air.wind" in present,
        arm.air.drag_curve != "constant" or arm.air.law is not None,
        arm.pneumatics is not None or any(path in present for path in _BY_THE_SECOND),
        any(channel.quantity in _SECONDS for channel in channels),
        any(np.any(values.get(INITIAL.rate.path, 0.0)) for values in initial),
        any(name not in ("hardening", "end_stops") for name in arm.joints.laws),
        any(np.any(np.asarray(get(model, path))) for path in held),
    ]
    if set(counted.values()) != {-1, -2} or any(known):
        return []
    changes = [
        f"{', '.join(path for path, each in counted.items() if each == power)} by {shown}"
        for power, shown in ((-2, "1 / r^2"), (-1, "1 / r"))
    ]
    return [
        f"{', '.join(counted)}: expressed in the seconds of the time stamps, because no other "
        "quantity fixes the unit of time; a clock that runs r times as fast scales "
        f"{' and '.join(changes)} and leaves the residuals unchanged (if the commands are short "
        "steps, a faster clock of the camera or sensor alone has the same effect)"
    ]


def controller_conditions(arm: Arm, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
    """Return a sentence on what the controller of muscles is assumed to know, if it applies."""
    known = [path for path in free if path.startswith(_OF_THE_CONTROLLER)]
    if arm.pneumatics is None or not known:
        return []
    names = [f"joint{joint:02d}_pressure_first" for joint in arm.pneumatics.joints]
    if all(name in run.channels for run in runs if run.model == "arm" for name in names):
        return []
    return [
        f"{', '.join(known)}: for commanded angles, the controller is assumed to use these "
        "values, so record the pressures if the real controller used other values"
    ]


def sensor_conditions(model: AbstractModel, free: Sequence[str], runs: Sequence[Run]) -> list[str]:
    """Return a sentence for each fitted sensor parameter on what it refers to."""
    fitted = {path.partition("[")[0] for path in free}
    sentences = [f"{path}: {sentence}" for path, sentence in _SENSORS.items() if path in fitted]
    encoder = sorted(fitted & {"encoder.offset", "encoder.scale", "encoder.rate_offset"})
    read = [run for run in runs if run.definition.section(InitialSection).first_row]
    if encoder and any(not run.definition.section(InitialSection).free for run in read):
        sentences.append(
            f"{', '.join(encoder)}: the initial state was computed from the first row with the "
            "start value of the parameter, so set free = true in [initial] to fit the initial "
            "state too"
        )
    if "camera.scale" in fitted and "links.length" not in fitted:
        sentences.append(
            f"camera.scale: valid for {_values(model, ['links.length'])}, because a larger scale "
            "has the same effect as a longer arm"
        )
    return sentences


def _links_in_points(arm: Arm) -> list[int]:
    """Return the links whose mass is given by point masses and not by `links.mass`."""
    fixed = arm.point_masses
    if fixed is None:
        return []
    masses = np.broadcast_to(np.asarray(fixed.mass), len(fixed.links))
    own = structural_points(np.asarray(arm.links.mass), fixed.links, masses)
    return sorted({link for link, is_link in zip(fixed.links, own, strict=True) if is_link})


def _values(model: AbstractModel, paths: Sequence[str]) -> str:
    """Return paths with their values, or the range of values of a non-uniform array."""
    shown = []
    for path in paths:
        parameter = find(model, path)
        values, unit = np.atleast_1d(parameter.value(model)), parameter.declaration.unit
        low, high = float(values.min()), float(values.max())
        text = f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"
        shown.append(f"{path} = {text}{f' {unit}' if unit else ''}")
    return ", ".join(shown)


_ADDED = AIR.added_mass_coefficient


def arm_variants(arm: Arm) -> dict[str, Arm]:
    """Return arms that differ in one choice of `[arm]`, by the key and value of this choice."""
    others, air = {}, arm.air

    def with_air(**changes: Any) -> Arm:
        return dataclasses.replace(arm, air=dataclasses.replace(air, **changes))

    if air.law is not None:
        # The built-in laws are tried instead of a user-defined one.
        usual = AIR.drag_coefficient.default
        for word in ("strip", "centre"):
            others[f"arm.drag = {word}"] = with_air(law=None, drag=word, drag_coefficient=usual)
    elif air.drag == "centre":
        others["arm.drag = strip"] = with_air(drag="strip")
    else:
        # Drag at the centres includes the velocity along a link already.
        others["arm.drag = centre"] = with_air(drag="centre", axial_coefficient=None)
    if air.law is None:
        curve = "cylinder" if air.drag_curve == "constant" else "constant"
        others[f"arm.drag_curve = {curve}"] = with_air(drag_curve=curve)
    if arm.joints.hysteresis.memory.strength is None:
        strength = JOINT_MEMORY.strength
        name = f"{strength.path} = {strength.default:g} {strength.unit}"
        others[name] = replace(arm, {strength.path: strength.default})
    if arm.point_masses is None:
        mass = POINT_MASSES.mass
        tip = PointMasses(
            links=(arm.count,),
            mass=jnp.full(1, mass.default),
            position=arm.links.length[-1:],
        )
        name = f"{mass.path} = {mass.default:g} {mass.unit} at the tip"
        others[name] = dataclasses.replace(arm, point_masses=tip)
    if "hardening" not in arm.joints.laws:
        harder = Hardening()
        laws = dict(sorted({**arm.joints.laws, "hardening": harder}.items()))
        joints = dataclasses.replace(arm.joints, laws=laws)
        name = f"joints.laws.hardening.cubic = {float(harder.cubic):g} N m/rad^3"
        others[name] = dataclasses.replace(arm, joints=joints)
    if arm.pneumatics is not None and arm.pneumatics.drive.lag is None:
        name = f"{DRIVE.lag.path} = {DRIVE.lag.default:g} {DRIVE.lag.unit}"
        others[name] = replace(arm, {DRIVE.lag.path: DRIVE.lag.default})
    if air.added_mass_coefficient is not None:
        other = "inertia" if air.added_mass == "kirchhoff" else "kirchhoff"
        others[f"arm.added_mass = {other}"] = with_air(added_mass=other)
    else:
        # The complete added mass is tested as a parameter. Other engines have only its inertia. A
        # wrong drag along the links can hide its effect, so both changes are also tried together.
        inertia = f"arm.added_mass = inertia, {_ADDED.path} = {_ADDED.default:g}"
        others[inertia] = _displacing(arm, dataclasses.replace(air, added_mass="inertia"))
        if air.drag == "centre" and air.law is None:
            both = dataclasses.replace(air, drag="strip", added_mass="inertia")
            others[f"arm.drag = strip, {inertia}"] = _displacing(arm, both)
    if arm.buoyancy is None:
        for depth in (None, BUOYANCY.trim_depth.default):
            try:
                floating = _floating(arm, depth)
            except InputError:  # the arm is too heavy to float, such as the rods of a pendulum
                break
            below = "" if depth is None else f", trim_depth = {depth:g} m"
            others[f"arm.trim = true{below}"] = floating
    return others


def _displacing(arm: Arm, air: Air) -> Arm:
    """Return the arm with added inertia equal to the mass of the displaced air."""
    coefficient = jnp.asarray(_ADDED.default, jnp.result_type(float))
    other = dataclasses.replace(
        arm, air=dataclasses.replace(air, added_mass_coefficient=coefficient)
    )
    mass = float(jnp.sum(bodies(arm).mass))
    moved = _ADDED.default * float(jnp.sum(arm.air.density * arm.links.volume))
    return _moved_alike(other, arm, 1 + moved / mass)


def _floating(arm: Arm, depth: float | None) -> Arm:
    """Return the arm with trim weights that make each link neutrally buoyant."""
    below = None if depth is None else jnp.asarray(depth, jnp.result_type(float))
    other, ratio = _afloat(arm, below)
    held: Any = other.buoyancy
    length, place = np.asarray(arm.links.length), np.asarray(held.trim_position)
    if np.any(np.asarray(held.trim_mass) < 0) or np.any((place < 0) | (place > length)):
        raise InputError("this arm cannot be made to float with trim weights")
    return _moved_alike(other, arm, float(ratio))


@eqx.filter_jit  # one compiled program instead of one for each operation
def _afloat(arm: Arm, below: Array | None) -> tuple[Arm, Scalar]:
    """Return a floating arm, and the ratio of its mass to that of the given arm."""
    other = dataclasses.replace(
        arm,
        buoyancy=Buoyancy(trim_position=arm.links.length / 2, trim_depth=below),
        gravity=jnp.where(arm.gravity == 0, STANDARD_GRAVITY, arm.gravity),
    )
    other = trimmed(other, level=True)
    return other, jnp.sum(bodies(other).mass) / jnp.sum(bodies(arm).mass)


def _moved_alike(other: Arm, arm: Arm, ratio: float) -> Arm:
    """Return the heavier arm `other` with forces scaled so that it moves like `arm`.

    Positions do not determine the mass of an arm. All forces are therefore multiplied by the mass
    ratio, and only the effect of the new terms remains. If the arm has weight, gravity fixes the
    scale, and forces are not changed.
    """
    if float(arm.gravity) != 0:
        return other
    # Scaling one parameter of the muscle strength is enough: the first one in the muscle law.
    strength = [path for path in STRENGTHS if path in declared(arm)][:1]
    forces = [path for path in (*SCALE, *strength) if path not in MASSES and path in declared(arm)]
    return replace(other, {path: ratio * get(arm, path) for path in forces})
