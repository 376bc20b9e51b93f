"""Held-out parts of runs, and a test of how well the fit predicts them.

`giajax.recordings.hold_out` defines which cells are held out: whole runs, whole channels, or the
last part of each recording by time. This module tests their prediction by the predictive-failure
test of Chow (Econometrica 28, 1960, p. 591), for any noise and priors. Let e be the residuals of
some cells, J their derivatives and V their covariance. To first order in the parameters, the lowest
chi-square that a fit of these cells can reach is

    C = min_d (e + J d)^T V^-1 (e + J d).

The excess of this chi-square for the fitted and held-out cells together, over the fitted cells
alone, has as many degrees of freedom as there are held-out cells, minus the parameters that only
these cells determine, such as the initial state of a held-out run. It compares the prediction
errors with both the noise and the uncertainty of the parameters, and does not depend on the weights
of the fit.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..models import model_for
from ..noise import (
    DIFFERENCES,
    OUTLIER,
    Cells,
    ChannelNoise,
    Reason,
    Series,
    alone_and_together,
    largest,
    orthonormal,
    robust_deviation,
    satterthwaite,
    tail,
)
from ..recordings import FitSettings, Run, SplitRun, fitted_parts, hold_out
from ..runtime.arrays import Bool, Float
from ..runtime.text import InputError
from ._configuration import Setup, WarmStart, between, set_up
from ._problem import predictions_by_run
from ._records import HeldChannel, HeldOut, recorded_noise
from ._result import FitResult, PredictedRun, errors_of
from ._steps import FitState, at_tolerance, begin, move, reweight, step
from ._uncertainty import TOLERANCE, prior_gram, residual_cells, series_of, shared_and_own
from ._weights import Noise

Groups = dict[str, list[list[str]]]

Sizes = dict[tuple[int, str], float | None]
"""Sizes of prediction errors, by the position of a run and the name of a channel."""


@dataclasses.dataclass(frozen=True)
class HoldOut:
    """Held-out parts of the runs of a fit.

    Attributes:
        parts: fitted and held-out parts of each run.
        whole: setup of a fit in which nothing is held out.
    """

    parts: tuple[SplitRun, ...]
    whole: Setup

    def judge(self, result: FitResult) -> FitResult:
        """Return a fit result with the prediction errors of the held-out data.

        If these errors exceed what the noise and the uncertainty of the parameters allow, the
        verdict has an additional reason.
        """
        state = state_at_end(result, self.whole, self.parts)
        if state.evaluated:
            predicted = predictions_by_run(state.problem, state.inner.aux, self.whole.runs)
            sizes, reason = _judged(state, self.parts)
        else:
            predicted, sizes = [{} for _ in self.parts], {}
            said = (
                "the held-out data cannot be predicted, because the model cannot be evaluated at "
                "the point where the fit ended"
            )
            reason = Reason("prediction", said, 0.0, math.inf)
        verdict = result.verdict
        # A fit that did not reach its optimum does not test the model.
        if reason is not None and "end" not in [other.code for other in verdict.reasons]:
            verdict = verdict.with_reason(reason)
        records, of_held, of_fitted = [], [], []
        # A loaded result has no predictions.
        fitted = iter(result.predictions or ({},) * len(self.parts))
        for number, (part, channels) in enumerate(zip(self.parts, predicted, strict=True)):
            known = {}
            if part.held is not None:
                names = list(part.held.observations)
                known = {name: channels[name] for name in names if name in channels}
                of_run = {name: sizes.get((number, name), math.inf) for name in names}
                found = errors_of(part.held, known).channels
                errors = {name: found[name].rmse if name in found else math.inf for name in names}
                records.append(_record(part.whole, part.held, errors, of_run))
                of_held.append(PredictedRun(part.held, known))
            if part.fitted is not None:
                of_fitted.append(PredictedRun(part.fitted, {**known, **next(fitted)}))
        return dataclasses.replace(
            result,
            held_out=tuple(records),
            verdict=verdict,
            predictions=tuple(of_fitted),
            held_predictions=tuple(of_held),
        )

    def unjudged(self, result: FitResult) -> FitResult:
        """Return the result with the held-out data, but without their prediction errors."""
        records = []
        for part in self.parts:
            if part.held is not None:
                unknown = dict.fromkeys(part.held.observations)
                records.append(_record(part.whole, part.held, unknown, unknown))
        return dataclasses.replace(result, held_out=tuple(records))


def set_up_with_hold_out(
    settings: FitSettings, runs: Sequence[Run], begin: WarmStart | None
) -> tuple[Setup, HoldOut]:
    """Return the setup of a fit with held-out data, and these data.

    The `config` of the setup specifies what is held out.

    Raises:
        InputError: as in `giajax.fit`, or `hold_out` selects nothing or everything.
    """
    parts = hold_out(runs, settings.hold_out)
    fitted = fitted_parts(parts)
    for model in dict.fromkeys(run.model for run in runs):
        if fitted and not any(run.model == model for run in fitted):
            raise InputError(
                f"every run of the {model} model is held out, so no fitted model can predict "
                "them: hold out only some of these runs"
            )
    if len(fitted) < len(parts):
        model_for(runs)  # refuses runs whose sidecars contradict each other
    of_fitted = settings.model_copy(update={"groups": _among(settings.groups, fitted, runs)})
    setup = set_up(model_for(fitted), fitted, of_fitted, begin=begin)
    free = [p.path for p in setup.parameters if p.path not in setup.groups]
    known = setup.settings.model_copy(update={"free": free, "groups": settings.groups})
    whole = set_up(setup.model, runs, known, begin=begin)
    config: dict[str, list[dict[str, Any]]] = {"runs": [], "hold_out": []}
    records = iter(setup.config["runs"])
    for part, record in zip(parts, whole.config["runs"], strict=True):
        first = part.held_from
        if part.fitted is not None:
            partly = {name: row for name, row in first.items() if name in part.fitted.observations}
            config["runs"].append({**next(records), **({"held_from": partly} if partly else {})})
        if part.held is not None:
            config["hold_out"].append({**record, "channels": list(first), "held_from": first})
    return dataclasses.replace(setup, config={**setup.config, **config}), HoldOut(parts, whole)


def _among(groups: Groups, runs: Sequence[Run], everything: Sequence[Run]) -> Groups:
    """Return the groups, restricted to the runs that are fitted."""

    def names_of(several: Sequence[Run]) -> set[str]:
        return {name for run in several for name in (run.name, run.recording)}

    gone = names_of(everything) - names_of(runs)
    return {
        path: [kept for names in sharing if (kept := [name for name in names if name not in gone])]
        for path, sharing in groups.items()
    }


def _record(
    whole: Run,
    held: Run,
    errors: Mapping[str, float | None],
    sizes: Mapping[str, float | None],
) -> HeldOut:
    """Return the record of the held-out data of a run."""
    channels = {
        name: HeldChannel(
            whole.channels[name].unit, errors[name], int(np.sum(~np.isnan(values))), sizes[name]
        )
        for name, values in held.observations.items()
    }
    path = None if whole.path is None else str(whole.path)
    return HeldOut(whole.name, path, whole.sha256, channels)


# Maximum number of steps for parameters that only the held-out cells determine, such as the initial
# state of a held-out run. The test is exact to first order, and a guessed state may be too far away
# for that.
_STEPS = 10


def state_at_end(result: FitResult, setup: Setup, parts: Sequence[SplitRun]) -> FitState:
    """Return the evaluated state of a fit of the whole runs at the end of a fit of their parts.

    Parameters to which no fitted cell responds are fitted to the held-out cells.
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


def _at_own_values(state: FitState, result: FitResult, parts: Sequence[SplitRun]) -> FitState:
    """Return the state with each fitted run at its own values, even if runs have the same name."""
    start = state.start.copy()
    records = iter(result.runs)
    known = [next(records).parameters if part.fitted is not None else {} for part in parts]
    for batch in state.problem.batches:
        for member, columns in zip(batch.members, batch.own_columns().tolist(), strict=True):
            for label, column in zip(batch.own_labels(), columns, strict=True):
                if label in known[member]:
                    start[column] = known[member][label].value
    return move(state, state.problem.bijector.inverse(start))


def _noise(result: FitResult, noise: Noise, parts: Sequence[SplitRun]) -> Noise:
    """Return the noise at the end of the fit.

    For channels that the fit did not include, it is specified or guessed.
    """
    by_key = noise.by_key()
    records = iter(result.runs)
    for part, keys in zip(parts, noise.keys, strict=True):
        for name, one in (next(records).channels if part.fitted else {}).items():
            by_key[keys[name]] = recorded_noise(part.whole.channels[name], one)
    return noise.with_values(by_key)


def _known_to_held(state: FitState, parts: Sequence[SplitRun]) -> np.ndarray:
    """Return which coordinates have no effect on any fitted cell, shape (parameter,)."""
    alone = np.ones(state.problem.size, bool)
    for batch in state.problem.batches:
        for member, columns in zip(batch.members, batch.columns(), strict=True):
            if parts[member].fitted is not None:
                alone[columns] = False
    shared, _ = shared_and_own(state)
    responds = np.zeros(len(shared), bool)
    for (number, name), cells in residual_cells(state).items():
        responds |= np.any(cells.shared[~held_cells(parts[number], name)] != 0, axis=0)
    alone[shared] = ~responds
    return alone


def held_cells(part: SplitRun, name: str) -> np.ndarray:
    """Return which measured cells of a channel are held out, shape (cell,)."""
    measured = ~np.isnan(part.whole.observations[name])
    if part.held is None or name not in part.held.observations:
        return np.zeros(int(np.sum(measured)), bool)
    return ~np.isnan(part.held.observations[name][measured])


def _judged(state: FitState, parts: Sequence[SplitRun]) -> tuple[Sizes, Reason | None]:
    """Return the relative prediction error of each channel of each run, and the reason, if any."""
    channels, sizes = [], Sizes()
    for (number, name), cells in residual_cells(state).items():
        whole = parts[number].whole
        largest = float(np.nanmax(np.abs(whole.observations[name])))
        stated = state.noise.stated[number][name].noise
        if stated is None and np.max(np.abs(cells.residual)) <= TOLERANCE * largest:
            # Residuals within the solver tolerance are not noise to compare with.
            sizes[number, name] = 0.0
            continue
        series = series_of(state, number, name, cells.residual, cells.times, lost=0.0)
        channels.append(PredictedChannel(series, cells, held_cells(parts[number], name)))
    test = PredictionTest(channels, prior_gram(state), robust=not state.setup.loss.is_linear)
    for each in channels:
        if np.any(each.held):
            at = each.cells.run, each.series.channel
            sizes[at] = test.of(*at).size
    return sizes, test.reason()


# The test: increase of the lowest chi-square that a fit can reach due to the held-out cells.


@dataclasses.dataclass(frozen=True)
class PredictedChannel:
    """Channel of a run whose cells may have been held out.

    Attributes:
        series: residuals of all its cells at the fitted values.
        cells: the same cells with their derivatives. Derivatives with respect to shared parameters
            are in the same columns for all runs.
        held: which cells were held out of the fit.
    """

    series: Series
    cells: Cells
    held: Bool[np.ndarray, " cell"]

    @property
    def noise(self) -> ChannelNoise:
        """Noise of the cells, independent of the model.

        It is the specified noise, including its specified correlation. Otherwise it is white noise,
        estimated from second differences. A correlation that was estimated from the residuals of
        the fit would include effects that the model omits, and would expect them in the held-out
        cells, too.
        """
        return self.series.stated or ChannelNoise(self.series.from_differences)

    @property
    def noise_degrees_of_freedom(self) -> float:
        """Degrees of freedom of the estimate of this noise, infinite if it is specified."""
        return np.inf if self.series.stated is not None else DIFFERENCES * len(self.series)

    def without_outliers(self) -> "PredictedChannel":
        """Return the channel without the cells that a robust loss would treat as outliers.

        If many held-out cells deviate, they are a failed prediction, not outliers.
        """
        size = np.abs(self.series.residual)
        usual = np.full(len(size), self.series.adopted)
        if np.any(self.held):
            many = robust_deviation(self.series.residual[self.held])
            usual[self.held] = max(self.series.adopted, many)
        kept = size <= OUTLIER * usual
        return PredictedChannel(self.series.where(kept), self.cells.where(kept), self.held[kept])


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Test of the prediction of the held-out cells of some channels.

    Attributes:
        statistic: increase of the chi-square due to these cells, each at the best parameters.
        degrees_of_freedom: number of degrees of freedom of the statistic.
        noise_degrees_of_freedom: degrees of freedom of the estimated noise.
    """

    statistic: float
    degrees_of_freedom: int
    noise_degrees_of_freedom: float

    @property
    def size(self) -> float | None:
        """Ratio of the errors to their expected size, or None without degrees of freedom."""
        if self.degrees_of_freedom <= 0:
            return None
        return float(np.sqrt(self.statistic / self.degrees_of_freedom))

    @property
    def p_value(self) -> float:
        """Probability of a larger statistic if the model is right."""
        if self.degrees_of_freedom <= 0:
            return 1.0
        count, of_noise = self.degrees_of_freedom, self.noise_degrees_of_freedom
        return tail(count, of_noise, self.statistic / count)


class PredictionTest:
    """Predictive-failure test of the cells that were held out of a fit.

    Arguments:
        channels: channels of all runs.
        priors: X^T X of the rows of the priors. The columns of X are the shared parameters and,
            last, the residual.
        robust: whether the loss of the fit is robust. Outliers are then omitted.
    """

    def __init__(
        self,
        channels: Sequence[PredictedChannel],
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
        """Return the test of the held-out cells of a channel of one run."""
        members = self._members[run]
        return self._of([i for i in members if self._channels[i].series.channel == channel])

    def reason(self) -> Reason | None:
        """Return the reason against the model: all held-out cells, or one channel of all runs."""
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
                    f"the prediction errors of the held-out data{where} are {found.size:.3g} "
                    "times those expected from noise and the uncertainty of the parameters"
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
            degrees_of_freedom=sum(counts) - (rank - rank_alone),
            noise_degrees_of_freedom=satterthwaite(
                counts, [each.noise_degrees_of_freedom for each in held]
            ),
        )

    def _least(self, positions: frozenset[int]) -> tuple[float, int]:
        """Return C of the fitted cells and the held-out cells of some channels, and its rank.

        Parameters of a single run are eliminated in that run first (Frisch, Waugh and Lovell), so
        that no matrix contains the parameters of all runs.
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


def _gram(each: PredictedChannel, kept: Bool[np.ndarray, " cell"]) -> np.ndarray:
    """Return X^T V^-1 X of some cells, with own columns, shared columns and the residual."""
    if not np.any(kept):
        width = each.cells.own.shape[1] + each.cells.shared.shape[1] + 1
        return np.zeros((width, width))
    return each.cells.where(kept).gram(each.noise)[0]


def _without(gram: np.ndarray, width: int) -> tuple[np.ndarray, int]:
    """Return a Gram matrix without the span of its first columns, and the rank of that span."""
    basis = orthonormal(gram[:width, :width])
    across = basis.T @ gram[:width, width:]
    return gram[width:, width:] - across.T @ across, basis.shape[1]
