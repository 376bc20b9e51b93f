"""What was held out of a fit, judged where the fit ended."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..runs import Parted, Run
from ..verdict import Foretold, Predictions, Reason, Series
from ._configuration import Setup
from ._held_state import held_cells, where_it_ended
from ._problem import predictions_by_run
from ._reestimate import TOLERANCE
from ._residual_cells import prior_gram, residual_cells
from ._result import FitResult
from ._run_records import HeldChannel, HeldOut
from ._state import FitState

# By the position of a run and the name of a channel.
Sizes = dict[tuple[int, str], float | None]


def with_held_out(result: FitResult, setup: Setup, parts: Sequence[Parted]) -> FitResult:
    """The result with how well it predicts what was held out of its runs, and a verdict on that.

    Arguments:
        result: of a fit of the fitted parts.
        setup: the same fit of the whole runs.
        parts: of each run of `setup`.

    Returns:
        The result with `held_out`; where the held cells are further off than noise and the
        uncertainty of the parameters allow, its verdict has one more reason.
    """
    state = where_it_ended(result, setup, parts)
    if state.evaluated:
        predicted = predictions_by_run(state.problem, state.inner.aux, setup.runs)
        sizes, reason = _judged(state, parts)
    else:
        predicted, sizes = [{} for _ in parts], {}
        said = "what was held out cannot be predicted, because the model fails where the fit ended"
        reason = Reason("prediction", said, 0.0, math.inf)
    verdict = result.verdict
    # A fit that did not reach its optimum says nothing of the model.
    if reason is not None and "end" not in [other.code for other in verdict.reasons]:
        verdict = verdict.with_reason(reason)
    records, of_held, of_fitted = [], [], []
    fitted = iter(result.predictions)
    for number, (part, channels) in enumerate(zip(parts, predicted, strict=True)):
        known = {}
        if part.held is not None:
            names = list(part.held.observations)
            known = {name: channels[name] for name in names if name in channels}
            of_run = {name: sizes.get((number, name), math.inf) for name in names}
            records.append(_record(part.whole, part.held, known, of_run))
            of_held.append(known)
        if part.fitted is not None:
            of_fitted.append({**known, **next(fitted)})
    return dataclasses.replace(
        result,
        held_out=tuple(records),
        verdict=verdict,
        predictions=tuple(of_fitted),
        held_predictions=tuple(of_held),
    )


def _judged(state: FitState, parts: Sequence[Parted]) -> tuple[Sizes, Reason | None]:
    """How far off the held cells of each channel of each run are, and what speaks against it."""
    channels, sizes = [], Sizes()
    for (number, name), cells in residual_cells(state).items():
        whole = parts[number].whole
        largest = float(np.nanmax(np.abs(whole.observations[name])))
        stated = state.noise.stated[number][name].noise
        if stated is None and np.max(np.abs(cells.residual)) <= TOLERANCE * largest:
            # What a solver's tolerance leaves is no noise to compare with.
            sizes[number, name] = 0.0
            continue
        series = Series(
            run=whole.name,
            channel=name,
            residual=cells.residual,
            times=cells.times,
            stated=stated,
            key=cells.key,
            adopted=state.noise.values[number][name].deviation,
            lost=0.0,
        )
        channels.append(Foretold(series, cells, held_cells(parts[number], name)))
    test = Predictions(channels, prior_gram(state), robust=state.setup.loss != "linear")
    for each in channels:
        if np.any(each.held):
            at = each.cells.run, each.series.channel
            sizes[at] = test.of(*at).size
    return sizes, test.reason()


def _record(
    whole: Run,
    held: Run,
    predicted: Mapping[str, np.ndarray],
    sizes: Mapping[str, float | None],
) -> HeldOut:
    """What was held out of a run, in the units of the recording."""
    channels = {}
    for name, values in held.observations.items():
        channel, measured = whole.channels[name], ~np.isnan(values)
        rmse = math.inf
        if name in predicted:
            off = (predicted[name] - values)[measured]
            rmse = float(channel.from_si(float(np.sqrt(np.mean(off**2)))))
        channels[name] = HeldChannel(channel.unit, rmse, int(np.sum(measured)), sizes[name])
    path = None if whole.path is None else str(whole.path)
    return HeldOut(whole.name, path, whole.sha256, channels)
