"""Which hysteresis model: by loops that it was not fitted to, and by AIC and BIC."""

import dataclasses
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ..fitting import FitResult, PredictionErrors, errors_of, fit, prediction_errors
from ..models import AbstractModel, HysteresisModel, as_stated, hysteresis_keys, model_for
from ..recordings import Definition, Run
from ..runtime.text import InputError
from ..schema import HysteresisSection
from ..schema.parameters import default_free


@dataclasses.dataclass(frozen=True)
class CandidateModel:
    """A model that may be chosen: what of `[hysteresis]` makes it, and what to free in it, too."""

    section: Mapping[str, Any]
    free: tuple[str, ...] = ()

    def applied_to(self, run: Run) -> Run:
        """A run with this model in its `[hysteresis]`, whose other keys stay."""
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
"""The models that may be chosen, by the names that `giajax choose` gives them."""


_LEAST = 8  # with fewer measured values than this a part of a run is no loop


def parted(run: Run, fraction: float) -> tuple[Run, Run]:
    """The run without its last measurements, to fit to, and with only those, to judge by.

    Both have the whole input, which a memory follows. An InputError where the fraction is none
    between 0 and 1, or leaves too few values to a part.
    """
    if not 0 < fraction < 1:
        raise InputError(f"the held-out fraction is {fraction:g}: give a value between 0 and 1")
    name, values = next(iter(run.observations.items()))
    measured = np.flatnonzero(~np.isnan(values))
    first = round(len(measured) * (1 - fraction))
    if first < _LEAST or len(measured) - first < _LEAST:
        raise InputError(
            f"'{run.name}' has {len(measured)} measured values, too few to hold out "
            f"{fraction:.0%} of them: give a longer run, or another run for validation"
        )
    early, late = values.copy(), values.copy()
    early[measured[first:]] = late[measured[:first]] = np.nan
    fitted, judged = (
        dataclasses.replace(run, values={**run.values, name: part}) for part in (early, late)
    )
    return fitted, judged


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
    without: Sequence[str] = (),
) -> list[Comparison]:
    """Errors of prediction, channel by channel.

    Arguments:
        model: what predicts.
        runs: what was recorded; each starts as its definition says.
        other: another model for the same runs.
        refit_initial: fit the initial state of each run first, for each model by itself.
        without: of what each run has another one, as of `giajax.predict`.

    Returns:
        One for each channel of each run, and of several runs for each channel of all together.
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
                # None, which only a file holds, was not finite.
                rmse=float("inf") if channel.rmse is None else channel.rmse,
                largest=float("inf") if channel.largest is None else channel.largest,
                reference_rmse=None if reference is None else reference.channels[name].rmse,
            )
            for name, channel in errors.channels.items()
        ]
    return comparisons if len(runs) == 1 else [*comparisons, *_pooled(comparisons)]


def _pooled(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """One comparison a channel for all runs together."""
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
    """Root mean square error of all values of several runs."""
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
    """One model and how well it does.

    Attributes:
        name: of `CANDIDATES`.
        parameters: number of fitted parameters.
        status: of the fit.
        rmse: root mean square error where it was fitted, in the unit of the run's output.
        held_out_rmse: where it was not.
        aic: Akaike's criterion, n log(RSS / n) + 2 (k + 1): the noise counts as a parameter.
        bic: Schwarz' criterion, n log(RSS / n) + (k + 1) log n.
        result: the fit.
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
        """Whether its fit converged: only then are its errors those of the model."""
        return self.status == "converged"


@dataclasses.dataclass(frozen=True)
class Choice:
    """All candidates and the unit of their errors.

    Those whose fit converged come first, the least error on the held-out loops at the top: the
    errors of the others are of a fit that ended early, and say little of the model.
    """

    candidates: tuple[Candidate, ...]
    unit: str

    @property
    def best(self) -> Candidate:
        """The first: converged, if any is, and with the least error on the held-out loops."""
        return self.candidates[0]


def choose_hysteresis(
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    fraction: float = 0.3,
    candidates: Sequence[str] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Choice:
    """Fit several hysteresis models and compare them on loops that none of them was fitted to.

    Arguments:
        runs: hysteresis runs to fit to.
        held_out: other runs to judge by. Without any, the last part of each run is held out: the
            model follows the whole input, and only its earlier output counts in the fit.
        fraction: the part that is held out where no run is given, between 0 and 1.
        candidates: names of `CANDIDATES`; all by default.
        progress: called with each name before it is fitted.

    Raises:
        InputError: an unknown name or none, a fraction that leaves too little, or other runs.
    """
    names = list(CANDIDATES) if candidates is None else list(candidates)
    unknown = [name for name in names if name not in CANDIDATES]
    if unknown or not names:
        which = f" '{unknown[0]}'" if unknown else ""
        raise InputError(f"unknown candidate{which}: choose from: {', '.join(CANDIDATES)}")
    if not runs or any(run.model != HysteresisModel.kind for run in (*runs, *held_out)):
        raise InputError(
            "only hysteresis models can be compared: give runs of the hysteresis model"
        )
    for run in (*runs, *held_out):
        run.require_observations()
    fitted, judged = runs, held_out
    if not held_out:
        fitted, judged = zip(*(parted(run, fraction) for run in runs), strict=True)
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
    """A sentence on the command that compares operators, where no run names one; else empty."""
    if any(
        run.model != HysteresisModel.kind
        or run.definition.section(HysteresisSection).operator is not None
        for run in runs
    ):
        return ""
    words = " ".join(f"--data {shlex.quote(path)}" for path in paths)
    return (
        "no sidecar states an operator in [hysteresis], so the default operator was fitted: to "
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
