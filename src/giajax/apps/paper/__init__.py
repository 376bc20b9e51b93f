"""The figures and tables that the paper derives from its models, made again."""

from ._contenders import (
    Reproduced as Reproduced,
    Sources as Sources,
    concordance as concordance,
    relative_error as relative_error,
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
