"""Multibody model of the arm: chain, presets, kinematics, dynamics, air, buoyancy and energy."""

from ._air import drag_force as drag_force
from ._arm import (
    PRESETS as PRESETS,
    STANDARD_GRAVITY as STANDARD_GRAVITY,
    Arm as Arm,
    Bodies as Bodies,
    bodies as bodies,
    chain as chain,
    lift as lift,
    net_lift as net_lift,
    pendulum as pendulum,
    preset as preset,
    takeichi_20m as takeichi_20m,
    takeichi_20m_full as takeichi_20m_full,
    trimmed as trimmed,
    with_wind as with_wind,
)
from ._contact import (
    Pairs as Pairs,
    Stiffness as Stiffness,
    Touch as Touch,
    clearance as clearance,
    contact_energy as contact_energy,
    contact_stiffness as contact_stiffness,
    flattening as flattening,
    touch as touch,
    touched as touched,
)
from ._drag import (
    AbstractDragLaw as AbstractDragLaw,
    CentreDrag as CentreDrag,
    Stream as Stream,
    StripDrag as StripDrag,
    check_drag_law as check_drag_law,
    cylinder_drag_coefficient as cylinder_drag_coefficient,
)
from ._dynamics import (
    acceleration as acceleration,
    damping_power as damping_power,
    drag_power as drag_power,
    forward_dynamics as forward_dynamics,
    hysteresis_power as hysteresis_power,
    joint_forces as joint_forces,
    joint_torque as joint_torque,
    kinetic_energy as kinetic_energy,
    muscle_power as muscle_power,
    potential_energy as potential_energy,
)
from ._inverse_dynamics import (
    carried_inertia as carried_inertia,
    eliminate_and_solve as eliminate_and_solve,
    inverse_dynamics as inverse_dynamics,
    mass_matrix as mass_matrix,
    motion_and_momentum as motion_and_momentum,
    solve_accelerations as solve_accelerations,
    solve_eliminated as solve_eliminated,
)
from ._joint_laws import (
    AbstractJointLaw as AbstractJointLaw,
    CoulombFriction as CoulombFriction,
    Damper as Damper,
    EndStops as EndStops,
    Hardening as Hardening,
    JointHysteresis as JointHysteresis,
    JointLaws as JointLaws,
    JointState as JointState,
    Memory as Memory,
    Spring as Spring,
    Stops as Stops,
)
from ._joint_trial import check_joint_law as check_joint_law
from ._kinematics import (
    Pose as Pose,
    angular_velocities as angular_velocities,
    link_centres as link_centres,
    link_velocities as link_velocities,
    pose as pose,
    sum_from_tip as sum_from_tip,
    tip_position as tip_position,
)
from ._parts import (
    ADDED_MASSES as ADDED_MASSES,
    DRAG_CURVES as DRAG_CURVES,
    DRAGS as DRAGS,
    Air as Air,
    Buoyancy as Buoyancy,
    Contact as Contact,
    Joints as Joints,
    Links as Links,
    PointMasses as PointMasses,
    named_axes as named_axes,
    six_points as six_points,
    structural_points as structural_points,
)
from ._pneumatics import (
    MUSCLE_BLEND as MUSCLE_BLEND,
    MuscleDrive as MuscleDrive,
    Pneumatics as Pneumatics,
)
from ._wind import AbstractWind as AbstractWind, check_wind as check_wind
