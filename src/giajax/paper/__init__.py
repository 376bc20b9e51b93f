"""The figures and tables that the paper derives from its models, made again."""

from ._concordance import concordance as concordance, relative_error as relative_error
from ._figures import FIGURES as FIGURES, reproduce as reproduce
from ._files import reproduced_files as reproduced_files, reproduction_page as reproduction_page
from ._reproduced import Reproduced as Reproduced, Sources as Sources
