"""Noise of channels, and tests of whether residuals are consistent with noise alone."""

from ._estimate import (
    estimate as estimate,
    outlier_weights as outlier_weights,
    robust_deviation as robust_deviation,
)
from ._model import (
    ChannelNoise as ChannelNoise,
    Stated as Stated,
    by_second_differences as by_second_differences,
    drawn as drawn,
    from_differences as from_differences,
    gains as gains,
    whitened as whitened,
)
from ._restricted import (
    Cells as Cells,
    Restricted as Restricted,
    Spread as Spread,
    grams as grams,
    orthonormal as orthonormal,
    score_covariance as score_covariance,
    small_sample as small_sample,
)
from ._verdict import (
    DIFFERENCES as DIFFERENCES,
    OUTLIER as OUTLIER,
    PRIOR_LEVEL as PRIOR_LEVEL,
    SUSPECT_LEVEL as SUSPECT_LEVEL,
    Reason as Reason,
    Series as Series,
    Verdict as Verdict,
    VerdictStatus as VerdictStatus,
    alone_and_together as alone_and_together,
    beyond_mixture as beyond_mixture,
    judge as judge,
    largest as largest,
    satterthwaite as satterthwaite,
    tail as tail,
    white_deviation as white_deviation,
)
