"""Names of functions and classes in the keys of tasks, independent of their location.

This module imports nothing of giajax. A key is the name of a file and determines the random numbers
of a task, so it must not change when code moves. The identities below are the names of version
0.1.0 and must never be changed. They contain "/" instead of "." so that renaming a module by search
and replace does not change them. Beside each identity is the module that now contains the code,
which must be updated when the code moves, and ":Name" if the code has a new name.

A renamed argument or field is written "before=now"; the new name may belong to a property. An
argument or field that is not listed was added later. It enters the key only if it differs from its
default (None for an argument).

Other code of giajax enters keys by its name only, and code of others by its full name.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

FORMAT = "0.1.0"
"""Part of every key: the version of giajax that defined these identities."""

# Identity -> module of the function, and its arguments.
FUNCTIONS: dict[str, tuple[str, str]] = {
    "repetitions/_left_out:left_out": ("studies._influence", "fitted parts"),
    "repetitions/_replicates:replicates": (
        "studies._bootstrap",
        "fitted first count method whole seed",
    ),
    "study/_posterior_chain:chain": ("studies._posterior", "begun number draws warmup"),
    "study/_profile_task:one_side": ("studies._profile", "fitted name side level"),
    "study/_start_task:one_start": ("studies._starts", "asked start most"),
    "sweeping/_fit:fitted": ("tasks._sweep", "definition inputs rename begin"),
}

# Identity -> module of the class, and its fields; None if the class defines its own text.
CLASSES: dict[str, tuple[str, str | None]] = {
    "arm/_arm:Arm": (
        "mechanics.arm._arm",
        "links joints air buoyancy point_masses pneumatics contact base_rotation gravity",
    ),
    "arm/_atmosphere:Air": (
        "mechanics.arm._parts",
        "density drag_coefficient axial_coefficient added_mass_coefficient wind viscosity "
        "drag strip_points drag_curve added_mass",
    ),
    "arm/_contact:Contact": (
        "mechanics.arm._parts",
        "obstacles pressure=former_pressure shape_factor damping friction friction_stiffness "
        "points",
    ),
    "arm/_hysteresis:JointHysteresis": ("mechanics.arm._joint_laws", "memory stops"),
    "arm/_joints:Joints": (
        "mechanics.arm._parts",
        "axes pitch_stiffness yaw_stiffness damping friction friction_rate armature hysteresis",
    ),
    "arm/_links:Links": (
        "mechanics.arm._parts",
        "length diameter mass centre_of_mass inertia_transverse inertia_axial fullness",
    ),
    "arm/_masses:Buoyancy": (
        "mechanics.arm._parts",
        "helium_density trim_mass trim_position trim_depth imbalance",
    ),
    "arm/_masses:PointMasses": ("mechanics.arm._parts", "links mass position left up drag_area"),
    "arm/_memory:Memory": ("mechanics.arm._joint_laws", "strength yield_angle nu delta"),
    "arm/_muscle_drive:MuscleDrive": (
        "mechanics.arm._pneumatics",
        "lag passive_stiffness stop_stiffness",
    ),
    "arm/_pneumatics:Pneumatics": ("mechanics.arm._pneumatics", "joints joint muscle drive"),
    "arm/_stops:Stops": ("mechanics.arm._joint_laws", "strength yield_angle"),
    "fitting/_integration:IntegrationFit": ("fitting._result", "solver tolerance chosen"),
    "fitting/_records:Estimate": (
        "fitting._records",
        "value standard_error unit lower upper free remark interval freedom sandwich_error "
        "prior_share sources",
    ),
    "fitting/_run_records:ChannelFit": (
        "fitting._records",
        "unit rmse n noise correlated correlation_time_s innovation",
    ),
    "fitting/_run_records:OwnEstimate": ("fitting._records", "value standard_error remark"),
    "fitting/_run_records:RunFit": ("fitting._records", "name path sha256 channels parameters"),
    "hysteresis/_bouc_wen:BoucWen": (
        "mechanics.hysteresis._bouc_wen",
        "elastic alpha beta gamma delta nu substeps",
    ),
    "hysteresis/_branches:BranchCompensator": (
        "mechanics.hysteresis._branches",
        "rising falling travel",
    ),
    "hysteresis/_branches:MonotoneCurve": ("mechanics.hysteresis._branches", "x y"),
    "hysteresis/_dead_zones:DeadZones": (
        "mechanics.hysteresis._prandtl_ishlinskii",
        "slope upper_thresholds upper_slopes lower_thresholds lower_slopes",
    ),
    "hysteresis/_inverse:InverseByBisection": (
        "mechanics.hysteresis._operator",
        "operator lower upper",
    ),
    "hysteresis/_modified:InverseModified": (
        "mechanics.hysteresis._prandtl_ishlinskii",
        "dead_zones hysteresis",
    ),
    "hysteresis/_modified:ModifiedPrandtlIshlinskii": (
        "mechanics.hysteresis._prandtl_ishlinskii",
        "dead_zones weights thresholds",
    ),
    "hysteresis/_oscillator:BoucWenOscillator": (
        "mechanics.hysteresis._bouc_wen",
        "mass damping stiffness alpha beta gamma delta nu steps",
    ),
    "hysteresis/_play:Play": ("mechanics.hysteresis._operator", "thresholds"),
    "hysteresis/_play:Stop": ("mechanics.hysteresis._operator", "thresholds"),
    "hysteresis/_prandtl_ishlinskii:PrandtlIshlinskii": (
        "mechanics.hysteresis._prandtl_ishlinskii",
        "elastic weights thresholds elements",
    ),
    "hysteresis/_preisach:Preisach": (
        "mechanics.hysteresis._preisach",
        "slope saturation coercivity coercivity_spread bias interaction extent rows",
    ),
    "joint/_braided:BraidedMuscle": (
        "mechanics.joint._muscle",
        "diameter braid_angle end_correction effectiveness dead_band pressure_limit",
    ),
    "joint/_correction:Alpha": ("mechanics.joint._statics", "offset threshold curvature"),
    "joint/_correction:Beta": ("mechanics.joint._statics", "offset width threshold curvature"),
    "joint/_correction:Correction": ("mechanics.joint._statics", "alpha beta reading blend"),
    "joint/_empirical:EmpiricalMuscle": (
        "mechanics.joint._muscle",
        "force_limit contraction_limit bell decay end_length length_scale pressure_limit",
    ),
    "joint/_friction:Friction": ("mechanics.joint._muscle", "half_width presliding pressures"),
    "joint/_geometry:JointGeometry": (
        "mechanics.joint._geometry",
        "anchor_x anchor_y wire_x wire_y contact_x contact_y wire_length muscle_length",
    ),
    "joint/_piston:Piston": ("mechanics.joint._muscle", "bore offset pressure_limit"),
    "joint/_statics:Joint": ("mechanics.joint._statics", "geometry correction torque"),
    "models/_arm:ArmModel": ("models._arm", "arm tolerance solver max_steps sensors steps_for"),
    "models/_hysteresis:HysteresisModel": (
        "models._hysteresis",
        "settings operator offset previous_extremes columns",
    ),
    "models/_hysteresis_definition:HysteresisSettings": (
        "models._hysteresis",
        "operator elements thresholds upper_dead_zones lower_dead_zones rows input_range "
        "previous_extremes",
    ),
    "models/_joint:JointModel": ("models._joint", "joint"),
    "models/_muscle:MuscleModel": ("models._muscle", "muscle friction length mean_pressure"),
    "models/_oscillator:OscillatorModel": (
        "models._oscillator",
        "oscillator offset interpolation columns",
    ),
    "models/_pinhole:Pinhole": (
        "models._cameras",
        "position rotation focal_length aspect centre distortion delay mount size",
    ),
    "models/_response:Columns": ("models._hysteresis", "input output"),
    "models/_sensors:Camera": ("models._arm_sensors", "rotation origin scale delay pinholes"),
    "models/_sensors:Encoder": ("models._arm_sensors", "offset scale delay"),
    "models/_sensors:Landmark": ("models._arm_sensors", "position"),
    "models/_sensors:Marker": ("models._arm_sensors", "along left up tip"),
    "models/_sensors:Sensors": ("models._arm_sensors", "camera marker encoder landmark"),
    "models/_several:SeveralModels": ("models._several", "parts"),
    "obstacles/_shapes:Box": ("mechanics.obstacles", "centre size rotation name"),
    "obstacles/_shapes:Plane": ("mechanics.obstacles", "centre normal name"),
    "obstacles/_shapes:WallWithOpening": (
        "mechanics.obstacles",
        "centre opening margins thickness rotation name",
    ),
    "repetitions/_parts:Part": ("studies._influence", "kind name runs channels rows"),
    "runs/_channels:Channel": (
        "recordings._channels",
        "name kind index component quantity unit camera",
    ),
    "study/_fitted:Fitted": ("studies._refit", None),
    "study/_posterior_chain:Begun": ("studies._posterior", None),
    "study/_start_task:Asked": ("studies._starts", None),
}


def identity(place: str) -> str:
    """Return the identity in keys of the code at a place, "module:qualified.name"."""
    known = _identities().get(place)
    if known is not None:
        return f"giajax.{known.replace('/', '.')}"
    module, _, name = place.partition(":")
    return f"giajax:{name}" if module.partition(".")[0] == "giajax" else place


def arguments_of(place: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of the function at a place that enter a key, by their names there."""
    known = _identities().get(place)
    if known is None:
        return dict(arguments)
    names = _pairs(FUNCTIONS[known][1])
    former = {now: before for before, now in names.items()}
    return {
        former.get(name, name): value
        for name, value in arguments.items()
        if name in former or value is not None
    }


def fields_of(value: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield the fields of a dataclass that may enter a key.

    Yields:
        The name of the field in keys, its value, and its default: `dataclasses.MISSING` if the
        field always enters the key.
    """
    kind = type(value)
    names: dict[str, str] = {}
    if ours := kind.__module__.partition(".")[0] == "giajax":
        known = _identities().get(f"{kind.__module__}:{kind.__qualname__}")
        names = _pairs((CLASSES[known][1] if known else None) or "")
    for before, now in names.items():
        yield before, getattr(value, now), dataclasses.MISSING
    for field in dataclasses.fields(value):
        if field.name not in names.values():
            default = _default(field) if ours else dataclasses.MISSING
            yield field.name, getattr(value, field.name), default


def _default(field: "dataclasses.Field[Any]") -> Any:
    default: Any = field.default
    if field.default_factory is not dataclasses.MISSING:
        default = field.default_factory()
    converter = field.metadata.get("converter")
    return default if converter is None or default is dataclasses.MISSING else converter(default)


def _pairs(names: str) -> dict[str, str]:
    """Return the current names by their names in keys."""
    pairs = (name.partition("=") for name in names.split())
    return {before: now or before for before, _, now in pairs}


def place_of(identity: str) -> str:
    """Return the current place of the code with an identity."""
    where = (FUNCTIONS.get(identity) or CLASSES[identity])[0]
    return f"giajax.{where}" if ":" in where else f"giajax.{where}:{identity.partition(':')[2]}"


@functools.cache
def _identities() -> dict[str, str]:
    """Return the identities by the current place of their code."""
    return {place_of(identity): identity for identity in (*FUNCTIONS, *CLASSES)}
