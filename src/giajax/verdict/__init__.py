"""Whether a fitted model describes its data, by the residuals before they are whitened."""

from ._judge import judge as judge
from ._prediction import (
    Foretold as Foretold,
    Prediction as Prediction,
    Predictions as Predictions,
)
from ._records import Reason as Reason, Verdict as Verdict, VerdictStatus as VerdictStatus
from ._series import Series as Series
