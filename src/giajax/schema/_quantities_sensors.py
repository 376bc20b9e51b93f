"""Quantities of what records an arm (camera, markers, angle sensors) and of what fills it."""

from ._declaration import EACH_JOINT, EACH_LINK, Declaration, Group, guess, left_out, positive
from ._quantities_arm import BUOYANCY

_LONGEST_DELAY = 5.0
"""A clock that is off by more than this (s) is a wrong file."""


def delay(key: str, doc: str) -> Declaration:
    """Of a clock that is late, or early, by so much."""
    return left_out("s", doc, lower=-_LONGEST_DELAY, upper=_LONGEST_DELAY).keyed(
        key, closed=True, example=0.05
    )


class _Camera(Group):
    rotation = left_out(
        "rad", "turn of the camera frame against the base frame, as a rotation vector", shape=(3,)
    ).keyed("camera_rotation_deg", example=[0.0, 5.0, 0.0])
    origin = left_out("m", "origin of the camera frame in the base frame", shape=(3,)).keyed(
        "camera_origin_m", example=[0.0, 0.1, 0.0]
    )
    scale = positive(1.0, "", "recorded over true distances", optional=True, neutral=1.0).keyed(
        "camera_scale"
    )
    delay = delay("camera_delay_s", "how long before its time stamp a position or picture was true")


class _Marker(Group):
    along = left_out(
        "m", "distance of a link's marker from its centre, along the link", **EACH_LINK
    ).keyed("marker_along_m")
    left = left_out(
        "m", "distance of a link's marker to the left of its centre", **EACH_LINK
    ).keyed("marker_left_m")
    up = left_out("m", "distance of a link's marker above its centre", **EACH_LINK).keyed(
        "marker_up_m", example=0.15
    )
    tip = left_out(
        "m", "offset of the tip's marker from the end of the last link: along, left, up", shape=(3,)
    ).keyed("marker_tip_m")


class _Encoder(Group):
    offset = left_out(
        "rad", "what a joint's angle sensor shows at the angle 0", **EACH_JOINT
    ).keyed("encoder_offset_deg")
    scale = positive(
        1.0,
        "",
        "shown over true changes of a joint's angle",
        optional=True,
        neutral=1.0,
        **EACH_JOINT,
    ).keyed("encoder_scale")
    delay = delay("encoder_delay_s", "how long before its time stamp a joint's angle was true")


CAMERA = _Camera("camera")
MARKER = _Marker("marker")
ENCODER = _Encoder("encoder")


class _Pinhole(Group):
    position = Declaration(
        0.0,
        "m",
        "centre of the camera's lens: in the base frame; of a camera on a link along, left "
        "and up from its mount",
        shape=(3,),
    ).keyed("position_m", example=[10.0, -15.0, 1.0])
    rotation = Declaration(
        0.0,
        "rad",
        "turn of the camera, as a rotation vector; at 0 it looks along x, u to the right",
        shape=(3,),
    ).keyed("rotation_deg", example=[0.0, 0.0, 90.0])
    focal_length = positive(
        1000.0, "px", "focal length over the width of a pixel", upper=1e6, source="OpenCV's f_x"
    ).keyed("focal_length_px")
    aspect = positive(
        1.0,
        "",
        "width over height of a pixel",
        upper=1e3,
        optional=True,
        neutral=1.0,
        source="OpenCV's f_y over its f_x",
    ).keyed("aspect")
    centre = Declaration(
        0.0,
        "px",
        "where the optical axis meets the picture: u, v; its middle by default",
        shape=(2,),
        source="OpenCV's c_x and c_y",
    ).keyed("centre_px", example=[959.5, 539.5])
    distortion = left_out(
        "",
        "distortion of the lens: k1, k2, p1, p2, k3",
        shape=(5,),
        source="OpenCV's five-parameter model (Brown-Conrady)",
    ).keyed("distortion", example=[-0.2, 0.05, 0.0, 0.0, 0.0])
    delay = delay(
        "delay_s",
        "how long before its time stamp a picture was true, added to the delay of all cameras",
    )


class _Landmark(Group):
    position = Declaration(
        0.0, "m", "where a landmark of the room is, in the base frame", shape=(3,)
    ).keyed("position_m", example=[6.0, 0.5, 1.2])


PINHOLE = _Pinhole("camera.NAME")
LANDMARK = _Landmark("landmark.NAME")


class _Gas(Group):
    density = positive(
        BUOYANCY.helium_density.default,
        "kg/m^3",
        "density of the gas at ambient pressure (helium, 20 C, 1 atm)",
    ).keyed("gas_density_kg_per_m3")
    ambient_pressure = positive(101325.0, "Pa", "absolute pressure of the room").keyed(
        "ambient_pressure_kPa"
    )
    viscosity = positive(1.96e-5, "Pa s", "dynamic viscosity of the gas (helium, 20 C)").keyed(
        "gas_viscosity_Pa_s"
    )
    heat_capacity_ratio = Declaration(
        5 / 3, "", "ratio of the gas's heat capacities (5/3 of one atom)", lower=1, upper=2
    ).keyed("gas_heat_capacity_ratio")


class _Skin(Group):
    stiffness = guess(
        1e4, "N/m", "modulus times thickness of the skin (polyethylene of 200 MPa and 50 um)"
    ).keyed("skin_stiffness_N_per_m")
    poisson_ratio = Declaration(
        0.45, "", "Poisson's ratio of the skin", lower=-1, upper=0.5, assumed=True
    ).keyed("skin_poisson_ratio")
    slack = guess(
        1e-3, "", "share of its volume over which a bag passes from limp to tight", upper=0.1
    ).keyed("skin_slack")


class _Ports(Group):
    diameter = guess(
        0.01, "m", "diameter of the port between two bags", per="port", each=True
    ).keyed("port_diameter_mm")
    length = guess(0.005, "m", "length of the port between two bags", per="port", each=True).keyed(
        "port_length_mm"
    )
    discharge_coefficient = guess(
        0.61, "", "discharge coefficient of a port (sharp edges)", upper=1
    ).keyed("port_discharge_coefficient")


class _Supply(Group):
    flow = positive(
        61e-3 / 60,
        "m^3/s",
        "flow of a flow meter, as volume at ambient pressure",
        source="IV.B: 1.40 m^3 in 23 min",
    ).keyed("supply_flow_l_per_min")
    pressure = guess(2e5, "Pa", "pressure that a regulator holds, above that of the room").keyed(
        "supply_pressure_bar"
    )
    bottle_volume = guess(0.01, "m^3", "volume of a bottle").keyed("bottle_volume_l")
    bottle_pressure = guess(200e5, "Pa", "pressure of a full bottle, above that of the room").keyed(
        "bottle_pressure_bar"
    )
    nozzle_diameter = guess(
        0.001, "m", "diameter of the restriction behind a regulator or bottle"
    ).keyed("nozzle_diameter_mm")
    nozzle_length = guess(0.001, "m", "length of that restriction").keyed("nozzle_length_mm")
    nozzle_coefficient = guess(0.8, "", "discharge coefficient of that restriction", upper=1).keyed(
        "nozzle_discharge_coefficient"
    )


GAS = _Gas("gas")
SKIN = _Skin("skin")
PORTS = _Ports("ports")
SUPPLY = _Supply("supply")
