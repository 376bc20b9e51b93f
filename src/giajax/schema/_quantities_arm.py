"""Quantities of the chain: air, links, joints, and contact with what stands around."""

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
        _LENGTH, "m", "length of a link, joint to joint", per="link", source=_TABLE
    ).keyed("link_length_m")
    diameter = positive(
        _DIAMETER, "m", "diameter of a link, as the air sees it", per="link", source=_TABLE
    ).keyed("link_diameter_m", closed=True)
    mass = positive(
        _MASS, "kg", "mass of a link that moves with it", per="link", source=_TABLE
    ).keyed("link_mass_kg")
    inertia_transverse = guess(
        _TRANSVERSE,
        "kg m^2",
        "moment of inertia about a transverse axis through the centre of mass (thin tube)",
        per="link",
    ).keyed("link_inertia_transverse_kg_m2", closed=True)
    inertia_axial = guess(
        _AXIAL, "kg m^2", "moment of inertia about the link's own axis (thin tube)", per="link"
    ).keyed("link_inertia_axial_kg_m2", closed=True)
    centre_of_mass = Declaration(
        _LENGTH / 2,
        "m",
        "distance of a link's centre of mass from its joint, along the link",
        per="link",
    ).keyed("link_centre_of_mass_m")
    fullness = guess(
        1.0,
        "",
        "displaced volume of a link over that of the cylinder of its length and diameter",
        per="link",
    )


class _Base(Group):
    base_rotation = Declaration(
        0.0,
        "rad",
        "turn of the straight arm against the base frame, as a rotation vector",
        shape=(3,),
    ).keyed("base_rotation_deg")
    gravity = Declaration(
        0.0, "m/s^2", "acceleration of gravity along -z; 0 where buoyancy balances weight"
    ).keyed("gravity_m_per_s2", lower=0, closed=True, remark=" (it acts along -z)")


class _PointMasses(Group):
    mass = positive(0.003, "kg", "mass of a point mass", **EACH_BODY).keyed("mass_kg")
    position = Declaration(
        _LENGTH, "m", "distance of a point mass from its link's joint, along the link", **EACH_BODY
    ).keyed("position_m")
    left = left_out(
        "m", "distance of a point mass to the left of its link's axis", **EACH_BODY
    ).keyed("left_m")
    up = left_out("m", "distance of a point mass above its link's axis", **EACH_BODY).keyed("up_m")
    drag_area = positive(
        1e-3,
        "m^2",
        "C_D A of a point mass: its drag coefficient times its frontal area",
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
        "drag coefficient C_D of eq. (1), referred to length times diameter",
        upper=50,
        source="eq. (1)",
    )
    axial_coefficient = guess(
        0.02,
        "",
        "coefficient of the drag along a link, referred to length times diameter (strip drag)",
        upper=50,
        optional=True,
    )
    added_mass_coefficient = positive(
        1.0,
        "",
        "added mass across a link over the air that it displaces (1 for a long cylinder)",
        upper=10,
        optional=True,
    )
    wind = left_out(
        "m/s",
        "constant velocity of the air in the base frame, beside the wind of the run",
        shape=(3,),
    )
    viscosity = positive(1.516e-5, "m^2/s", "kinematic viscosity of the air (20 C, 1 atm)")


class _Buoyancy(Group):
    helium_density = positive(0.1664, "kg/m^3", "density of the helium (20 C, 1 atm)")
    trim_mass = positive(0.0, "kg", "trim weight of a link", **EACH_LINK)
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
        "distance of the trim weight below the link's axis, in the straight arm",
        optional=True,
        **EACH_LINK,
    )
    imbalance = left_out(
        "N", "lift that is left over on a link, negative where it is weight", **EACH_LINK
    )


AIR = _Air("air")
BUOYANCY = _Buoyancy("buoyancy")


class _Joints(Group):
    pitch_stiffness = freed_guess(
        3.0, "N m/rad", "stiffness of a pitch joint about its commanded angle", upper=1e3
    )
    yaw_stiffness = freed_guess(
        30.0, "N m/rad", "stiffness of a yaw joint about its commanded angle", upper=1e4
    )
    damping = freed_guess(
        0.05, "N m s/rad", "viscous damping of a joint's own rate", upper=1e2, **EACH_JOINT
    )
    friction = positive(
        0.1, "N m", "Coulomb friction of a joint", upper=1e3, optional=True, **EACH_JOINT
    )
    friction_rate = guess(
        0.05, "rad/s", "rate at which Coulomb friction has reached tanh(1) = 76 % of its value"
    )
    armature = positive(
        1e-3,
        "kg m^2",
        "inertia of a joint's drive, reflected to the joint",
        optional=True,
        **EACH_JOINT,
    )


class _Memory(Group):
    strength = positive(
        0.02,
        "N m",
        "largest torque of a joint's hysteresis (Bouc-Wen; Dahl's friction by default)",
        upper=1e3,
        optional=True,
        has_states=True,
        **EACH_JOINT,
    )
    yield_angle = Declaration(
        0.005,
        "rad",
        "strength of a joint's hysteresis over its stiffness at the beginning of a motion",
        lower=1e-6,
        upper=10,
        assumed=True,
        **EACH_JOINT,
    )
    nu = Declaration(1.0, "", "sharpness of the knee of the hysteresis", lower=1, upper=20)
    delta = Declaration(
        0.0,
        "",
        "shape of the loop of the hysteresis; 0 is Dahl's, 1/2 unloads elastically",
        lower=-1,
        upper=0.5,
    )


class _Stops(Group):
    strength = positive(
        0.1,
        "N m",
        "torque at which each of a joint's elastic springs in parallel slides (Iwan)",
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
        "strain at which each of a joint's elastic springs in parallel slides",
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


class _Contact(Group):
    pressure = guess(
        1000.0, "Pa", "gauge pressure in a link, which presses where it is flattened", **EACH_LINK
    ).keyed("contact_pressure_kPa")
    shape_factor = positive(
        np.pi,
        "",
        "force of a flattened link over pressure, length and penetration: pi between two "
        "plates, 4 pi / 3 at one wall against the weight of the skin",
    ).keyed("contact_shape_factor")
    damping = guess(
        0.5, "s/m", "by how much a contact presses harder while it closes, over the closing speed"
    ).keyed("contact_damping_s_per_m", closed=True)
    friction = guess(
        0.3,
        "",
        "coefficient of friction between links and obstacles",
        optional=True,
        has_states=True,
    ).keyed("contact_friction")
    friction_stiffness = guess(
        300.0, "N/m", "stiffness of a link's skin along a surface that it sticks to"
    ).keyed("contact_friction_stiffness_N_per_m")


CONTACT = _Contact("contact")
