"""What functions and classes are called in the keys of tasks, wherever they lie. Imports nothing.

A key is kept in the name of a file and gives a task its random numbers, so that it must stay when
code moves. The identities below are the names of version 0.1.0, and are never changed: "/" stands
for "." so that nobody who replaces the name of a module replaces one of them. Each has beside it
where the code lies now, which is to be changed with the code.

An argument or a field that was renamed is written "before=now"; now may be a property. One that is
not listed was added later: it counts where it is not what it is by default (an argument: None).

What else giajax has counts by its name alone, and code of others by its full name.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

FORMAT = "0.1.0"
"""Counts in every key: that of the version whose identities these are."""

# Identity -> where it lies, and its arguments.
FUNCTIONS: dict[str, tuple[str, str]] = {
    "repetitions/_left_out:left_out": ("giajax.studies._influence:left_out", "fitted parts"),
    "repetitions/_replicates:replicates": (
        "giajax.studies._bootstrap:replicates",
        "fitted first count method whole seed",
    ),
    "study/_posterior_chain:chain": (
        "giajax.studies._posterior:chain",
        "begun number draws warmup",
    ),
    "study/_profile_task:one_side": (
        "giajax.studies._profile:one_side",
        "fitted name side level",
    ),
    "study/_start_task:one_start": ("giajax.studies._starts:one_start", "asked start most"),
    "sweeping/_fit:fitted": ("giajax.tasks._sweep:fitted", "definition inputs rename begin"),
}

# Identity -> where it lies, and its fields; None where a text of its own stands for them.
CLASSES: dict[str, tuple[str, str | None]] = {
    "arm/_arm:Arm": (
        "giajax.mechanics.arm._arm:Arm",
        "links joints air buoyancy point_masses pneumatics contact base_rotation gravity",
    ),
    "arm/_atmosphere:Air": (
        "giajax.mechanics.arm._parts:Air",
        "density drag_coefficient axial_coefficient added_mass_coefficient wind viscosity "
        "drag strip_points drag_curve added_mass",
    ),
    "arm/_contact:Contact": (
        "giajax.mechanics.arm._parts:Contact",
        "obstacles pressure shape_factor damping friction friction_stiffness points",
    ),
    "arm/_hysteresis:JointHysteresis": (
        "giajax.mechanics.arm._hysteresis:JointHysteresis",
        "memory stops",
    ),
    "arm/_joints:Joints": (
        "giajax.mechanics.arm._parts:Joints",
        "axes pitch_stiffness yaw_stiffness damping friction friction_rate armature hysteresis",
    ),
    "arm/_links:Links": (
        "giajax.mechanics.arm._parts:Links",
        "length diameter mass centre_of_mass inertia_transverse inertia_axial fullness",
    ),
    "arm/_masses:Buoyancy": (
        "giajax.mechanics.arm._parts:Buoyancy",
        "helium_density trim_mass trim_position trim_depth imbalance",
    ),
    "arm/_masses:PointMasses": (
        "giajax.mechanics.arm._parts:PointMasses",
        "links mass position left up drag_area",
    ),
    "arm/_memory:Memory": (
        "giajax.mechanics.arm._hysteresis:Memory",
        "strength yield_angle nu delta",
    ),
    "arm/_muscle_drive:MuscleDrive": (
        "giajax.mechanics.arm._pneumatics:MuscleDrive",
        "lag passive_stiffness stop_stiffness",
    ),
    "arm/_pneumatics:Pneumatics": (
        "giajax.mechanics.arm._pneumatics:Pneumatics",
        "joints joint muscle drive",
    ),
    "arm/_stops:Stops": ("giajax.mechanics.arm._hysteresis:Stops", "strength yield_angle"),
    "fitting/_integration:IntegrationFit": (
        "giajax.fitting._result:IntegrationFit",
        "solver tolerance chosen",
    ),
    "fitting/_records:Estimate": (
        "giajax.fitting._records:Estimate",
        "value standard_error unit lower upper free remark interval freedom sandwich_error "
        "prior_share sources",
    ),
    "fitting/_run_records:ChannelFit": (
        "giajax.fitting._records:ChannelFit",
        "unit rmse n noise correlated correlation_time_s innovation",
    ),
    "fitting/_run_records:OwnEstimate": (
        "giajax.fitting._records:OwnEstimate",
        "value standard_error remark",
    ),
    "fitting/_run_records:RunFit": (
        "giajax.fitting._records:RunFit",
        "name path sha256 channels parameters",
    ),
    "hysteresis/_bouc_wen:BoucWen": (
        "giajax.mechanics.hysteresis._bouc_wen:BoucWen",
        "elastic alpha beta gamma delta nu substeps",
    ),
    "hysteresis/_branches:BranchCompensator": (
        "giajax.mechanics.hysteresis._branches:BranchCompensator",
        "rising falling travel",
    ),
    "hysteresis/_branches:MonotoneCurve": (
        "giajax.mechanics.hysteresis._branches:MonotoneCurve",
        "x y",
    ),
    "hysteresis/_dead_zones:DeadZones": (
        "giajax.mechanics.hysteresis._prandtl_ishlinskii:DeadZones",
        "slope upper_thresholds upper_slopes lower_thresholds lower_slopes",
    ),
    "hysteresis/_inverse:InverseByBisection": (
        "giajax.mechanics.hysteresis._operator:InverseByBisection",
        "operator lower upper",
    ),
    "hysteresis/_modified:InverseModified": (
        "giajax.mechanics.hysteresis._prandtl_ishlinskii:InverseModified",
        "dead_zones hysteresis",
    ),
    "hysteresis/_modified:ModifiedPrandtlIshlinskii": (
        "giajax.mechanics.hysteresis._prandtl_ishlinskii:ModifiedPrandtlIshlinskii",
        "dead_zones weights thresholds",
    ),
    "hysteresis/_oscillator:BoucWenOscillator": (
        "giajax.mechanics.hysteresis._bouc_wen:BoucWenOscillator",
        "mass damping stiffness alpha beta gamma delta nu steps",
    ),
    "hysteresis/_play:Play": ("giajax.mechanics.hysteresis._operator:Play", "thresholds"),
    "hysteresis/_play:Stop": ("giajax.mechanics.hysteresis._operator:Stop", "thresholds"),
    "hysteresis/_prandtl_ishlinskii:PrandtlIshlinskii": (
        "giajax.mechanics.hysteresis._prandtl_ishlinskii:PrandtlIshlinskii",
        "elastic weights thresholds elements",
    ),
    "hysteresis/_preisach:Preisach": (
        "giajax.mechanics.hysteresis._preisach:Preisach",
        "slope saturation coercivity coercivity_spread bias interaction extent rows",
    ),
    "joint/_braided:BraidedMuscle": (
        "giajax.mechanics.joint._muscle:BraidedMuscle",
        "diameter braid_angle end_correction effectiveness dead_band pressure_limit",
    ),
    "joint/_correction:Alpha": (
        "giajax.mechanics.joint._statics:Alpha",
        "offset threshold curvature",
    ),
    "joint/_correction:Beta": (
        "giajax.mechanics.joint._statics:Beta",
        "offset width threshold curvature",
    ),
    "joint/_correction:Correction": (
        "giajax.mechanics.joint._statics:Correction",
        "alpha beta reading blend",
    ),
    "joint/_empirical:EmpiricalMuscle": (
        "giajax.mechanics.joint._muscle:EmpiricalMuscle",
        "force_limit contraction_limit bell decay end_length length_scale pressure_limit",
    ),
    "joint/_friction:Friction": (
        "giajax.mechanics.joint._muscle:Friction",
        "half_width presliding pressures",
    ),
    "joint/_geometry:JointGeometry": (
        "giajax.mechanics.joint._geometry:JointGeometry",
        "anchor_x anchor_y wire_x wire_y contact_x contact_y wire_length muscle_length",
    ),
    "joint/_piston:Piston": ("giajax.mechanics.joint._muscle:Piston", "bore offset pressure_limit"),
    "joint/_statics:Joint": ("giajax.mechanics.joint._statics:Joint", "geometry correction torque"),
    "models/_arm:ArmModel": (
        "giajax.models._arm:ArmModel",
        "arm tolerance solver max_steps sensors steps_for",
    ),
    "models/_hysteresis:HysteresisModel": (
        "giajax.models._hysteresis:HysteresisModel",
        "settings operator offset previous_extremes columns",
    ),
    "models/_hysteresis_definition:HysteresisSettings": (
        "giajax.models._hysteresis:HysteresisSettings",
        "operator elements thresholds upper_dead_zones lower_dead_zones rows input_range "
        "previous_extremes",
    ),
    "models/_joint:JointModel": ("giajax.models._joint:JointModel", "joint"),
    "models/_muscle:MuscleModel": (
        "giajax.models._muscle:MuscleModel",
        "muscle friction length mean_pressure",
    ),
    "models/_oscillator:OscillatorModel": (
        "giajax.models._oscillator:OscillatorModel",
        "oscillator offset interpolation columns",
    ),
    "models/_pinhole:Pinhole": (
        "giajax.models._cameras:Pinhole",
        "position rotation focal_length aspect centre distortion delay mount size",
    ),
    "models/_response:Columns": ("giajax.models._hysteresis:Columns", "input output"),
    "models/_sensors:Camera": (
        "giajax.models._arm_sensors:Camera",
        "rotation origin scale delay pinholes",
    ),
    "models/_sensors:Encoder": ("giajax.models._arm_sensors:Encoder", "offset scale delay"),
    "models/_sensors:Landmark": ("giajax.models._arm_sensors:Landmark", "position"),
    "models/_sensors:Marker": ("giajax.models._arm_sensors:Marker", "along left up tip"),
    "models/_sensors:Sensors": (
        "giajax.models._arm_sensors:Sensors",
        "camera marker encoder landmark",
    ),
    "models/_several:SeveralModels": ("giajax.models._several:SeveralModels", "parts"),
    "obstacles/_shapes:Box": ("giajax.mechanics.obstacles:Box", "centre size rotation name"),
    "obstacles/_shapes:Plane": ("giajax.mechanics.obstacles:Plane", "centre normal name"),
    "obstacles/_shapes:WallWithOpening": (
        "giajax.mechanics.obstacles:WallWithOpening",
        "centre opening margins thickness rotation name",
    ),
    "repetitions/_parts:Part": ("giajax.studies._influence:Part", "kind name runs channels rows"),
    "runs/_channels:Channel": (
        "giajax.recordings._channels:Channel",
        "name kind index component quantity unit camera",
    ),
    "study/_fitted:Fitted": ("giajax.studies._refit:Fitted", None),
    "study/_posterior_chain:Begun": ("giajax.studies._posterior:Begun", None),
    "study/_start_task:Asked": ("giajax.studies._starts:Asked", None),
}


def identity(place: str) -> str:
    """What code is called in keys.

    Arguments:
        place: where it lies, as "module:qualified.name".
    """
    known = _identities().get(place)
    if known is not None:
        return f"giajax.{known.replace('/', '.')}"
    module, _, name = place.partition(":")
    return f"giajax:{name}" if module.partition(".")[0] == "giajax" else place


def arguments_of(place: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a function that count in a key, by the names that they have there.

    Arguments:
        place: of the function.
        arguments: by name.
    """
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
    """The fields of a dataclass that may count in a key.

    Arguments:
        value: one of any class.

    Yields:
        The name that the field has in keys, its value, and its value by default: `MISSING` of
        `dataclasses` where the field always counts.
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
    """Names as they are in keys -> as they are now."""
    pairs = (name.partition("=") for name in names.split())
    return {before: now or before for before, _, now in pairs}


@functools.cache
def _identities() -> dict[str, str]:
    """By where the code lies now."""
    return {place: name for name, (place, _) in [*FUNCTIONS.items(), *CLASSES.items()]}
