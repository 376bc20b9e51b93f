"""The verdict on a fit: its residuals as they are, whatever they were weighted with."""

import numpy as np

from ..verdict import Reason, Series, Verdict, judge
from ._problem import predictions_by_run
from ._records import Status
from ._reestimate import TOLERANCE
from ._state import FitState


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
