"""Which recording determines which parameter: what its standard error would be without each."""

from collections.abc import Mapping, Sequence

import numpy as np

from ..runs import Run
from ._identifiability import COLLINEAR, undetermined_groups
from ._jacobian import BlockJacobian
from ._state import FitState
from ._uncertainty import inverse_gram

Sources = Mapping[str, float | None]
"""By recording, how many times larger a standard error would be; None: there would be none."""


def sources(
    state: FitState, jacobian: BlockJacobian, alive: np.ndarray
) -> dict[int, dict[str, float | None]]:
    """What each recording is worth for what several of them determine together.

    To first order at the optimum, with the noise as it was found: nothing is fitted again.

    Arguments:
        state: the last one.
        jacobian: residuals by the parameters.
        alive: positions of those that the residuals respond to.

    Returns:
        By position of a parameter that belongs to no single run, by recording; empty for a fit of
        one recording.
    """
    problem = state.problem
    members = [member for group in problem.groups for member in group.members]
    names = _names([state.setup.runs[member] for member in members])
    if len(set(names)) < 2:
        return {}
    common, own = alive[alive < problem.shared], alive[alive >= problem.shared]
    triangles = [
        _of_shared(block, columns, common, own)
        for block, columns in zip(jacobian.blocks, jacobian.columns, strict=True)
    ]
    whole = _triangle(triangles)
    norms = np.linalg.norm(whole, axis=0)
    known = _variances(whole, norms)
    found: dict[int, dict[str, float | None]] = {int(index): {} for index in common}
    for name in dict.fromkeys(names):
        # What priors say comes last, and is there whichever recording is not.
        rest = [t for i, t in enumerate(triangles) if i >= len(names) or names[i] != name]
        left = _variances(_triangle(rest), norms)
        for column, index in enumerate(common.tolist()):
            if column in known:
                ratio = left[column] / known[column] if column in left else None
                found[index][name] = None if ratio is None else float(np.sqrt(ratio))
    return found


def _names(runs: Sequence[Run]) -> list[str]:
    """Of the recording of each run; of files of the same name their paths."""
    paths: dict[str, set[str]] = {}
    for run in runs:
        paths.setdefault(run.recording, set()).add(str(run.path))
    return [run.recording if len(paths[run.recording]) == 1 else str(run.path) for run in runs]


def _of_shared(
    block: np.ndarray, columns: np.ndarray, common: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """What the rows of a run say of the common parameters, once its own ones fit as they like."""
    alone, shared = np.isin(columns, own), np.isin(columns, common)
    triangle = _triangle([block[:, alone], block[:, shared]], axis=1)
    left = triangle[int(alone.sum()) :, int(alone.sum()) :]
    placed = np.zeros((len(left), len(common)))
    placed[:, np.searchsorted(common, columns[shared])] = left
    return placed


def _triangle(parts: Sequence[np.ndarray], axis: int = 0) -> np.ndarray:
    """R of the QR factorisation, square also where there are fewer rows."""
    triangle = np.asarray(np.linalg.qr(np.concatenate(parts, axis=axis), mode="r"))
    return np.pad(triangle, ((0, triangle.shape[1] - len(triangle)), (0, 0)))


def _variances(root: np.ndarray, norms: np.ndarray) -> dict[int, float]:
    """Variances by column of what R determines; `norms` are those of all rows together."""
    moves = np.flatnonzero(np.linalg.norm(root, axis=0) > COLLINEAR * norms)
    loose = {i for group in undetermined_groups(root[:, moves]) for i in group}
    variances = np.diag(inverse_gram(root[:, moves]))
    return {int(column): float(variances[i]) for i, column in enumerate(moves) if i not in loose}
