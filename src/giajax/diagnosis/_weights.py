"""A fit where it ended, as weighted tables: residuals and columns in units of white noise."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import FitResult, Response, scores
from ..noise import by_second_differences
from ..runs import Run
from ._ended import Moved
from ._projection import Table

Array = np.ndarray


def fitted_noise(result: FitResult, runs: Sequence[Run]) -> list[dict[str, float]]:
    """Standard deviations (SI) that each run was weighted with, by channel."""
    return [
        {
            name: float(run.channels[name].to_si(channel.noise))
            for name, channel in record.channels.items()
        }
        for run, record in zip(runs, result.runs, strict=True)
    ]


def white_noise(
    result: FitResult, runs: Sequence[Run], at: Sequence[Response]
) -> list[dict[str, float]]:
    """Standard deviations (SI) of white noise by channel, which no wrong model makes larger.

    Those that a run states; else from second differences of the residuals, in which what is
    smooth leaves nothing; else, where the samples do not follow each other, those of the fit.
    """
    deviations = []
    for run, response, weighted in zip(runs, at, fitted_noise(result, runs), strict=True):
        rest = response.predicted - response.observed
        each = {}
        for index, name in enumerate(response.channels):
            stated = run.noise(name)
            apart = None if run.times is None else by_second_differences(rest[:, index])
            each[name] = stated or apart or weighted[name]
        deviations.append(each)
    return deviations


def robust_weights(result: FitResult, runs: Sequence[Run], at: Sequence[Response]) -> list[Array]:
    """Roots of the weights that the loss gives the residuals, each (sample, channel)."""
    loss = result.config.get("loss", "linear")
    weights = []
    for response, noise in zip(at, fitted_noise(result, runs), strict=True):
        sigma = np.asarray([noise[name] for name in response.channels])
        rest = np.nan_to_num((response.predicted - response.observed) / sigma)
        psi, _, _ = scores(loss, rest)
        weights.append(np.sqrt(np.where(rest == 0, 1.0, psi / np.where(rest == 0, 1.0, rest))))
    return weights


@dataclasses.dataclass(frozen=True)
class Weighing:
    """How the cells of each run count.

    Attributes:
        factors: one over the noise, times the root of the weight of the loss, 0 where nothing
            was measured; each (sample, channel).
    """

    factors: list[Array]

    @classmethod
    def of(
        cls, at: Sequence[Response], noise: Sequence[Mapping[str, float]], weights: Sequence[Array]
    ) -> "Weighing":
        """From standard deviations by channel and the roots of weights."""
        factors = []
        for response, deviations, weight in zip(at, noise, weights, strict=True):
            sigma = np.asarray([deviations[name] for name in response.channels])
            factors.append(np.where(np.isnan(response.observed), 0.0, weight / sigma))
        return cls(factors)

    def chi_square(self, at: Sequence[Response], predicted: Sequence[Array]) -> float:
        """Sum of weighted squares of predictions less what was observed."""
        total = 0.0
        for response, table, factor in zip(at, predicted, self.factors, strict=True):
            rest = np.where(factor > 0, table - np.nan_to_num(response.observed), 0.0)
            total += float(np.sum((rest * factor) ** 2))
        return total

    def tables(
        self,
        at: Sequence[Response],
        runs: Sequence[Run],
        moved: Moved,
        switches: Sequence[Sequence[Array]] = (),
    ) -> list[Table]:
        """Weighted residuals and columns of each run.

        Arguments:
            at: responses, the columns of the fitted parameters first.
            runs: their runs.
            moved: what these are the coordinates of.
            switches: of each switch, the change of the predictions of each run that it makes;
                they are tested after the other columns.
        """
        tables = []
        count = len(moved.places[0])
        for index, (response, run, factor) in enumerate(zip(at, runs, self.factors, strict=True)):
            rest = np.where(factor > 0, response.predicted - np.nan_to_num(response.observed), 0.0)
            changes = np.stack(
                [response.columns[..., i] for i in range(count, response.columns.shape[2])]
                + [changed[index] for changed in switches],
                axis=-1,
            )
            each = factor[..., None]
            fitted, own = moved.split(index, response.columns[..., :count], response.own)
            tables.append(
                Table(
                    residual=rest * factor,
                    measured=~np.isnan(response.observed),
                    fitted=fitted * each,
                    own=own * each,
                    asked=changes * each,
                    timed=run.times is not None,
                    known=moved.known_of_runs[index],
                )
            )
        return tables
