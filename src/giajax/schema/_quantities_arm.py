"""Quantities of the arm, its obstacles, the sensors that record it, and its filling."""

import numpy as np

from ._declaration import (
    EACH_BODY,
    EACH_JOINT,
    EACH_LINK,
    Declaration,
    Group,
    freed_guess,
    guess,
    left_out,
    positive,
)

_TABLE = "table 2"
_LENGTH, _DIAMETER, _MASS = 0.99, 0.3, 0.047
# A thin-walled tube of this mass, length and diameter.
_AXIAL = _MASS * (_DIAMETER / 2) ** 2
_TRANSVERSE = _AXIAL / 2 + _MASS * _LENGTH**2 / 12


class _Links(Group):
    length = positive(
        _LENGTH, "m", "length of a link from joint to joint", per="link", source=_TABLE
    ).keyed("link_length_m")
    diameter = positive(
        _DIAMETER, "m", "aerodynamic diameter of a link", per="link", source=_TABLE
    ).keyed("link_diameter_m", closed=True)
    mass = positive(
        _MASS,
        "kg",
        "mass of a link, without the gas, trim weight and point masses",
        per="link",
        source=_TABLE,
    ).keyed("link_mass_kg")
    inertia_transverse = guess(
        _TRANSVERSE,
        "kg m^2",
        "moment of inertia of a link about a transverse axis through its centre of mass "
        "(default: thin tube)",
        per="link",
    ).keyed("link_inertia_transverse_kg_m2", closed=True)
    inertia_axial = guess(
        _AXIAL,
        "kg m^2",
        "moment of inertia of a link about its own axis (default: thin tube)",
        per="link",
    ).keyed("link_inertia_axial_kg_m2", closed=True)
    centre_of_mass = Declaration(
        _LENGTH / 2,
        "m",
        "distance from the joint of a link to its centre of mass, along the link",
        per="link",
    ).keyed("link_centre_of_mass_m")
    fullness = guess(
        1.0,
        "",
        "ratio of the displaced volume of a link to the volume of a cylinder of the same length "
        "and diameter",
        per="link",
    )
    pressure = guess(
        1000.0,
        "Pa",
        "gauge pressure of the gas in a link",
        earlier="contact.pressure",
        **EACH_LINK,
    ).keyed("link_pressure_kPa", closed=True, earlier="contact_pressure_kPa")


class _Base(Group):
    base_rotation = Declaration(
        0.0,
        "rad",
        "rotation of the straight arm relative to the base frame, as a rotation vector",
        shape=(3,),
    ).keyed("base_rotation_deg")
    # A small negative value is legal in files, because a fit of a balanced arm can end there.
    gravity = Declaration(
        0.0, "m/s^2", "gravitational acceleration along -z; 0 if buoyancy balances weight"
    ).keyed("gravity_m_per_s2", lower=-1, closed=True, remark=" (it acts along -z)")


class _PointMasses(Group):
    mass = positive(0.003, "kg", "mass of a point mass", **EACH_BODY).keyed("mass_kg")
    position = Declaration(
        _LENGTH, "m", "distance of a point mass from its link's joint, along the link", **EACH_BODY
    ).keyed("position_m")
    left = left_out("m", "leftward offset of a point mass from its link's axis", **EACH_BODY).keyed(
        "left_m"
    )
    up = left_out("m", "upward offset of a point mass from its link's axis", **EACH_BODY).keyed(
        "up_m"
    )
    drag_area = positive(
        1e-3,
        "m^2",
        "drag area C_D A of a point mass: its drag coefficient times its frontal area",
        optional=True,
        **EACH_BODY,
    ).keyed("drag_area_m2", closed=True)


LINKS = _Links("links")
BASE = _Base("")
POINT_MASSES = _PointMasses("point_masses")


class _Air(Group):
    density = positive(1.204, "kg/m^3", "density of the air (20 C, 1 atm)", source="eq. (1)").keyed(
        "air_density_kg_per_m3", closed=True
    )
    drag_coefficient = freed_guess(
        1.2,
        "",
        "drag coefficient C_D of eq. (1); its reference area is length times diameter of a link",
        upper=50,
        source="eq. (1)",
    )
    axial_coefficient = guess(
        0.02,
        "",
        "coefficient of the strip drag along a link; its reference area is length times diameter "
        "of the link",
        upper=50,
        optional=True,
    )
    added_mass_coefficient = positive(
        1.0,
        "",
        "ratio of the transverse added mass of a link to the mass of the displaced air (1 for a "
        "long cylinder)",
        upper=10,
        optional=True,
    )
    wind = left_out(
        "m/s",
        "constant wind velocity in the base frame, added to the wind of the run",
        shape=(3,),
    )
    viscosity = positive(1.516e-5, "m^2/s", "kinematic viscosity of the air (20 C, 1 atm)")


class _Buoyancy(Group):
    helium_density = positive(0.1664, "kg/m^3", "density of the helium (20 C, 1 atm)")
    trim_mass = positive(0.0, "kg", "mass of the trim weight of a link", **EACH_LINK)
    trim_position = Declaration(
        LINKS.length.default / 2,
        "m",
        "distance of the trim weight from the link's joint, along the link",
        assumed=True,
        **EACH_LINK,
    )
    trim_depth = Declaration(
        0.15,
        "m",
        "depth of the trim weight below the link's axis when the arm is straight",
        optional=True,
        **EACH_LINK,
    )
    imbalance = left_out("N", "excess lift of a link; negative for excess weight", **EACH_LINK)
    imbalance_drift = left_out(
        "N/s", "rate of change of the excess lift of a link from the first sample on", **EACH_LINK
    )


AIR = _Air("air")
BUOYANCY = _Buoyancy("buoyancy")


class _Joints(Group):
    pitch_stiffness = freed_guess(
        3.0,
        "N m/rad",
        "stiffness of a pitch joint about its commanded angle",
        upper=1e3,
        essential=True,
    )
    yaw_stiffness = freed_guess(
        30.0,
        "N m/rad",
        "stiffness of a yaw joint about its commanded angle",
        upper=1e4,
        essential=True,
    )
    damping = freed_guess(
        0.05, "N m s/rad", "viscous damping coefficient of a joint", upper=1e2, **EACH_JOINT
    )
    drive_gain = positive(
        1.0,
        "",
        "ratio of the angle held by a joint's drive to the commanded angle",
        upper=10,
        optional=True,
        neutral=1.0,
        **EACH_JOINT,
    )
    stiffness_factor = positive(
        1.0,
        "",
        "ratio of the stiffness of a joint to the common stiffness of all joints of its kind "
        "(pitch or yaw)",
        upper=100,
        optional=True,
        neutral=1.0,
        **EACH_JOINT,
    )
    stiffness_drift = left_out(
        "1/s",
        "relative rate of change of the joint stiffness from the first sample on",
        lower=-1.0,
        upper=1.0,
    )
    friction = positive(
        0.1, "N m", "Coulomb friction torque of a joint", upper=1e3, optional=True, **EACH_JOINT
    )
    friction_rate = guess(
        0.05,
        "rad/s",
        "joint rate at which the friction torque reaches tanh(1) = 76 % of the Coulomb "
        "friction torque",
    )
    armature = positive(
        1e-3,
        "kg m^2",
        "moment of inertia of a joint's drive, reflected to the joint",
        optional=True,
        **EACH_JOINT,
    )
    drive_lag = positive(
        0.1,
        "s",
        "time constant of the first-order lag of a joint's drive behind its command",
        upper=10,
        optional=True,
        **EACH_JOINT,
    )
    drive_saturation = positive(
        0.1,
        "1/rad^2",
        "saturation coefficient s of a joint's drive, which reaches u / sqrt(1 + s u^2) for a "
        "commanded angle u",
        upper=100,
        optional=True,
        **EACH_JOINT,
    )


class _Memory(Group):
    strength = positive(
        0.02,
        "N m",
        "maximum hysteretic torque of a joint (Bouc-Wen; Dahl friction by default)",
        upper=1e3,
        optional=True,
        has_states=True,
        **EACH_JOINT,
    )
    yield_angle = Declaration(
        0.005,
        "rad",
        "yield angle of the hysteresis of a joint: maximum hysteretic torque divided by initial "
        "stiffness",
        lower=1e-6,
        upper=10,
        assumed=True,
        **EACH_JOINT,
    )
    nu = Declaration(
        1.0,
        "",
        "exponent that determines the sharpness of the knee of the hysteresis loop",
        lower=1,
        upper=20,
    )
    delta = Declaration(
        0.0,
        "",
        "shape coefficient of the hysteresis loop; 0: Dahl friction; 1/2: elastic unloading",
        lower=-1,
        upper=0.5,
    )
    initial = left_out(
        "",
        "ratio of the initial hysteretic torque of a joint to its maximum; positive if the "
        "torque acts towards negative joint angles",
        lower=-1,
        upper=1,
        **EACH_JOINT,
    )


class _Stops(Group):
    strength = positive(
        0.1,
        "N m",
        "yield torque of each of the parallel elastic-plastic elements of a joint (Iwan)",
        per="stop",
        each=True,
        any_number=True,
        upper=1e3,
        optional=True,
        has_states=True,
    )
    yield_angle = Declaration(
        0.02,
        "rad",
        "yield angle of each of the parallel elastic-plastic elements of a joint",
        per="stop",
        each=True,
        any_number=True,
        lower=1e-6,
        upper=10,
        assumed=True,
    )


class _Initial(Group):
    angle = Declaration(0.0, "rad", "joint angles at the first sample", **EACH_JOINT).keyed(
        "angle_deg"
    )
    rate = Declaration(0.0, "rad/s", "joint rates at the first sample", **EACH_JOINT).keyed(
        "rate_deg_per_s"
    )


JOINTS = _Joints("joints")
JOINT_MEMORY = _Memory("joints.memory")
JOINT_STOPS = _Stops("joints.stops")
INITIAL = _Initial("initial")

NO_NEUTRAL = (LINKS.length, LINKS.diameter, LINKS.mass,
              JOINTS.pitch_stiffness, JOINTS.yaw_stiffness, JOINTS.damping)  # fmt: skip
"""Quantities that must be given for a user's arm, because they have no neutral default."""


class _Contact(Group):
    shape_factor = positive(
        np.pi,
        "",
        "ratio of the contact force of a flattened link to the product of pressure, length and "
        "penetration: pi between two plates, and 4 pi / 3 at one wall if the only reaction is "
        "the weight of the skin",
    ).keyed("contact_shape_factor")
    damping = guess(
        0.5, "s/m", "relative increase in the contact force per unit of closing speed"
    ).keyed("contact_damping_s_per_m", closed=True)
    friction = guess(
        0.3,
        "",
        "coefficient of friction between links and obstacles",
        optional=True,
        has_states=True,
    ).keyed("contact_friction")
    friction_stiffness = guess(
        300.0, "N/m", "tangential stiffness of a link's skin while it sticks to a surface"
    ).keyed("contact_friction_stiffness_N_per_m")


CONTACT = _Contact("contact")


# Sensors of an arm (camera, markers, angle sensors), and its filling.

_LONGEST_DELAY = 5.0
"""Largest permitted delay of a clock, s. A larger delay indicates a wrong file."""


def delay(key: str, doc: str) -> Declaration:
    """Declare the delay of a clock, which may be late (positive) or early."""
    return left_out("s", doc, lower=-_LONGEST_DELAY, upper=_LONGEST_DELAY).keyed(
        key, closed=True, example=0.05
    )


def clock_rate(key: str) -> Declaration:
    """Declare the rate error of a clock, which may be slow (positive) or fast."""
    doc = (
        "relative error of the clock rate: true time since the first sample divided by the time "
        "according to the time stamps, minus 1"
    )
    return left_out("", doc, lower=-0.05, upper=0.05).keyed(key, closed=True, example=0.001)


class _Camera(Group):
    rotation = left_out(
        "rad",
        "rotation of the camera frame relative to the base frame, as a rotation vector",
        shape=(3,),
    ).keyed("camera_rotation_deg", example=[0.0, 5.0, 0.0])
    origin = left_out("m", "origin of the camera frame in the base frame", shape=(3,)).keyed(
        "camera_origin_m", example=[0.0, 0.1, 0.0]
    )
    scale = positive(
        1.0, "", "ratio of recorded to true distances", optional=True, neutral=1.0
    ).keyed("camera_scale")
    delay = delay("camera_delay_s", "time by which the time stamp of a position or image is late")
    clock_rate = clock_rate("camera_clock_rate")
    lens_k1 = left_out(
        "",
        "relative radial distortion at a distance of half the arm's length from the middle of "
        "the straight arm; the distortion is proportional to the square of this distance",
        lower=-1,
        upper=1,
    ).keyed("camera_lens_k1", closed=True, example=-0.05)
    lens_k2 = left_out(
        "",
        "relative radial distortion as for lens_k1, but proportional to the fourth power "
        "of the distance",
        lower=-1,
        upper=1,
    ).keyed("camera_lens_k2", closed=True, example=0.01)


class _Marker(Group):
    along = left_out(
        "m", "offset of a link's marker from the centre of the link, along the link", **EACH_LINK
    ).keyed("marker_along_m")
    left = left_out(
        "m", "leftward offset of a link's marker from the centre of the link", **EACH_LINK
    ).keyed("marker_left_m")
    up = left_out(
        "m", "upward offset of a link's marker from the centre of the link", **EACH_LINK
    ).keyed("marker_up_m", example=0.15)
    tip = left_out(
        "m",
        "offset of the tip marker from the end of the last link (along, left, up)",
        shape=(3,),
    ).keyed("marker_tip_m")


class _Encoder(Group):
    offset = left_out(
        "rad", "reading of a joint's angle sensor at a joint angle of 0", **EACH_JOINT
    ).keyed("encoder_offset_deg")
    scale = positive(
        1.0,
        "",
        "ratio of measured to true changes in a joint angle",
        optional=True,
        neutral=1.0,
        **EACH_JOINT,
    ).keyed("encoder_scale")
    delay = delay("encoder_delay_s", "time by which the time stamp of a joint angle is late")
    clock_rate = clock_rate("encoder_clock_rate")
    rate_offset = left_out(
        "rad/s",
        "reading of a joint's rate sensor, such as a gyroscope, at a joint rate of 0",
        **EACH_JOINT,
    ).keyed("encoder_rate_offset_deg_per_s")


CAMERA = _Camera("camera")
MARKER = _Marker("marker")
ENCODER = _Encoder("encoder")


class _Pinhole(Group):
    position = Declaration(
        0.0,
        "m",
        "position of the lens centre in the base frame; for a camera on a link, its offset from "
        "the mount (along, left, up)",
        shape=(3,),
    ).keyed("position_m", example=[10.0, -15.0, 1.0])
    rotation = Declaration(
        0.0,
        "rad",
        "rotation of the camera, as a rotation vector; an unrotated camera looks along x, with u "
        "to the right",
        shape=(3,),
    ).keyed("rotation_deg", example=[0.0, 0.0, 90.0])
    focal_length = positive(
        1000.0,
        "px",
        "focal length divided by the width of a pixel",
        upper=1e6,
        source="OpenCV's f_x",
    ).keyed("focal_length_px")
    aspect = positive(
        1.0,
        "",
        "ratio of the width to the height of a pixel",
        upper=1e3,
        optional=True,
        neutral=1.0,
        source="OpenCV's f_y over its f_x",
    ).keyed("aspect")
    centre = Declaration(
        0.0,
        "px",
        "image point (u, v) on the optical axis (default: the middle of the image)",
        shape=(2,),
        source="OpenCV's c_x and c_y",
    ).keyed("centre_px", example=[959.5, 539.5])
    distortion = left_out(
        "",
        "distortion coefficients of the lens: k1, k2, p1, p2, k3",
        shape=(5,),
        source="OpenCV's five-parameter model (Brown-Conrady)",
    ).keyed("distortion", example=[-0.2, 0.05, 0.0, 0.0, 0.0])
    delay = delay(
        "delay_s",
        "time by which the time stamps of this camera are late, in addition to the common delay "
        "of all cameras",
    )


class _Landmark(Group):
    position = Declaration(0.0, "m", "position of a landmark in the base frame", shape=(3,)).keyed(
        "position_m", example=[6.0, 0.5, 1.2]
    )


PINHOLE = _Pinhole("camera.NAME")
LANDMARK = _Landmark("landmark.NAME")


class _Gas(Group):
    density = positive(
        BUOYANCY.helium_density.default,
        "kg/m^3",
        "density of the gas at ambient pressure (helium, 20 C, 1 atm)",
    ).keyed("gas_density_kg_per_m3")
    ambient_pressure = positive(101325.0, "Pa", "absolute pressure in the room").keyed(
        "ambient_pressure_kPa"
    )
    viscosity = positive(1.96e-5, "Pa s", "dynamic viscosity of the gas (helium, 20 C)").keyed(
        "gas_viscosity_Pa_s"
    )
    heat_capacity_ratio = Declaration(
        5 / 3, "", "heat capacity ratio of the gas (5/3 for a monatomic gas)", lower=1, upper=2
    ).keyed("gas_heat_capacity_ratio")


class _Skin(Group):
    stiffness = guess(
        1e4,
        "N/m",
        "membrane stiffness of the skin: Young's modulus times thickness (polyethylene, "
        "200 MPa times 50 um)",
    ).keyed("skin_stiffness_N_per_m")
    poisson_ratio = Declaration(
        0.45, "", "Poisson's ratio of the skin", lower=-1, upper=0.5, assumed=True
    ).keyed("skin_poisson_ratio")
    slack = guess(
        1e-3, "", "relative change in volume over which a bag changes from limp to taut", upper=0.1
    ).keyed("skin_slack")


class _Neck(Group):
    radius = Declaration(
        0.05, "m", "radius of the neck in a joint", lower=0, optional=True, assumed=True
    )
    length = guess(0.02, "m", "length of the film that bends in the neck")
    film_stiffness = guess(
        _Skin.stiffness.default,
        "N/m",
        "membrane stiffness of the film of the neck: Young's modulus times thickness",
    )
    # The default is the pressure of the links, because gas passes between links and neck.
    pressure = guess(_Links.pressure.default, "Pa", "gauge pressure of the gas in the neck")


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
        "volume flow rate through a flow meter, at ambient pressure",
        source="IV.B: 1.40 m^3 in 23 min",
    ).keyed("supply_flow_l_per_min")
    pressure = guess(2e5, "Pa", "gauge pressure that a regulator holds").keyed(
        "supply_pressure_bar"
    )
    bottle_volume = guess(0.01, "m^3", "volume of a gas bottle").keyed("bottle_volume_l")
    bottle_pressure = guess(200e5, "Pa", "gauge pressure in a full gas bottle").keyed(
        "bottle_pressure_bar"
    )
    nozzle_diameter = guess(
        0.001, "m", "diameter of the restriction behind a regulator or bottle"
    ).keyed("nozzle_diameter_mm")
    nozzle_length = guess(
        0.001, "m", "length of the restriction behind a regulator or bottle"
    ).keyed("nozzle_length_mm")
    nozzle_coefficient = guess(
        0.8, "", "discharge coefficient of the restriction behind a regulator or bottle", upper=1
    ).keyed("nozzle_discharge_coefficient")


class _Roll(Group):
    radius = guess(0.1, "m", "outer radius of the roll when the whole arm is wound up").keyed(
        "roll_radius_mm"
    )
    core_radius = guess(0.05, "m", "radius of the core on which the arm is wound").keyed(
        "core_radius_mm"
    )
    core_mass = guess(0.1, "kg", "mass of the core of the roll, which is a thin tube").keyed(
        "core_mass_kg"
    )
    start = guess(0.1, "m", "initial unrolled length of the arm").keyed("start_length_m")
    start_speed = positive(0.0, "m/s", "initial speed of the roll", assumed=True).keyed(
        "start_speed_m_per_s", closed=True
    )


class _Film(Group):
    thickness = guess(50e-6, "m", "thickness of the skin's film").keyed("film_thickness_mm")
    creep = Declaration(
        1.0,
        "",
        "fraction of the curvature in the roll that the film retains when it is unrolled: 0 for "
        "elastic film, which drives the roll; 1 for fully crept film, which must be straightened",
        lower=0,
        upper=1,
        assumed=True,
    ).keyed("film_creep", closed=True)
    peel = guess(0.3, "N", "force required to separate the layers of the roll").keyed(
        "peel_force_N", closed=True
    )
    loss = guess(
        10.0,
        "N s/m",
        "coefficient of viscous resistance to the roll: opposing force divided by the "
        "speed of the roll",
    ).keyed("front_loss_N_s_per_m", closed=True)


class _Hand(Group):
    speed = guess(0.1, "m/s", "speed at which a hand unrolls the arm").keyed("hand_speed_m_per_s")
    force = guess(1.0, "N", "force with which a hand pushes the roll").keyed(
        "hand_force_N", closed=True
    )


GAS = _Gas("gas")
SKIN = _Skin("skin")
NECK = _Neck("neck")
PORTS = _Ports("ports")
SUPPLY = _Supply("supply")
ROLL = _Roll("roll")
FILM = _Film("film")
HAND = _Hand("hand")
