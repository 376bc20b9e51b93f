"""Combinations of parameters that data determine where they do not determine each alone.

A direction that leaves every channel unchanged has in it, say, a mass, a stiffness and a damping
that grow by the same factor. What does not change along it is determined: stiffness / mass and
damping / mass. Of positive parameters the combinations are products of powers, because the physics
is made of products; of others they are sums, which hold near the estimate.
"""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from .._text import format_estimate
from ._identifiability import COLLINEAR
from ._statistics import Statistics

# Part in a direction, with normalised columns, below which a parameter is not in it.
_NOTHING = 0.01

# An exponent this close to a simple fraction is that fraction: the rest is the integrator's.
_CLOSE = 0.02

# The least of a singular value at which parameters can be given the place of a direction.
_SOUND = 1e-3


@dataclasses.dataclass(frozen=True)
class Combination:
    """What is determined of some parameters.

    Attributes:
        text: such as `joints.damping / links.mass`.
        members: positions of its parameters.
        value, standard_error: SI.
    """

    text: str
    members: tuple[int, ...]
    value: float
    standard_error: float

    def __str__(self) -> str:
        value, error = format_estimate(self.value, self.standard_error)
        return f"{self.text} = {value} +- {error}"


def combinations(
    statistics: Statistics, positive: Sequence[bool], usual: Sequence[bool]
) -> list[tuple[tuple[int, ...], list[Combination]]]:
    """Parameters that are not determined one by one, and what of them is.

    Arguments:
        statistics: of the fit.
        positive: whether each free parameter has no negative values.
        usual: whether a fit usually holds it; such a one is the denominator, if there is one.

    Returns:
        Positions of the parameters that belong together, and their determined combinations; of a
        direction in which nothing is determined there are none.
    """
    directions = _directions(statistics.root)
    if not len(directions):
        return []
    alive = statistics.alive.tolist()
    order = sorted(range(len(alive)), key=lambda i: (not usual[alive[i]], i))
    pivots = _pivots(directions, order)
    # Along the k-th row the k-th pivot moves, and no other pivot does.
    rows = np.linalg.solve(directions[:, pivots], directions)
    norms = np.linalg.norm(statistics.root, axis=0)
    groups = []
    for part in _connected(np.abs(rows) > _NOTHING, pivots):
        members = tuple(alive[i] for i in part)
        powers = all(positive[i] and statistics.values[i] > 0 for i in members)
        known = [
            _combination(statistics, i, pivots, rows, norms, powers=powers)
            for i in part
            if i not in pivots
        ]
        groups.append((members, known))
    return groups


def _directions(root: np.ndarray) -> np.ndarray:
    """Rows of unit length, of normalised columns, that leave every residual unchanged."""
    if root.shape[1] < 2:
        return np.zeros((0, root.shape[1]))
    _, singular, right = np.linalg.svd(root / np.linalg.norm(root, axis=0))
    return right[: len(singular)][singular < COLLINEAR * singular[0]]


def _pivots(directions: np.ndarray, order: Sequence[int]) -> list[int]:
    """A parameter for each direction, such that no direction is left when they are held."""
    pivots: list[int] = []
    for limit in (_SOUND, 0.0):
        for i in order:
            tried = [*pivots, i]
            least = np.linalg.svd(directions[:, tried], compute_uv=False)[-1]
            if len(pivots) < len(directions) and i not in pivots and least > limit:
                pivots = tried
    return pivots


def _connected(present: np.ndarray, pivots: Sequence[int]) -> list[list[int]]:
    """Positions that some rows have in common, in their order."""
    parts: list[set[int]] = []
    for row in present:
        part = set(np.flatnonzero(row).tolist())
        apart = [other for other in parts if not other & part]
        parts = [*apart, part.union(*(other for other in parts if other & part))]
    return [sorted(part) for part in parts]


def _combination(
    statistics: Statistics,
    index: int,
    pivots: Sequence[int],
    rows: np.ndarray,
    norms: np.ndarray,
    *,
    powers: bool,
) -> Combination:
    """What of a parameter and the pivots does not change along the rows."""
    alive, values = statistics.alive.tolist(), statistics.values[statistics.alive]
    moves = {
        pivot: rows[k, index] * norms[pivot] / norms[index]
        for k, pivot in enumerate(pivots)
        if abs(rows[k, index]) > _NOTHING
    }
    gradient = np.zeros(len(alive))
    if powers:
        exponents: dict[int, Fraction | float] = {
            p: _simple(move * values[p] / values[index]) for p, move in moves.items()
        }
        value = values[index] / np.prod([values[p] ** float(e) for p, e in exponents.items()])
        gradient[index] = value / values[index]
        for pivot, exponent in exponents.items():
            gradient[pivot] = -value * float(exponent) / values[pivot]
        text = _product(statistics.labels[alive[index]], exponents, statistics.labels, alive)
    else:
        value = values[index] - sum(move * values[p] for p, move in moves.items())
        gradient[index] = 1.0
        for pivot, move in moves.items():
            gradient[pivot] = -move
        terms = [
            f"{'-' if move > 0 else '+'} {abs(move):.3g} {statistics.labels[alive[p]]}"
            for p, move in moves.items()
        ]
        text = " ".join([statistics.labels[alive[index]], *terms])
    error = float(np.sqrt(gradient @ statistics.covariance @ gradient))
    members = tuple(alive[i] for i in (index, *moves))
    return Combination(text, members, float(value), error)


def _simple(exponent: float) -> Fraction | float:
    near = Fraction(exponent).limit_denominator(4)
    return near if abs(float(near) - exponent) < _CLOSE else round(exponent, 2)


def _product(
    first: str,
    exponents: dict[int, Fraction | float],
    labels: Sequence[str],
    alive: Sequence[int],
) -> str:
    """`a / b`, `a * b` or `a / (b * c^2)`, where `exponents` are those of the denominator."""

    def power(pivot: int, exponent: Fraction | float) -> str:
        size = exponent if exponent > 0 else -exponent
        name = labels[alive[pivot]]
        if size == 1:
            return name
        return f"{name}^{size}" if float(size).is_integer() else f"{name}^({size})"

    above = [first, *(power(p, e) for p, e in exponents.items() if e < 0)]
    below = [power(p, e) for p, e in exponents.items() if e > 0]
    over = " * ".join(above)
    if not below:
        return over
    return f"{over} / {below[0]}" if len(below) == 1 else f"{over} / ({' * '.join(below)})"
