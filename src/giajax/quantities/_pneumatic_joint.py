"""A joint with muscles: geometry, torque, the corrections alpha and beta, and what drives it."""

import numpy as np

from ._declaration import Declaration, Group, Key
from ._muscle import MUSCLE_LENGTH

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
