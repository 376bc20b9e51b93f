"""apps/filling"""

from ._fill import (
    DIAMETERS as DIAMETERS,
    LIMIT as LIMIT,
    PAPER_DURATION as PAPER_DURATION,
    Filled as Filled,
    FillingCurve as FillingCurve,
    State as State,
    fill as fill,
    filling_curve as filling_curve,
    rates as rates,
)
from ._report import (
    CURVE_FILES as CURVE_FILES,
    FILLING_FILES as FILLING_FILES,
    curve_figure as curve_figure,
    filling_figure as filling_figure,
    filling_files as filling_files,
    filling_json as filling_json,
)
