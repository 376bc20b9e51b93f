"""What was held out of a fit, judged where the fit ended."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from ..noise import ChannelNoise, Foretold, Predictions, Reason, Series, Verdict, judge
from ..recordings import Parted, Run
from ._configuration import Setup
from ._free import between
from ._noise import TOLERANCE, prior_gram, residual_cells, shared_and_own
from ._problem import predictions_by_run
from ._records import Status
from ._result import FitResult
from ._run_records import HeldChannel, HeldOut
from ._state import FitState
from ._transitions import at_tolerance, begin, move, reweight, step
from ._weights import Noise

# Where a fit of parts of runs ended, as the state of a fit of the whole runs.

# Steps of what only the held cells know, such as where a held run starts: the test that follows is
# exact to first order, and a state that was guessed may be further off than that.
_STEPS = 10


def where_it_ended(result: FitResult, setup: Setup, parts: Sequence[Parted]) -> FitState:
    """The state of a fit of the whole runs where that of the fitted parts ended, evaluated.

    What no fitted cell responds to is where the held cells want it.

    Arguments:
        result, setup, parts: as of `with_held_out`.
    """
    values = {
        p.path: between(result.parameters[p.path].value, p.declaration.lower, p.declaration.upper)
        for p in setup.parameters
    }
    own = {
        record.name: {p: one.value for p, one in record.parameters.items() if p in setup.groups}
        for record in result.runs
    }
    for path, groups in setup.groups.items():
        for names in ([setup.runs[i].name for i in members] for members in groups):
            known = [own[name][path] for name in names if path in own.get(name, {})]
            for name in names if known else ():
                own.setdefault(name, {})[path] = known[0]
    state = begin(dataclasses.replace(setup.started_at(values), own=own))
    if result.integration is not None:
        state = at_tolerance(state, result.integration.tolerance)
    state = _at_own_values(state, result, parts)
    state = step(reweight(state, _noise(result, state.noise, parts)))
    if not state.evaluated:
        return state
    alone = _known_to_held(state, parts)
    if not np.any(alone):
        return state
    everything = state.active
    state = dataclasses.replace(state, active=jnp.asarray(alone))
    for _ in range(_STEPS):
        state = step(state)
        if state.done:
            break
    return dataclasses.replace(state, active=everything)


def _at_own_values(state: FitState, result: FitResult, parts: Sequence[Parted]) -> FitState:
    """The state where each fitted run has its own values, also where others have its name."""
    start = state.start.copy()
    records = iter(result.runs)
    known = [next(records).parameters if part.fitted is not None else {} for part in parts]
    for group in state.problem.groups:
        for member, columns in zip(group.members, group.own_columns().tolist(), strict=True):
            for label, column in zip(group.own_labels(), columns, strict=True):
                if label in known[member]:
                    start[column] = known[member][label].value
    return move(state, state.problem.bijector.inverse(start))


def _noise(result: FitResult, noise: Noise, parts: Sequence[Parted]) -> Noise:
    """The noise that the fit ended with; of what it did not have, what is stated or guessed."""
    by_key = noise.by_key()
    records = iter(result.runs)
    for part, keys in zip(parts, noise.keys, strict=True):
        for name, one in (next(records).channels if part.fitted else {}).items():
            channel = part.whole.channels[name]
            by_key[keys[name]] = ChannelNoise.of_cell(
                float(channel.to_si(one.noise)),
                float(channel.to_si(one.correlated)),
                one.correlation_time_s,
            )
    return noise.with_values(by_key)


def _known_to_held(state: FitState, parts: Sequence[Parted]) -> np.ndarray:
    """The coordinates that no fitted cell responds to, shape (parameter,)."""
    alone = np.ones(state.problem.size, bool)
    for group in state.problem.groups:
        for member, columns in zip(group.members, group.columns(), strict=True):
            if parts[member].fitted is not None:
                alone[columns] = False
    shared, _ = shared_and_own(state)
    responds = np.zeros(len(shared), bool)
    for (number, name), cells in residual_cells(state).items():
        responds |= np.any(cells.shared[~held_cells(parts[number], name)] != 0, axis=0)
    alone[shared] = ~responds
    return alone


def held_cells(part: Parted, name: str) -> np.ndarray:
    """Which of the measured cells of a channel are held out, shape (cell,).

    Arguments:
        part: a run.
        name: of the channel.
    """
    measured = ~np.isnan(part.whole.observations[name])
    if part.held is None or name not in part.held.observations:
        return np.zeros(int(np.sum(measured)), bool)
    return ~np.isnan(part.held.observations[name][measured])


# The verdict on a fit: its residuals as they are, whatever they were weighted with.


def verdict(state: FitState, status: Status, prior_freedom: float) -> Verdict:
    """Whether the model describes the data, at the end of a fit.

    Arguments:
        state: the last one.
        status: how the fit ended; a fit that never reached an optimum is not judged.
        prior_freedom: degrees of freedom of the parameters that their priors know.
    """
    ended = {"not_converged": "did not converge", "interrupted": "was interrupted"}.get(status, "")
    early = Verdict("not evaluated", (Reason("end", f"the fit {ended}", 1.0, 1.0),))
    # Where the noise was estimated anew, an optimum was reached with the noise before.
    anew = status == "not_converged" and state.rounds_left < FitState.rounds_left
    if ended and not anew:
        return early
    series = residual_series(state, prior_freedom)
    if not series:
        return Verdict("adequate")
    found = judge(series, robust=state.setup.loss != "linear")
    return early if ended and found.status != "inadequate" else found


def residual_series(state: FitState, prior_freedom: float) -> list[Series]:
    """The residuals of each channel of each run; those of a perfect description are left out."""
    runs = state.setup.runs
    predictions = predictions_by_run(state.problem, state.inner.aux, runs)
    cells = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    lost = float(np.sum(np.asarray(state.active))) - prior_freedom
    share = lost / max(cells, 1)
    series = []
    for number, (run, predicted) in enumerate(zip(runs, predictions, strict=True)):
        for name, recorded in run.observations.items():
            measured = ~np.isnan(recorded)
            difference = (predicted[name] - recorded)[measured]
            largest = float(np.max(np.abs(recorded[measured]), initial=0.0))
            if not len(difference) or np.max(np.abs(difference)) <= TOLERANCE * largest:
                continue
            times = None if run.times is None else run.times[measured]
            lost = share * len(difference)
            series.append(series_of(state, number, name, difference, times, lost=lost))
    return series


def series_of(
    state: FitState,
    number: int,
    name: str,
    residual: np.ndarray,
    times: np.ndarray | None,
    *,
    lost: float,
) -> Series:
    """Residuals of a channel of a run, with what is known of their noise.

    Arguments:
        state: the last one.
        number: position of the run.
        name: of the channel.
        residual: predicted minus recorded, SI, shape (cell,).
        times: of the cells, s; None for a run without time.
        lost: degrees of freedom that fitted parameters took from them.
    """
    noise = state.noise
    return Series(
        run=state.setup.runs[number].name,
        channel=name,
        residual=residual,
        times=times,
        stated=noise.stated[number][name].noise,
        key=noise.keys[number][name],
        adopted=noise.values[number][name].deviation,
        lost=lost,
    )


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
