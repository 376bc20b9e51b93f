"""What a fit left over: cell by cell, the noise that it shows, and the verdict on the fit."""

import dataclasses
from collections import Counter
from collections.abc import Sequence

import numpy as np

from ..noise import (
    Cells,
    Reason,
    Restricted,
    Series,
    Verdict,
    estimate,
    judge,
    outlier_weights,
    robust_deviation,
)
from ..recordings import Run
from ._losses import AbstractLoss, untransformed
from ._problem import predictions_by_run
from ._records import Status
from ._steps import FitState
from ._weights import Noise


def residual_cells(state: FitState, *, together: bool = False) -> dict[tuple[int, str], Cells]:
    """The residuals of a state and their derivatives in SI, by number of the run and channel.

    Without weights and not whitened. Coordinates that are held have no columns; those that one run
    alone responds to are its own. `together`, every coordinate is a shared column, held ones too.
    """
    jacobian, active = state.jacobian, np.asarray(state.active)
    if together:
        common, mine = list(range(state.problem.size)), set[int]()
    else:
        common, mine = shared_and_own(state)
    cells = {}
    at_block = iter(zip(jacobian.blocks, jacobian.columns, strict=True))
    for batch, tables in zip(state.problem.batches, state.inner.aux.channels, strict=True):
        for row, member in enumerate(batch.members):
            block, columns = next(at_block)
            weight = np.asarray(batch.weight, dtype=float)[row]
            predicted = np.asarray(tables, dtype=float)[row]
            difference = predicted - np.asarray(batch.observed)[row]
            if batch.whitening is not None:
                block = batch.whitening.of_run(row).undone(block)
            slope = state.problem.loss.scores((difference * weight).ravel()).slope
            block = untransformed(block, (slope * weight.ravel())[:, None])
            block = block.reshape(*weight.shape, -1)
            where = {int(column): position for position, column in enumerate(columns)}
            own = [where[c] for c in sorted(mine & set(where)) if active[c]]
            shared = [where.get(c, -1) for c in common]
            run = state.setup.runs[member]
            for at, name in enumerate(batch.channels):
                measured = weight[:, at] > 0
                # A last column of zeros stands for what the run does not respond to.
                columns_at = np.pad(block[measured, at], ((0, 0), (0, 1)))
                cells[member, name] = Cells(
                    key=state.noise.keys[member][name],
                    run=member,
                    times=None if run.times is None else run.times[measured[: len(run.times)]],
                    weights=np.ones(len(columns_at)),
                    residual=difference[measured, at],
                    shared=columns_at[:, shared],
                    own=columns_at[:, own],
                )
    return cells


def prior_gram(state: FitState) -> np.ndarray:
    """X^T X of the rows of priors, by the shared columns of `residual_cells` and the residual."""
    common, _ = shared_and_own(state)
    count, columns = len(state.problem.priors.columns), state.problem.priors.columns
    rows = np.zeros((count, len(common) + 1))
    if count:
        slopes = np.diag(state.jacobian.blocks[-1])
        residual = np.asarray(state.inner.residual)[-count:]
        for row, column, slope, value in zip(rows, columns, slopes, residual, strict=True):
            # What is held stays as far off whatever the others do.
            if column in common:
                row[common.index(column)], row[-1] = slope, value
    return np.asarray(rows.T @ rows)


def shared_and_own(state: FitState) -> tuple[list[int], set[int]]:
    """Positions of the coordinates that move: shared ones; of single runs, without a prior."""
    active = np.asarray(state.active)
    count = Counter(int(c) for columns in state.jacobian.columns for c in columns)
    several = len(state.setup.runs) > 1
    mine = {column for column, uses in count.items() if several and uses == 1}
    return [c for c in range(state.problem.size) if active[c] and c not in mine], mine


# The noise that the residuals of a fit show, where no sidecar states it.

# Residuals below this part of the largest recorded value are what a solver's tolerance leaves.
TOLERANCE = 1e-5

_SETTLED = 0.1  # twice the gain in log-likelihood below which another noise is the same one

# Change of a robust deviation, in its logarithm, and mean change of weights, likewise.
_SAME_DEVIATION = 0.05
_SAME_WEIGHT = 0.01


def reestimate(state: FitState) -> Noise:
    """The noise to fit with next: the same where no channel changes by what a fit would notice."""
    noise = state.noise
    if noise.complete and not noise.correlated:
        return noise
    cells = residual_cells(state)
    perfect, robust = _perfect(cells, state.setup.runs), not state.setup.loss.is_linear
    if perfect and (noise.estimated or robust):
        # What rounding leaves has no size to be estimated again.
        return dataclasses.replace(noise, estimated=not noise.complete)
    if robust:
        return _among_outliers(noise, cells, state.setup.runs, state.setup.loss)
    # Without the priors: one that is wrong would pass for noise that is correlated for long.
    before = Restricted.of(list(cells.values()), noise.by_key())
    after = estimate(before, noise.stated_by_key(), correlated=noise.correlated and not perfect)
    if _gain(before, after) < _SETTLED:
        return dataclasses.replace(noise, estimated=not noise.complete)
    return noise.with_values(after.noise)


def _perfect(cells: dict[tuple[int, str], Cells], runs: Sequence[Run]) -> bool:
    """Whether nothing is left but what the tolerance of a solver leaves."""
    return all(
        np.max(np.abs(each.residual), initial=0.0)
        <= TOLERANCE * np.nanmax(np.abs(runs[run].observations[name]))
        for (run, name), each in cells.items()
    )


def _gain(before: Restricted, after: Restricted) -> float:
    key = next(iter(before.noise))
    return before.value(key, before.noise[key]) - after.value(key, after.noise[key])


def _among_outliers(
    noise: Noise, cells: dict[tuple[int, str], Cells], runs: Sequence[Run], loss: AbstractLoss
) -> Noise:
    """The noise by robust statistics; correlated, each cell gets a weight of its own."""
    stated, old = noise.stated_by_key(), noise.by_key()
    sizes = {
        key: each.times(robust_deviation(np.concatenate(residuals)) / each.deviation)
        if each.is_white and stated[key].deviation is None
        else each
        for key, each in old.items()
        for residuals in [[c.residual for c in cells.values() if c.key == key]]
    }
    if noise.correlated:
        weights = {
            at: outlier_weights(each, sizes[each.key], loss.weights) for at, each in cells.items()
        }
        # An outlier is no noise: it has no part in its size, only little in the fit.
        least = loss.outlier_weight
        inliers = [each.where(weights[at] > least) for at, each in cells.items()]
        before = Restricted.of(inliers, sizes)
        after = estimate(before, stated, correlated=True)
        if not all(each.is_white for each in after.noise.values()):
            return _weighted(noise, weights, runs, _gain(before, after), after)
    change = max(abs(np.log(sizes[key].deviation / old[key].deviation)) for key in old)
    if change < _SAME_DEVIATION:
        return dataclasses.replace(noise, estimated=not noise.complete)
    return noise.with_values(sizes)


def _weighted(
    noise: Noise,
    weights: dict[tuple[int, str], np.ndarray],
    runs: Sequence[Run],
    gain: float,
    after: Restricted,
) -> Noise:
    """Correlated noise, and with the weight of each cell at its sample."""
    placed: list[dict[str, np.ndarray]] = [{} for _ in noise.keys]
    changes = []
    for (run, name), of_cells in weights.items():
        measured = ~np.isnan(runs[run].observations[name])
        placed[run][name] = np.ones(len(measured))
        placed[run][name][measured] = of_cells
        before = np.ones(1) if noise.weights is None else noise.weights[run][name][measured]
        changes.append(np.mean(np.abs(of_cells - before)))
    if noise.weights is not None and gain < _SETTLED and max(changes) < _SAME_WEIGHT:
        return noise
    return noise.with_values(after.noise, tuple(placed))


def verdict(state: FitState, status: Status, prior_degrees_of_freedom: float) -> Verdict:
    """Whether the model describes the data, at the end of a fit, if it ever reached an optimum."""
    ended = {"not_converged": "did not converge", "interrupted": "was interrupted"}.get(status, "")
    early = Verdict("not evaluated", (Reason("end", f"the fit {ended}", 1.0, 1.0),))
    # Where the noise was estimated anew, an optimum was reached with the noise before.
    anew = status == "not_converged" and state.rounds_left < FitState.rounds_left
    if ended and not anew:
        return early
    series = residual_series(state, prior_degrees_of_freedom)
    if not series:
        return Verdict("adequate")
    found = judge(series, robust=not state.setup.loss.is_linear)
    return early if ended and found.status != "inadequate" else found


def residual_series(state: FitState, prior_degrees_of_freedom: float) -> list[Series]:
    """The residuals of each channel of each run; those of a perfect description are left out."""
    runs = state.setup.runs
    predictions = predictions_by_run(state.problem, state.inner.aux, runs)
    cells = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    lost = float(np.sum(np.asarray(state.active))) - prior_degrees_of_freedom
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
    """Residuals (SI) of a channel of a run, `lost` degrees of freedom less, and known noise."""
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
