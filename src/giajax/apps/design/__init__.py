"""The next experiment: the command and the markers that tell most of chosen parameters."""

from ._experiment import (
    Design as Design,
    Expected as Expected,
    design_experiment as design_experiment,
)
from ._question import (
    Criterion as Criterion,
    covariance_of as covariance_of,
    joint_count as joint_count,
)
from ._report import (
    DESIGN_HEADINGS as DESIGN_HEADINGS,
    design_figure as design_figure,
    design_json as design_json,
    design_rows as design_rows,
)
from ._search import Evaluation as Evaluation, Limits as Limits
