"""Arms for which table 3 would be as it is printed, looked for from several starts."""

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._cores import cores
from .._threads import Tell, side_by_side
from .._typing import Float
from ..fitting import Marquardt
from ._readings import READINGS, Reading
from ._table3 import PRINTED
from ._unknown_experiment import UNKNOWNS, Compared, evaluated, linearised

Say = Callable[[str], None]

LINKS_COMPARED = 4
CELLS = np.asarray([float(cell) for row in PRINTED.values() for cell in row[:LINKS_COMPARED]])
"""The eight that are printed, %: with air, then without."""

# Cells are printed in whole percent.
ROUNDING = 0.5

STARTS, POOL, ITERATIONS, SEED = 5, 60, 40, 0

# A step changes no number by more than a factor of e^0.5, and one by a thousandth is the last.
_SOLVER = Marquardt(largest_step=0.5, rtol=0.0, atol=1e-3, distance=1e-4)


@dataclasses.dataclass(frozen=True)
class SearchEnd:
    """How the search from one start ended.

    Attributes:
        reading: name of the reading.
        number: of the start, from 1.
        why: "reached", "minimum" (converged beside the printed cells), "stuck" (no minimum, but no
            step along these slopes helps), "iterations", "failed" or "interrupted".
        iterations: steps that were tried.
        start, end: values of `UNKNOWNS` there, SI, shape (unknown,).
        out: what comes out at the end; all NaN where nothing was evaluated, as what follows.
        jacobian: of the cells by the logarithms of what is free, % a unit, shape (8, free).
        checked: the same by differences of the cells.
    """

    reading: str
    number: int
    why: str
    iterations: int
    start: np.ndarray
    end: np.ndarray
    out: Compared
    jacobian: np.ndarray
    checked: np.ndarray

    @property
    def misfit(self) -> np.ndarray:
        """Cells that come out less those that are printed, %, shape (8,)."""
        return np.asarray(self.out.cells) - CELLS

    def at_bounds(self) -> list[str]:
        """Names of what is free and lies at an end of its range."""
        reading = READINGS[self.reading]
        at = dict(zip(UNKNOWNS, np.log(self.end), strict=True))
        return [
            name
            for name, first, last in zip(reading.free, *reading.box(), strict=True)
            if min(at[name] - first, last - at[name]) < 1e-6
        ]


def search(
    reading: str,
    *,
    starts: int = STARTS,
    pool: int = POOL,
    iterations: int = ITERATIONS,
    seed: int = SEED,
    say: Say = lambda text: None,
) -> list[SearchEnd]:
    """Look for arms from the best of some random ones.

    Arguments:
        reading: of `READINGS`.
        starts: how many.
        pool: from among how many random arms, evenly spread in the logarithms of their ranges.
        iterations: steps of a search at most.
        seed: of the pool.
        say: called with what is being done.

    Returns:
        How each search ended; after Ctrl-C those that had begun.

    Raises:
        KeyboardInterrupt: stopped at the random arms, before any search had begun.
    """
    taken = READINGS[reading]
    random = np.random.default_rng(seed)
    say(f"{taken.label}: {pool} random arms")
    drawn = [random.uniform(*taken.box()) for _ in range(pool)]
    off = [_size(evaluated(taken.all(each)).cells) for each in drawn]
    chosen = [drawn[at] for at in np.argsort(off)[:starts]]
    jobs = [
        functools.partial(_descend, reading, number, start, iterations, say)
        for number, start in enumerate(chosen, 1)
    ]
    ends = side_by_side(jobs, min(cores(), len(jobs)), until=lambda end: end.why == "interrupted")
    return [end for end in ends if end is not None]


def _descend(
    reading: str, number: int, start: np.ndarray, iterations: int, say: Say, tell: Tell
) -> SearchEnd:
    """One search, by the solver of every fit; its steps are taken here, to be told and stopped."""
    taken = READINGS[reading]
    options = dict(zip(("lower", "upper"), map(jnp.asarray, taken.box()), strict=True))
    at, why, tried, state = jnp.asarray(start), "iterations", 1, None
    out, slopes, checked = _nothing(taken)
    try:
        there = _weighed(taken, start)
        state = _SOLVER.init(_unused, at, None, options, there[0], there[4], frozenset())
        for tried in range(1, iterations + 2):
            trial = _SOLVER.propose(at, options, state)
            # The first one is the start, which is known.
            there = there if tried == 1 else _weighed(taken, np.asarray(trial))
            at, state = _SOLVER.judge(at, options, state, trial, there)
            worst = float(np.max(np.abs(np.asarray(state.aux.cells) - CELLS)))
            tell(say, f"{taken.label}, start {number}, step {tried - 1}: "
                      f"largest error of a cell {worst:.3g} points")  # fmt: skip
            if worst < ROUNDING:
                why = "reached"
                break
            over, how = _SOLVER.terminate(_unused, at, None, options, state, frozenset())
            if bool(over):
                why = "minimum" if bool(how == optx.RESULTS.successful) else "stuck"
                break
        checked = _differences(taken, np.asarray(at))
    except KeyboardInterrupt:
        why = "interrupted"
    if state is not None and np.isfinite(float(state.cost)):
        out, slopes = jax.tree.map(np.asarray, (state.aux, state.jacobian[: len(CELLS)]))
    elif why != "interrupted":
        why = "failed"
    return SearchEnd(
        reading=reading,
        number=number,
        why=why,
        iterations=tried - 1,
        start=np.exp(np.asarray(taken.all(start))),
        end=np.exp(np.asarray(taken.all(np.asarray(at)))),
        out=out,
        jacobian=slopes,
        checked=checked,
    )


def _nothing(taken: Reading) -> tuple[Compared, np.ndarray, np.ndarray]:
    """What comes out, and its derivatives in both ways, where nothing was evaluated."""
    slopes: Any = np.full((len(CELLS), len(taken.free)), np.nan)
    four = slopes[:LINKS_COMPARED, 0]
    return Compared(slopes[:, 0], four, four > 0), slopes, slopes


def _unused(y: Any, args: Any) -> Any:
    """The solver is given what it would evaluate."""
    raise NotImplementedError


def _weighed(taken: Reading, at: np.ndarray) -> tuple[Any, ...]:
    """Residual, Jacobian, R, Q^T r and what came out, as the solver wants them."""
    out, slopes = linearised(taken.all(at))
    # Rows of zeros: the solver's R is square, also where there is more to find than was printed.
    missing = max(len(taken.free) - len(CELLS), 0)
    residual = np.pad(np.asarray(out.cells) - CELLS, (0, missing))
    jacobian = np.pad(np.asarray(slopes) @ taken.spread(), ((0, missing), (0, 0)))
    sound = np.all(np.isfinite(jacobian))
    q, r = np.linalg.qr(jacobian if sound else np.zeros_like(jacobian))
    return (*map(jnp.asarray, (residual, jacobian, r, q.T @ residual)), out)


def _differences(taken: Reading, at: np.ndarray, step: float = 3e-3) -> np.ndarray:
    """The Jacobian once more, by central differences."""
    columns = []
    for direction in np.eye(len(at)):
        ahead, behind = (
            np.asarray(evaluated(taken.all(at + sign * step * direction)).cells) for sign in (1, -1)
        )
        columns.append((ahead - behind) / (2 * step))
    return np.stack(columns, axis=1)


def _size(cells: Float[Any, " cell"]) -> float:
    off = float(np.sum((np.asarray(cells) - CELLS) ** 2))
    return off if np.isfinite(off) else float("inf")
