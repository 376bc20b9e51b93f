"""Quantities of what records an arm (camera, markers, angle sensors) and of what fills it."""

from ._declaration import Declaration, Group, Key
from ._quantities_arm import BUOYANCY

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


class _Gas(Group):
    density = Declaration(
        BUOYANCY.helium_density.default,
        unit="kg/m^3",
        lower=0,
        doc="density of the gas at ambient pressure (helium, 20 C, 1 atm)",
        key=Key("gas_density_kg_per_m3"),
    )
    ambient_pressure = Declaration(
        101325.0,
        unit="Pa",
        lower=0,
        doc="absolute pressure of the room",
        key=Key("ambient_pressure_kPa"),
    )
    viscosity = Declaration(
        1.96e-5,
        unit="Pa s",
        lower=0,
        doc="dynamic viscosity of the gas (helium, 20 C)",
        key=Key("gas_viscosity_Pa_s"),
    )
    heat_capacity_ratio = Declaration(
        5 / 3,
        unit="",
        lower=1,
        upper=2,
        doc="ratio of the gas's heat capacities (5/3 of one atom)",
        key=Key("gas_heat_capacity_ratio"),
    )


class _Skin(Group):
    stiffness = Declaration(
        1e4,
        unit="N/m",
        lower=0,
        assumed=True,
        doc="modulus times thickness of the skin (polyethylene of 200 MPa and 50 um)",
        key=Key("skin_stiffness_N_per_m"),
    )
    poisson_ratio = Declaration(
        0.45,
        unit="",
        lower=-1,
        upper=0.5,
        assumed=True,
        doc="Poisson's ratio of the skin",
        key=Key("skin_poisson_ratio"),
    )
    slack = Declaration(
        1e-3,
        unit="",
        lower=0,
        upper=0.1,
        assumed=True,
        doc="share of its volume over which a bag passes from limp to tight",
        key=Key("skin_slack"),
    )


class _Ports(Group):
    diameter = Declaration(
        0.01,
        unit="m",
        lower=0,
        per="port",
        each=True,
        assumed=True,
        doc="diameter of the port between two bags",
        key=Key("port_diameter_mm"),
    )
    length = Declaration(
        0.005,
        unit="m",
        lower=0,
        per="port",
        each=True,
        assumed=True,
        doc="length of the port between two bags",
        key=Key("port_length_mm"),
    )
    discharge_coefficient = Declaration(
        0.61,
        unit="",
        lower=0,
        upper=1,
        assumed=True,
        doc="discharge coefficient of a port (sharp edges)",
        key=Key("port_discharge_coefficient"),
    )


class _Supply(Group):
    flow = Declaration(
        61e-3 / 60,
        unit="m^3/s",
        lower=0,
        doc="flow of a flow meter, as volume at ambient pressure",
        source="IV.B: 1.40 m^3 in 23 min",
        key=Key("supply_flow_l_per_min"),
    )
    pressure = Declaration(
        2e5,
        unit="Pa",
        lower=0,
        assumed=True,
        doc="pressure that a regulator holds, above that of the room",
        key=Key("supply_pressure_bar"),
    )
    bottle_volume = Declaration(
        0.01,
        unit="m^3",
        lower=0,
        assumed=True,
        doc="volume of a bottle",
        key=Key("bottle_volume_l"),
    )
    bottle_pressure = Declaration(
        200e5,
        unit="Pa",
        lower=0,
        assumed=True,
        doc="pressure of a full bottle, above that of the room",
        key=Key("bottle_pressure_bar"),
    )
    nozzle_diameter = Declaration(
        0.001,
        unit="m",
        lower=0,
        assumed=True,
        doc="diameter of the restriction behind a regulator or bottle",
        key=Key("nozzle_diameter_mm"),
    )
    nozzle_length = Declaration(
        0.001,
        unit="m",
        lower=0,
        assumed=True,
        doc="length of that restriction",
        key=Key("nozzle_length_mm"),
    )
    nozzle_coefficient = Declaration(
        0.8,
        unit="",
        lower=0,
        upper=1,
        assumed=True,
        doc="discharge coefficient of that restriction",
        key=Key("nozzle_discharge_coefficient"),
    )


GAS = _Gas("gas")
SKIN = _Skin("skin")
PORTS = _Ports("ports")
SUPPLY = _Supply("supply")
