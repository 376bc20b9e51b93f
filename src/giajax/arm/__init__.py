"""The multibody arm: chain, presets, kinematics, dynamics, drag and energy."""

from ._chain import (
    Air as Air,
    Arm as Arm,
    Joints as Joints,
    Links as Links,
    named_axes as named_axes,
)
from ._drag import drag_force as drag_force
from ._dynamics import (
    acceleration as acceleration,
    forward_dynamics as forward_dynamics,
    inverse_dynamics as inverse_dynamics,
    joint_torque as joint_torque,
    mass_matrix as mass_matrix,
)
from ._energy import (
    damping_power as damping_power,
    drag_power as drag_power,
    kinetic_energy as kinetic_energy,
    potential_energy as potential_energy,
)
from ._kinematics import (
    link_centres as link_centres,
    link_velocities as link_velocities,
    tip_position as tip_position,
)
from ._presets import chain as chain, preset as preset, takeichi_20m as takeichi_20m
