"""Life cycle of an arm: it is unrolled, filled, raised, flown through an opening and deflated."""

from ._flight import (
    Audit as Audit,
    FlightWorks as FlightWorks,
    Impulses as Impulses,
    audit as audit,
    check_audited as check_audited,
)
from ._gas import (
    GasCourse as GasCourse,
    GasState as GasState,
    GasWorks as GasWorks,
    Handling as Handling,
    as_one_bag as as_one_bag,
    gas_at as gas_at,
    gas_course as gas_course,
)
from ._life import (
    Balance as Balance,
    Life as Life,
    Phase as Phase,
    live as live,
)
from ._report import (
    LIFE_FILES as LIFE_FILES,
    life_figure as life_figure,
    life_files as life_files,
    life_json as life_json,
    life_show as life_show,
)
