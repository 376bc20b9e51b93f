"""Hysteresis operators and their compensation, independent of any arm."""

from ._bouc_wen import (
    MOST_STEPS as MOST_STEPS,
    BoucWen as BoucWen,
    BoucWenOscillator as BoucWenOscillator,
    bouc_wen_after as bouc_wen_after,
    bouc_wen_rate as bouc_wen_rate,
)
from ._branches import (
    BranchCompensator as BranchCompensator,
    MonotoneCurve as MonotoneCurve,
    branches_from_loop as branches_from_loop,
    isotonic as isotonic,
)
from ._operator import (
    AbstractOperator as AbstractOperator,
    InverseByBisection as InverseByBisection,
    Play as Play,
    Stop as Stop,
    history_by_steps as history_by_steps,
    play as play,
    stop as stop,
)
from ._prandtl_ishlinskii import (
    DeadZones as DeadZones,
    InverseModified as InverseModified,
    ModifiedPrandtlIshlinskii as ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii as PrandtlIshlinskii,
)
from ._preisach import Preisach as Preisach
