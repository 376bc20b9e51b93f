"""The figures and tables that the paper derives from its models, made again."""

from ._concordance import concordance as concordance, relative_error as relative_error
from ._figures import FIGURES as FIGURES, reproduce as reproduce
from ._files import (
    is_reproduction_page as is_reproduction_page,
    reproduced_files as reproduced_files,
    reproduced_names as reproduced_names,
    reproduced_record as reproduced_record,
    reproduction_page as reproduction_page,
    stored_record as stored_record,
)
from ._reproduced import Reproduced as Reproduced, Sources as Sources
