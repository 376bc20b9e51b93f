"""Tests of whether a fitted model describes its data, from residuals before whitening."""

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from typing import Literal, Self

import numpy as np
from scipy.special import chdtr, chdtrc, fdtrc, ndtr

from ..runtime.arrays import Bool, Float
from ..runtime.records import InfiniteWhereNull
from ._model import ChannelNoise, by_second_differences, whitened

# Degrees of freedom per cell of a white-noise variance from second differences: 18 / 35, because
# these have the autocorrelations 1, -2/3 and 1/6.
DIFFERENCES = 18 / 35

OUTLIER = 3.0  # standard deviations beyond which a robust loss treats a cell as an outlier
_SHORT_SERIES = 16  # minimum number of cells for an estimate from second differences


@dataclasses.dataclass(frozen=True)
class Series:
    """Residuals of one channel of one run.

    Attributes:
        run: name of the run.
        channel: name of the channel.
        residual: predicted minus recorded values where measured, SI units, shape (cell,).
        times: times of these cells, s, or None for a run without times.
        stated: noise that the run specifies, or None.
        key: key of the noise. Cells with the same key have the same noise.
        adopted: standard deviation of a cell that the fit used, SI units.
        lost: number of degrees of freedom that the fit used.
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
        """Number of degrees of freedom that the fit has left."""
        return max(len(self) - self.lost, 1.0)

    @property
    def white(self) -> float:
        """White noise: the specified standard deviation, or the one from differences if larger."""
        stated = 0.0 if self.stated is None else self.stated.deviation
        return max(stated, self.from_differences)

    @property
    def white_degrees_of_freedom(self) -> float:
        """Degrees of freedom of `white`, infinite if it is specified."""
        known = self.stated is not None and self.stated.deviation >= self.from_differences
        return np.inf if known else DIFFERENCES * len(self)

    @property
    def from_differences(self) -> float:
        """Standard deviation of white noise from the second differences of the residuals.

        Their mean square is 6 times its variance (`giajax.noise.from_differences`). Its accuracy is
        that of `DIFFERENCES` times as many independent cells.
        """
        if len(self) < _SHORT_SERIES:
            return self.adopted
        # Residuals without any difference belong to a perfect description.
        return float(np.sqrt(np.mean(np.diff(self.residual, 2) ** 2) / 6)) or self.adopted

    def where(self, kept: Bool[np.ndarray, " cell"]) -> Self:
        """Return some of the cells."""
        times = None if self.times is None else self.times[kept]
        return dataclasses.replace(self, residual=self.residual[kept], times=times)

    def known_memory_removed(self) -> Self:
        """Return the residuals, whitened with the correlation that the run specifies, if any."""
        if self.stated is None or self.stated.is_white:
            return self
        white = whitened(self.stated, self.times, self.residual[:, None])[:, 0]
        unit = ChannelNoise(1.0)
        return dataclasses.replace(self, residual=white, stated=unit, adopted=1.0)


VerdictStatus = Literal["adequate", "doubtful", "inadequate", "not evaluated"]


@dataclasses.dataclass(frozen=True)
class Reason:
    """A reason why residuals are not consistent with noise alone.

    Attributes:
        code: "noise", "correlation", "differences", "drift", "runs" or "prediction"; "too_small",
            residuals far below the specified noise; "outliers", a few cells dominate the noise of
            the fit; "suspect", an effect that the fit held or omitted; "prior", a value far from
            its usual value; "vanished", a value that is 0 but should not be; "unexplained", no
            suspect explains the residuals; "end", a fit without an optimum; "cells", too few cells.
        sentence: what was found, and where.
        p_value: probability of such a result due to noise alone, corrected for the number of tests.
        size: factor by which the residuals exceed the noise for this reason, infinite if the model
            cannot be evaluated. For a suspect, the shift of a parameter in its standard errors.
        channels: names of the channels concerned most.
    """

    code: str
    sentence: str
    p_value: float
    size: InfiniteWhereNull
    channels: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Verdict:
    """Whether the model describes the data, independent of the convergence of the fit.

    Attributes:
        status: "adequate"; "inadequate", the residuals are not consistent with noise; "doubtful",
            they are, but a held or omitted effect is significant and changes a parameter, or the
            fit has no optimum; "not evaluated", too few cells.
        reasons: reasons why the model is not adequate, the most certain first.
    """

    status: VerdictStatus
    reasons: tuple[Reason, ...] = ()

    @classmethod
    def inadequate(cls, reasons: Iterable[Reason]) -> Self:
        """Return the verdict "inadequate" with these reasons."""
        surest = sorted(reasons, key=lambda reason: (reason.p_value, -reason.size))
        return cls("inadequate", tuple(surest))

    def with_reason(self, reason: Reason) -> Self:
        """Return the verdict with an additional reason, which makes it inadequate."""
        others = self.reasons if self.status != "not evaluated" else ()
        return self.inadequate((*others, reason))

    def doubted(self, reason: Reason) -> Self:
        """Return the verdict with a reason that makes an adequate model doubtful.

        Such a reason is not visible in the residuals.
        """
        status: VerdictStatus = "inadequate" if self.status == "inadequate" else "doubtful"
        others = self.reasons if self.status != "not evaluated" else ()
        reasons = sorted((*others, reason), key=lambda each: each.p_value)
        return dataclasses.replace(self, status=status, reasons=tuple(reasons))

    def without(self, code: str) -> Self:
        """Return the verdict without the reasons of a code that made an adequate model doubtful."""
        reasons = tuple(reason for reason in self.reasons if reason.code != code)
        status = self.status if reasons or self.status != "doubtful" else "adequate"
        return dataclasses.replace(self, status=status, reasons=reasons)

    @property
    def sentence(self) -> str:
        """Status and reasons in one line."""
        if not self.reasons:
            return self.status
        return f"{self.status}: {'; '.join(reason.sentence for reason in self.reasons)}"

    @classmethod
    def missing(cls) -> Self:
        """Return the verdict of a result that was stored without one."""
        return cls("not evaluated")


# Tests of residuals against noise alone. Each may give a reason.
#
# A reason requires both significance and size: with many cells everything is significant, and with
# few cells a large misfit may be due to chance. Each function makes several tests and corrects for
# their number (Bonferroni), so noise alone gives a reason with a probability of at most `LEVEL`.

# The probability of rejecting an adequate model is 1.2 % for these five tests and the test of
# held-out data (`giajax.fitting`) together, 0.6 % for held and omitted effects (`giajax.suspects`),
# and 0.2 % for nuisance parameters, by their priors.
LEVEL = 0.012 / 6
SUSPECT_LEVEL = 0.006
PRIOR_LEVEL = 0.002

SIZE = 1.1  # a noise that is larger by a tenth is reported

# Lengths in cells of the blocks whose means are compared with those of white noise.
_BLOCKS = (2, 4, 8, 16, 32)

_FEWEST_BLOCKS = 4  # minimum number of blocks for a test
_FEWEST_VALUES = 32  # minimum number of cells of a series for a separate test


_FAR_BELOW = 3.0  # factor below the specified noise, because data sheets are often conservative


def beyond_stated(series: Sequence[Series]) -> Reason | None:
    """Test whether the residuals exceed the specified noise."""
    return _against_stated(series, below=False)


def below_stated(series: Sequence[Series]) -> Reason | None:
    """Test whether the residuals are far below the specified noise: noise or unit is wrong."""
    return _against_stated(series, below=True)


_HEAVY = 3.0  # ratio of standard deviations; Student's t with 3 degrees of freedom has 1.7
# Standard deviations of a second difference that is a glitch, and the largest fraction of such
# differences. A glitch causes three of them.
_GLITCH, _FEW_CELLS = 6.0, 0.2


def _usual_differences(values: Float[np.ndarray, " sample"]) -> tuple[float, float] | None:
    """Return the white noise from second differences: of most of them, and of all.

    The values differ if a few cells are glitches. They are equal (the value of all) if many cells
    have larger noise, or if only every other cell has noise because of resampling.
    """
    usual, second = by_second_differences(values), np.diff(values, 2)
    if not usual:
        return None
    every = float(np.sqrt(np.mean(second**2) / 6))
    few = np.mean(np.abs(second) > _GLITCH * np.sqrt(6) * usual) < _FEW_CELLS
    return (usual if few and every > _HEAVY * usual else every), every


def by_a_few_cells(series: Sequence[Series]) -> Reason | None:
    """Test whether a few outliers dominate the noise of the fit, if none is specified."""
    unknown = [each for each in series if each.stated is None and len(each) >= _FEWEST_VALUES]

    def looked_at() -> Iterator[Reason]:
        for each in unknown:
            both = None if each.times is None else _usual_differences(each.residual)
            if both is not None and both[1] > both[0]:
                size = each.from_differences / both[0]
                sentence = (
                    f"the noise estimate of {each.channel} is dominated by a few cells, which "
                    f"increase it by a factor of {size:.3g}: empty these cells, or "
                    "fit with --loss student_t"
                )
                p = tail(each.white_degrees_of_freedom, DIFFERENCES * len(each), size**2)
                yield Reason("outliers", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(unknown))


def white_deviation(
    rest: Float[np.ndarray, " sample"], stated: float | None, adopted: float, *, in_time: bool
) -> float:
    """Return the standard deviation of white noise of a channel, which no wrong model increases.

    It is the specified noise, otherwise the noise of the fit. If the latter significantly exceeds
    the noise from second differences of the residuals `rest`, it is the noise from differences.
    These do not contain smooth errors, and the few outliers are omitted. NaN is not measured.
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
    """Test one side of the specified noise. Both sides share the probability of one test."""
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
                    f"the stated noise is {1 / size:.3g} times the residuals{where}, so the stated "
                    "noise or the unit of a column is wrong"
                )
                p = float(chdtr(degrees_of_freedom, total))
                yield Reason("too_small", sentence, p, 1 / size, names)

    return largest(looked_at(), 2 * len(groups))


def correlated(series: Sequence[Series]) -> Reason | None:
    """Test whether means of blocks of cells vary more than those of white noise.

    The mean of L cells of white noise has 1 / L of the variance of a cell, and correlated residuals
    have more. A fit removes slow parts from the residuals, which can only lower the statistic.
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
            # Excess variance of the blocks over white noise, per cell, relative to the white
            # variance.
            share = max(squares / count - 1 / length, 0.0) / (1 - 1 / length)
            size = float(np.sqrt(1 + share))
            where = "" if names == groups[0] else f" of {', '.join(names)}"
            sentence = (
                f"the residuals{where} are correlated, because the noise is correlated or the "
                "model omits an effect: the correlated part increases the standard deviation of "
                f"the residuals by a factor of {size:.3g}"
            )
            yield Reason("correlation", sentence, p, size, names)

    return largest(looked_at(), len(_BLOCKS) * len(groups))


def beyond_differences(series: Sequence[Series]) -> Reason | None:
    """Compare the noise of the fit with that of second differences, if none is specified.

    Noise that is estimated from residuals hides any wrong model, because chi-square is then 1 by
    construction.
    """
    unknown = [each for each in series if each.stated is None and len(each) >= _FEWEST_VALUES]
    channels = sorted({each.channel for each in unknown})

    def looked_at() -> Iterator[Reason]:
        for name in channels:
            chosen = [each for each in unknown if each.channel == name]
            # Each is divided by its own noise, because runs may differ in length and in noise.
            total = sum(float(np.sum((e.residual / e.from_differences) ** 2)) for e in chosen)
            degrees_of_freedom = sum(each.degrees_of_freedom for each in chosen)
            size = float(np.sqrt(total / degrees_of_freedom))
            sentence = (
                f"the noise estimate of {name} is {size:.3g} times the noise estimated from "
                "differences between neighbouring residuals"
            )
            p = tail(degrees_of_freedom, _together(chosen), size**2)
            yield Reason("differences", sentence, p, size, (name,))

    return largest(looked_at(), len(channels))


def drift(series: Sequence[Series]) -> Reason | None:
    """Test for a trend of the residuals over the run."""
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
    """Compare the residuals of a channel in one run with those in the other runs."""
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
                f"large in {each.run} as in the other runs"
            )
            p = tail(len(each), degrees_of_freedom, ratio)
            yield Reason("runs", sentence, p, size, (each.channel,))

    return largest(looked_at(), len(pairs))


def largest(looked_at: Iterable[Reason], looks: int) -> Reason | None:
    """Return the largest reason that is significant, after correction for the number of tests."""
    corrected = (
        dataclasses.replace(each, p_value=min(looks * each.p_value, 1.0)) for each in looked_at
    )
    known = [each for each in corrected if each.p_value < LEVEL and each.size > SIZE]
    return max(known, key=lambda each: each.size, default=None)


def alone_and_together(series: Sequence[Series]) -> list[tuple[str, ...]]:
    """Return all channels of some series as one group, and each of several channels alone."""
    channels = sorted({each.channel for each in series})
    alone: list[tuple[str, ...]] = [(name,) for name in channels]
    return [tuple(channels), *alone] if len(alone) > 1 else alone


def _together(series: Sequence[Series]) -> float:
    """Return the degrees of freedom of the white noise of several series."""
    return satterthwaite([*map(len, series)], [each.white_degrees_of_freedom for each in series])


def satterthwaite(counts: Sequence[int], each_known_with: Sequence[float]) -> float:
    """Return the degrees of freedom of the mean of several variances."""
    sizes = np.array(counts, dtype=float)
    below = float(np.sum(sizes**2 / np.array(each_known_with)))
    return float(np.sum(sizes)) ** 2 / below if below else np.inf


def beyond_mixture(weights: np.ndarray, value: float) -> float:
    """Return the probability that a weighted sum of chi-squares (1) exceeds a value.

    It is computed by the saddlepoint approximation (Kuonen 1999), with a relative error of a few
    hundredths even for small probabilities.
    """
    from scipy.optimize import brentq  # slow to import, and only needed for a wrong model

    largest = float(np.max(weights, initial=0.0))
    if largest <= 0 or value <= 0:
        return 1.0
    scaled = np.maximum(weights, 0.0) / largest
    ratio = value / largest

    def slope(turn: float) -> float:
        return float(np.sum(scaled / (1 - 2 * scaled * turn))) - ratio

    if abs(slope(0.0)) < 1e-3 * float(np.sum(scaled)):
        return 0.5  # at the mean, where the formula has a pole
    if slope(0.5 - 1e-14) < 0:
        return 0.0
    at = float(brentq(slope, -(len(scaled) + 1) / min(ratio, 1.0), 0.5 - 1e-14))
    log = -0.5 * float(np.sum(np.log1p(-2 * scaled * at)))
    away = np.sign(at) * np.sqrt(2 * (at * ratio - log))
    bend = at * np.sqrt(2 * float(np.sum((scaled / (1 - 2 * scaled * at)) ** 2)))
    return float(ndtr(-(away + np.log(bend / away) / away)))


def tail(above: float, below: float, ratio: float) -> float:
    """Return the probability of a larger ratio of two variances with these degrees of freedom."""
    if np.isinf(below):
        return float(chdtrc(above, above * ratio))
    return float(fdtrc(above, below, ratio))


def _block_means(series: Series, length: int) -> np.ndarray:
    """Return the means of consecutive cells, divided by the white noise of a cell."""
    count = len(series) // length
    cells = series.residual[: count * length].reshape(count, length)
    return np.mean(cells, axis=1) / series.white


_TESTS = (beyond_stated, correlated, beyond_differences, drift, runs_disagree)

_FEWEST_RESIDUALS = 10  # minimum number of degrees of freedom for a verdict


def judge(series: Sequence[Series], *, robust: bool) -> Verdict:
    """Judge whether the residuals are consistent with noise alone.

    Arguments:
        series: residuals of all channels of all runs before whitening.
        robust: whether the loss of the fit is robust. Outliers are then omitted.

    Returns:
        The verdict. It is "adequate" if no test finds a reason against the model. At most 2 % of
        adequate models are called inadequate, if their noise is white or has the specified
        correlation. It is "doubtful" if the residuals are far below the specified noise, or if a
        few cells dominate the noise of the fit.
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
