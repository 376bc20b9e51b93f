"""Statics of one joint: muscle paths, forces, corrections, muscle laws and pressures."""

from ._equilibria import (
    Equilibria as Equilibria,
    Equilibrium as Equilibrium,
    crushed_neck as crushed_neck,
    equilibria as equilibria,
)
from ._geometry import (
    BRANCHES as BRANCHES,
    LARGEST_ANGLE as LARGEST_ANGLE,
    Bend as Bend,
    JointGeometry as JointGeometry,
    MusclePath as MusclePath,
    branch_angles as branch_angles,
    check_geometry as check_geometry,
    is_possible as is_possible,
    muscle_path as muscle_path,
)
from ._history import slow_history as slow_history
from ._muscle import (
    MUSCLE_LAWS as MUSCLE_LAWS,
    NEEDS_PRESSURE as NEEDS_PRESSURE,
    TOO_SHORT as TOO_SHORT,
    AbstractMuscle as AbstractMuscle,
    BraidedMuscle as BraidedMuscle,
    EmpiricalMuscle as EmpiricalMuscle,
    Friction as Friction,
    Piston as Piston,
    PressureAnswer as PressureAnswer,
    muscle_force as muscle_force,
    muscle_pressure as muscle_pressure,
)
from ._pair import (
    JointPair as JointPair,
    PairCommand as PairCommand,
    Spring as Spring,
    commanded as commanded,
    compression as compression,
    joint_spring as joint_spring,
    muscle_torques as muscle_torques,
    net_torque as net_torque,
    pair_command as pair_command,
)
from ._statics import (
    READINGS as READINGS,
    Alpha as Alpha,
    Beta as Beta,
    Correction as Correction,
    Joint as Joint,
    MuscleState as MuscleState,
    balanced as balanced,
    muscle_balance as muscle_balance,
    muscle_state as muscle_state,
    resistance as resistance,
    resistance_energy as resistance_energy,
)
