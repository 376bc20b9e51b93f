"""The joints of an arm, what they remember, and their state at the first sample of a run."""

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
