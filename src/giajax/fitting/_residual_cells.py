"""What a fit left over, cell by cell, with derivatives: what the noise is estimated from."""

from collections import Counter

import numpy as np

from ..noise import Cells
from ._loss import scores
from ._state import FitState


def residual_cells(state: FitState, *, together: bool = False) -> dict[tuple[int, str], Cells]:
    """The residuals of a state and their derivatives in SI, by run and channel.

    Without weights and not whitened. Coordinates that are held have no columns; those that one
    run alone responds to are its own.

    Arguments:
        state: evaluated.
        together: every coordinate as a shared column, also those that are held.

    Returns:
        By the position of the run and the name of the channel.
    """
    jacobian, active = state.jacobian(), np.asarray(state.active)
    if together:
        common, mine = list(range(state.problem.size)), set[int]()
    else:
        common, mine = shared_and_own(state)
    cells = {}
    at_block = iter(zip(jacobian.blocks, jacobian.columns, strict=True))
    for group, tables in zip(state.problem.groups, state.inner.aux.channels, strict=True):
        for row, member in enumerate(group.members):
            block, columns = next(at_block)
            weight = np.asarray(group.weight, dtype=float)[row]
            predicted = np.asarray(tables, dtype=float)[row]
            difference = predicted - np.asarray(group.observed)[row]
            if group.whitening is not None:
                block = group.whitening.of_run(row).undone(block)
            slope = scores(state.problem.loss, (difference * weight).ravel())[2]
            with np.errstate(divide="ignore", invalid="ignore"):
                block = (block / (slope * weight.ravel())[:, None]).reshape(*weight.shape, -1)
            where = {int(column): position for position, column in enumerate(columns)}
            own = [where[c] for c in sorted(mine & set(where)) if active[c]]
            shared = [where.get(c, -1) for c in common]
            run = state.setup.runs[member]
            for at, name in enumerate(group.channels):
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
    """X^T X of the rows of the priors, by the shared coordinates that move and the residual.

    Arguments:
        state: evaluated.

    Returns:
        Shape (shared + 1, shared + 1): by the shared columns of `residual_cells`, and, last, the
        residual.
    """
    common, _ = shared_and_own(state)
    count, columns = len(state.problem.priors), state.problem.priors.columns
    rows = np.zeros((count, len(common) + 1))
    if count:
        slopes = np.diag(state.jacobian().blocks[-1])
        residual = np.asarray(state.inner.residual)[-count:]
        for row, column, slope, value in zip(rows, columns, slopes, residual, strict=True):
            # What is held stays as far off whatever the others do.
            if column in common:
                row[common.index(column)], row[-1] = slope, value
    return np.asarray(rows.T @ rows)


def shared_and_own(state: FitState) -> tuple[list[int], set[int]]:
    """Positions of the coordinates that move: shared ones; of single runs, without a prior.

    Arguments:
        state: evaluated.
    """
    active = np.asarray(state.active)
    count = Counter(int(c) for columns in state.jacobian().columns for c in columns)
    several = len(state.setup.runs) > 1
    mine = {column for column, uses in count.items() if several and uses == 1}
    return [c for c in range(state.problem.size) if active[c] and c not in mine], mine
