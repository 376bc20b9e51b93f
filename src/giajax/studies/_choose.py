"""Choice of a hysteresis model by the error on held-out loops, and by AIC and BIC."""

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..fitting import FitResult, PredictionErrors, errors_of, fit, prediction_errors
from ..models import AbstractModel, HysteresisModel, as_stated, hysteresis_keys, model_for
from ..recordings import Definition, Run, fitted_parts, held_parts, hold_out as split
from ..runtime.text import InputError
from ..schema import HysteresisSection
from ..schema.parameters import default_free


@dataclasses.dataclass(frozen=True)
class CandidateModel:
    """Hysteresis model that can be chosen: its `[hysteresis]` keys and further free parameters."""

    section: Mapping[str, Any]
    free: tuple[str, ...] = ()

    def applied_to(self, run: Run) -> Run:
        """Return a run whose `[hysteresis]` section specifies this model and keeps other keys."""
        sections, known = run.definition.contents(), hysteresis_keys(self.section["operator"])
        kept = {
            key: value
            for key, value in sections.get("hysteresis", {}).items()
            if key in known and key not in ("operator", "elements") and key not in self.section
        }
        sections["hysteresis"] = {**kept, **self.section}
        return dataclasses.replace(run, definition=Definition.parse(sections, run.name))


CANDIDATES: dict[str, CandidateModel] = {
    "play": CandidateModel({"operator": "prandtl_ishlinskii", "thresholds": 1}, ("thresholds",)),
    "stop": CandidateModel(
        {"operator": "prandtl_ishlinskii", "thresholds": 1, "elements": "stop"}, ("thresholds",)
    ),
    "prandtl_ishlinskii": CandidateModel({"operator": "prandtl_ishlinskii"}),
    "prandtl_ishlinskii_stop": CandidateModel(
        {"operator": "prandtl_ishlinskii", "elements": "stop"}
    ),
    "modified_prandtl_ishlinskii": CandidateModel({"operator": "modified_prandtl_ishlinskii"}),
    "preisach": CandidateModel({"operator": "preisach"}, ("bias",)),
    "bouc_wen": CandidateModel({"operator": "bouc_wen"}),
}
"""The candidate models, by their names in `giajax choose`."""


# A part of a run with fewer measured values than this is not a loop.
_LEAST = 8


def check_loops(runs: Sequence[Run]) -> None:
    """Raise an error if a run, or what is held out of it, has too few values."""
    for run in runs:
        count = max(np.sum(~np.isnan(values)) for values in run.observations.values())
        if count < _LEAST:
            raise InputError(
                f"'{run.name}' has a part of {count} measured values to fit or to validate on, but "
                f"at least {_LEAST} are required: hold out another part, or give a longer run"
            )


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Prediction errors of one channel, in the unit of the recording.

    Attributes:
        run: name of the run; "all N" for N runs together.
        channel: name of the channel, without the unit.
        unit: unit of the recording.
        n: number of measured values.
        rmse: root mean square error of the model.
        largest: largest absolute error of the model.
        reference_rmse: root mean square error of the other model; None without one.
        pooled: whether the comparison combines several runs.
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
        """Error of the model divided by the error of the other model; None without one."""
        if self.reference_rmse is None:
            return None
        return self.rmse / self.reference_rmse if self.reference_rmse else float("nan")


def compare(
    model: AbstractModel,
    runs: Sequence[Run],
    other: AbstractModel | None = None,
    *,
    refit_initial: bool = False,
    without: Sequence[str] = (),
) -> list[Comparison]:
    """Return the prediction errors of a model for each channel.

    Arguments:
        model: the model to be tested.
        runs: recorded runs; each starts from the initial state in its definition.
        other: another model for the same runs.
        refit_initial: fit the initial state of each run first, separately for each model.
        without: names of the parts of the model that are taken from the sidecar of each run
            instead, as for `giajax.predict`.

    Returns:
        One comparison for each channel of each run. For several runs, one comparison of all runs
        together for each channel is appended.
    """
    comparisons = []
    for run in runs:
        errors = _errors(as_stated(model, run, without), run, refit_initial)
        reference = (
            None if other is None else _errors(as_stated(other, run, without), run, refit_initial)
        )
        comparisons += [
            Comparison(
                run=run.name,
                channel=name,
                unit=channel.unit,
                n=channel.n,
                # A value that was not finite is stored as None in files.
                rmse=float("inf") if channel.rmse is None else channel.rmse,
                largest=float("inf") if channel.largest is None else channel.largest,
                reference_rmse=None if reference is None else reference.channels[name].rmse,
            )
            for name, channel in errors.channels.items()
        ]
    return comparisons if len(runs) == 1 else [*comparisons, *_pooled(comparisons)]


def _pooled(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Combine the comparisons of all runs to one comparison per channel."""
    pooled = []
    for channel, unit in dict.fromkeys((one.channel, one.unit) for one in comparisons):
        those = [one for one in comparisons if (one.channel, one.unit) == (channel, unit)]
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
    """Return the root mean square error over all values of several runs."""
    weights = np.asarray(counts) / np.sum(counts)
    return float(np.sqrt(np.sum(weights * np.asarray(errors) ** 2)))


def _errors(model: AbstractModel, run: Run, refit: bool) -> PredictionErrors:
    if not refit:
        return prediction_errors(model, run)
    free = Definition.parse({"initial": {"free": True}})
    run = dataclasses.replace(run, definition=run.definition.merged_with(free))
    (predicted,) = fit(model, run, free=[], nuisances=False, check=False).predictions
    return errors_of(run, predicted)


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One hysteresis model and its errors.

    Attributes:
        name: name in `CANDIDATES`.
        parameters: number of fitted parameters.
        status: status of the fit.
        rmse: root mean square error on the fitted data, in the unit of the run's output.
        held_out_rmse: root mean square error on the held-out data, in the same unit.
        aic: Akaike's information criterion, n log(RSS / n) + 2 (k + 1): the noise counts as a
            parameter.
        bic: Schwarz's (Bayesian) information criterion, n log(RSS / n) + (k + 1) log n.
        result: result of the fit.
    """

    name: str
    parameters: int
    status: str
    rmse: float
    held_out_rmse: float
    aic: float
    bic: float
    result: FitResult

    @property
    def converged(self) -> bool:
        """Whether the fit converged. Only then do the errors characterise the model."""
        return self.status == "converged"


@dataclasses.dataclass(frozen=True)
class Choice:
    """All candidates, and the unit of their errors.

    Candidates whose fit converged come first, in order of their error on the held-out loops. The
    errors of a fit that ended early do not characterise the model.
    """

    candidates: tuple[Candidate, ...]
    unit: str

    @property
    def best(self) -> Candidate:
        """The first candidate: if any converged, the one with the smallest held-out error."""
        return self.candidates[0]


def choose_hysteresis(
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    hold_out: Sequence[str] = (),
    candidates: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Choice:
    """Fit several hysteresis models and compare their errors on held-out loops.

    Arguments:
        runs: hysteresis runs to be fitted.
        held_out: further runs for validation.
        hold_out: what is held out of the runs, as in `giajax.recordings.hold_out`: the model
            receives the whole input, but only the remaining output is fitted. If neither this nor
            further runs are given, it is the last 30 % of each run.
        candidates: names in `CANDIDATES`; defaults to all.
        progress: function that is called with each name before the model is fitted.

    Raises:
        InputError: a name is unknown; no name is given; what is held out does not exist, or is
            all; a part has too few values; or a run is not a hysteresis run.
    """
    names = list(CANDIDATES) if candidates is None else list(candidates)
    unknown = [name for name in names if name not in CANDIDATES]
    if unknown or not names:
        which = f" '{unknown[0]}'" if unknown else ""
        raise InputError(f"unknown candidate{which}: choose from {', '.join(CANDIDATES)}")
    if not runs or any(run.model != HysteresisModel.kind for run in (*runs, *held_out)):
        raise InputError(
            "only hysteresis models can be compared: give runs of the hysteresis model"
        )
    for run in (*runs, *held_out):
        run.require_observations()
    parts = split(runs, hold_out if hold_out or held_out else ["last:0.3"])
    fitted, judged = fitted_parts(parts), [*held_out, *held_parts(parts)]
    check_loops([*fitted, *judged])
    tried = []
    for name in names:
        if progress is not None:
            progress(name)
        tried.append(_candidate(name, fitted, judged))
    channel = runs[0].channels[next(iter(runs[0].observations))]

    def rank(candidate: Candidate) -> tuple[bool, float]:
        error = candidate.held_out_rmse
        return not candidate.converged, error if np.isfinite(error) else np.inf

    return Choice(tuple(sorted(tried, key=rank)), channel.unit)


def choice_hint(runs: Sequence[Run], paths: Sequence[str]) -> str:
    """Return a sentence that suggests `giajax choose` if no run specifies an operator, else ""."""
    if any(
        run.model != HysteresisModel.kind
        or run.definition.section(HysteresisSection).operator is not None
        for run in runs
    ):
        return ""
    words = " ".join(f"--data {shlex.quote(path)}" for path in paths)
    return (
        "no sidecar specifies an operator in [hysteresis], so the default one was fitted: to "
        f"compare it with the other operators, run giajax choose {words}"
    )


def _candidate(name: str, fitted: Sequence[Run], judged: Sequence[Run]) -> Candidate:
    candidate = CANDIDATES[name]
    fitted = [candidate.applied_to(run) for run in fitted]
    model = model_for(fitted)
    free = [*default_free(model), *candidate.free]
    result = fit(model, fitted, free=free, check=False, max_iterations=100)
    residuals = _residuals(result, fitted)
    count, size = len(residuals), len(result.free)
    spread = count * np.log(np.mean(residuals**2))
    channel = fitted[0].channels[next(iter(fitted[0].observations))]

    def rms(values: np.ndarray) -> float:
        return float(channel.from_si(float(np.sqrt(np.mean(values**2)))))

    return Candidate(
        name=name,
        parameters=size,
        status=result.status,
        rmse=rms(residuals),
        held_out_rmse=rms(_residuals(result, judged)),
        aic=float(spread + 2 * (size + 1)),
        bic=float(spread + np.log(count) * (size + 1)),
        result=result,
    )


def _residuals(result: FitResult, runs: Sequence[Run]) -> np.ndarray:
    pairs = [(run.observations, result.predict(run)) for run in runs]
    parts = [recorded[n] - predicted[n] for recorded, predicted in pairs for n in recorded]
    together = np.concatenate(parts)
    return together[~np.isnan(together)]
