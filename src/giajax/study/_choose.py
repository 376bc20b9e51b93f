"""Which hysteresis model: by loops that it was not fitted to, and by AIC and BIC."""

import dataclasses
import shlex
from collections.abc import Callable, Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, fit
from ..kinds import HysteresisSection
from ..models import HysteresisModel, model_for
from ..parameters import default_free
from ..runs import Run
from ._candidates import CANDIDATES
from ._held_out import parted


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

    Returns:
        The candidates in their order, the best one first.

    Raises:
        InputError: an unknown name or none, a fraction that leaves nothing to fit or to judge by,
            or no hysteresis run.
    """
    names = list(CANDIDATES) if candidates is None else list(candidates)
    if not names:
        raise InputError(f"there is no candidate: use some of: {', '.join(CANDIDATES)}")
    for name in names:
        if name not in CANDIDATES:
            raise InputError(
                f"there is no candidate '{name}': use some of: {', '.join(CANDIDATES)}"
            )
    if not runs or any(run.model != HysteresisModel.kind for run in (*runs, *held_out)):
        raise InputError("a choice is between models of hysteresis: give runs of hysteresis")
    for run in (*runs, *held_out):
        run.require_observations()
    if held_out:
        fitted, judged = list(runs), list(held_out)
    else:
        parts = [parted(run, fraction) for run in runs]
        fitted, judged = [a for a, _ in parts], [b for _, b in parts]
    tried = []
    for name in names:
        if progress is not None:
            progress(name)
        tried.append(_candidate(name, fitted, judged))
    channel = runs[0].channels[next(iter(runs[0].observations))]
    return Choice(tuple(sorted(tried, key=_rank)), channel.unit)


def choice_hint(runs: Sequence[Run], paths: Sequence[str]) -> str:
    """A sentence on the other operators, where no run names one; else empty.

    Arguments:
        runs: the runs that were fitted.
        paths: of their files.

    Returns:
        The sentence, with the command that compares the operators.
    """
    if any(
        run.model != HysteresisModel.kind
        or run.definition.section(HysteresisSection).operator is not None
        for run in runs
    ):
        return ""
    words = " ".join(f"--data {shlex.quote(path)}" for path in paths)
    return (
        "no sidecar states an operator in [hysteresis], so the default was fitted: to compare "
        f"it with the others, run giajax choose {words}"
    )


def _rank(candidate: Candidate) -> tuple[bool, float]:
    error = candidate.held_out_rmse
    return not candidate.converged, error if np.isfinite(error) else np.inf


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
    return Candidate(
        name=name,
        parameters=size,
        status=result.status,
        rmse=float(channel.from_si(_rms(residuals))),
        held_out_rmse=float(channel.from_si(_rms(_residuals(result, judged)))),
        aic=float(spread + 2 * (size + 1)),
        bic=float(spread + np.log(count) * (size + 1)),
        result=result,
    )


def _residuals(result: FitResult, runs: Sequence[Run]) -> np.ndarray:
    parts = []
    for run in runs:
        predicted = result.predict(run)
        parts += [values - predicted[name] for name, values in run.observations.items()]
    together = np.concatenate(parts)
    return together[~np.isnan(together)]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
