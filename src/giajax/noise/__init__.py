"""Noise of channels, white and correlated: its size, and what it makes of standard errors."""

from ._basis import orthonormal as orthonormal
from ._cells import Cells as Cells
from ._differences import (
    by_second_differences as by_second_differences,
    from_differences as from_differences,
)
from ._draw import drawn as drawn
from ._estimate import estimate as estimate
from ._intervals import Spread as Spread, small_sample as small_sample
from ._model import ChannelNoise as ChannelNoise, Stated as Stated
from ._restricted import Restricted as Restricted
from ._robust import outlier_weights as outlier_weights, robust_deviation as robust_deviation
from ._sandwich import score_covariance as score_covariance
from ._segment import gains as gains, whitened as whitened
