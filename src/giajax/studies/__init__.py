"""Studies that repeat a fit or use the derivatives of a fitted model."""

from typing import TYPE_CHECKING

from ..runtime.aliases import earlier as _earlier
from ._bootstrap import (
    Bootstrap as Bootstrap,
    Repeated as Repeated,
    bootstrap as bootstrap,
    repeated as repeated,
)
from ._candidates import inquiry as inquiry, is_disturbed as is_disturbed
from ._choose import (
    CANDIDATES as CANDIDATES,
    Candidate as Candidate,
    Choice as Choice,
    Comparison as Comparison,
    choice_hint as choice_hint,
    choose_hysteresis as choose_hysteresis,
    compare as compare,
)
from ._contrast import (
    Contrast as Contrast,
    ContrastColumn as ContrastColumn,
    ContrastRow as ContrastRow,
    contrast as contrast,
)
from ._explain import (
    NEARNESS as NEARNESS,
    Explained as Explained,
    explain as explain,
)
from ._explain_records import (
    ExplainedParameter as ExplainedParameter,
    ExplainedStep as ExplainedStep,
    Explanation as Explanation,
    behind as behind,
)
from ._influence import (
    Influence as Influence,
    LeftOut as LeftOut,
    influence as influence,
    parts_of as parts_of,
)
from ._multi_start import (
    SAME_END as SAME_END,
    DistinctOptimum as DistinctOptimum,
    distinct_optima as distinct_optima,
    lost_starts as lost_starts,
    multi_start as multi_start,
    solve_from_starts as solve_from_starts,
)
from ._posterior import check_posterior as check_posterior, posterior as posterior
from ._posterior_records import (
    Band as Band,
    Marginal as Marginal,
    Posterior as Posterior,
    PosteriorSummary as PosteriorSummary,
    as_arviz as as_arviz,
    mixing as mixing,
)
from ._profile import profile as profile
from ._profile_records import (
    PROFILES as PROFILES,
    Profile as Profile,
    ProfilePoint as ProfilePoint,
    Profiles as Profiles,
    interval_end as interval_end,
    load_profiles as load_profiles,
)
from ._refit import (
    Fitted as Fitted,
    StudyRecord as StudyRecord,
    optimum_of as optimum_of,
    refit as refit,
    with_fitted_state as with_fitted_state,
    with_fitted_states as with_fitted_states,
)
from ._sensitivity import (
    Sensitivity as Sensitivity,
    body_of as body_of,
    expected_errors as expected_errors,
    sensitivity as sensitivity,
)
from ._starts import (
    has_earlier_starts as has_earlier_starts,
    interrupted as interrupted,
    misfit as misfit,
)
from ._stepwise import (
    MOST as MOST,
    TRIES as TRIES,
    Step as Step,
    StepwiseSelection as StepwiseSelection,
    ladder as ladder,
)
from ._suspects import (
    LEVEL as LEVEL,
    UNEXPLAINED as UNEXPLAINED,
    Suspects as Suspects,
    linearised as linearised,
    promising as promising,
    suspects as suspects,
)
from ._systematic import (
    check_uncertainty as check_uncertainty,
    deciding_conditions as deciding_conditions,
    systematic_errors as systematic_errors,
    together as together,
    with_suspects as with_suspects,
    with_systematic_errors as with_systematic_errors,
)

# Type checkers must report names that do not exist.
if not TYPE_CHECKING:
    __getattr__ = _earlier(__name__)
