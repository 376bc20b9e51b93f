"""Quantities of one joint: muscles, geometry, corrections, pressures, and hysteresis."""

import numpy as np

from ._declaration import Declaration, Group, Key

MUSCLE_LENGTH = 1.96
"""Length at rest of the muscle of a joint, m; assumed."""


def _pressure_limit(default: float, doc: str) -> Declaration:
    """One key for all laws."""
    return Declaration(
        default, unit="Pa", lower=0, assumed=True, doc=doc, key=Key("pressure_limit_kPa")
    )


class _AtRest(Group):
    length = Declaration(
        MUSCLE_LENGTH,
        unit="m",
        lower=0,
        assumed=True,
        doc="length at rest",
        key=Key("length_m"),
    )


class _Braided(Group):
    diameter = Declaration(
        3.5e-3,
        unit="m",
        lower=0,
        assumed=True,
        doc="diameter of a braided muscle at rest",
        key=Key("diameter_m"),
    )
    braid_angle = Declaration(
        float(np.deg2rad(18)),
        unit="rad",
        lower=0,
        upper=float(np.arctan(np.sqrt(2))),
        assumed=True,
        doc="angle of the braid from the axis at rest (18 deg: thin muscles)",
        key=Key("braid_angle_deg"),
    )
    end_correction = Declaration(
        1.6,
        unit="",
        lower=0,
        frozen=False,
        assumed=True,
        doc="k: how many times the ideal law contracts further than the muscle",
    )
    effectiveness = Declaration(
        1.0,
        unit="",
        lower=0,
        frozen=False,
        assumed=True,
        doc="eta: force relative to the ideal law's",
    )
    dead_band = Declaration(
        10e3,
        unit="Pa",
        lower=0,
        frozen=False,
        assumed=True,
        doc="p_0: pressure below which the muscle does not pull",
    )
    pressure_limit = _pressure_limit(300e3, "highest pressure (thin muscles: 0.3 MPa)")


class _Empirical(Group):
    force_limit = Declaration(
        20.0,
        unit="N",
        lower=0,
        frozen=False,
        assumed=True,
        doc="F_max of a very long muscle at the pressure limit",
    )
    contraction_limit = Declaration(
        0.25,
        unit="",
        lower=0,
        upper=1,
        frozen=False,
        assumed=True,
        doc="contraction without a load at the pressure limit",
    )
    bell = Declaration(
        1.0,
        unit="",
        lower=0,
        frozen=False,
        assumed=True,
        doc="fall of the active part with strain",
    )
    decay = Declaration(
        4.0,
        unit="",
        lower=0,
        frozen=False,
        assumed=True,
        doc="rise of the passive part with strain",
    )
    end_length = Declaration(
        0.0075, unit="m", assumed=True, doc="length that the ends take from F_max"
    )
    length_scale = Declaration(
        0.05, unit="m", lower=0, assumed=True, doc="length over which F_max saturates"
    )
    pressure_limit = _pressure_limit(300e3, "highest pressure, at which q = 1")


class _Piston(Group):
    bore = Declaration(
        0.025, unit="m", lower=0, frozen=False, assumed=True, doc="diameter of the bore"
    )
    offset = Declaration(
        0.0, unit="N", frozen=False, doc="force without pressure: the zero of the load cell"
    )
    pressure_limit = _pressure_limit(1e6, "highest pressure")


class _Friction(Group):
    half_width = Declaration(
        1.0,
        unit="N",
        lower=0,
        frozen=False,
        assumed=True,
        doc="half of the force between filling and exhausting (one number a pressure)",
    )
    presliding = Declaration(
        2e-4,
        unit="m",
        lower=0,
        frozen=False,
        assumed=True,
        doc="displacement over which friction builds up",
    )


AT_REST = _AtRest("")
BRAIDED = _Braided("muscle")
EMPIRICAL = _Empirical("muscle")
PISTON = _Piston("muscle")
FRICTION = _Friction("friction")


# A joint with muscles: geometry, torque, the corrections alpha and beta, and what drives it.

# N m/deg^2 in N m/rad^2.
_PER_SQUARE_DEGREE = float(np.rad2deg(1.0) ** 2)


def _along(key: str, default: float, doc: str, lower: float) -> Declaration:
    """The coordinate along the link of a point; `_off` is the other one."""
    return _coordinate(key, default, doc, 0, "along the link", lower)


def _off(key: str, default: float, doc: str, lower: float) -> Declaration:
    return _coordinate(key, default, doc, 1, "off the link's axis", lower)


def _coordinate(
    key: str, default: float, doc: str, place: int, direction: str, lower: float
) -> Declaration:
    return Declaration(
        default,
        unit="m",
        lower=lower,
        assumed=True,
        doc=f"{doc}: {direction}",
        key=Key(
            key,
            lower=-np.inf,
            remark=": along the link, and off its axis towards the muscle",
            place=place,
            meaning=doc,
        ),
    )


_ANCHOR = "ends A, C, M, N of the muscle"
_WIRE = "ends B, D of the wire"
_CONTACT = "shoulders P, Q of the balloon"


class _Geometry(Group):
    anchor_x = _along("anchor_m", 0.90, _ANCHOR, lower=0)
    anchor_y = _off("anchor_m", 0.18, _ANCHOR, lower=0)
    wire_x = _along("wire_m", 0.03, _WIRE, lower=-np.inf)
    wire_y = _off("wire_m", 0.04, _WIRE, lower=-np.inf)
    contact_x = _along("contact_m", 0.055, _CONTACT, lower=0)
    contact_y = _off("contact_m", 0.15, _CONTACT, lower=0)
    wire_length = Declaration(
        0.34,
        unit="m",
        lower=0,
        assumed=True,
        doc="length L_wire of the wire through the bush",
        key=Key("wire_length_m"),
    )
    muscle_length = Declaration(
        MUSCLE_LENGTH,
        unit="m",
        lower=0,
        assumed=True,
        doc="length L_pam of the muscle at rest",
        key=Key("muscle_length_m"),
    )


class _Load(Group):
    torque = Declaration(
        0.3,
        unit="N m",
        doc="torque on the joint at all times, where a run does not record it",
        key=Key("torque_N_m", lower=0),
    )


class _Alpha(Group):
    offset = Declaration(0.03, unit="N m", frozen=False, doc="alpha up to its threshold")
    threshold = Declaration(
        float(np.deg2rad(40)),
        unit="rad",
        lower=0,
        upper=float(np.pi / 2),
        frozen=False,
        doc="bending angle above which alpha grows (40 deg)",
    )
    curvature = Declaration(
        _PER_SQUARE_DEGREE / 1600,
        unit="N m/rad^2",
        frozen=False,
        doc="growth of alpha with the square of the angle beyond its threshold (1/1600 per deg^2)",
    )


class _Beta(Group):
    offset = Declaration(0.01, unit="N m", frozen=False, doc="beta in the straight joint")
    width = Declaration(
        float(np.deg2rad(2)),
        unit="rad",
        lower=0,
        upper=float(np.pi / 2),
        frozen=False,
        doc="angle at which beta's wedge has gone (2 deg)",
    )
    threshold = Declaration(
        float(np.deg2rad(20)),
        unit="rad",
        lower=0,
        upper=float(np.pi / 2),
        frozen=False,
        doc="bending angle beyond which beta falls (20 deg)",
    )
    curvature = Declaration(
        0.3 * _PER_SQUARE_DEGREE / 1600,
        unit="N m/rad^2",
        frozen=False,
        doc="fall of beta with the square of the angle beyond its threshold (0.3/1600 per deg^2)",
    )


class _Drive(Group):
    lag = Declaration(
        0.2,
        unit="s",
        lower=1e-3,
        upper=1e3,
        optional=True,
        has_states=True,
        assumed=True,
        doc="time in which the pressure of a muscle follows its command to 63 %",
    )
    passive_stiffness = Declaration(
        0.1,
        unit="N m/rad",
        lower=0,
        upper=1e3,
        optional=True,
        doc="stiffness of a joint with muscles about its straight pose, beside them",
    )
    stop_stiffness = Declaration(
        10.0,
        unit="N m/rad",
        lower=0,
        upper=1e4,
        assumed=True,
        doc="stiffness of a joint with muscles beyond 60 deg",
    )


GEOMETRY = _Geometry("geometry")
LOAD = _Load("")
ALPHA = _Alpha("alpha")
BETA = _Beta("beta")
DRIVE = _Drive("drive")


class _Play(Group):
    thresholds = Declaration(0.0, unit="input", lower=0, doc="half-width of the backlash")


class _Stop(Group):
    thresholds = Declaration(
        1.0, unit="input", lower=0, doc="input at which the element begins to slide"
    )


class _PrandtlIshlinskii(Group):
    elastic = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="weight of the input itself"
    )
    weights = Declaration(
        0.1, unit="output/input", lower=0, frozen=False, doc="weights of the plays or stops"
    )
    thresholds = Declaration(1.0, unit="input", lower=0, doc="thresholds of the plays or stops")


class _DeadZones(Group):
    slope = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope between the dead zones"
    )
    upper_thresholds = Declaration(1.0, unit="input", lower=0, doc="dead zones above 0")
    upper_slopes = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope beyond each dead zone above 0"
    )
    lower_thresholds = Declaration(
        1.0, unit="input", lower=0, doc="dead zones below 0, as distances from it"
    )
    lower_slopes = Declaration(
        1.0, unit="output/input", lower=0, frozen=False, doc="slope beyond each dead zone below 0"
    )


class _ModifiedPrandtlIshlinskii(Group):
    weights = Declaration(
        0.1, unit="", lower=0, frozen=False, doc="weights of the plays, relative to the input"
    )
    thresholds = Declaration(1.0, unit="input", lower=0, doc="thresholds of the plays")


class _Preisach(Group):
    slope = Declaration(0.5, unit="output/input", frozen=False, doc="reversible part of the output")
    saturation = Declaration(
        0.5, unit="output", lower=0, frozen=False, doc="output of all relays up"
    )
    coercivity = Declaration(
        0.2, unit="input", lower=0, frozen=False, doc="median half-width of the relays"
    )
    coercivity_spread = Declaration(
        0.7, unit="", lower=0.05, upper=5, frozen=False, doc="spread of the logarithm of it"
    )
    bias = Declaration(0.0, unit="input", doc="mean centre of the relays")
    interaction = Declaration(
        0.3, unit="input", lower=0, frozen=False, doc="standard deviation of the centres"
    )


class _BoucWen(Group):
    elastic = Declaration(
        0.5, unit="output/input", lower=0, frozen=False, doc="weight of the input itself"
    )
    alpha = Declaration(
        0.5, unit="output/input", lower=0, frozen=False, doc="slope of the hysteretic part at 0"
    )
    beta = Declaration(
        1.0, unit="1/input", lower=0, doc="scale of gamma and delta; only their products count"
    )
    gamma = Declaration(1.0, unit="", lower=0, frozen=False, doc="width of the loop")
    delta = Declaration(0.1, unit="", frozen=False, doc="shape of the loop")
    nu = Declaration(1.0, unit="", lower=0.5, upper=20, doc="sharpness of the knee")


class _Branches(Group):
    travel = Declaration(1.0, unit="output", lower=0, doc="travel from one branch to the other")


class _BoucWenOscillator(Group):
    mass = Declaration(2.0, unit="kg", lower=0, frozen=False, doc="moving mass")
    damping = Declaration(10.0, unit="N s/m", lower=0, frozen=False, doc="viscous damping")
    stiffness = Declaration(
        5e4, unit="N/m", lower=0, frozen=False, doc="stiffness beside the hysteretic element"
    )
    alpha = Declaration(
        5e4, unit="N/m", lower=0, frozen=False, doc="stiffness of the hysteretic element at rest"
    )
    beta = Declaration(
        1e3, unit="1/m", lower=0, doc="scale of gamma and delta; only their products count"
    )
    gamma = Declaration(0.8, unit="", lower=0, frozen=False, doc="width of the loop")
    delta = Declaration(-1.1, unit="", frozen=False, doc="shape of the loop")
    nu = Declaration(1.0, unit="", lower=0.5, upper=20, doc="sharpness of the knee")


class _Loop(Group):
    offset = Declaration(0.0, unit="output", frozen=False, doc="added to the output")
    previous_extremes = Declaration(
        0.0, unit="input", doc="turning points of the input before the run, the latest last"
    )


PLAY = _Play("")
STOP = _Stop("")
PRANDTL_ISHLINSKII = _PrandtlIshlinskii("")
DEAD_ZONES = _DeadZones("dead_zones")
MODIFIED_PRANDTL_ISHLINSKII = _ModifiedPrandtlIshlinskii("")
PREISACH = _Preisach("")
BOUC_WEN = _BoucWen("")
BRANCH_COMPENSATOR = _Branches("")
BOUC_WEN_OSCILLATOR = _BoucWenOscillator("")
LOOP = _Loop("")
