"""Where the fits of several starts ended, and how two ends compare."""

import dataclasses
from collections.abc import Mapping

import numpy as np

from ..fitting import FitResult, Start


def interrupted(result: FitResult, when: str) -> FitResult:
    """The same result; it is the best so far."""
    message = f"{result.message}; interrupted {when}"
    return dataclasses.replace(result, status="interrupted", message=message, reason="interrupted")


def misfit(result: FitResult) -> float:
    """Minus the logarithm of the likelihood of a fit, up to a constant."""
    channels = [channel for run in result.runs for channel in run.channels.values()]
    cost = np.inf if result.cost is None else result.cost
    return float(cost + sum(c.n * np.log(c.innovation or c.noise) for c in channels))


def end_values(result: FitResult) -> dict[str, float]:
    """Values of the free parameters where a fit ended, by path."""
    return {path: estimate.value for path, estimate in result.free.items()}


def end_of(start: Mapping[str, float], result: FitResult) -> Start:
    """Where a start ended that was fitted."""
    message = None if result.status == "converged" else result.message
    return Start(dict(start), result.status, misfit(result), end_values(result), message)
