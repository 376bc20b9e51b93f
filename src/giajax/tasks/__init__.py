"""What `giajax fit` does, from Python: a fit with its data, its settings and its validation."""

from ._fit_task import FitTask as FitTask
from ._fitted_runs import fitted_runs as fitted_runs
