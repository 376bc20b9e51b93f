"""Two models on the same recordings, from the same first rows."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from ..fitting import PredictionErrors, errors_of, fit, prediction_errors
from ..models import AbstractModel
from ..runs import Definition, Run


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Errors of prediction of one channel, in the unit of the recording.

    Attributes:
        run: name of the run; "all N" for N runs together.
        channel: its name, without unit.
        unit: of the recording.
        n: number of measured values.
        rmse: root mean square error of the model.
        largest: largest absolute error of the model.
        reference_rmse: root mean square error of the other model; None without one.
        pooled: whether several runs are taken together.
    """

    run: str
    channel: str
    unit: str
    n: int
    rmse: float
    largest: float
    reference_rmse: float | None = None
    pooled: bool = False

    @property
    def ratio(self) -> float | None:
        """Error of the model relative to that of the other one; None without one."""
        if self.reference_rmse is None:
            return None
        return self.rmse / self.reference_rmse if self.reference_rmse else float("nan")


def compare(
    model: AbstractModel,
    runs: Sequence[Run],
    other: AbstractModel | None = None,
    *,
    refit_initial: bool = False,
) -> list[Comparison]:
    """Errors of prediction, channel by channel.

    Arguments:
        model: what predicts.
        runs: what was recorded; each starts as its definition says.
        other: another model for the same runs.
        refit_initial: fit the initial state of each run first, for each model by itself.

    Returns:
        A comparison for each channel of each run, and of several runs for each channel of all
        of them together.

    Raises:
        InputError: as `giajax.predict` and `giajax.fit`.
    """
    comparisons = []
    for run in runs:
        errors = _errors(model, run, refit_initial)
        reference = None if other is None else _errors(other, run, refit_initial)
        comparisons += [
            Comparison(
                run=run.name,
                channel=name,
                unit=channel.unit,
                n=channel.n,
                rmse=_known(channel.rmse),
                largest=_known(channel.largest),
                reference_rmse=None if reference is None else reference.channels[name].rmse,
            )
            for name, channel in errors.channels.items()
        ]
    return comparisons if len(runs) == 1 else [*comparisons, *_pooled(comparisons)]


def _known(error: float | None) -> float:
    """An error that was computed; None, which only a file holds, was not finite."""
    return float("inf") if error is None else error


def _pooled(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """One comparison a channel for all runs together."""
    by_channel: dict[tuple[str, str], list[Comparison]] = {}
    for one in comparisons:
        by_channel.setdefault((one.channel, one.unit), []).append(one)
    pooled = []
    for (channel, unit), those in by_channel.items():
        counts = [one.n for one in those]
        references = [one.reference_rmse for one in those if one.reference_rmse is not None]
        pooled.append(
            Comparison(
                run=f"all {len(those)}",
                channel=channel,
                unit=unit,
                n=sum(counts),
                rmse=_together(counts, [one.rmse for one in those]),
                largest=max(one.largest for one in those),
                reference_rmse=_together(counts, references) if references else None,
                pooled=True,
            )
        )
    return pooled


def _together(counts: Sequence[int], errors: Sequence[float]) -> float:
    """Root mean square error of all values of several runs."""
    weights = np.asarray(counts) / np.sum(counts)
    return float(np.sqrt(np.sum(weights * np.asarray(errors) ** 2)))


def _errors(model: AbstractModel, run: Run, refit: bool) -> PredictionErrors:
    if not refit:
        return prediction_errors(model, run)
    free = Definition.parse({"initial": {"free": True}})
    run = dataclasses.replace(run, definition=run.definition.merged_with(free))
    (predicted,) = fit(model, run, free=[], check=False).predictions
    return errors_of(run, predicted)
