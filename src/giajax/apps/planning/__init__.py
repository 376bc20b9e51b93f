"""Planning of commands that move an arm to a pose, or its tip to a place or an opening."""

from ._plan import (
    Plan as Plan,
    Planned as Planned,
    PlanProblem as PlanProblem,
    plan_command as plan_command,
)
from ._report import (
    PLAN_HEADINGS as PLAN_HEADINGS,
    path_columns as path_columns,
    plan_facts as plan_facts,
    plan_figure as plan_figure,
    plan_rows as plan_rows,
)
from ._target import (
    AbstractTarget as AbstractTarget,
    CommandLimits as CommandLimits,
    Pose as Pose,
    Through as Through,
    Tip as Tip,
)
