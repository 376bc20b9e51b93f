"""Design of the next experiment: the most informative command and markers."""

from ._experiment import (
    Design as Design,
    Expected as Expected,
    RobustError as RobustError,
    chosen_markers as chosen_markers,
    design_experiment as design_experiment,
)
from ._question import (
    Criterion as Criterion,
    covariance_of as covariance_of,
    draws as draws,
    joint_count as joint_count,
    known_before as known_before,
    question_of as question_of,
)
from ._report import (
    DESIGN_HEADINGS as DESIGN_HEADINGS,
    design_figure as design_figure,
    design_json as design_json,
    design_rows as design_rows,
)
from ._search import (
    CommandSeries as CommandSeries,
    Evaluation as Evaluation,
    Informed as Informed,
    Limits as Limits,
    Search as Search,
    base_step as base_step,
    informed as informed,
    starts_of as starts_of,
)
