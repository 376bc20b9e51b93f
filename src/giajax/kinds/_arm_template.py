"""What the sidecar of an arm's run is offered, by what was recorded."""

from collections.abc import Sequence

from ._arm_channels import COMMANDS, DEFAULT_LINKS, PIXELS, WINDS
from ._arm_inputs import InitialSection
from ._arm_sections import ArmSection, SensorsSection
from ._camera_sections import LandmarkSection, PinholeSection
from ._content import RecordedChannel
from ._kind import Offer


def arm_template(channels: Sequence[RecordedChannel]) -> list[Offer]:
    """The sections to offer for a run with these channels."""
    rows = {channel.kind for channel in channels}
    numbered = [channel for channel in channels if channel.kind != "mark_pixel"]
    largest = max((channel.index or 0 for channel in numbered), default=0)
    commanded = bool(rows & set(COMMANDS))
    arm = dict.fromkeys(ArmSection.model_fields)
    if largest > DEFAULT_LINKS:
        arm["links"] = largest
    sensors = [
        name for name in SensorsSection.model_fields if _records(name.partition("_")[0], rows)
    ]
    angles = {channel.index for channel in channels if channel.kind == "joint_angle"}
    recorded = largest > 0 and angles == set(range(1, largest + 1))
    state = ["first_row"] if recorded else list(InitialSection.quantities)
    wind = "interpolation" if rows & set(WINDS) else "velocity_m_per_s"
    return [
        *([] if commanded else [Offer("", {"free_motion": True})]),
        Offer("arm", arm, "known constants; a number holds for all links, a list has one a link"),
        Offer(
            "sensors",
            dict.fromkeys(sensors),
            "known errors of the recording; a fit can find them too",
        ),
        *_cameras(channels),
        Offer(
            "initial",
            dict.fromkeys((*state, "free")),
            "at the first sample; a number holds for all joints",
        ),
        *([Offer("command", {"interpolation": None})] if commanded else []),
        Offer("wind", {wind: None}),
    ]


def _cameras(channels: Sequence[RecordedChannel]) -> list[Offer]:
    """A section for each camera and each landmark that is recorded."""
    seen = [channel for channel in channels if channel.kind in PIXELS]
    cameras = sorted({channel.camera or "main" for channel in seen})
    marks = sorted({channel.index or 0 for channel in seen if channel.kind == "mark_pixel"})
    lens = "its lens and where it is; a fit can find these too"
    where = "where this landmark is; must be stated"
    return [
        *(
            Offer(f"camera.{name}", dict.fromkeys(PinholeSection.model_fields), lens)
            for name in cameras
        ),
        *(
            Offer(f"landmark.mark{mark:02d}", dict.fromkeys(LandmarkSection.model_fields), where)
            for mark in marks
        ),
    ]


def _records(sensor: str, rows: set[str]) -> bool:
    """Whether a sensor records one of these rows of the table."""
    if sensor == "encoder":
        return bool(rows & {"joint_angle", "joint_rate", "link_angle"})
    positions = {"link_position", "tip_position"}
    return bool(rows & (positions | PIXELS if sensor == "marker" else positions))
