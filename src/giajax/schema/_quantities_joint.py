"""Quantities of one joint: muscles, geometry, corrections, pressures, and hysteresis."""

import numpy as np

from ._declaration import Declaration, Group, freed, freed_guess, guess, positive

MUSCLE_LENGTH = 1.96
"""Length at rest of the muscle of a joint, m; assumed."""


def _pressure_limit(default: float, doc: str) -> Declaration:
    """One key for all laws."""
    return guess(default, "Pa", doc).keyed("pressure_limit_kPa")


class _AtRest(Group):
    length = guess(MUSCLE_LENGTH, "m", "length at rest").keyed("length_m")


class _Braided(Group):
    diameter = guess(3.5e-3, "m", "diameter of a braided muscle at rest").keyed("diameter_m")
    braid_angle = guess(
        float(np.deg2rad(18)),
        "rad",
        "angle of the braid from the axis at rest (18 deg: thin muscles)",
        upper=float(np.arctan(np.sqrt(2))),
    ).keyed("braid_angle_deg")
    end_correction = freed_guess(
        1.6, "", "k: how many times the ideal law contracts further than the muscle"
    )
    effectiveness = freed_guess(1.0, "", "eta: force relative to the ideal law's")
    dead_band = freed_guess(10e3, "Pa", "p_0: pressure below which the muscle does not pull")
    pressure_limit = _pressure_limit(300e3, "highest pressure (thin muscles: 0.3 MPa)")


class _Empirical(Group):
    force_limit = freed_guess(20.0, "N", "F_max of a very long muscle at the pressure limit")
    contraction_limit = freed_guess(
        0.25, "", "contraction without a load at the pressure limit", upper=1
    )
    bell = freed_guess(1.0, "", "fall of the active part with strain")
    decay = freed_guess(4.0, "", "rise of the passive part with strain")
    end_length = Declaration(0.0075, "m", "length that the ends take from F_max", assumed=True)
    length_scale = guess(0.05, "m", "length over which F_max saturates")
    pressure_limit = _pressure_limit(300e3, "highest pressure, at which q = 1")


class _Piston(Group):
    bore = freed_guess(0.025, "m", "diameter of the bore")
    offset = Declaration(
        0.0, "N", "force without pressure: the zero of the load cell", frozen=False
    )
    pressure_limit = _pressure_limit(1e6, "highest pressure")


class _Friction(Group):
    half_width = freed_guess(
        1.0, "N", "half of the force between filling and exhausting (one number a pressure)"
    )
    presliding = freed_guess(2e-4, "m", "displacement over which friction builds up")


AT_REST = _AtRest("")
BRAIDED = _Braided("muscle")
EMPIRICAL = _Empirical("muscle")
PISTON = _Piston("muscle")
FRICTION = _Friction("friction")


# A joint with muscles: geometry, torque, the corrections alpha and beta, and what drives it.

_PER_SQUARE_DEGREE = float(np.rad2deg(1.0) ** 2)  # N m/deg^2 in N m/rad^2


def _along(key: str, default: float, doc: str, lower: float) -> Declaration:
    """The coordinate along the link of a point; `_off` is the other one."""
    return _coordinate(key, default, doc, 0, "along the link", lower)


def _off(key: str, default: float, doc: str, lower: float) -> Declaration:
    return _coordinate(key, default, doc, 1, "off the link's axis", lower)


def _coordinate(
    key: str, default: float, doc: str, place: int, direction: str, lower: float
) -> Declaration:
    return Declaration(default, "m", f"{doc}: {direction}", lower=lower, assumed=True).keyed(
        key,
        lower=-np.inf,
        remark=": along the link, and off its axis towards the muscle",
        place=place,
        meaning=doc,
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
    wire_length = guess(0.34, "m", "length L_wire of the wire through the bush").keyed(
        "wire_length_m"
    )
    muscle_length = guess(MUSCLE_LENGTH, "m", "length L_pam of the muscle at rest").keyed(
        "muscle_length_m"
    )


class _Load(Group):
    torque = Declaration(
        0.3, "N m", "torque on the joint at all times, where a run does not record it"
    ).keyed("torque_N_m", lower=0)


class _Alpha(Group):
    offset = Declaration(0.03, "N m", "alpha up to its threshold", frozen=False)
    threshold = freed(
        float(np.deg2rad(40)),
        "rad",
        "bending angle above which alpha grows (40 deg)",
        upper=float(np.pi / 2),
    )
    curvature = Declaration(
        _PER_SQUARE_DEGREE / 1600,
        "N m/rad^2",
        "growth of alpha with the square of the angle beyond its threshold (1/1600 per deg^2)",
        frozen=False,
    )


class _Beta(Group):
    offset = Declaration(0.01, "N m", "beta in the straight joint", frozen=False)
    width = freed(
        float(np.deg2rad(2)),
        "rad",
        "angle at which beta's wedge has gone (2 deg)",
        upper=float(np.pi / 2),
    )
    threshold = freed(
        float(np.deg2rad(20)),
        "rad",
        "bending angle beyond which beta falls (20 deg)",
        upper=float(np.pi / 2),
    )
    curvature = Declaration(
        0.3 * _PER_SQUARE_DEGREE / 1600,
        "N m/rad^2",
        "fall of beta with the square of the angle beyond its threshold (0.3/1600 per deg^2)",
        frozen=False,
    )


class _Drive(Group):
    lag = Declaration(
        0.2,
        "s",
        "time in which the pressure of a muscle follows its command to 63 %",
        lower=1e-3,
        upper=1e3,
        optional=True,
        has_states=True,
        assumed=True,
    )
    passive_stiffness = positive(
        0.1,
        "N m/rad",
        "stiffness of a joint with muscles about its straight pose, beside them",
        upper=1e3,
        optional=True,
    )
    stop_stiffness = guess(
        10.0, "N m/rad", "stiffness of a joint with muscles beyond 60 deg", upper=1e4
    )


GEOMETRY = _Geometry("geometry")
LOAD = _Load("")
ALPHA = _Alpha("alpha")
BETA = _Beta("beta")
DRIVE = _Drive("drive")


class _Play(Group):
    thresholds = positive(0.0, "input", "half-width of the backlash")


class _Stop(Group):
    thresholds = positive(1.0, "input", "input at which the element begins to slide")


class _PrandtlIshlinskii(Group):
    elastic = freed(1.0, "output/input", "weight of the input itself")
    weights = freed(0.1, "output/input", "weights of the plays or stops")
    thresholds = positive(1.0, "input", "thresholds of the plays or stops")


class _DeadZones(Group):
    slope = freed(1.0, "output/input", "slope between the dead zones")
    upper_thresholds = positive(1.0, "input", "dead zones above 0")
    upper_slopes = freed(1.0, "output/input", "slope beyond each dead zone above 0")
    lower_thresholds = positive(1.0, "input", "dead zones below 0, as distances from it")
    lower_slopes = freed(1.0, "output/input", "slope beyond each dead zone below 0")


class _ModifiedPrandtlIshlinskii(Group):
    weights = freed(0.1, "", "weights of the plays, relative to the input")
    thresholds = positive(1.0, "input", "thresholds of the plays")


class _Preisach(Group):
    slope = Declaration(0.5, "output/input", "reversible part of the output", frozen=False)
    saturation = freed(0.5, "output", "output of all relays up")
    coercivity = freed(0.2, "input", "median half-width of the relays")
    coercivity_spread = Declaration(
        0.7, "", "spread of the logarithm of it", lower=0.05, upper=5, frozen=False
    )
    bias = Declaration(0.0, "input", "mean centre of the relays")
    interaction = freed(0.3, "input", "standard deviation of the centres")


class _BoucWen(Group):
    elastic = freed(0.5, "output/input", "weight of the input itself")
    alpha = freed(0.5, "output/input", "slope of the hysteretic part at 0")
    beta = positive(1.0, "1/input", "scale of gamma and delta; only their products count")
    gamma = freed(1.0, "", "width of the loop")
    delta = Declaration(0.1, "", "shape of the loop", frozen=False)
    nu = Declaration(1.0, "", "sharpness of the knee", lower=0.5, upper=20)


class _Branches(Group):
    travel = positive(1.0, "output", "travel from one branch to the other")


class _BoucWenOscillator(Group):
    mass = freed(2.0, "kg", "moving mass")
    damping = freed(10.0, "N s/m", "viscous damping")
    stiffness = freed(5e4, "N/m", "stiffness beside the hysteretic element")
    alpha = freed(5e4, "N/m", "stiffness of the hysteretic element at rest")
    beta = positive(1e3, "1/m", "scale of gamma and delta; only their products count")
    gamma = freed(0.8, "", "width of the loop")
    delta = Declaration(-1.1, "", "shape of the loop", frozen=False)
    nu = Declaration(1.0, "", "sharpness of the knee", lower=0.5, upper=20)


class _Loop(Group):
    offset = Declaration(0.0, "output", "added to the output", frozen=False)
    previous_extremes = Declaration(
        0.0, "input", "turning points of the input before the run, the latest last"
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
