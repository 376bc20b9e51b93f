"""The multibody arm: chain, presets, kinematics, dynamics, air, buoyancy and energy."""

from ._air import drag_force as drag_force
from ._arm import Arm as Arm
from ._atmosphere import (
    ADDED_MASSES as ADDED_MASSES,
    DRAG_CURVES as DRAG_CURVES,
    DRAGS as DRAGS,
    Air as Air,
)
from ._axes import named_axes as named_axes
from ._bodies import Bodies as Bodies, bodies as bodies, lift as lift
from ._build import chain as chain
from ._contact import Contact as Contact
from ._contact_stiffness import (
    Stiffness as Stiffness,
    contact_stiffness as contact_stiffness,
)
from ._cylinder import cylinder_drag_coefficient as cylinder_drag_coefficient
from ._dynamics import (
    acceleration as acceleration,
    forward_dynamics as forward_dynamics,
    joint_torque as joint_torque,
)
from ._energy import (
    damping_power as damping_power,
    drag_power as drag_power,
    hysteresis_power as hysteresis_power,
    kinetic_energy as kinetic_energy,
    muscle_power as muscle_power,
    potential_energy as potential_energy,
)
from ._hysteresis import JointHysteresis as JointHysteresis
from ._inertia import mass_matrix as mass_matrix
from ._joints import Joints as Joints
from ._kinematics import (
    Pose as Pose,
    link_centres as link_centres,
    link_velocities as link_velocities,
    pose as pose,
    tip_position as tip_position,
)
from ._links import Links as Links
from ._load import inverse_dynamics as inverse_dynamics
from ._masses import Buoyancy as Buoyancy, PointMasses as PointMasses
from ._memory import Memory as Memory
from ._muscle_drive import MuscleDrive as MuscleDrive
from ._pneumatics import MUSCLE_BLEND as MUSCLE_BLEND, Pneumatics as Pneumatics
from ._presets import (
    PRESETS as PRESETS,
    STANDARD_GRAVITY as STANDARD_GRAVITY,
    pendulum as pendulum,
    preset as preset,
    takeichi_20m as takeichi_20m,
    takeichi_20m_full as takeichi_20m_full,
)
from ._stops import Stops as Stops
from ._touch import Touch as Touch, contact_energy as contact_energy, touch as touch
from ._touched import touched as touched
from ._trim import net_lift as net_lift, trimmed as trimmed
