"""Tests of residuals against what noise alone would leave; each may give a reason.

A reason needs significance and size: with many cells everything is significant, and with few a
large misfit may be chance. Each function looks at several things and corrects for how many
(Bonferroni), so that noise alone gives a reason with the chance `LEVEL` at most.

The file is longer than 200 lines because the tests share one form, and are read side by side.
"""

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc, fdtrc

from ._records import Reason
from ._series import Series

# Five tests together have a chance of 2 % to accuse an adequate model.
LEVEL = 0.004

# Noise up by a tenth is worth a word.
SIZE = 1.1

# Lengths of the blocks whose means are compared with those of white noise, in cells.
_BLOCKS = (2, 4, 8, 16, 32)

# Cells of a series, at least, for a statement on it alone.
_FEW = 32


def beyond_stated(series: Sequence[Series]) -> Reason | None:
    """Residuals against the noise that is stated."""
    known = [each for each in series if each.stated is not None]
    if not known:
        return None
    squares = np.array(
        [np.sum((each.residual / each.stated.deviation) ** 2) for each in known if each.stated]
    )
    freedoms = np.array([each.freedom for each in known])
    channels = sorted({each.channel for each in known})
    looks = len(channels) + 1 if len(channels) > 1 else 1
    best: tuple[float, float, tuple[str, ...]] | None = None
    for names in _alone_and_together(channels):
        chosen = [each.channel in names for each in known]
        total, freedom = float(np.sum(squares[chosen])), float(np.sum(freedoms[chosen]))
        p = min(looks * float(chdtrc(freedom, total)), 1.0)
        size = float(np.sqrt(total / freedom))
        if p < LEVEL and size > SIZE and (best is None or size > best[1]):
            best = (p, size, names)
    if best is None:
        return None
    p, size, names = best
    where = "" if len(names) == len(channels) else f" in {', '.join(names)}"
    sentence = f"the residuals are {size:.3g} times the stated noise{where}"
    return Reason("noise", sentence, p, size, names)


def correlated(series: Sequence[Series]) -> Reason | None:
    """Means of blocks of cells against those of white noise.

    The mean of L cells of white noise has a variance of one L-th of a cell's; where residuals go
    together it has more. A fit takes slow parts out of them, which only lowers the statistic.
    """
    usable = [each for each in series if len(each) >= _FEW]
    if not usable:
        return None
    channels = sorted({each.channel for each in usable})
    looks = len(_BLOCKS) * (len(channels) + (len(channels) > 1))
    best: tuple[float, float, tuple[str, ...], int] | None = None
    for names in _alone_and_together(channels):
        chosen = [each for each in usable if each.channel in names]
        for length in _BLOCKS:
            means = [_block_means(each, length) for each in chosen]
            count = sum(map(len, means))
            if count < 4:
                continue
            squares = float(np.sum(np.concatenate(means) ** 2))
            freedom = _together(chosen)
            p = min(looks * _tail(count, freedom, squares * length / count), 1.0)
            # What the blocks have beyond white noise, for each cell, in units of its variance.
            share = max(squares / count - 1 / length, 0.0) / (1 - 1 / length)
            size = float(np.sqrt(1 + share))
            if p < LEVEL and size > SIZE and (best is None or size > best[1]):
                best = (p, size, names, length)
    if best is None:
        return None
    p, size, names, _ = best
    where = "" if len(names) == len(channels) else f" of {', '.join(names)}"
    sentence = (
        f"the residuals{where} are correlated, noise or missing physics: with their memory they "
        f"are {size:.3g} times what differs from cell to cell"
    )
    return Reason("correlation", sentence, p, size, names)


def beyond_differences(series: Sequence[Series]) -> Reason | None:
    """Adopted noise against that of second differences, where none is stated.

    Noise that is estimated from residuals hides any wrong model: chi-square is 1 by construction.
    """
    unknown = [each for each in series if each.stated is None and len(each) >= _FEW]
    if not unknown:
        return None
    channels = sorted({each.channel for each in unknown})
    best: tuple[float, float, str] | None = None
    for name in channels:
        chosen = [each for each in unknown if each.channel == name]
        # Each over its own: runs may differ in length and in noise.
        total = sum(float(np.sum((e.residual / e.from_differences) ** 2)) for e in chosen)
        freedom = sum(each.freedom for each in chosen)
        size = float(np.sqrt(total / freedom))
        known = _together(chosen)
        p = min(len(channels) * _tail(freedom, known, size**2), 1.0)
        if p < LEVEL and size > SIZE and (best is None or size > best[1]):
            best = (p, size, name)
    if best is None:
        return None
    p, size, name = best
    sentence = (
        f"the noise adopted for {name} is {size:.3g} times what its residuals differ by from "
        "sample to sample"
    )
    return Reason("differences", sentence, p, size, (name,))


def drift(series: Sequence[Series]) -> Reason | None:
    """A trend of residuals over the run."""
    usable = [each for each in series if each.times is not None and len(each) >= _FEW]
    best: tuple[float, float, Series, float] | None = None
    for each in usable:
        assert each.times is not None
        line = each.times - np.mean(each.times)
        norm = float(np.sqrt(np.sum(line**2)))
        along = float(np.sum(line * each.residual)) / norm
        z = abs(along) / each.white
        p = min(len(usable) * _tail(1, each.white_freedom, z**2), 1.0)
        size = float(np.sqrt(1 + max(z**2 - 1, 0.0) / len(each)))
        if p < LEVEL and size > SIZE and (best is None or size > best[1]):
            best = (p, size, each, along / norm * float(np.ptp(each.times)))
    if best is None:
        return None
    p, size, each, change = best
    sentence = (
        f"the residuals of {each.channel} drift over {each.run}, by "
        f"{abs(change) / each.white:.2g} times its noise"
    )
    return Reason("drift", sentence, p, size, (each.channel,))


def runs_disagree(series: Sequence[Series]) -> Reason | None:
    """Residuals of one run against those of the same channel in the others."""
    by_key: dict[str, list[Series]] = {}
    for each in series:
        if len(each) >= _FEW:
            by_key.setdefault(each.key, []).append(each)
    groups = [those for those in by_key.values() if len(those) > 1]
    looks = sum(map(len, groups))
    best: tuple[float, float, Series] | None = None
    for those in groups:
        for each in those:
            others = [other for other in those if other is not each]
            mine = float(np.mean(each.residual**2))
            theirs = sum(float(np.sum(other.residual**2)) for other in others)
            if not theirs:
                continue
            freedom = sum(other.freedom for other in others)
            ratio = mine / (theirs / freedom)
            p = min(looks * float(fdtrc(len(each), freedom, ratio)), 1.0)
            size = float(np.sqrt(ratio))
            if p < LEVEL and size > SIZE and (best is None or size > best[1]):
                best = (p, size, each)
    if best is None:
        return None
    p, size, each = best
    sentence = (
        f"the runs disagree: the residuals of {each.channel} are {size:.3g} times as large in "
        f"{each.run} as in the others"
    )
    return Reason("runs", sentence, p, size, (each.channel,))


def _alone_and_together(channels: Sequence[str]) -> list[tuple[str, ...]]:
    """All channels, and each of several by itself."""
    alone: list[tuple[str, ...]] = [(name,) for name in channels]
    return [tuple(channels), *alone] if len(alone) > 1 else alone


def _together(series: Sequence[Series]) -> float:
    """Degrees of freedom of the white noise of several series (Satterthwaite)."""
    sizes = np.array([len(each) for each in series], dtype=float)
    below = float(np.sum(sizes**2 / np.array([each.white_freedom for each in series])))
    return float(np.sum(sizes)) ** 2 / below if below else np.inf


def _tail(above: float, below: float, ratio: float) -> float:
    """Chance of a larger ratio of two variances of these degrees of freedom."""
    if np.isinf(below):
        return float(chdtrc(above, above * ratio))
    return float(fdtrc(above, below, ratio))


def _block_means(series: Series, length: int) -> np.ndarray:
    """Means of consecutive cells over the white noise of a cell."""
    count = len(series) // length
    cells = series.residual[: count * length].reshape(count, length)
    return np.mean(cells, axis=1) / series.white
