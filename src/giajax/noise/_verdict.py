"""Whether a fitted model describes its data, by the residuals before they are whitened."""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, Self

import numpy as np
from scipy.special import chdtr, chdtrc, fdtrc, ndtr

from ..runtime.arrays import Bool, Float
from ..runtime.records import InfiniteWhereNull
from ._model import ChannelNoise, by_second_differences, whitened

# Of the cells, for the variance of white noise by their second differences: 18 / 35, because these
# have the autocorrelations 1, -2/3 and 1/6.
DIFFERENCES = 18 / 35

OUTLIER = 3.0  # deviations beyond which a cell is an outlier, for a loss that lets outliers stand
_SHORT_SERIES = 16  # second differences tell noise from motion where so many of them are there


@dataclasses.dataclass(frozen=True)
class Series:
    """The residuals of one channel of one run.

    Attributes:
        run: name of the run.
        channel: name of the channel.
        residual: predicted minus recorded where measured, SI, shape (cell,).
        times: of these cells, s; None for a run without time.
        stated: noise that the run states; None where it states none.
        key: cells of the same key have the same noise.
        adopted: deviation of the noise that the fit adopted for a cell, SI.
        lost: degrees of freedom that the fit took from it.
    """

    run: str
    channel: str
    residual: Float[np.ndarray, " cell"]
    times: Float[np.ndarray, " cell"] | None
    stated: ChannelNoise | None
    key: str
    adopted: float
    lost: float

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def degrees_of_freedom(self) -> float:
        """What the fit has left of its cells."""
        return max(len(self) - self.lost, 1.0)

    @property
    def white(self) -> float:
        """Deviation of what differs from cell to cell: stated, or more by second differences."""
        stated = 0.0 if self.stated is None else self.stated.deviation
        return max(stated, self.from_differences)

    @property
    def white_degrees_of_freedom(self) -> float:
        """Degrees of freedom of `white`; infinite where it is stated."""
        known = self.stated is not None and self.stated.deviation >= self.from_differences
        return np.inf if known else DIFFERENCES * len(self)

    @property
    def from_differences(self) -> float:
        """Deviation of white noise by the second differences of the residuals.

        Their mean square is 6 times its variance (`giajax.noise.from_differences`), and knows it
        as well as `DIFFERENCES` times as many independent cells would.
        """
        if len(self) < _SHORT_SERIES:
            return self.adopted
        # Residuals without any difference are those of a perfect description.
        return float(np.sqrt(np.mean(np.diff(self.residual, 2) ** 2) / 6)) or self.adopted

    def where(self, kept: Bool[np.ndarray, " cell"]) -> Self:
        """Some of the cells."""
        times = None if self.times is None else self.times[kept]
        return dataclasses.replace(self, residual=self.residual[kept], times=times)

    def known_memory_removed(self) -> Self:
        """The residuals made independent by the correlation that the run states, if it does."""
        if self.stated is None or self.stated.is_white:
            return self
        white = whitened(self.stated, self.times, self.residual[:, None])[:, 0]
        unit = ChannelNoise(1.0)
        return dataclasses.replace(self, residual=white, stated=unit, adopted=1.0)


VerdictStatus = Literal["adequate", "doubtful", "inadequate", "not evaluated"]


@dataclasses.dataclass(frozen=True)
class Reason:
    """One way in which residuals are not what the noise alone would leave.

    Attributes:
        code: "noise", "correlation", "differences", "drift", "runs" or "prediction"; "too_small" of
            residuals far below the stated noise, "outliers" where a few cells make that which was
            adopted, "suspect" of what the fit held or left out,
            "prior" of what is far from what is usual, "vanished" of what should not be 0 and is,
            "unexplained" where no suspect explains it, "end" of a fit that has no optimum, "cells"
            of too few.
        sentence: what is seen, and where.
        p_value: chance of as much from the noise alone, corrected for how often was looked.
        size: how many times the noise the residuals are for this reason, infinite where the model
            cannot be evaluated; of a suspect, standard errors by which it moves a parameter.
        channels: where it is seen most, by name.
    """

    code: str
    sentence: str
    p_value: float
    size: InfiniteWhereNull
    channels: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the model describes the data; apart from whether the fit converged.

    Attributes:
        status: "adequate"; "inadequate", where the residuals are not what the noise would leave;
            "doubtful", where they are, but something that was held or left out is significant and
            moves a parameter, or the fit has no optimum; "not evaluated" of too few cells.
        reasons: why it is not adequate, the surest first.
    """

    status: VerdictStatus
    reasons: tuple[Reason, ...] = ()

    @classmethod
    def inadequate(cls, reasons: Iterable[Reason]) -> Self:
        """That for some reasons."""
        surest = sorted(reasons, key=lambda reason: (reason.p_value, -reason.size))
        return cls("inadequate", tuple(surest))

    def with_reason(self, reason: Reason) -> Self:
        """With one more reason; what was not evaluated for want of cells is inadequate by it."""
        others = self.reasons if self.status != "not evaluated" else ()
        return self.inadequate((*others, reason))

    def doubted(self, reason: Reason) -> Self:
        """With a reason that residuals do not show: an adequate model is doubtful by it."""
        status: VerdictStatus = "inadequate" if self.status == "inadequate" else "doubtful"
        others = self.reasons if self.status != "not evaluated" else ()
        reasons = sorted((*others, reason), key=lambda each: each.p_value)
        return dataclasses.replace(self, status=status, reasons=tuple(reasons))

    def without(self, code: str) -> Self:
        """Without the reasons of a code that made an adequate model doubtful."""
        reasons = tuple(reason for reason in self.reasons if reason.code != code)
        status = self.status if reasons or self.status != "doubtful" else "adequate"
        return dataclasses.replace(self, status=status, reasons=reasons)

    @property
    def sentence(self) -> str:
        """Status and reasons in a line."""
        if not self.reasons:
            return self.status
        return f"{self.status}: {'; '.join(reason.sentence for reason in self.reasons)}"

    @classmethod
    def missing(cls) -> Self:
        """That of a result which was written without one."""
        return cls("not evaluated")


# Tests of residuals against what noise alone would leave; each may give a reason.
#
# A reason needs significance and size: with many cells everything is significant, and with few a
# large misfit may be chance. Each function looks at several things and corrects for how many
# (Bonferroni), so that noise alone gives a reason with the chance `LEVEL` at most.

# These five tests and that of what was held out (`giajax.fitting`) together have a chance of 1.2 %
# to accuse an adequate model, what it holds or leaves out (`giajax.suspects`) one of 0.6 %,
# and what is always uncertain, by its priors, one of 0.2 %.
LEVEL = 0.012 / 6
SUSPECT_LEVEL = 0.006
PRIOR_LEVEL = 0.002

SIZE = 1.1  # noise up by a tenth is worth a word

# Lengths of the blocks whose means are compared with those of white noise, in cells.
_BLOCKS = (2, 4, 8, 16, 32)

_FEWEST_BLOCKS = 4  # blocks, at least, for a statement on them
_FEWEST_VALUES = 32  # cells of a series, at least, for a statement on it alone


_FAR_BELOW = 3.0  # times smaller than the stated noise: that of a data sheet is often cautious


def beyond_stated(series: Sequence[Series]) -> Reason | None:
    """Residuals larger than the noise that is stated."""
    return _against_stated(series, below=False)


def below_stated(series: Sequence[Series]) -> Reason | None:
    """Residuals far smaller than the noise that is stated: that, or a unit, is wrong."""
    return _against_stated(series, below=True)


_HEAVY = 3.0  # times; noise with tails as wide as those of Student's t with 3 degrees has 1.7
# Deviations of a second difference, and of how many at most: a glitch makes three of them.
_GLITCH, _FEW_CELLS = 6.0, 0.2


def _usual_differences(values: Float[np.ndarray, " sample"]) -> tuple[float, float] | None:
    """Deviation of white noise by second differences: of most, and of all of them.

    They differ where a few cells are glitches, and not where many have larger noise, or only every
    other one has any, because it was resampled: both are then that of all.
    """
    usual, second = by_second_differences(values), np.diff(values, 2)
    if not usual:
        return None
    every = float(np.sqrt(np.mean(second**2) / 6))
    few = np.mean(np.abs(second) > _GLITCH * np.sqrt(6) * usual) < _FEW_CELLS
    return (usual if few and every > _HEAVY * usual else every), every


def by_a_few_cells(series: Sequence[Series]) -> Reason | None:
    """Adopted noise that a few cells make, where none is stated: outliers that count in full."""
    unknown = [each for each in series if each.stated is None and len(each) >= _FEWEST_VALUES]

    def looked_at() -> Iterator[Reason]:
        for each in unknown:
            both = None if each.times is None else _usual_differences(each.residual)
            if both is not None and both[1] > both[0]:
                size = each.from_differences / both[0]
                sentence = (
                    f"the noise estimate of {each.channel} is dominated by a few cells, which "
                    f"make it {size:.3g} times the difference between neighbouring samples: empty "
                    "these cells, or fit with --loss student_t"
                )
                p = tail(each.white_degrees_of_freedom, DIFFERENCES * len(each), size**2)
                yield Reason("outliers", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(unknown))


def white_deviation(
    rest: Float[np.ndarray, " sample"], stated: float | None, adopted: float, *, in_time: bool
) -> float:
    """Deviation of white noise of a channel, which no wrong model makes larger.

    It is what the run states; else what the fit adopted, or, where that is larger by more than
    chance, that of second differences of the residuals `rest`, in which what is smooth leaves
    nothing, without the few cells that are outliers. NaN is not measured.
    """
    if stated or not in_time:
        return stated or adopted
    known = rest[np.isfinite(rest)]
    both = _usual_differences(known)
    if both is None:
        return adopted
    ratio = adopted / both[0]
    sure = ratio > SIZE and tail(len(known), DIFFERENCES * len(known), ratio**2) < LEVEL
    return both[0] if sure else adopted


def _against_stated(series: Sequence[Series], *, below: bool) -> Reason | None:
    """One side of the noise that is stated; both have the chance of one test."""
    known = [(each, each.stated.deviation) for each in series if each.stated is not None]
    groups = alone_and_together([each for each, _ in known])

    def looked_at() -> Iterator[Reason]:
        for names in groups:
            chosen = [(each, size) for each, size in known if each.channel in names]
            total = sum(float(np.sum((each.residual / size) ** 2)) for each, size in chosen)
            degrees_of_freedom = sum(each.degrees_of_freedom for each, _ in chosen)
            size = float(np.sqrt(total / degrees_of_freedom))
            where = "" if names == groups[0] else f" in {', '.join(names)}"
            if not below:
                sentence = f"the residuals are {size:.3g} times the stated noise{where}"
                p = float(chdtrc(degrees_of_freedom, total))
                yield Reason("noise", sentence, p, size, names)
            elif 0 < size < 1 / _FAR_BELOW:
                sentence = (
                    f"the residuals are {1 / size:.3g} times smaller than the stated noise{where}, "
                    "so the stated noise or the unit of a column is wrong"
                )
                p = float(chdtr(degrees_of_freedom, total))
                yield Reason("too_small", sentence, p, 1 / size, names)

    return largest(looked_at(), 2 * len(groups))


def correlated(series: Sequence[Series]) -> Reason | None:
    """Means of blocks of cells against those of white noise.

    The mean of L cells of white noise has a variance of one L-th of a cell's; where residuals go
    together it has more. A fit takes slow parts out of them, which only lowers the statistic.
    """
    usable = [each for each in series if len(each) >= _FEWEST_VALUES]
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
                f"the residuals{where} are correlated, because of noise or missing physics: with "
                f"the correlation they are {size:.3g} times the difference between neighbouring "
                "cells"
            )
            yield Reason("correlation", sentence, p, size, names)

    return largest(looked_at(), len(_BLOCKS) * len(groups))


def beyond_differences(series: Sequence[Series]) -> Reason | None:
    """Adopted noise against that of second differences, where none is stated.

    Noise that is estimated from residuals hides any wrong model: chi-square is 1 by construction.
    """
    unknown = [each for each in series if each.stated is None and len(each) >= _FEWEST_VALUES]
    channels = sorted({each.channel for each in unknown})

    def looked_at() -> Iterator[Reason]:
        for name in channels:
            chosen = [each for each in unknown if each.channel == name]
            # Each over its own: runs may differ in length and in noise.
            total = sum(float(np.sum((e.residual / e.from_differences) ** 2)) for e in chosen)
            degrees_of_freedom = sum(each.degrees_of_freedom for each in chosen)
            size = float(np.sqrt(total / degrees_of_freedom))
            sentence = (
                f"the noise estimate of {name} is {size:.3g} times the difference between "
                "neighbouring residuals"
            )
            p = tail(degrees_of_freedom, _together(chosen), size**2)
            yield Reason("differences", sentence, p, size, (name,))

    return largest(looked_at(), len(channels))


def drift(series: Sequence[Series]) -> Reason | None:
    """A trend of residuals over the run."""
    usable = [(e, e.times) for e in series if e.times is not None and len(e) >= _FEWEST_VALUES]

    def looked_at() -> Iterator[Reason]:
        for each, times in usable:
            line = times - np.mean(times)
            norm = float(np.sqrt(np.sum(line**2)))
            along = float(np.sum(line * each.residual)) / norm
            z = abs(along) / each.white
            sentence = (
                f"the residuals of {each.channel} drift during {each.run} by "
                f"{z / norm * float(np.ptp(times)):.2g} times the noise of the channel"
            )
            size = float(np.sqrt(1 + max(z**2 - 1, 0.0) / len(each)))
            p = tail(1, each.white_degrees_of_freedom, z**2)
            yield Reason("drift", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(usable))


def runs_disagree(series: Sequence[Series]) -> Reason | None:
    """Residuals of one run against those of the same channel in the others."""
    by_key: dict[str, list[Series]] = {}
    for each in series:
        if len(each) >= _FEWEST_VALUES:
            by_key.setdefault(each.key, []).append(each)
    pairs = [(each, those) for those in by_key.values() if len(those) > 1 for each in those]

    def looked_at() -> Iterator[Reason]:
        for each, those in pairs:
            others = [other for other in those if other is not each]
            theirs = sum(float(np.sum(other.residual**2)) for other in others)
            if not theirs:
                continue
            degrees_of_freedom = sum(other.degrees_of_freedom for other in others)
            ratio = float(np.mean(each.residual**2)) / (theirs / degrees_of_freedom)
            size = float(np.sqrt(ratio))
            sentence = (
                f"the runs disagree: the residuals of {each.channel} are {size:.3g} times as "
                f"large in {each.run} as in the others"
            )
            p = tail(len(each), degrees_of_freedom, ratio)
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
    return satterthwaite([*map(len, series)], [each.white_degrees_of_freedom for each in series])


def satterthwaite(counts: Sequence[int], each_known_with: Sequence[float]) -> float:
    """Degrees of freedom of the mean of several variances, each known by its own."""
    sizes = np.array(counts, dtype=float)
    below = float(np.sum(sizes**2 / np.array(each_known_with)))
    return float(np.sum(sizes)) ** 2 / below if below else np.inf


def beyond_mixture(weights: np.ndarray, value: float) -> float:
    """Chance that a sum of independent chi-squares (1) with these weights exceeds a value.

    By the saddlepoint of its distribution (Kuonen 1999), to a few hundredths of itself, however
    small it is.
    """
    from scipy.optimize import brentq  # slow to import, and only a model that is wrong asks this

    largest = float(np.max(weights, initial=0.0))
    if largest <= 0 or value <= 0:
        return 1.0
    scaled = np.maximum(weights, 0.0) / largest
    ratio = value / largest

    def slope(turn: float) -> float:
        return float(np.sum(scaled / (1 - 2 * scaled * turn))) - ratio

    if abs(slope(0.0)) < 1e-3 * float(np.sum(scaled)):
        return 0.5  # at its mean, where it is about that and the formula has a pole
    if slope(0.5 - 1e-14) < 0:
        return 0.0
    at = float(brentq(slope, -(len(scaled) + 1) / min(ratio, 1.0), 0.5 - 1e-14))
    log = -0.5 * float(np.sum(np.log1p(-2 * scaled * at)))
    away = np.sign(at) * np.sqrt(2 * (at * ratio - log))
    bend = at * np.sqrt(2 * float(np.sum((scaled / (1 - 2 * scaled * at)) ** 2)))
    return float(ndtr(-(away + np.log(bend / away) / away)))


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


_TESTS = (beyond_stated, correlated, beyond_differences, drift, runs_disagree)

_FEWEST_RESIDUALS = 10  # degrees of freedom below which nothing is said of a model


def judge(series: Sequence[Series], *, robust: bool) -> Verdict:
    """Whether residuals are what noise alone would leave.

    Arguments:
        series: of all channels of all runs, before they are whitened.
        robust: whether the loss of the fit lets outliers stand; they are then left out.

    Returns:
        "adequate" where no test finds a reason against it; at most 2 % of adequate models whose
        noise is white, or has the correlation that is stated, are called inadequate. "doubtful"
        where residuals are far smaller than the stated noise, or a few cells make that which was
        adopted.
    """
    if robust:
        series = [each.where(np.abs(each.residual) <= OUTLIER * each.adopted) for each in series]
    if sum(len(each) - each.lost for each in series) < _FEWEST_RESIDUALS:
        few = Reason("cells", "too few measured values for a verdict on the model", 1.0, 1.0)
        return Verdict("not evaluated", (few,))
    series = [each.known_memory_removed() for each in series if len(each)]
    reasons = [reason for test in _TESTS if (reason := test(series)) is not None]
    found = Verdict.inadequate(reasons) if reasons else Verdict("adequate")
    for doubt in below_stated(series), None if robust else by_a_few_cells(series):
        found = found if doubt is None else found.doubted(doubt)
    return found
