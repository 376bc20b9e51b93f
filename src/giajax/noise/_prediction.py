"""Whether cells that were held out of a fit are where it predicts them.

The predictive-failure test of Chow (Econometrica 28, 1960, p. 591), for any noise and priors. To
first order in the parameters, with e the residuals of some cells, J their derivatives and V their
covariance, the least chi-square that a fit of these cells can reach is

    C = min_d (e + J d)^T V^-1 (e + J d).

What the fitted and the held cells together have more of it than the fitted ones alone has the
degrees of freedom of the held cells, less those parameters that only these know, such as the
initial state of a run that was held out. That is the error of prediction against noise and the
uncertainty of the parameters in one, and it does not depend on the weights that the fit had.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from ..runtime.arrays import Bool, Float
from ._estimate import robust_deviation
from ._model import ChannelNoise
from ._restricted import Cells, orthonormal
from ._verdict import (
    DIFFERENCES,
    OUTLIER,
    Reason,
    Series,
    alone_and_together,
    largest,
    satterthwaite,
    tail,
)


@dataclasses.dataclass(frozen=True)
class Foretold:
    """One channel of one run, of which cells may have been held out.

    Attributes:
        series: residuals of all of its cells, at the fitted values.
        cells: the same with their derivatives, those by what runs share in the same columns.
        held: which of them were held out of the fit, shape (cell,).
    """

    series: Series
    cells: Cells
    held: Bool[np.ndarray, " cell"]

    @property
    def noise(self) -> ChannelNoise:
        """What the cells may be off by, whatever the model.

        As stated, with the memory that is stated. Else white, from second differences: a memory
        that was estimated from the residuals of the fit would take physics that the model lacks
        for noise, and expect it in the held cells, too.
        """
        return self.series.stated or ChannelNoise(self.series.from_differences)

    @property
    def noise_freedom(self) -> float:
        """Degrees of freedom that this noise is known with; infinite where it is stated."""
        return np.inf if self.series.stated is not None else DIFFERENCES * len(self.series)

    def without_outliers(self) -> "Foretold":
        """The cells that no loss which lets outliers stand would leave alone.

        Held cells among which many are off are no outliers, but a prediction that fails.
        """
        size = np.abs(self.series.residual)
        usual = np.full(len(size), self.series.adopted)
        if np.any(self.held):
            many = robust_deviation(self.series.residual[self.held])
            usual[self.held] = max(self.series.adopted, many)
        kept = size <= OUTLIER * usual
        return Foretold(self.series.where(kept), self.cells.where(kept), self.held[kept])


@dataclasses.dataclass(frozen=True)
class Prediction:
    """How well the held cells of some channels are predicted.

    Attributes:
        statistic: chi-square that these cells have beyond what the fitted ones have, with the
            parameters where both together want them.
        freedom: its degrees of freedom.
        noise_freedom: those of the noise that it is in units of.
    """

    statistic: float
    freedom: int
    noise_freedom: float

    @property
    def size(self) -> float | None:
        """How many times as far off the cells are as they may; None without any freedom."""
        return float(np.sqrt(self.statistic / self.freedom)) if self.freedom > 0 else None

    @property
    def p_value(self) -> float:
        """Chance of more where the model is right."""
        if self.freedom <= 0:
            return 1.0
        return tail(self.freedom, self.noise_freedom, self.statistic / self.freedom)


class Predictions:
    """The cells of a fit and those that were held out of it.

    Arguments:
        channels: of all runs.
        priors: X^T X of the rows of the priors; X are the shared columns and, last, the residual.
        robust: whether the loss of the fit lets outliers stand; they are then left out.
    """

    def __init__(
        self,
        channels: Sequence[Foretold],
        priors: Float[np.ndarray, "column column"],
        *,
        robust: bool,
    ) -> None:
        self._channels = [each.without_outliers() for each in channels] if robust else channels
        self._priors = priors
        self._fitted = [_gram(each, ~each.held) for each in self._channels]
        self._whole = [_gram(each, np.ones_like(each.held)) for each in self._channels]
        self._members: dict[int, list[int]] = {}
        for position, each in enumerate(self._channels):
            self._members.setdefault(each.cells.run, []).append(position)
        self._of_runs: dict[tuple[int, frozenset[int]], tuple[np.ndarray, int]] = {}
        self._alone = self._least(frozenset())

    def of(self, run: int, channel: str) -> Prediction:
        """That of the held cells of a channel of one run."""
        return self._of(
            [
                position
                for position in self._members[run]
                if self._channels[position].series.channel == channel
            ]
        )

    def reason(self) -> Reason | None:
        """What speaks against the model: all held cells, or those of one channel in all runs."""
        held = {i: each for i, each in enumerate(self._channels) if np.any(each.held)}
        groups = alone_and_together([each.series for each in held.values()])

        def looked_at() -> Iterator[Reason]:
            for names in groups:
                at = [i for i, each in held.items() if each.series.channel in names]
                found = self._of(at)
                if found.size is None:
                    continue
                where = "" if names == groups[0] else f" of {', '.join(names)}"
                sentence = (
                    f"what was held out{where} is {found.size:.3g} times as far off as noise and "
                    "the uncertainty of the parameters allow"
                )
                yield Reason("prediction", sentence, found.p_value, found.size, names)

        return largest(looked_at(), len(groups))

    def _of(self, positions: Sequence[int]) -> Prediction:
        held = [self._channels[position] for position in positions]
        counts = [int(np.sum(each.held)) for each in held]
        known, rank = self._least(frozenset(positions))
        alone, rank_alone = self._alone
        return Prediction(
            statistic=max(known - alone, 0.0),
            freedom=sum(counts) - (rank - rank_alone),
            noise_freedom=satterthwaite(counts, [each.noise_freedom for each in held]),
        )

    def _least(self, positions: frozenset[int]) -> tuple[float, int]:
        """C of the fitted cells with the held ones of some channels, and how much they determine.

        What one run alone responds to is taken out of that run first (Frisch, Waugh and Lovell),
        so that no matrix with the parameters of all runs is ever made.
        """
        total, rank = self._priors, 0
        for run in self._members:
            rest, own = self._of_run(run, positions)
            total, rank = total + rest, rank + own
        rest, shared = _without(total, len(total) - 1)
        return float(rest[0, 0]), rank + shared

    def _of_run(self, run: int, positions: frozenset[int]) -> tuple[np.ndarray, int]:
        members = self._members[run]
        key = run, positions.intersection(members)
        if key not in self._of_runs:
            grams = [self._whole[i] if i in positions else self._fitted[i] for i in members]
            width = self._channels[members[0]].cells.own.shape[1]
            self._of_runs[key] = _without(np.sum(grams, axis=0), width)
        return self._of_runs[key]


def _gram(each: Foretold, kept: Bool[np.ndarray, " cell"]) -> np.ndarray:
    """X^T V^-1 X of own and shared columns and the residual, of some cells."""
    if not np.any(kept):
        width = each.cells.own.shape[1] + each.cells.shared.shape[1] + 1
        return np.zeros((width, width))
    return each.cells.where(kept).gram(each.noise)[0]


def _without(gram: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """A Gram matrix without the span of its first columns, and how many dimensions that has."""
    basis = orthonormal(gram[:width, :width])
    across = basis.T @ gram[:width, width:]
    return gram[width:, width:] - across.T @ across, basis.shape[1]
