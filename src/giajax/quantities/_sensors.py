"""What records an arm: camera, markers and angle sensors. All of it may be left out."""

from ._declaration import Declaration, Group, Key

_LONGEST_DELAY = 5.0
"""A clock that is off by more than this (s) is a wrong file."""


def delay(key: str, doc: str) -> Declaration:
    """Of a clock that is late, or early, by so much."""
    return Declaration(
        0.0,
        unit="s",
        lower=-_LONGEST_DELAY,
        upper=_LONGEST_DELAY,
        optional=True,
        doc=doc,
        key=Key(key, closed=True, example=0.05),
    )


class _Camera(Group):
    rotation = Declaration(
        0.0,
        unit="rad",
        shape=(3,),
        optional=True,
        doc="turn of the camera frame against the base frame, as a rotation vector",
        key=Key("camera_rotation_deg", example=[0.0, 5.0, 0.0]),
    )
    origin = Declaration(
        0.0,
        unit="m",
        shape=(3,),
        optional=True,
        doc="origin of the camera frame in the base frame",
        key=Key("camera_origin_m", example=[0.0, 0.1, 0.0]),
    )
    scale = Declaration(
        1.0,
        unit="",
        lower=0,
        optional=True,
        neutral=1.0,
        doc="recorded over true distances",
        key=Key("camera_scale"),
    )
    delay = delay("camera_delay_s", "how long before its time stamp a position or picture was true")


class _Marker(Group):
    along = Declaration(
        0.0,
        unit="m",
        per="link",
        each=True,
        optional=True,
        doc="distance of a link's marker from its centre, along the link",
        key=Key("marker_along_m"),
    )
    left = Declaration(
        0.0,
        unit="m",
        per="link",
        each=True,
        optional=True,
        doc="distance of a link's marker to the left of its centre",
        key=Key("marker_left_m"),
    )
    up = Declaration(
        0.0,
        unit="m",
        per="link",
        each=True,
        optional=True,
        doc="distance of a link's marker above its centre",
        key=Key("marker_up_m", example=0.15),
    )
    tip = Declaration(
        0.0,
        unit="m",
        shape=(3,),
        optional=True,
        doc="offset of the tip's marker from the end of the last link: along, left, up",
        key=Key("marker_tip_m"),
    )


class _Encoder(Group):
    offset = Declaration(
        0.0,
        unit="rad",
        per="joint",
        each=True,
        optional=True,
        doc="what a joint's angle sensor shows at the angle 0",
        key=Key("encoder_offset_deg"),
    )
    scale = Declaration(
        1.0,
        unit="",
        lower=0,
        per="joint",
        each=True,
        optional=True,
        neutral=1.0,
        doc="shown over true changes of a joint's angle",
        key=Key("encoder_scale"),
    )
    delay = delay("encoder_delay_s", "how long before its time stamp a joint's angle was true")


CAMERA = _Camera("camera")
MARKER = _Marker("marker")
ENCODER = _Encoder("encoder")
