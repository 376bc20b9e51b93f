"""One joint at rest: muscle paths, forces, corrections, muscles and their pressures."""

from ._answer import (
    NEEDS_PRESSURE as NEEDS_PRESSURE,
    TOO_SHORT as TOO_SHORT,
    PressureAnswer as PressureAnswer,
)
from ._balance import MuscleState as MuscleState, muscle_balance as muscle_balance
from ._braided import BraidedMuscle as BraidedMuscle
from ._correction import (
    READINGS as READINGS,
    Alpha as Alpha,
    Beta as Beta,
    Correction as Correction,
)
from ._empirical import EmpiricalMuscle as EmpiricalMuscle
from ._equilibria import equilibria as equilibria
from ._equilibrium import Equilibria as Equilibria, Equilibrium as Equilibrium
from ._force_and_pressure import muscle_force as muscle_force, muscle_pressure as muscle_pressure
from ._friction import Friction as Friction
from ._geometry import (
    LARGEST_ANGLE as LARGEST_ANGLE,
    JointGeometry as JointGeometry,
    check_geometry as check_geometry,
    is_possible as is_possible,
)
from ._laws import MUSCLE_LAWS as MUSCLE_LAWS
from ._muscle import AbstractMuscle as AbstractMuscle
from ._pair import (
    JointPair as JointPair,
    PairCommand as PairCommand,
    commanded as commanded,
    pair_command as pair_command,
)
from ._path import (
    BRANCHES as BRANCHES,
    MusclePath as MusclePath,
    branch_angles as branch_angles,
    muscle_path as muscle_path,
)
from ._piston import Piston as Piston
from ._resistance import resistance as resistance, resistance_energy as resistance_energy
from ._spring import Spring as Spring, joint_spring as joint_spring
from ._statics import Joint as Joint, balanced as balanced, muscle_state as muscle_state
from ._torque import muscle_torques as muscle_torques, net_torque as net_torque
