"""One joint at rest: muscle paths, forces, corrections, muscles and their pressures."""

from ._braided import BraidedMuscle as BraidedMuscle
from ._correction import (
    READINGS as READINGS,
    Alpha as Alpha,
    Beta as Beta,
    Correction as Correction,
)
from ._empirical import EmpiricalMuscle as EmpiricalMuscle
from ._equilibria import (
    Equilibria as Equilibria,
    Equilibrium as Equilibrium,
    Spring as Spring,
    equilibria as equilibria,
    joint_spring as joint_spring,
)
from ._friction import Friction as Friction
from ._geometry import (
    LARGEST_ANGLE as LARGEST_ANGLE,
    JointGeometry as JointGeometry,
    check_geometry as check_geometry,
    is_possible as is_possible,
)
from ._muscle import (
    AbstractMuscle as AbstractMuscle,
    PressureAnswer as PressureAnswer,
    muscle_force as muscle_force,
    muscle_pressure as muscle_pressure,
)
from ._pair import (
    JointPair as JointPair,
    PairCommand as PairCommand,
    net_torque as net_torque,
    pair_command as pair_command,
)
from ._piston import Piston as Piston
from ._statics import (
    BRANCHES as BRANCHES,
    Joint as Joint,
    MusclePath as MusclePath,
    MuscleState as MuscleState,
    balanced as balanced,
    branch_angles as branch_angles,
    muscle_balance as muscle_balance,
    muscle_path as muscle_path,
    muscle_state as muscle_state,
)
