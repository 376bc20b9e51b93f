"""Where a fit that starts far off begins: at the first rows, in coordinates that the data size.

A motion that is predicted with a wrong rate is out of step after a while, and there the linear
model of the cost leads anywhere. Its first rows lead the right way, and from where they lead the
next ones do. And a parameter whose start is small beside what the data would notice has a
coordinate that bends every valley as soon as it has grown: it is linear as far as they notice.
"""

import dataclasses
import math

import numpy as np

from ..recordings import Run
from ._problem import with_recorded
from ._steps import FitState, counting, in_coordinates, move, step

# A record swings that is so often now above its mean and now below it, by this part of its standard
# deviation, and each time for so many rows, which noise is not. Of others the linear model of the
# cost holds from farther off.
_SWINGS, _BEYOND, _EACH = 6, 0.5, 8

# Rows are followed as long as their squared residuals add up to no more than this part of those of
# constants, closely by the second; a fit that follows all of them begins with all of them.
_FOLLOWS, _CLOSELY = 0.25, 0.01

# A first part has so many rows for each free value. The next one is longer by the first factor
# where the fit follows it already; by the second at an optimum, or where it follows these rows
# closely. What is nearly the whole is the whole.
_ROWS, _FURTHER, _TWICE, _WHOLE = 3, 1.5, 2.0, 0.7

_LEFT = 0.5  # part of the cost that is still promised: before it is gained no row is added

_SMALL = 10.0  # by this factor a start is smaller than what the data notice


def sized_by_data(state: FitState) -> FitState:
    """The start in coordinates that are linear as far as the data do not notice the parameter.

    That is by how much it alone would have to move to explain all residuals, and no more than its
    size, of which the start or the default is the larger.
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
    """The start of one free motion that swings: as many rows as the model follows, if not most."""
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
    """Whether nothing drives a run: what is driven gets less out of step, and begins at rest."""
    others = (values for name, values in run.values.items() if run.part_of(name) != "measured")
    return not any(np.ptp(values) > 0 for values in others)


def with_next_rows(tried: FitState, stopped: bool) -> FitState:
    """After a trial step by some rows: the same, with more where it follows these, or with all.

    All count where no step is found, as if the fit had begun with them.
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
    """The same point, evaluated with all rows."""
    return state if state.part == 1 else step(counting(state, 1.0))


def _counting(state: FitState, part: float) -> FitState:
    """The same point with some rows; with all rows the start, where that describes them better."""
    there = step(counting(state, part if part <= _WHOLE else 1.0))
    known = state.history[0].cost if state.history else np.inf
    if state.history and not (there.evaluated and (there.part < 1 or there.cost <= known)):
        there = counting(there, 1.0)
        there = step(move(there, there.problem.bijector.inverse(there.start)))
    return dataclasses.replace(there, done=False, converged=False)


def _squares(state: FitState) -> list[tuple[np.ndarray, np.ndarray]]:
    """By batch, squared weighted residuals of each row: of the model, and of constants."""
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
    """Whether what counts is described so well that further rows tell more than these."""
    for model, constant in _squares(state):
        rows = math.ceil(state.part * len(model))
        if not np.sum(model[:rows]) <= _CLOSELY * np.sum(constant[:rows]):
            return False
    return True


def _swings(values: np.ndarray) -> bool:
    """Whether what was recorded of a channel goes to and fro."""
    known = values[np.isfinite(values)]
    off = known - np.mean(known) if len(known) else known
    sides = np.sign(off[np.abs(off) > _BEYOND * np.std(off)]) if len(off) else off
    return bool(_SWINGS <= np.count_nonzero(np.diff(sides)) <= len(known) / _EACH)


def _followed(state: FitState) -> float:
    """The part of the rows, from the first, that the model follows."""
    parts = []
    for model, constant in _squares(state):
        with np.errstate(invalid="ignore"):
            lost = ~(np.cumsum(model) <= _FOLLOWS * np.cumsum(constant))
        parts.append(float(np.argmax(lost)) / len(lost) if np.any(lost) else 1.0)
    return min(parts)
