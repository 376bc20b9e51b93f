"""The joints of an arm, and their state at the first sample of a run."""

from ._declaration import Declaration, Group, Key


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
INITIAL = _Initial("initial")
