"""From residuals to a verdict."""

from collections.abc import Sequence

from ._records import Reason, Verdict
from ._series import OUTLIER, Series
from ._tests import beyond_differences, beyond_stated, correlated, drift, runs_disagree

_TESTS = (beyond_stated, correlated, beyond_differences, drift, runs_disagree)

# Degrees of freedom below which nothing is said of a model.
_FEW = 10


def judge(series: Sequence[Series], *, robust: bool) -> Verdict:
    """Whether residuals are what noise alone would leave.

    Arguments:
        series: of all channels of all runs, before they are whitened.
        robust: whether the loss of the fit lets outliers stand; they are then left out.

    Returns:
        "adequate" where no test finds a reason against it; at most 2 % of adequate models whose
        noise is white, or has the correlation that is stated, are called inadequate.
    """
    if robust:
        series = [each.without_outliers(OUTLIER) for each in series]
    if sum(len(each) - each.lost for each in series) < _FEW:
        few = Reason("cells", "there are too few measured values to judge the model", 1.0, 1.0)
        return Verdict("not evaluated", (few,))
    series = [each.known_memory_removed() for each in series if len(each)]
    reasons = [reason for test in _TESTS if (reason := test(series)) is not None]
    if not reasons:
        return Verdict("adequate")
    return Verdict.inadequate(reasons)
