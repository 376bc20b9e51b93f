"""The rigid links of an arm, and how it stands."""

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
