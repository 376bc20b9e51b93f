"""Fits with poor initial guesses: they begin with the first rows and with suitable coordinates.

If a motion is predicted with a wrong rate, it is out of phase after some time, and the linear model
of the cost is then useless. The first rows give a useful direction, and the resulting parameters
extend the range of rows that give one. A parameter whose initial value is small compared with the
change that the data would notice has a coordinate that bends every valley once the parameter has
grown. Its coordinate is therefore linear up to the change that the data notice.
"""

import dataclasses
import math

import numpy as np

from ..recordings import Run
from ._problem import with_recorded
from ._steps import FitState, counting, in_coordinates, move, step

# A record oscillates if it alternates at least `_SWINGS` times between values above and below its
# mean by this fraction of its standard deviation, and if each half-swing lasts at least `_EACH`
# rows on average, which excludes noise. For other records, the linear model of the cost is valid at
# a greater distance.
_SWINGS, _BEYOND, _EACH = 6, 0.5, 8

# The model follows the rows up to which the sum of its squared residuals is at most this fraction
# of the sum for constants. It follows them closely if the second fraction holds. A fit whose model
# follows all rows begins with all of them.
_FOLLOWS, _CLOSELY = 0.25, 0.01

# The first part has at least `_ROWS` rows for each free value. The next part is longer by at least
# the factor `_FURTHER` if the model already follows that many rows. It is longer by at least the
# factor `_TWICE` at an optimum, or if the model follows the rows closely. A fraction above `_WHOLE`
# is replaced by all rows.
_ROWS, _FURTHER, _TWICE, _WHOLE = 3, 1.5, 2.0, 0.7

_LEFT = 0.5  # while a larger fraction of the cost can still be gained, no row is added

_SMALL = 10.0  # ratio by which a small initial value is below the change that the data notice


def sized_by_data(state: FitState) -> FitState:
    """Return the start in coordinates that are linear up to the change that the data notice.

    This change is the one by which a parameter alone would have to move to explain all residuals.
    It is limited to the size of the parameter, which is the larger of its initial value and its
    default.
    """
    bijector, first = state.problem.bijector, np.arange(state.problem.size)
    for places in state.problem.positions:
        first[list(places)] = places[0]
    size = float(np.linalg.norm(np.asarray(state.inner.residual)))
    noticed = size / np.maximum(state.natural_jacobian.norms(), 1e-300)
    noticed = np.minimum(noticed, state.sizes)[first]
    small = noticed > _SMALL * bijector.distances()
    small = small & np.asarray(state.active)[first] & np.isfinite(np.asarray(bijector.lower))
    if not np.any(small):
        return state
    distances = np.where(small, noticed, bijector.distances())
    there = step(in_coordinates(state, bijector.linear_within(distances)))
    return dataclasses.replace(there, done=False, converged=False) if there.evaluated else state


def at_first_rows(state: FitState) -> FitState:
    """Return the start for a single free oscillation, with only the rows that the model follows.

    All rows are used if the model follows most of them.
    """
    runs, batches = state.setup.runs, state.problem.batches
    if len(runs) > 1 or runs[0].times is None or not _is_free(runs[0]):
        return state
    settled = state.setup.settings.optimiser is None and state.setup.loss.is_linear
    if not (settled and state.noise.is_white):
        return state
    if all(np.sum(model) <= _FOLLOWS * np.sum(constant) for model, constant in _squares(state)):
        return state
    if not any(_swings(row) for row in runs[0].observations.values()):
        return state
    part = max(_followed(state), _ROWS * state.problem.size / batches[0].observed.shape[1])
    if part > _WHOLE:
        return state
    there = _counting(state, part)
    return there if there.evaluated else state


def _is_free(run: Run) -> bool:
    """Return whether a run has no varying input.

    A driven motion gets less out of phase, and begins at rest.
    """
    others = (values for name, values in run.values.items() if run.part_of(name) != "measured")
    return not any(np.ptp(values) > 0 for values in others)


def with_next_rows(tried: FitState, stopped: bool) -> FitState:
    """Return the state after a trial step with some rows: the same, with more, or with all rows.

    Rows are added if the model follows them. If no step is found, all rows are used, as if the fit
    had begun with them.
    """
    reach, part = _followed(tried), tried.part
    closely = bool(tried.inner.accepted) and _is_close(tried)
    if tried.converged or (closely and reach >= part):
        return _counting(tried, max(reach, _TWICE * part))
    if tried.done or stopped:
        return _counting(tried, 1.0)
    left = tried.predicted_decrease() > _LEFT * tried.cost
    if not bool(tried.inner.accepted) or left or reach <= _FURTHER * part:
        return tried
    return _counting(tried, reach)


def with_all_rows(state: FitState) -> FitState:
    """Return the same point, evaluated with all rows."""
    return state if state.part == 1 else step(counting(state, 1.0))


def _counting(state: FitState, part: float) -> FitState:
    """Return the same point with some rows.

    If all rows are used, the point is replaced by the start if the start describes them better.
    """
    there = step(counting(state, part if part <= _WHOLE else 1.0))
    known = state.history[0].cost if state.history else np.inf
    if state.history and not (there.evaluated and (there.part < 1 or there.cost <= known)):
        there = counting(there, 1.0)
        there = step(move(there, there.problem.bijector.inverse(there.start)))
    return dataclasses.replace(there, done=False, converged=False)


def _squares(state: FitState) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the squared weighted residuals of each row, for the model and constants, by batch."""
    found = []
    runs = state.setup.runs
    recorded = [run.observations for run in runs]
    whole = with_recorded(state.problem.batches, runs, state.noise, recorded)
    for batch, predicted in zip(whole, state.inner.aux.channels, strict=True):
        squares, observed = np.asarray(batch.weight) ** 2, np.asarray(batch.observed)
        mean = np.sum(squares * observed, axis=1) / np.maximum(np.sum(squares, axis=1), 1e-300)
        model = squares * (np.asarray(predicted) - observed) ** 2
        constant = squares * (observed - mean[:, None]) ** 2
        found.append((np.sum(model, axis=(0, 2)), np.sum(constant, axis=(0, 2))))
    return found


def _is_close(state: FitState) -> bool:
    """Return whether the current rows are described so well that further rows tell more."""
    for model, constant in _squares(state):
        rows = math.ceil(state.part * len(model))
        if not np.sum(model[:rows]) <= _CLOSELY * np.sum(constant[:rows]):
            return False
    return True


def _swings(values: np.ndarray) -> bool:
    """Return whether a recorded channel oscillates."""
    known = values[np.isfinite(values)]
    off = known - np.mean(known) if len(known) else known
    sides = np.sign(off[np.abs(off) > _BEYOND * np.std(off)]) if len(off) else off
    return bool(_SWINGS <= np.count_nonzero(np.diff(sides)) <= len(known) / _EACH)


def _followed(state: FitState) -> float:
    """Return the fraction of the rows, counted from the first, that the model follows."""
    parts = []
    for model, constant in _squares(state):
        with np.errstate(invalid="ignore"):
            lost = ~(np.cumsum(model) <= _FOLLOWS * np.cumsum(constant))
        parts.append(float(np.argmax(lost)) / len(lost) if np.any(lost) else 1.0)
    return min(parts)
