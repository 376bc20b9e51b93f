"""Kind of the arm: from joint commands, torques and wind to positions and joint angles."""

from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np

from ..runtime.text import InputError
from ._arm_sections import (
    ArmSection,
    CamerasSection,
    CommandSection,
    InitialSection,
    LandmarkSection,
    LandmarksSection,
    PinholeSection,
    SensorsSection,
    WindSection,
)
from ._joint import GEOMETRY
from ._kind import (
    KINDS,
    ChannelKind,
    Kind,
    Naming,
    RecordedChannel,
    RecordedRun,
    SectionTemplate,
)
from ._quantities_arm import AIR, BASE, CONTACT, NO_NEUTRAL

PRESSURES = ("joint_pressure_first", "joint_pressure_second")
"""Rows of the column table. A positive angle bends a joint towards the muscle of the first row."""


def check_pressures(content: RecordedRun, naming: Naming) -> None:
    """Require pressures of both muscles of a joint, none below 0, and no other command."""
    names = {(channel.kind, channel.index): channel for channel in content.channels.values()}
    for (kind, joint), channel in names.items():
        if kind not in PRESSURES:
            continue
        (other,) = (row for row in PRESSURES if row != kind)
        if (other, joint) not in names:
            raise InputError(
                f"{naming.source}: {naming.of(channel)} is given without the column of the other "
                "muscle of the joint: add the column "
                f"joint{joint:02d}_{other.removeprefix('joint_')}_kPa"
            )
        if ("joint_command", joint) in names:
            raise InputError(
                f"{naming.source}: joint {joint} has a command and pressures, but only one of "
                f"them can drive the joint: remove the columns of the other"
            )
        low = np.flatnonzero(content.values[channel.name] < 0)
        if low.size:
            raise InputError(
                f"{naming.source}: {naming.of(channel)} is below 0 in {naming.at(low[0])}: give "
                f"the gauge pressure, which is at least 0"
            )
        if (joints := _with_muscles(content.definition.section(ArmSection))) and not joints(joint):
            raise InputError(
                f"{naming.source}: {naming.of(channel)} is given, but joint {joint} has no "
                "muscles: correct the name, or muscles in [arm]"
            )


def _with_muscles(section: ArmSection) -> Callable[[int | None], bool] | None:
    """Return a function that tells whether a joint has muscles; None if it cannot be known here."""
    muscles, axes = section.muscles, section.joint_axes
    if isinstance(muscles, list):
        return lambda joint: joint in muscles
    if muscles != "pitch":
        return None
    if axes in (None, "pitch_yaw"):
        return lambda joint: joint is not None and joint % 2 == 1
    return lambda joint: joint is not None and axes[joint - 1 : joint] != ["yaw"]


DEFAULT_PRESET = "takeichi_20m"
DEFAULT_LINKS = 20


def from_default_preset(section: ArmSection) -> dict[str, Any]:
    """Return the values by path that a section without a preset takes from the default preset.

    These are the quantities that have no neutral value, or that have another value in the preset.
    """
    if section.preset is not None:
        return {}
    stated = {*section.values(), *(path.partition("[")[0] for path in section.parameters or {})}
    every = (*NO_NEUTRAL, BASE.gravity, AIR.drag_coefficient)
    taken: dict[str, Any] = {each.path: each.default for each in every if each.path not in stated}
    return taken | ({"joint_axes": "pitch_yaw"} if section.joint_axes is None else {})


def missing_of_chain(section: ArmSection) -> list[str]:
    """Return the required quantities that a section of the preset "chain" does not give.

    For axes given as vectors or for muscles, the required stiffness is checked when the arm is
    built.
    """
    if section.preset != "chain":
        return []
    axes = section.joint_axes
    words = ("pitch", "yaw")[: section.links] if axes in (None, "pitch_yaw") else axes
    unused = {
        f"joints.{name}_stiffness"
        for name in ("pitch", "yaw")
        if name not in words or section.muscles is not None
    }
    stated = {*section.values(), *(section.parameters or {}), *unused}
    missing = [
        each.path if each.key is None else each.key.name
        for each in NO_NEUTRAL
        if each.path not in stated
    ]
    return missing + ["joint_axes"] * (section.joint_axes is None)


def preset_sentence(taken: Collection[str], where: str = "[arm] names no preset") -> str:
    """Return a sentence on the values taken from the default preset, and how to change it."""
    what = ", ".join(taken) if len(taken) < len(NO_NEUTRAL) else "the constants"
    return (
        f"{where}: {what} of the preset {DEFAULT_PRESET} are assumed (to change this, set preset "
        'in [arm], for example to "chain" for your own arm)'
    )


IMU_RATE = ChannelKind(
    "imu_rate", "imuNN_gyro_x", "angular_velocity", "output", noise="rate_deg_per_s"
)
IMU_FORCE = ChannelKind(
    "imu_force", "imuNN_accel_x", "acceleration", "output", noise="acceleration_m_per_s2"
)
INCLINATION = ChannelKind(
    "link_inclination", "linkNN_inclination", "angle", "output", noise="angle_deg"
)
TENSION = ChannelKind("joint_tension", "jointNN_tension", "force", "output")
CURVATURE = ChannelKind("joint_curvature", "jointNN_curvature", "curvature", "output")
CHANNELS = (
    ChannelKind("joint_command", "jointNN_command", "angle", "input"),
    ChannelKind("joint_angle", "jointNN_angle", "angle", "output", noise="angle_deg"),
    ChannelKind("joint_rate", "jointNN_rate", "angular_velocity", "output", noise="rate_deg_per_s"),
    ChannelKind("joint_torque", "jointNN_torque", "torque", "input"),
    ChannelKind("joint_pressure_first", "jointNN_pressure_first", "pressure", "input"),
    ChannelKind("joint_pressure_second", "jointNN_pressure_second", "pressure", "input"),
    TENSION,
    CURVATURE,
    ChannelKind("link_angle", "linkNN_angle", "angle", "output", noise="angle_deg"),
    ChannelKind("link_position", "linkNN_x", "length", "output", noise="position_m"),
    ChannelKind("link_pixel", "linkNN_u", "pixel", "output", noise="pixel_px"),
    INCLINATION,
    ChannelKind("tip_position", "tip_x", "length", "output", noise="position_m"),
    ChannelKind("tip_pixel", "tip_u", "pixel", "output", noise="pixel_px"),
    ChannelKind("mark_pixel", "markNN_u", "pixel", "output", noise="pixel_px"),
    IMU_RATE,
    IMU_FORCE,
    ChannelKind("wind", "wind_x", "velocity", "surroundings"),
    ChannelKind("link_wind", "linkNN_wind_x", "velocity", "surroundings"),
)
PIXELS = frozenset({"link_pixel", "tip_pixel", "mark_pixel"})
"""Rows of the column table for pixel coordinates of cameras with a lens model."""

WINDS = ("wind", "link_wind")
COMMANDS = ("joint_command", "joint_torque", *PRESSURES)


def arm_template(channels: Sequence[RecordedChannel]) -> list[SectionTemplate]:
    """Return the sections to offer for a run with these channels."""
    rows = {channel.kind for channel in channels}
    numbered = [channel for channel in channels if channel.kind != "mark_pixel"]
    largest = max((channel.index or 0 for channel in numbered), default=0)
    commanded = bool(rows & set(COMMANDS))
    arm = dict.fromkeys(ArmSection.model_fields) | {"preset": DEFAULT_PRESET}
    del arm["wind_field"]  # no wind field is part of giajax
    if largest > DEFAULT_LINKS:
        arm["links"] = largest
    places = {"link_position", "tip_position"}
    shown = {
        "encoder": {"joint_angle", "joint_rate", "link_angle"},
        "marker": places | PIXELS,
        "camera": places,
    }
    shown["own"] = {row.name for row in KINDS["arm"].channels} - {row.name for row in CHANNELS}
    sensors = [name for name in SensorsSection.model_fields if rows & shown[name.partition("_")[0]]]
    angles = {channel.index for channel in channels if channel.kind == "joint_angle"}
    recorded = largest > 0 and angles == set(range(1, largest + 1))
    state = ["first_row"] if recorded else list(InitialSection.quantities)
    wind = "interpolation" if rows & set(WINDS) else "velocity_m_per_s"
    return [
        *([] if commanded else [SectionTemplate("", {"free_motion": True})]),
        SectionTemplate(
            "arm",
            arm,
            "known constants; a number applies to all links, and a list has one value for each "
            "link",
        ),
        SectionTemplate(
            "sensors",
            dict.fromkeys(sensors),
            "known errors of the recording; a fit can estimate them",
        ),
        *_cameras(channels),
        SectionTemplate(
            "initial",
            dict.fromkeys((*state, "free")),
            "state at the first sample; a number applies to all joints",
        ),
        *([SectionTemplate("command", {"interpolation": None})] if commanded else []),
        SectionTemplate("wind", {wind: None}),
    ]


def _cameras(channels: Sequence[RecordedChannel]) -> list[SectionTemplate]:
    """Return a section for each recorded camera and each recorded landmark."""
    seen = [channel for channel in channels if channel.kind in PIXELS]
    cameras = sorted({channel.camera or "main" for channel in seen})
    marks = sorted({channel.index or 0 for channel in seen if channel.kind == "mark_pixel"})
    lens = "lens and pose of the camera; a fit can estimate them"
    where = "position of this landmark; required"
    keys, of_mark = (dict.fromkeys(of.model_fields) for of in (PinholeSection, LandmarkSection))
    return [
        *(SectionTemplate(f"camera.{name}", keys, lens) for name in cameras),
        *(SectionTemplate(f"landmark.mark{mark:02d}", of_mark, where) for mark in marks),
    ]


def check_obstacles(section: ArmSection, source: str | None = None) -> None:
    """Raise `InputError` if a section gives contact parameters, but no obstacles."""
    about = "" if source is None else f"{source}: "
    for key in (quantity.key.name for quantity in CONTACT if quantity.key is not None):
        if getattr(section, key) is not None and not section.obstacles:
            raise InputError(
                f"{about}arm.{key} is set, but the arm has no obstacles: add them as "
                "[[arm.obstacles]], or remove this key"
            )


def links_of(section: ArmSection) -> int | None:
    """Return the number of links of a section or of its preset; None if it is not known here."""
    if section.links is not None:
        return section.links
    if section.preset in (None, DEFAULT_PRESET):
        return DEFAULT_LINKS
    return next((len(value) for value in section.lists().values()), None)


def _check(content: RecordedRun, naming: Naming) -> None:
    channels, definition = content.channels, content.definition
    section = definition.section(ArmSection)
    links = links_of(section)
    for channel in channels.values():
        numbered = channel.kind != "mark_pixel" and channel.index is not None
        if links is not None and numbered and (channel.index or 0) > links:
            part = "joint" if channel.kind.startswith("joint") else "link"
            raise InputError(
                f"{naming.source}: {naming.of(channel)} refers to {part} {channel.index}, but the "
                f"arm has only {links} links: correct the name, or set links in [arm]"
            )
    for name, check in (
        ("arm", section.check_lists),
        ("sensors", definition.section(SensorsSection).check_lists),
        ("camera", definition.section(CamerasSection).check_mounts),
    ):
        try:
            check(links)
        except ValueError as error:
            raise InputError(f"{naming.source}: [{name}] {error}") from None
    check_obstacles(section, naming.source)
    for body in section.point_masses or ():
        if links is not None and body.link > links:
            raise InputError(
                f"{naming.source}: a body of arm.point_masses is on link {body.link}, but the arm "
                f"has only {links} links: correct the number, or set links in [arm]"
            )
    _check_motion(content, naming, links)
    check_pressures(content, naming)
    windy = [channel for channel in channels.values() if channel.kind in WINDS]
    if windy and definition.section(WindSection).velocity_m_per_s is not None:
        raise InputError(
            f"{naming.source}: wind.velocity_m_per_s sets a constant wind, but the column "
            f"{naming.of(windy[0])} records the wind: remove one of them"
        )


def _check_motion(content: RecordedRun, naming: Naming, links: int | None) -> None:
    """Require a cause of motion: a command, an initial state, or `free_motion = true`."""
    initial = content.definition.section(InitialSection)
    for key in initial.quantities:
        value = getattr(initial, key)
        if isinstance(value, list) and links is not None and len(value) != links:
            raise InputError(
                f"{naming.source}: initial.{key} has {len(value)} values, but must have one for "
                f"each of the {links} joints: correct the list"
            )
    commanded = any(channel.kind in COMMANDS for channel in content.channels.values())
    free = bool(content.definition.free_motion)
    if commanded and free:
        raise InputError(
            f"{naming.source}: free_motion = true is set, but the run has command columns: remove "
            "the key or the columns"
        )
    if not (commanded or free or initial.first_row or initial.free or initial.values()):
        raise InputError(
            f"{naming.source} has no command column: an arm run must have one such as "
            "joint01_command_deg, or a sidecar with free_motion = true or [initial], so add one "
            "of these"
        )


def _notes(content: RecordedRun, sidecar: bool) -> list[str]:
    definition, notes = content.definition, []
    rows = {channel.kind for channel in content.channels.values()}
    section = definition.section(ArmSection)
    if taken := from_default_preset(section):
        where = "the sidecar has no [arm]" if sidecar else "there is no sidecar"
        about = () if section.contents() else (where,)
        notes.append(preset_sentence(taken, *about))
    if missing := missing_of_chain(section):
        notes.append(
            f"[arm] with the preset chain does not give {', '.join(missing)}, and a fit requires "
            "these values: set keys in [arm] and joints.* in [arm.parameters] (0 is a valid value "
            "there)"
        )
    unknown = [each.path for each in GEOMETRY if each.path not in (section.parameters or {})]
    if section.preset == "chain" and section.muscles and unknown:
        notes.append(
            f"the muscles are assumed to be as in the arm of the paper: {', '.join(unknown)}"
        )
    own = set(section.joint_laws or ()) - {"hardening", "end_stops"}
    if rows & set(PRESSURES) and section.muscles is None and not own:
        notes.append(
            "pressures are recorded, but no joint has muscles: set muscles in [arm], such as "
            'muscles = "pitch"'
        )
    if rows & PIXELS and not definition.section(CamerasSection).named():
        notes.append(
            "pixels are recorded, but no camera is described: describe it in [camera.NAME]"
        )
    if not definition.section(InitialSection).contents():
        notes.append(
            "the initial state is not specified: the arm is assumed to start straight and at rest"
        )
    if (
        rows & set(COMMANDS)
        and "interpolation" not in definition.section(CommandSection).contents()
    ):
        notes.append(
            "the interpolation of the commands is not specified: it is linear between samples"
        )
    absent = [f"wind_{axis}" for axis in "xyz" if f"wind_{axis}" not in content.channels]
    if "wind" in rows:
        if absent:
            verb = "are" if absent[1:] else "is"
            notes.append(f"{' and '.join(absent)} {verb} not recorded: assumed to be zero")
    elif "link_wind" in rows:
        columns = sum(each.kind == "link_wind" for each in content.channels.values())
        links = links_of(section)
        if links is None or columns < 3 * links:
            notes.append(
                "the wind is not recorded for all links and axes: it is assumed to be zero where "
                "missing"
            )
    elif definition.section(WindSection).velocity_m_per_s is None and (
        definition.section(ArmSection).wind_field is None
    ):
        notes.append("the wind is not specified: still air is assumed")
    return notes


ARM = Kind(
    name="arm",
    model="_arm:ArmModel",
    channels=CHANNELS,
    recognises=lambda rows: not rows.isdisjoint(KINDS["arm"].rows("input", "output")),
    measured="linkNN_z_m or jointNN_angle_deg",
    sections={
        "arm": ArmSection,
        "sensors": SensorsSection,
        "camera": CamerasSection,
        "landmark": LandmarksSection,
    },
    run_sections={"initial": InitialSection, "command": CommandSection, "wind": WindSection},
    commands=COMMANDS,
    uncommanded="none (free motion)",
    timed=True,
    interpolation=lambda content: content.definition.section(CommandSection).interpolation,
    check=_check,
    notes=_notes,
    template=arm_template,
    template_heading=f"# is taken from the preset {DEFAULT_PRESET}.",
)
