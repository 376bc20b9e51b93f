"""Filling an arm of balloons with helium: bags in a row, ports between them, and a supply."""

from ._bags import BagState as BagState, Skin as Skin, bag_state as bag_state
from ._curve import (
    DIAMETERS as DIAMETERS,
    PAPER_DURATION as PAPER_DURATION,
    FillingCurve as FillingCurve,
    filling_curve as filling_curve,
)
from ._fill import LIMIT as LIMIT, Filled as Filled, fill as fill
from ._filling import Filling as Filling, Ports as Ports
from ._gas import Gas as Gas
from ._orifice import Hole as Hole, critical_ratio as critical_ratio, mass_flow as mass_flow
from ._stiffness import stiff_share as stiff_share
from ._supply import STRENGTHS as STRENGTHS, Supply as Supply, inflow as inflow
