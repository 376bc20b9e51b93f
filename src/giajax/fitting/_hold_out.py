"""A part of the runs that is held out of a fit, and how well the fit predicts it.

Which cells are held out is said in `giajax.recordings.hold_out`: whole runs, whole channels, or the
last part of each recording by time. How they are judged is said here, by the predictive-failure
test of Chow (Econometrica 28, 1960, p. 591), for any noise and priors. To first order in the
parameters, with e the residuals of some cells, J their derivatives and V their covariance, the
least chi-square that a fit of these cells can reach is

    C = min_d (e + J d)^T V^-1 (e + J d).

What the fitted and the held cells together have more of it than the fitted ones alone has the
degrees of freedom of the held cells, less those parameters that only these know, such as the
initial state of a run that was held out. That is the error of prediction against noise and the
uncertainty of the parameters in one, and it does not depend on the weights that the fit had.
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
from ..recordings import FitSettings, Run, SplitRun, hold_out
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
"""By the position of a run and the name of a channel."""


@dataclasses.dataclass(frozen=True)
class HoldOut:
    """What is held out of each run of a fit, and its setup, were nothing held out."""

    parts: tuple[SplitRun, ...]
    whole: Setup

    def judge(self, result: FitResult) -> FitResult:
        """The result of a fit of the fitted parts with how well it predicts what was held out.

        Where the held cells are further off than noise and the uncertainty of the parameters allow,
        its verdict has one more reason.
        """
        state = state_at_end(result, self.whole, self.parts)
        if state.evaluated:
            predicted = predictions_by_run(state.problem, state.inner.aux, self.whole.runs)
            sizes, reason = _judged(state, self.parts)
        else:
            predicted, sizes = [{} for _ in self.parts], {}
            said = "the held-out data cannot be predicted, because the model fails where the fit "
            reason = Reason("prediction", f"{said}ended", 0.0, math.inf)
        verdict = result.verdict
        # A fit that did not reach its optimum says nothing of the model.
        if reason is not None and "end" not in [other.code for other in verdict.reasons]:
            verdict = verdict.with_reason(reason)
        records, of_held, of_fitted = [], [], []
        # A result that was loaded has none.
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
        """The result with what was held out, where nothing is known of how it is predicted."""
        records = []
        for part in self.parts:
            if part.held is not None:
                unknown = dict.fromkeys(part.held.observations)
                records.append(_record(part.whole, part.held, unknown, unknown))
        return dataclasses.replace(result, held_out=tuple(records))


def set_up_with_hold_out(
    settings: FitSettings, runs: Sequence[Run], begin: WarmStart | None
) -> tuple[Setup, HoldOut]:
    """The setup of a fit that holds something out, whose `config` says what; and that.

    Raises:
        InputError: as `giajax.fit`, or a `hold_out` that names nothing, or everything.
    """
    parts = hold_out(runs, settings.hold_out)
    fitted = [part.fitted for part in parts if part.fitted is not None]
    for model in dict.fromkeys(run.model for run in runs):
        if fitted and not any(run.model == model for run in fitted):
            raise InputError(
                f"every run of the {model} model is held out, so no fitted model can predict "
                "them: hold out only some of them"
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
    """The groups without the runs that are not among these."""

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
    """What was held out of a run."""
    channels = {
        name: HeldChannel(
            whole.channels[name].unit, errors[name], int(np.sum(~np.isnan(values))), sizes[name]
        )
        for name, values in held.observations.items()
    }
    path = None if whole.path is None else str(whole.path)
    return HeldOut(whole.name, path, whole.sha256, channels)


# Steps of what only the held cells know, such as where a held run starts: the test that follows is
# exact to first order, and a state that was guessed may be further off than that.
_STEPS = 10


def state_at_end(result: FitResult, setup: Setup, parts: Sequence[SplitRun]) -> FitState:
    """The state of a fit of the whole runs where that of the fitted parts ended, evaluated.

    What no fitted cell responds to is where the held cells want it.
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
    """The state where each fitted run has its own values, also where others have its name."""
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
    """The noise that the fit ended with; of what it did not have, what is stated or guessed."""
    by_key = noise.by_key()
    records = iter(result.runs)
    for part, keys in zip(parts, noise.keys, strict=True):
        for name, one in (next(records).channels if part.fitted else {}).items():
            by_key[keys[name]] = recorded_noise(part.whole.channels[name], one)
    return noise.with_values(by_key)


def _known_to_held(state: FitState, parts: Sequence[SplitRun]) -> np.ndarray:
    """The coordinates that no fitted cell responds to, shape (parameter,)."""
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
    """Which of the measured cells of a channel are held out, shape (cell,)."""
    measured = ~np.isnan(part.whole.observations[name])
    if part.held is None or name not in part.held.observations:
        return np.zeros(int(np.sum(measured)), bool)
    return ~np.isnan(part.held.observations[name][measured])


def _judged(state: FitState, parts: Sequence[SplitRun]) -> tuple[Sizes, Reason | None]:
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
        channels.append(PredictedChannel(series, cells, held_cells(parts[number], name)))
    test = PredictionTest(channels, prior_gram(state), robust=not state.setup.loss.is_linear)
    for each in channels:
        if np.any(each.held):
            at = each.cells.run, each.series.channel
            sizes[at] = test.of(*at).size
    return sizes, test.reason()


# The test: what the held cells add to the least chi-square that a fit can reach.


@dataclasses.dataclass(frozen=True)
class PredictedChannel:
    """One channel of one run, of which cells may have been held out.

    Attributes:
        series: residuals of all of its cells, at the fitted values.
        cells: the same with their derivatives, those by what runs share in the same columns.
        held: which of them were held out of the fit.
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
    def noise_degrees_of_freedom(self) -> float:
        """Degrees of freedom that this noise is known with; infinite where it is stated."""
        return np.inf if self.series.stated is not None else DIFFERENCES * len(self.series)

    def without_outliers(self) -> "PredictedChannel":
        """The cells that no loss which lets outliers stand would leave alone.

        Held cells among which many are off are not outliers, but a prediction that fails.
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
    """How well the held cells of some channels are predicted.

    Attributes:
        statistic: chi-square that these cells have beyond what the fitted ones have, with the
            parameters where both together want them.
        noise_degrees_of_freedom: those of the noise that it is in units of.
    """

    statistic: float
    degrees_of_freedom: int
    noise_degrees_of_freedom: float

    @property
    def size(self) -> float | None:
        """How many times as far off the cells are as they may; None without any freedom."""
        if self.degrees_of_freedom <= 0:
            return None
        return float(np.sqrt(self.statistic / self.degrees_of_freedom))

    @property
    def p_value(self) -> float:
        """Chance of more where the model is right."""
        if self.degrees_of_freedom <= 0:
            return 1.0
        count, of_noise = self.degrees_of_freedom, self.noise_degrees_of_freedom
        return tail(count, of_noise, self.statistic / count)


class PredictionTest:
    """The cells of a fit and those that were held out of it.

    Arguments:
        channels: of all runs.
        priors: X^T X of the rows of the priors; X are the shared columns and, last, the residual.
        robust: whether the loss of the fit lets outliers stand; they are then left out.
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
        """That of the held cells of a channel of one run."""
        members = self._members[run]
        return self._of([i for i in members if self._channels[i].series.channel == channel])

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


def _gram(each: PredictedChannel, kept: Bool[np.ndarray, " cell"]) -> np.ndarray:
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
