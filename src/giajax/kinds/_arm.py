"""An arm: from joint commands, torques and wind to positions and joint angles."""

from collections.abc import Mapping

from .._errors import InputError
from ..quantities import CONTACT
from ._arm_channels import CHANNELS, COMMANDS, DEFAULT_LINKS, DEFAULT_PRESET, PIXELS, WINDS
from ._arm_inputs import CommandSection, InitialSection, WindSection
from ._arm_pressures import PRESSURES, check_pressures
from ._arm_sections import ArmSection, SensorsSection
from ._arm_template import arm_template
from ._camera_sections import CamerasSection, LandmarksSection
from ._content import Content, RecordedChannel, Wording
from ._kind import Kind


def _recognises(rows: frozenset[str]) -> bool:
    return bool(rows & {row.name for row in CHANNELS if row.part != "surroundings"})


def check_obstacles(section: ArmSection, source: str | None = None) -> None:
    """Raise `InputError` where a section says how links press, but not against what."""
    about = "" if source is None else f"{source}: "
    for quantity in CONTACT:
        key = "" if quantity.key is None else quantity.key.name
        if getattr(section, key) is not None and not section.obstacles:
            raise InputError(
                f"{about}arm.{key} is stated, but no obstacles: add them as "
                "[[arm.obstacles]], or remove it"
            )


def links_of(section: ArmSection) -> int | None:
    """The number of links of a section or of its preset; None if it is not known here."""
    if section.links is not None:
        return section.links
    return DEFAULT_LINKS if section.preset in (None, DEFAULT_PRESET) else None


def _interpolation(content: Content) -> str:
    return content.definition.section(CommandSection).interpolation


def _check(content: Content, wording: Wording) -> None:
    channels, definition = content.channels, content.definition
    section = definition.section(ArmSection)
    links = links_of(section)
    for channel in channels.values():
        numbered = channel.kind != "mark_pixel" and channel.index is not None
        if links is not None and numbered and (channel.index or 0) > links:
            part = "link" if channel.kind.startswith("link") else "joint"
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is of {part} {channel.index}, but the "
                f"arm has {links} links: correct the name, or state links in [arm]"
            )
    for name, lists in (("arm", section), ("sensors", definition.section(SensorsSection))):
        try:
            lists.check_lists(links)
        except ValueError as error:
            raise InputError(f"{wording.source}: [{name}] {error}") from None
    try:
        definition.section(CamerasSection).check_mounts(links)
    except ValueError as error:
        raise InputError(f"{wording.source}: [camera] {error}") from None
    check_obstacles(section, wording.source)
    for body in section.point_masses or ():
        if links is not None and body.link > links:
            raise InputError(
                f"{wording.source}: a body of arm.point_masses is on link {body.link}, but the "
                f"arm has {links} links: correct the number, or state links in [arm]"
            )
    _check_motion(channels, content, wording, links)
    check_pressures(content, wording)
    windy = [channel for channel in channels.values() if channel.kind in WINDS]
    if windy and definition.section(WindSection).velocity_m_per_s is not None:
        raise InputError(
            f"{wording.source}: wind.velocity_m_per_s states a constant wind, but "
            f"{wording.of(windy[0])} records it: remove one or the other"
        )


def _check_motion(
    channels: Mapping[str, RecordedChannel], content: Content, wording: Wording, links: int | None
) -> None:
    """What moves the arm: a command, an initial state, or nothing on purpose."""
    initial = content.definition.section(InitialSection)
    for key in initial.quantities:
        value = getattr(initial, key)
        if isinstance(value, list) and links is not None and len(value) != links:
            raise InputError(
                f"{wording.source}: initial.{key} has {len(value)} values, but must have one for "
                f"each of the {links} joints: correct the list"
            )
    commanded = any(channel.kind in COMMANDS for channel in channels.values())
    free = bool(content.definition.free_motion)
    if commanded and free:
        raise InputError(
            f"{wording.source}: free_motion = true is stated, but there are command columns: "
            "remove one or the other"
        )
    has_initial = bool(initial.first_row) or bool(initial.free)
    has_initial |= bool(initial.values())
    if not commanded and not free and not has_initial:
        raise InputError(
            f"{wording.source} has no command column: an arm run must have one such as "
            "joint01_command_deg, or a sidecar with free_motion = true or [initial], so add it"
        )


def _notes(content: Content, sidecar: bool) -> list[str]:
    definition, notes = content.definition, []
    rows = {channel.kind for channel in content.channels.values()}
    if not definition.section(ArmSection).contents():
        where = "no [arm] in the sidecar" if sidecar else "no sidecar"
        notes.append(f"{where}: the constants of the preset {DEFAULT_PRESET} are assumed")
    if rows & set(PRESSURES) and definition.section(ArmSection).muscles is None:
        notes.append(
            "pressures are recorded, but no joint has muscles: state muscles in [arm], such as "
            'muscles = "pitch"'
        )
    if rows & PIXELS and not definition.section(CamerasSection).named():
        notes.append("pixels are recorded, but no camera is described: state it in [camera.NAME]")
    if not definition.section(InitialSection).contents():
        notes.append("initial state not stated: the arm starts straight and at rest")
    if (
        rows & set(COMMANDS)
        and "interpolation" not in definition.section(CommandSection).contents()
    ):
        notes.append("command interpolation not stated: linear between two rows")
    if "wind" not in rows:
        if "link_wind" in rows:
            columns = sum(each.kind == "link_wind" for each in content.channels.values())
            links = links_of(definition.section(ArmSection))
            if links is None or columns < 3 * links:
                notes.append("wind of links or along axes that are not recorded: taken as zero")
            return notes
        if definition.section(WindSection).velocity_m_per_s is None:
            notes.append("wind not stated: still air is assumed")
        return notes
    absent = [f"wind_{axis}" for axis in "xyz" if f"wind_{axis}" not in content.channels]
    if absent:
        notes.append(f"{' and '.join(absent)} not recorded: taken as zero")
    return notes


ARM = Kind(
    name="arm",
    model="_arm:ArmModel",
    channels=CHANNELS,
    recognises=_recognises,
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
    interpolation=_interpolation,
    check=_check,
    notes=_notes,
    template=arm_template,
    template_heading=f"# is as in the preset {DEFAULT_PRESET}.",
)
