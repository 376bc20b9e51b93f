"""What the figures of a fit say of its runs and of its end."""

import numpy as np

from ..fitting import FitResult
from ..runs import Run


def unfinished(result: FitResult) -> str:
    """What a title says of a fit that did not end well."""
    return "" if result.status == "converged" else f" ({result.status.replace('_', ' ')})"


def sample_times(run: Run) -> np.ndarray:
    """Times of the samples, s; their numbers where a run has no times."""
    if run.times is not None:
        return run.times
    return np.arange(len(next(iter(run.values.values()))), dtype=float)


def time_label(run: Run) -> str:
    """What `sample_times` are."""
    return "time (s)" if run.times is not None else "sample"
