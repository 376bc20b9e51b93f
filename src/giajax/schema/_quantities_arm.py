"""Quantities of the chain: air, links, joints, and contact with what stands around."""

import numpy as np

from ._declaration import Declaration, Group, Key

_TABLE = "table 2"
_LENGTH, _DIAMETER, _MASS = 0.99, 0.3, 0.047
# A thin-walled tube of this mass, length and diameter.
_AXIAL = _MASS * (_DIAMETER / 2) ** 2
_TRANSVERSE = _AXIAL / 2 + _MASS * _LENGTH**2 / 12


class _Links(Group):
    length = Declaration(
        _LENGTH,
        unit="m",
        lower=0,
        per="link",
        doc="length of a link, joint to joint",
        source=_TABLE,
        key=Key("link_length_m"),
    )
    diameter = Declaration(
        _DIAMETER,
        unit="m",
        lower=0,
        per="link",
        doc="diameter of a link, as the air sees it",
        source=_TABLE,
        key=Key("link_diameter_m", closed=True),
    )
    mass = Declaration(
        _MASS,
        unit="kg",
        lower=0,
        per="link",
        doc="mass of a link that moves with it",
        source=_TABLE,
        key=Key("link_mass_kg"),
    )
    inertia_transverse = Declaration(
        _TRANSVERSE,
        unit="kg m^2",
        lower=0,
        per="link",
        assumed=True,
        doc="moment of inertia about a transverse axis through the centre of mass (thin tube)",
        key=Key("link_inertia_transverse_kg_m2", closed=True),
    )
    inertia_axial = Declaration(
        _AXIAL,
        unit="kg m^2",
        lower=0,
        per="link",
        assumed=True,
        doc="moment of inertia about the link's own axis (thin tube)",
        key=Key("link_inertia_axial_kg_m2", closed=True),
    )
    centre_of_mass = Declaration(
        _LENGTH / 2,
        unit="m",
        per="link",
        doc="distance of a link's centre of mass from its joint, along the link",
        key=Key("link_centre_of_mass_m"),
    )
    fullness = Declaration(
        1.0,
        unit="",
        lower=0,
        per="link",
        assumed=True,
        doc="displaced volume of a link over that of the cylinder of its length and diameter",
    )


class _Base(Group):
    base_rotation = Declaration(
        0.0,
        unit="rad",
        shape=(3,),
        doc="turn of the straight arm against the base frame, as a rotation vector",
        key=Key("base_rotation_deg"),
    )
    gravity = Declaration(
        0.0,
        unit="m/s^2",
        doc="acceleration of gravity along -z; 0 where buoyancy balances weight",
        key=Key("gravity_m_per_s2", lower=0, closed=True, remark=" (it acts along -z)"),
    )


class _PointMasses(Group):
    mass = Declaration(
        0.003,
        unit="kg",
        lower=0,
        per="body",
        each=True,
        doc="mass of a point mass",
        key=Key("mass_kg"),
    )
    position = Declaration(
        _LENGTH,
        unit="m",
        per="body",
        each=True,
        doc="distance of a point mass from its link's joint, along the link",
        key=Key("position_m"),
    )
    left = Declaration(
        0.0,
        unit="m",
        per="body",
        each=True,
        optional=True,
        doc="distance of a point mass to the left of its link's axis",
        key=Key("left_m"),
    )
    up = Declaration(
        0.0,
        unit="m",
        per="body",
        each=True,
        optional=True,
        doc="distance of a point mass above its link's axis",
        key=Key("up_m"),
    )
    drag_area = Declaration(
        1e-3,
        unit="m^2",
        lower=0,
        per="body",
        each=True,
        optional=True,
        doc="C_D A of a point mass: its drag coefficient times its frontal area",
        key=Key("drag_area_m2", closed=True),
    )


LINKS = _Links("links")
BASE = _Base("")
POINT_MASSES = _PointMasses("point_masses")


class _Air(Group):
    density = Declaration(
        1.204,
        unit="kg/m^3",
        lower=0,
        doc="density of the air (20 C, 1 atm)",
        source="eq. (1)",
        key=Key("air_density_kg_per_m3", closed=True),
    )
    drag_coefficient = Declaration(
        1.2,
        unit="",
        lower=0,
        upper=50,
        frozen=False,
        assumed=True,
        doc="drag coefficient C_D of eq. (1), referred to length times diameter",
        source="eq. (1)",
    )
    axial_coefficient = Declaration(
        0.02,
        unit="",
        lower=0,
        upper=50,
        optional=True,
        assumed=True,
        doc="coefficient of the drag along a link, referred to length times diameter (strip drag)",
    )
    added_mass_coefficient = Declaration(
        1.0,
        unit="",
        lower=0,
        upper=10,
        optional=True,
        doc="added mass across a link over the air that it displaces (1 for a long cylinder)",
    )
    wind = Declaration(
        0.0,
        unit="m/s",
        shape=(3,),
        optional=True,
        doc="constant velocity of the air in the base frame, beside the wind of the run",
    )
    viscosity = Declaration(
        1.516e-5, unit="m^2/s", lower=0, doc="kinematic viscosity of the air (20 C, 1 atm)"
    )


class _Buoyancy(Group):
    helium_density = Declaration(
        0.1664, unit="kg/m^3", lower=0, doc="density of the helium (20 C, 1 atm)"
    )
    trim_mass = Declaration(
        0.0, unit="kg", lower=0, per="link", each=True, doc="trim weight of a link"
    )
    trim_position = Declaration(
        LINKS.length.default / 2,
        unit="m",
        per="link",
        each=True,
        assumed=True,
        doc="distance of the trim weight from the link's joint, along the link",
    )
    trim_depth = Declaration(
        0.15,
        unit="m",
        per="link",
        each=True,
        optional=True,
        doc="distance of the trim weight below the link's axis, in the straight arm",
    )
    imbalance = Declaration(
        0.0,
        unit="N",
        per="link",
        each=True,
        optional=True,
        doc="lift that is left over on a link, negative where it is weight",
    )


AIR = _Air("air")
BUOYANCY = _Buoyancy("buoyancy")


class _Joints(Group):
    pitch_stiffness = Declaration(
        3.0,
        unit="N m/rad",
        lower=0,
        upper=1e3,
        frozen=False,
        assumed=True,
        doc="stiffness of a pitch joint about its commanded angle",
    )
    yaw_stiffness = Declaration(
        30.0,
        unit="N m/rad",
        lower=0,
        upper=1e4,
        frozen=False,
        assumed=True,
        doc="stiffness of a yaw joint about its commanded angle",
    )
    damping = Declaration(
        0.05,
        unit="N m s/rad",
        per="joint",
        each=True,
        lower=0,
        upper=1e2,
        frozen=False,
        assumed=True,
        doc="viscous damping of a joint's own rate",
    )
    friction = Declaration(
        0.1,
        unit="N m",
        per="joint",
        each=True,
        lower=0,
        upper=1e3,
        optional=True,
        doc="Coulomb friction of a joint",
    )
    friction_rate = Declaration(
        0.05,
        unit="rad/s",
        lower=0,
        assumed=True,
        doc="rate at which Coulomb friction has reached tanh(1) = 76 % of its value",
    )
    armature = Declaration(
        1e-3,
        unit="kg m^2",
        per="joint",
        each=True,
        lower=0,
        optional=True,
        doc="inertia of a joint's drive, reflected to the joint",
    )


class _Memory(Group):
    strength = Declaration(
        0.02,
        unit="N m",
        per="joint",
        each=True,
        lower=0,
        upper=1e3,
        optional=True,
        has_states=True,
        doc="largest torque of a joint's hysteresis (Bouc-Wen; Dahl's friction by default)",
    )
    yield_angle = Declaration(
        0.005,
        unit="rad",
        per="joint",
        each=True,
        lower=1e-6,
        upper=10,
        assumed=True,
        doc="strength of a joint's hysteresis over its stiffness at the beginning of a motion",
    )
    nu = Declaration(1.0, unit="", lower=1, upper=20, doc="sharpness of the knee of the hysteresis")
    delta = Declaration(
        0.0,
        unit="",
        lower=-1,
        upper=0.5,
        doc="shape of the loop of the hysteresis; 0 is Dahl's, 1/2 unloads elastically",
    )


class _Stops(Group):
    strength = Declaration(
        0.1,
        unit="N m",
        per="stop",
        each=True,
        any_number=True,
        lower=0,
        upper=1e3,
        optional=True,
        has_states=True,
        doc="torque at which each of a joint's elastic springs in parallel slides (Iwan)",
    )
    yield_angle = Declaration(
        0.02,
        unit="rad",
        per="stop",
        each=True,
        any_number=True,
        lower=1e-6,
        upper=10,
        assumed=True,
        doc="strain at which each of a joint's elastic springs in parallel slides",
    )


class _Initial(Group):
    angle = Declaration(
        0.0,
        unit="rad",
        per="joint",
        each=True,
        doc="joint angles at the first sample",
        key=Key("angle_deg"),
    )
    rate = Declaration(
        0.0,
        unit="rad/s",
        per="joint",
        each=True,
        doc="joint rates at the first sample",
        key=Key("rate_deg_per_s"),
    )


JOINTS = _Joints("joints")
JOINT_MEMORY = _Memory("joints.memory")
JOINT_STOPS = _Stops("joints.stops")
INITIAL = _Initial("initial")


class _Contact(Group):
    pressure = Declaration(
        1000.0,
        unit="Pa",
        lower=0,
        per="link",
        each=True,
        assumed=True,
        doc="gauge pressure in a link, which presses where it is flattened",
        key=Key("contact_pressure_kPa"),
    )
    shape_factor = Declaration(
        np.pi,
        unit="",
        lower=0,
        doc="force of a flattened link over pressure, length and penetration: pi between two "
        "plates, 4 pi / 3 at one wall against the weight of the skin",
        key=Key("contact_shape_factor"),
    )
    damping = Declaration(
        0.5,
        unit="s/m",
        lower=0,
        assumed=True,
        doc="by how much a contact presses harder while it closes, over the closing speed",
        key=Key("contact_damping_s_per_m", closed=True),
    )
    friction = Declaration(
        0.3,
        unit="",
        lower=0,
        assumed=True,
        optional=True,
        has_states=True,
        doc="coefficient of friction between links and obstacles",
        key=Key("contact_friction"),
    )
    friction_stiffness = Declaration(
        300.0,
        unit="N/m",
        lower=0,
        assumed=True,
        doc="stiffness of a link's skin along a surface that it sticks to",
        key=Key("contact_friction_stiffness_N_per_m"),
    )


CONTACT = _Contact("contact")
