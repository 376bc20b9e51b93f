"""How well a model follows a recording, as the paper's table 3 has it, and as it is usual."""

import numpy as np

from .._errors import InputError
from .._typing import Float

WINDOW = (10.0, 25.0)
"""First and last time that table 3 compares, s."""

STEP = 0.1
"""Between two of those times, s."""


def compared(times: Float[np.ndarray, " sample"]) -> np.ndarray:
    """Rows of a recording that table 3 compares: every 0.1 s from 10 to 25 s.

    Arguments:
        times: of the samples, s.

    Returns:
        Their positions.

    Raises:
        InputError: one of those times was not sampled.
    """
    count = round((WINDOW[1] - WINDOW[0]) / STEP)
    every = np.linspace(*WINDOW, count + 1)
    rows = np.abs(np.asarray(times)[:, None] - every[None]).argmin(axis=0)
    off = np.abs(times[rows] - every)
    if off.max() > 1e-6:
        raise InputError(
            f"the recording has no sample at {every[off.argmax()]:g} s, but table 3 compares "
            "every 0.1 s from 10 to 25 s: sample it so"
        )
    return rows


def concordance(
    model: Float[np.ndarray, " sample"], experiment: Float[np.ndarray, " sample"]
) -> float:
    """The paper's concordance rate: the mean of 1 - |Xm - Xe| / |Xe|.

    It is 1 where model and experiment agree, and has no lower end: where the experiment passes
    zero a term is as large as you like. Samples at which it is exactly zero have no term.

    Arguments:
        model: displacements Xm of a link in the model, m, shape (sample,).
        experiment: displacements Xe of it in the experiment, m; NaN where not measured.

    Returns:
        The rate.
    """
    counts = np.isfinite(experiment) & (experiment != 0)
    model, experiment = model[counts], experiment[counts]
    return float(np.mean(1 - np.abs(model - experiment) / np.abs(experiment)))


def relative_error(
    model: Float[np.ndarray, " sample"], experiment: Float[np.ndarray, " sample"]
) -> float:
    """Root mean square of Xm - Xe over that of Xe: 0 where they agree, 1 for a model at rest.

    Arguments:
        model, experiment: as of `concordance`.

    Returns:
        The ratio.
    """
    counts = np.isfinite(experiment)
    difference = (model - experiment)[counts]
    return float(np.sqrt(np.mean(difference**2) / np.mean(experiment[counts] ** 2)))
