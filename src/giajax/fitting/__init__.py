"""Least squares over chosen parameters of any model that predicts channels."""

from ._configuration import configuration as configuration, set_up as set_up
from ._descend import Iteration as Iteration
from ._fit import fit as fit
from ._predict import predict as predict, prediction_errors as prediction_errors
from ._result import Estimate as Estimate, FitResult as FitResult, load_result as load_result
from ._solver import Marquardt as Marquardt
