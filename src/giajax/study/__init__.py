"""Questions that take many fits or derivatives of a model."""

from ._candidates import CANDIDATES as CANDIDATES
from ._choose import (
    Candidate as Candidate,
    Choice as Choice,
    choice_hint as choice_hint,
    choose_hysteresis as choose_hysteresis,
)
from ._compare import Comparison as Comparison, compare as compare
from ._contrast import (
    Contrast as Contrast,
    ContrastColumn as ContrastColumn,
    ContrastRow as ContrastRow,
    contrast as contrast,
)
from ._earlier_starts import has_earlier_starts as has_earlier_starts
from ._ends import misfit as misfit
from ._fitted import Fitted as Fitted, fit_key as fit_key
from ._marginal import Marginal as Marginal
from ._multi_start import (
    SEED as SEED,
    SPREAD as SPREAD,
    multi_start as multi_start,
    solve_from_starts as solve_from_starts,
)
from ._planned import planned as planned
from ._posterior import check_posterior as check_posterior, posterior as posterior
from ._posterior_records import (
    Band as Band,
    Posterior as Posterior,
    PosteriorSummary as PosteriorSummary,
)
from ._profile import profile as profile, profiles_beside as profiles_beside
from ._profile_records import (
    PROFILES as PROFILES,
    Profile as Profile,
    ProfilePoint as ProfilePoint,
    Profiles as Profiles,
    load_profiles as load_profiles,
)
from ._refit import (
    begun_as_fitted as begun_as_fitted,
    begun_where_it_ended as begun_where_it_ended,
    optimum_of as optimum_of,
    refit as refit,
)
from ._sensitivity import (
    Sensitivity as Sensitivity,
    body_of as body_of,
    expected_errors as expected_errors,
    sensitivity as sensitivity,
)
from ._valleys import (
    SAME_END as SAME_END,
    Valley as Valley,
    lost_starts as lost_starts,
    valleys as valleys,
)
