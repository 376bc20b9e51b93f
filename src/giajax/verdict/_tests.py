"""Tests of residuals against what noise alone would leave; each may give a reason.

A reason needs significance and size: with many cells everything is significant, and with few a
large misfit may be chance. Each function looks at several things and corrects for how many
(Bonferroni), so that noise alone gives a reason with the chance `LEVEL` at most.
"""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy.special import chdtrc, fdtrc

from ._records import Reason
from ._series import Series

# These five tests and that of what was held out (`_prediction`) together have a chance of 2 % to
# accuse an adequate model.
LEVEL = 0.02 / 6

# Noise up by a tenth is worth a word.
SIZE = 1.1

# Lengths of the blocks whose means are compared with those of white noise, in cells.
_BLOCKS = (2, 4, 8, 16, 32)

# Blocks, at least, for a statement on them.
_FEWEST_BLOCKS = 4

# Cells of a series, at least, for a statement on it alone.
_FEW = 32


def beyond_stated(series: Sequence[Series]) -> Reason | None:
    """Residuals against the noise that is stated."""
    known = [(each, each.stated.deviation) for each in series if each.stated is not None]
    groups = alone_and_together([each for each, _ in known])

    def looked_at() -> Iterator[Reason]:
        for names in groups:
            chosen = [(each, size) for each, size in known if each.channel in names]
            total = sum(float(np.sum((each.residual / size) ** 2)) for each, size in chosen)
            freedom = sum(each.freedom for each, _ in chosen)
            size = float(np.sqrt(total / freedom))
            where = "" if names == groups[0] else f" in {', '.join(names)}"
            sentence = f"the residuals are {size:.3g} times the stated noise{where}"
            yield Reason("noise", sentence, float(chdtrc(freedom, total)), size, names)

    return largest(looked_at(), len(groups))


def correlated(series: Sequence[Series]) -> Reason | None:
    """Means of blocks of cells against those of white noise.

    The mean of L cells of white noise has a variance of one L-th of a cell's; where residuals go
    together it has more. A fit takes slow parts out of them, which only lowers the statistic.
    """
    usable = [each for each in series if len(each) >= _FEW]
    groups = alone_and_together(usable)

    def looked_at() -> Iterator[Reason]:
        for names, length in itertools.product(groups, _BLOCKS):
            chosen = [each for each in usable if each.channel in names]
            means = np.concatenate([_block_means(each, length) for each in chosen])
            count = len(means)
            if count < _FEWEST_BLOCKS:
                continue
            squares = float(np.sum(means**2))
            p = tail(count, _together(chosen), squares * length / count)
            # What the blocks have beyond white noise, for each cell, in units of its variance.
            share = max(squares / count - 1 / length, 0.0) / (1 - 1 / length)
            size = float(np.sqrt(1 + share))
            where = "" if names == groups[0] else f" of {', '.join(names)}"
            sentence = (
                f"the residuals{where} are correlated, noise or missing physics: with their "
                f"memory they are {size:.3g} times what differs from cell to cell"
            )
            yield Reason("correlation", sentence, p, size, names)

    return largest(looked_at(), len(_BLOCKS) * len(groups))


def beyond_differences(series: Sequence[Series]) -> Reason | None:
    """Adopted noise against that of second differences, where none is stated.

    Noise that is estimated from residuals hides any wrong model: chi-square is 1 by construction.
    """
    unknown = [each for each in series if each.stated is None and len(each) >= _FEW]
    channels = sorted({each.channel for each in unknown})

    def looked_at() -> Iterator[Reason]:
        for name in channels:
            chosen = [each for each in unknown if each.channel == name]
            # Each over its own: runs may differ in length and in noise.
            total = sum(float(np.sum((e.residual / e.from_differences) ** 2)) for e in chosen)
            freedom = sum(each.freedom for each in chosen)
            size = float(np.sqrt(total / freedom))
            sentence = (
                f"the noise adopted for {name} is {size:.3g} times what its residuals differ by "
                "from sample to sample"
            )
            p = tail(freedom, _together(chosen), size**2)
            yield Reason("differences", sentence, p, size, (name,))

    return largest(looked_at(), len(channels))


def drift(series: Sequence[Series]) -> Reason | None:
    """A trend of residuals over the run."""
    usable = [(e, e.times) for e in series if e.times is not None and len(e) >= _FEW]

    def looked_at() -> Iterator[Reason]:
        for each, times in usable:
            line = times - np.mean(times)
            norm = float(np.sqrt(np.sum(line**2)))
            along = float(np.sum(line * each.residual)) / norm
            z = abs(along) / each.white
            sentence = (
                f"the residuals of {each.channel} drift over {each.run}, by "
                f"{z / norm * float(np.ptp(times)):.2g} times its noise"
            )
            size = float(np.sqrt(1 + max(z**2 - 1, 0.0) / len(each)))
            p = tail(1, each.white_freedom, z**2)
            yield Reason("drift", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(usable))


def runs_disagree(series: Sequence[Series]) -> Reason | None:
    """Residuals of one run against those of the same channel in the others."""
    by_key: dict[str, list[Series]] = {}
    for each in series:
        if len(each) >= _FEW:
            by_key.setdefault(each.key, []).append(each)
    pairs = [(each, those) for those in by_key.values() if len(those) > 1 for each in those]

    def looked_at() -> Iterator[Reason]:
        for each, those in pairs:
            others = [other for other in those if other is not each]
            theirs = sum(float(np.sum(other.residual**2)) for other in others)
            if not theirs:
                continue
            freedom = sum(other.freedom for other in others)
            ratio = float(np.mean(each.residual**2)) / (theirs / freedom)
            size = float(np.sqrt(ratio))
            sentence = (
                f"the runs disagree: the residuals of {each.channel} are {size:.3g} times as "
                f"large in {each.run} as in the others"
            )
            p = tail(len(each), freedom, ratio)
            yield Reason("runs", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(pairs))


def largest(looked_at: Iterable[Reason], looks: int) -> Reason | None:
    """The largest of what is seen that is sure and large enough, for so many looks."""
    corrected = (
        dataclasses.replace(each, p_value=min(looks * each.p_value, 1.0)) for each in looked_at
    )
    known = [each for each in corrected if each.p_value < LEVEL and each.size > SIZE]
    return max(known, key=lambda each: each.size, default=None)


def alone_and_together(series: Sequence[Series]) -> list[tuple[str, ...]]:
    """All channels of some series, and each of several by itself."""
    channels = sorted({each.channel for each in series})
    alone: list[tuple[str, ...]] = [(name,) for name in channels]
    return [tuple(channels), *alone] if len(alone) > 1 else alone


def _together(series: Sequence[Series]) -> float:
    """Degrees of freedom of the white noise of several series."""
    return satterthwaite([len(each) for each in series], [each.white_freedom for each in series])


def satterthwaite(counts: Sequence[int], freedoms: Sequence[float]) -> float:
    """Degrees of freedom of the mean of several variances, each known by its own."""
    sizes = np.array(counts, dtype=float)
    below = float(np.sum(sizes**2 / np.array(freedoms)))
    return float(np.sum(sizes)) ** 2 / below if below else np.inf


def tail(above: float, below: float, ratio: float) -> float:
    """Chance of a larger ratio of two variances of these degrees of freedom."""
    if np.isinf(below):
        return float(chdtrc(above, above * ratio))
    return float(fdtrc(above, below, ratio))


def _block_means(series: Series, length: int) -> np.ndarray:
    """Means of consecutive cells over the white noise of a cell."""
    count = len(series) // length
    cells = series.residual[: count * length].reshape(count, length)
    return np.mean(cells, axis=1) / series.white
