"""Where channels are predicted to be: the predictions of some draws."""

import math
from collections.abc import Sequence

import numpy as np

from ..fitting import FitResult, Optimum
from ..runs import Run
from ._posterior_records import Band

# Of 200 draws the ends of a 95 % interval are known to a tenth of its width.
DRAWS = 200

_ENDS = (2.5, 50.0, 97.5)


def bands(
    result: FitResult, runs: Sequence[Run], optimum: Optimum, draws: np.ndarray
) -> tuple[dict[str, Band], ...]:
    """Where each channel of each run is predicted to be.

    Arguments:
        result: of the fit, whose noise counts; widened as its standard errors are, where the
            residuals exceed it.
        runs: what it was fitted to.
        optimum: predicts, by the programs of the fit.
        draws: of all parameters, shape (draw, parameter); some `DRAWS` of them are predicted.

    Returns:
        Bands by channel, for each run; draws at which the model fails are left out.
    """
    chosen = np.unique(np.linspace(0, len(draws) - 1, DRAWS).round().astype(int))
    points = (optimum.at(draws[index]) for index in chosen)
    widened = math.sqrt(optimum.statistics.scale)
    predicted = [point.predictions for point in points if np.isfinite(point.cost)]
    return tuple(
        {
            name: _band(
                np.stack([each[at][name] for each in predicted]),
                run.observations[name],
                widened * float(run.channels[name].to_si(record.channels[name].noise)),
            )
            for name in run.observations
        }
        for at, (run, record) in enumerate(zip(runs, result.runs, strict=True))
    )


def _band(predicted: np.ndarray, recorded: np.ndarray, noise: float) -> Band:
    low, median, high = np.percentile(predicted, _ENDS, axis=0)
    band = Band(median, low, high, noise, None)
    known = ~np.isnan(recorded)
    if not known.any():
        return band
    least, most = (ends[known] for ends in band.with_noise())
    inside = (least <= recorded[known]) & (recorded[known] <= most)
    return Band(median, low, high, noise, float(np.mean(inside)))
