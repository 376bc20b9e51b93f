"""A muscle or a cylinder: its length, the parameters of each law, and its friction."""

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
