"""What was held out of a fit, judged where the fit ended."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np

from ..noise import ChannelNoise
from ..runs import Parted, Run
from ..verdict import Foretold, Predictions, Reason, Series
from ._beginning import between
from ._configuration import Setup
from ._noise import Noise
from ._problem import predictions_by_run
from ._reestimate import TOLERANCE
from ._residual_cells import residual_cells, shared_and_own
from ._result import FitResult
from ._run_records import HeldChannel, HeldOut
from ._state import FitState
from ._transitions import begin, reweight, step

# Steps of what only the held cells know, such as where a held run starts: the test that follows is
# exact to first order, and a state that was guessed may be further off than that.
_STEPS = 10

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
    state = _where_it_ended(result, setup, parts)
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


def _where_it_ended(result: FitResult, setup: Setup, parts: Sequence[Parted]) -> FitState:
    """The state of a fit of the whole runs where that of the fitted parts ended, evaluated."""
    values = {
        p.path: between(result.parameters[p.path].value, p.declaration.lower, p.declaration.upper)
        for p in setup.parameters
    }
    own = {
        record.name: {path: one.value for path, one in record.parameters.items()}
        for record in result.runs
    }
    for path, groups in setup.groups.items():
        for names in ([setup.runs[i].name for i in members] for members in groups):
            known = [own[name][path] for name in names if path in own.get(name, {})]
            for name in names if known else ():
                own.setdefault(name, {})[path] = known[0]
    state = begin(dataclasses.replace(setup.started_at(values), own=own))
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
        responds |= np.any(cells.shared[~_held_cells(parts[number], name)] != 0, axis=0)
    alone[shared] = ~responds
    return alone


def _held_cells(part: Parted, name: str) -> np.ndarray:
    """Which of the measured cells of a channel are held out, shape (cell,)."""
    measured = ~np.isnan(part.whole.observations[name])
    if part.held is None or name not in part.held.observations:
        return np.zeros(int(np.sum(measured)), bool)
    return ~np.isnan(part.held.observations[name][measured])


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
        channels.append(Foretold(series, cells, _held_cells(parts[number], name)))
    test = Predictions(channels, _priors(state), robust=state.setup.loss != "linear")
    for each in channels:
        if np.any(each.held):
            at = each.cells.run, each.series.channel
            sizes[at] = test.of(*at).size
    return sizes, test.reason()


def _priors(state: FitState) -> np.ndarray:
    """X^T X of the rows of the priors, by the shared coordinates and, last, the residual."""
    common, _ = shared_and_own(state)
    count = len(state.problem.priors)
    rows = np.zeros((count, len(common) + 1))
    if count:
        at = [common.index(column) for column in state.problem.priors.columns]
        rows[:, at] = state.jacobian().blocks[-1]
        rows[:, -1] = np.asarray(state.inner.residual)[-count:]
    return np.asarray(rows.T @ rows)


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
