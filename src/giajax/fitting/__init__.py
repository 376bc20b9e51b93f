"""Least squares over chosen parameters of any model that predicts channels."""

from ._fit import Iteration as Iteration, configuration as configuration, fit as fit
from ._predict import predict as predict
from ._result import Estimate as Estimate, FitResult as FitResult, load_result as load_result
from ._solver import Marquardt as Marquardt
