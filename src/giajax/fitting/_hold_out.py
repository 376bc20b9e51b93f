"""What was held out of a fit, judged where the fit ended."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..runs import Parted, Run
from ..verdict import Foretold, Predictions, Reason
from ._configuration import Setup
from ._held_state import held_cells, where_it_ended
from ._problem import predictions_by_run
from ._reestimate import TOLERANCE
from ._residual_cells import prior_gram, residual_cells
from ._result import FitResult
from ._run_records import HeldChannel, HeldOut
from ._state import FitState
from ._verdict import series_of

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
    # A result that was loaded has none.
    fitted = iter(result.predictions or ({},) * len(parts))
    for number, (part, channels) in enumerate(zip(parts, predicted, strict=True)):
        known = {}
        if part.held is not None:
            names = list(part.held.observations)
            known = {name: channels[name] for name in names if name in channels}
            of_run = {name: sizes.get((number, name), math.inf) for name in names}
            errors = _errors(part.whole, part.held, known)
            records.append(_record(part.whole, part.held, errors, of_run))
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
        series = series_of(state, number, name, cells.residual, cells.times, lost=0.0)
        channels.append(Foretold(series, cells, held_cells(parts[number], name)))
    test = Predictions(channels, prior_gram(state), robust=state.setup.loss != "linear")
    for each in channels:
        if np.any(each.held):
            at = each.cells.run, each.series.channel
            sizes[at] = test.of(*at).size
    return sizes, test.reason()


def not_judged(result: FitResult, parts: Sequence[Parted]) -> FitResult:
    """The result with what was held out of its runs, of which no error is known.

    Arguments:
        result: of a fit of the fitted parts.
        parts: of each run.
    """
    records = [
        _record(part.whole, part.held, unknown, unknown)
        for part in parts
        if part.held is not None
        for unknown in [dict.fromkeys(part.held.observations)]
    ]
    return dataclasses.replace(result, held_out=tuple(records))


def _errors(whole: Run, held: Run, predicted: Mapping[str, np.ndarray]) -> dict[str, float]:
    """Root mean square error of the held cells of each channel, in the unit of the recording."""
    errors = dict.fromkeys(held.observations, math.inf)
    for name, values in predicted.items():
        observed = held.observations[name]
        off = (values - observed)[~np.isnan(observed)]
        rmse = float(np.sqrt(np.mean(off**2)))
        errors[name] = float(whole.channels[name].from_si(rmse))
    return errors


def _record(
    whole: Run,
    held: Run,
    errors: Mapping[str, float | None],
    sizes: Mapping[str, float | None],
) -> HeldOut:
    """What was held out of a run."""
    channels = {
        name: HeldChannel(
            whole.channels[name].unit, errors[name], int(np.sum(~np.isnan(values))), sizes[name]
        )
        for name, values in held.observations.items()
    }
    path = None if whole.path is None else str(whole.path)
    return HeldOut(whole.name, path, whole.sha256, channels)
