"""Cameras that show the world in pixels, and landmarks of the room. All of it may be left out."""

from ._declaration import Declaration, Group, Key
from ._sensors import delay


class _Pinhole(Group):
    position = Declaration(
        0.0,
        unit="m",
        shape=(3,),
        doc="centre of the camera's lens: in the base frame; of a camera on a link along, left "
        "and up from its mount",
        key=Key("position_m", example=[10.0, -15.0, 1.0]),
    )
    rotation = Declaration(
        0.0,
        unit="rad",
        shape=(3,),
        doc="turn of the camera, as a rotation vector; at 0 it looks along x, u to the right",
        key=Key("rotation_deg", example=[0.0, 0.0, 90.0]),
    )
    focal_length = Declaration(
        1000.0,
        unit="px",
        lower=0,
        upper=1e6,
        doc="focal length over the width of a pixel",
        source="OpenCV's f_x",
        key=Key("focal_length_px"),
    )
    aspect = Declaration(
        1.0,
        unit="",
        lower=0,
        upper=1e3,
        optional=True,
        neutral=1.0,
        doc="width over height of a pixel",
        source="OpenCV's f_y over its f_x",
        key=Key("aspect"),
    )
    centre = Declaration(
        0.0,
        unit="px",
        shape=(2,),
        doc="where the optical axis meets the picture: u, v; its middle by default",
        source="OpenCV's c_x and c_y",
        key=Key("centre_px", example=[959.5, 539.5]),
    )
    distortion = Declaration(
        0.0,
        unit="",
        shape=(5,),
        optional=True,
        doc="distortion of the lens: k1, k2, p1, p2, k3",
        source="OpenCV's five-parameter model (Brown-Conrady)",
        key=Key("distortion", example=[-0.2, 0.05, 0.0, 0.0, 0.0]),
    )
    delay = delay(
        "delay_s",
        "how long before its time stamp a picture was true, added to the delay of all cameras",
    )


class _Landmark(Group):
    position = Declaration(
        0.0,
        unit="m",
        shape=(3,),
        doc="where a landmark of the room is, in the base frame",
        key=Key("position_m", example=[6.0, 0.5, 1.2]),
    )


PINHOLE = _Pinhole("camera.NAME")
LANDMARK = _Landmark("landmark.NAME")
