"""Hysteresis operators and their compensation. Knows no arm."""

from ._bouc_wen import BoucWen as BoucWen, bouc_wen_rate as bouc_wen_rate
from ._branches import (
    BranchCompensator as BranchCompensator,
    MonotoneCurve as MonotoneCurve,
    branches_from_loop as branches_from_loop,
    isotonic as isotonic,
)
from ._dead_zones import DeadZones as DeadZones
from ._inverse import InverseByBisection as InverseByBisection
from ._modified import (
    InverseModified as InverseModified,
    ModifiedPrandtlIshlinskii as ModifiedPrandtlIshlinskii,
)
from ._operator import AbstractOperator as AbstractOperator
from ._oscillator import MOST_STEPS as MOST_STEPS, BoucWenOscillator as BoucWenOscillator
from ._play import Play as Play, Stop as Stop, play as play, stop as stop
from ._prandtl_ishlinskii import PrandtlIshlinskii as PrandtlIshlinskii
from ._preisach import Preisach as Preisach
