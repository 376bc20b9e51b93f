"""Reproduction of the figures and tables that the paper derives from its models."""

from ._arm_figures import (
    PRINTED as PRINTED,
    READINGS as READINGS,
    SHOWN_LINKS as SHOWN_LINKS,
    STEP_AT as STEP_AT,
    STEP_DEG as STEP_DEG,
    TOLERANCE as TOLERANCE,
    UNKNOWNS as UNKNOWNS,
    Compared as Compared,
    evaluated as evaluated,
    fig19 as fig19,
    heights as heights,
    table3 as table3,
)
from ._contenders import (
    CONTENDERS as CONTENDERS,
    HEIGHTS as HEIGHTS,
    Fits as Fits,
    Reproduced as Reproduced,
    Sources as Sources,
    compared as compared,
    concordance as concordance,
    relative_error as relative_error,
    stand_in as stand_in,
)
from ._explanations import (
    EXPLANATIONS as EXPLANATIONS,
    Explained as Explained,
    Searched as Searched,
    at_pressure as at_pressure,
    collapse_pressure as collapse_pressure,
    collapse_radius as collapse_radius,
    explained as explained,
    explanations_figure as explanations_figure,
    likelihood as likelihood,
    misfit as misfit,
)
from ._files import (
    FIGURES as FIGURES,
    is_reproduction_page as is_reproduction_page,
    reproduce as reproduce,
    reproduced_files as reproduced_files,
    reproduced_names as reproduced_names,
    reproduced_record as reproduced_record,
    reproduction_page as reproduction_page,
    stored_record as stored_record,
)
from ._inverse import (
    CELLS as CELLS,
    SearchEnd as SearchEnd,
    directions as directions,
    search as search,
    shown as shown,
)
