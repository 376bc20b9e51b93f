"""From where repetitions of a fit ended to what they say of its standard errors and intervals."""

from collections.abc import Sequence

import numpy as np
from scipy.special import betaincinv

from ._records import Repeated

LEVEL = 0.95


def repeated(
    value: float,
    standard_error: float | None,
    unit: str,
    values: Sequence[float],
    reaches: Sequence[float | None] | None,
) -> Repeated:
    """What repetitions say of a parameter.

    Arguments:
        value: that made their data.
        standard_error: that the result states; None where it states none.
        unit: SI.
        values: where the repetitions ended.
        reaches: half of the 95 % interval of each, None of one without; None where nothing is to be
            said of coverage.
    """
    found = np.asarray(values, dtype=float)
    count = len(found)
    bias = bias_error = spread = ratio = ratio_error = None
    percentile = basic = None
    if count > 1:
        spread = float(np.std(found, ddof=1))
        low, high = map(float, np.quantile(found, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]))
        percentile, basic = (low, high), (2 * value - high, 2 * value - low)
    if spread is not None and standard_error:
        bias = (float(np.mean(found)) - value) / standard_error
        bias_error = spread / np.sqrt(count) / standard_error
        ratio = spread / standard_error
        ratio_error = ratio / float(np.sqrt(2 * (count - 1)))
    covered = coverage = interval = None
    pairs = (
        [
            (there, reach)
            for there, reach in zip(values, reaches or [], strict=reaches is not None)
            if reach is not None
        ]
        if reaches is not None
        else []
    )
    if pairs:
        covered = sum(bool(abs(there - value) <= reach) for there, reach in pairs)
        coverage = covered / len(pairs)
        interval = binomial_interval(covered, len(pairs))
    return Repeated(
        value=value,
        standard_error=standard_error,
        unit=unit,
        bias=bias,
        bias_error=None if bias_error is None else float(bias_error),
        spread=spread,
        ratio=ratio,
        ratio_error=ratio_error,
        percentile=percentile,
        basic=basic,
        covered=covered,
        asked=len(pairs),
        coverage=coverage,
        coverage_interval=interval,
        values=tuple(found.tolist()),
    )


def binomial_interval(covered: int, asked: int) -> tuple[float, float]:
    """Where a probability is by 95 %, of so many of so many (Clopper and Pearson 1934)."""
    tail = (1 - LEVEL) / 2
    low = 0.0 if covered == 0 else float(betaincinv(covered, asked - covered + 1, tail))
    high = 1.0 if covered == asked else float(betaincinv(covered + 1, asked - covered, 1 - tail))
    return low, high
