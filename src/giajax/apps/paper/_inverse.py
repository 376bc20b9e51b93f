"""Inversion of table 3: arms whose eight cells agree with the printed values."""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from matplotlib.figure import Figure

from ...fitting import Marquardt
from ...report import BLUE, GREY, INK, VERMILLION, new_figure, plain
from ...runtime.parallel import Tell, run_in_threads
from ...runtime.process import cores
from ._arm_figures import (
    PRINTED,
    READINGS,
    STARTS_AT,
    UNKNOWNS,
    Compared,
    Reading,
    evaluated,
    linearised,
)
from ._contenders import LINKS, Reproduced, Sources

Say = Callable[[str], None]

LINKS_COMPARED = 4
CELLS = np.asarray([float(cell) for row in PRINTED.values() for cell in row[:LINKS_COMPARED]])
"""The eight printed cells of table 3, %: first with air, then without air."""

ROUNDING = 0.5  # Cells are printed in whole per cent.
STARTS, POOL, ITERATIONS, SEED = 5, 60, 40, 0

# A step changes no value by more than a factor of e^0.5. The search ends at a step of 0.001.
_SOLVER = Marquardt(largest_step=0.5, rtol=0.0, atol=1e-3, distance=1e-4)


@dataclasses.dataclass(frozen=True)
class SearchEnd:
    """Result of the search from one initial guess (numbered from 1).

    Attributes:
        why: "reached", "minimum" (converged, but not to the printed cells), "stuck" (no minimum,
            but no step in the descent direction reduces the error), "iterations", "failed" or
            "interrupted".
        start: initial values of `UNKNOWNS`, SI, shape (unknown,).
        end: final values, SI, shape (unknown,).
        out: comparison at the end. It and the two items below are NaN if nothing was evaluated.
        jacobian: derivatives of the cells with respect to the logarithms of the free unknowns, in
            percentage points per unit, shape (8, free).
        checked: the same derivatives from finite differences.
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
        """Computed minus printed cells, percentage points, shape (8,)."""
        return np.asarray(self.out.cells) - CELLS

    def at_bounds(self) -> list[str]:
        """Return the names of the free unknowns that are at an end of their range."""
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
    """Search for arms from the best of some random ones, and return the result of each search.

    Ctrl-C ends the search. Before the first descent has begun it is passed on.

    Arguments:
        reading: key of `READINGS`.
        starts: number of descents.
        pool: number of random arms, uniform in the logarithms of their ranges, from which the
            starts are chosen.
        iterations: maximum number of steps of a descent.
    """
    taken = READINGS[reading]
    random = np.random.default_rng(seed)
    say(f"{taken.label}: evaluating {pool} random arms")
    drawn = [random.uniform(*taken.box()) for _ in range(pool)]
    cells = [np.asarray(evaluated(taken.all(each)).cells) for each in drawn]
    off = np.nan_to_num(np.sum((np.stack(cells) - CELLS) ** 2, axis=1), nan=np.inf)
    chosen = [drawn[at] for at in np.argsort(off)[:starts]]
    jobs = [
        functools.partial(_descend, reading, number, start, iterations, say)
        for number, start in enumerate(chosen, 1)
    ]
    ends = run_in_threads(jobs, min(cores(), len(jobs)), until=lambda end: end.why == "interrupted")
    return [end for end in ends if end is not None]


def _descend(
    reading: str, number: int, start: np.ndarray, iterations: int, say: Say, tell: Tell
) -> SearchEnd:
    """Run one descent with the solver that all fits use."""
    taken = READINGS[reading]
    options = dict(zip(("lower", "upper"), map(jnp.asarray, taken.box()), strict=True))
    at, why, tried = jnp.asarray(start), "iterations", 1
    state: Any = None
    # Placeholders for the comparison and both kinds of derivatives if nothing is evaluated.
    slopes: Any = np.full((len(CELLS), len(taken.free)), np.nan)
    four, checked = slopes[:LINKS_COMPARED, 0], slopes
    out = Compared(slopes[:, 0], four, four > 0)
    blank = jnp.zeros(max(len(CELLS), len(taken.free))), out
    steps = _SOLVER.trials(at, lambda y: _weighed(taken, np.asarray(y)), options, blank)
    try:
        # The first step evaluates the initial guess.
        for tried, each in zip(range(1, iterations + 2), steps, strict=False):
            at, state, end = each
            worst = float(np.max(np.abs(np.asarray(state.aux.cells) - CELLS)))
            tell(say, f"{taken.label}, start {number}, step {tried - 1}: "
                      f"largest error of a cell: {worst:.3g} percentage points")  # fmt: skip
            if worst < ROUNDING:
                why = "reached"
                break
            if end is not None:
                why = "minimum" if bool(end == optx.RESULTS.successful) else "stuck"
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


def _weighed(taken: Reading, at: np.ndarray) -> tuple[Any, ...]:
    """Return residual, Jacobian, R, Q^T r and the comparison in the form the solver expects."""
    out, slopes = linearised(taken.all(at))
    # Rows of zeros keep the solver's R square if there are more unknowns than printed cells.
    missing = max(len(taken.free) - len(CELLS), 0)
    residual = np.pad(np.asarray(out.cells) - CELLS, (0, missing))
    jacobian = np.pad(np.asarray(slopes) @ taken.spread(), ((0, missing), (0, 0)))
    sound = np.all(np.isfinite(jacobian))
    q, r = np.linalg.qr(jacobian if sound else np.zeros_like(jacobian))
    return (*map(jnp.asarray, (residual, jacobian, r, q.T @ residual)), out)


def _differences(taken: Reading, at: np.ndarray, step: float = 3e-3) -> np.ndarray:
    """Return the Jacobian from central differences."""
    columns = []
    for change in step * np.eye(len(at)):
        ahead, behind = (evaluated(taken.all(at + sign * change)).cells for sign in (1, -1))
        columns.append((np.asarray(ahead) - np.asarray(behind)) / (2 * step))
    return np.stack(columns, axis=1)


_STYLES = {"memory": (BLUE, "o"), "own": (VERMILLION, "s")}

_WORTH = 0.25  # Smallest component of a direction that is shown.


def nearest(ends: Sequence[SearchEnd]) -> SearchEnd:
    """Return the search whose final cells are closest to the printed ones."""
    return min(ends, key=lambda end: np.nan_to_num(rms(end), nan=np.inf))


def rms(end: SearchEnd) -> float:
    """Return the root mean square of the errors of the cells, percentage points."""
    return float(np.sqrt(np.mean(end.misfit**2)))


def directions(end: SearchEnd) -> tuple[np.ndarray, np.ndarray]:
    """Return singular values and right singular vectors of the Jacobian at the end of a search.

    Hysteresis can make derivatives differ from the slopes of the cells. Columns that differ much
    from finite differences are replaced by these. The singular values are in percentage points per
    unit of the logarithms, shape (8,). The directions are the rows of an array of shape (free,
    free). The cells contain no information about directions beyond the eighth.
    """
    jacobian = np.where(rough(end), end.checked, end.jacobian)
    if not np.all(np.isfinite(jacobian)):
        count = jacobian.shape[1]
        return np.full(len(CELLS), np.nan), np.full((count, count), np.nan)
    _, sizes, rows = np.linalg.svd(jacobian, full_matrices=True)
    # Choose the sign of each direction so that its largest component is positive.
    return sizes, rows * np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])[:, None]


def rough(end: SearchEnd) -> np.ndarray:
    """Return which derivatives differ from differences by more than 10 % and by one point."""
    off = np.abs(end.jacobian - end.checked).max(axis=0)
    return np.asarray(off > np.maximum(0.1 * np.abs(end.checked).max(axis=0), 1.0))


def in_words(row: np.ndarray, names: Sequence[str]) -> str:
    """Format a direction as a product of powers, without its small components."""
    order = [at for at in np.argsort(-np.abs(row)) if abs(row[at]) >= _WORTH]
    return " ".join(f"{names[at]}^{row[at]:.2f}" for at in order)


_CAPTION = (
    "Left: singular values of the derivatives of the eight cells with respect to the logarithms of "
    "the unknowns, at the end of each search. Colour and marker denote the assumption of the "
    "search. At the dashed lines, a change of 0.1 (upper) or 1 (lower) in the logarithms along a "
    "direction changes the cells by half a percentage point, the largest rounding error of a cell. "
    "Right: components of these directions for the best search, from -1 (blue) to 1 (red). "
    f"Components with a magnitude of at least {_WORTH:g} are printed. To first order, only the "
    "first eight directions change the cells."
)


def drawn(ends: Sequence[SearchEnd], title: str) -> Figure:
    """Plot the singular values of all searches and the directions of the best one."""
    figure = new_figure(11, 5.4, title, _CAPTION)
    left, right = figure.subplots(1, 2)
    for end in ends:
        label = READINGS[end.reading].label if end.number == 1 else None
        colour, mark = _STYLES[end.reading]
        small: Any = {"marker": mark, "markersize": 3.5, "linewidth": 0.8, "alpha": 0.8}
        at = np.arange(1, len(CELLS) + 1)
        left.plot(at, directions(end)[0], color=colour, label=label, **small)
    beside: Any = {"textcoords": "offset points", "fontsize": 7, "color": GREY}
    for share in (0.1, 1.0):
        left.axhline(ROUNDING / share, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)))
        left.annotate(
            f"half a percentage point for a change of {share:.0%}",
            (1, ROUNDING / share),
            (0, 3),
            **beside,
        )
    left.set_yscale("log")
    plain(left, "singular values (percentage points per factor of e)", "direction")
    left.legend(fontsize=8, frameon=False)
    best = nearest(ends)
    free = READINGS[best.reading].free
    rows = directions(best)[1]
    right.imshow(rows, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    right.set_xticks(range(len(free)), free, rotation=60, ha="right", fontsize=7, color=INK)
    right.set_yticks(range(len(rows)), [str(at + 1) for at in range(len(rows))], fontsize=7)
    for (at, column), share in np.ndenumerate(rows):
        if abs(share) >= _WORTH:
            ink = "white" if abs(share) > 0.6 else INK
            right.text(column, at, f"{share:.1f}", ha="center", va="center", fontsize=6, color=ink)
    title = f"directions of the best result ({best.reading} {best.number})"
    right.set_title(title, fontsize=9, loc="left", color=INK)
    right.set_ylabel("direction", fontsize=8)
    return figure


SOURCES = Sources(
    printed="the eight cells, the definition of the concordance, the paper's model (eq. (1) at the "
    "centres of the links, 0.047 kg each), and the remark that the joints of the prototype do not "
    "return to 0.",
    assumed=f"that the base joint bends at {STARTS_AT:g} s and returns once, at the same speed, "
    "that the displacement is z, and that camera noise and wind are absent. The ranges of all "
    "unknowns are also assumed (see the table).",
    reconstructed="the experiment: the paper's arm with hysteretic joints (Dahl friction). In the "
    "second reading, its stiffness, damping, C_D and base angle also differ from those of the "
    "model.",
)

_PLACES = tuple(f"link {link}, {air} air, %" for air in ("with", "without") for link in LINKS)


def table3_inverse(say: Say = lambda text: None) -> Reproduced:
    """Find arms for which table 3 is as printed, and the parameters that its cells determine.

    After Ctrl-C the searches that had begun are shown. Before the first one it is passed on.
    """
    ends: list[SearchEnd] = []
    for reading in READINGS:
        try:
            found = search(reading, say=say)
        except KeyboardInterrupt:
            # Keep the results of the earlier searches.
            break
        ends += found
        if len(found) < STARTS or any(end.why == "interrupted" for end in found):
            break
    return shown(ends)


def shown(ends: Sequence[SearchEnd]) -> Reproduced:
    """Return the results of searches as a table and a figure; raise an error if there are none."""
    if not ends:
        raise KeyboardInterrupt
    reached = sum(end.why == "reached" for end in ends)
    best = nearest(ends)
    title = (
        f"Inversion of table 3: {reached or 'none'} of {len(ends)} searches reproduce the "
        f"eight printed cells, and the best RMS error is {rms(best):.1f} percentage points"
    )
    return Reproduced(
        title,
        SOURCES,
        drawn(ends, title),
        ("", "printed value, or range", *(f"{end.reading} {end.number}" for end in ends)),
        _rows(ends),
        _columns(ends),
        {"searches": [_record(end) for end in ends]},
    )


def _rows(ends: Sequence[SearchEnd]) -> tuple[tuple[Any, ...], ...]:
    rows: list[tuple[Any, ...]] = [
        *(
            (place, f"{CELLS[at]:g}", *(f"{end.out.cells[at]:.1f}" for end in ends))
            for at, place in enumerate(_PLACES)
        ),
        ("RMS error, percentage points", "", *(f"{rms(end):.1f}" for end in ends)),
        ("ended", "", *(end.why for end in ends)),
        ("steps", "", *(end.iterations for end in ends)),
    ]
    rows += [
        (f"link {link}: smallest |Xe|, m", "", *(f"{end.out.nearest[at]:.2g}" for end in ends))
        for at, link in enumerate(LINKS)
    ]
    for at, (name, unknown) in enumerate(UNKNOWNS.items()):
        cells = [
            f"{end.end[at] / unknown.unit:.3g}{'*' if name in end.at_bounds() else ''}"
            for end in ends
        ]
        rows.append((unknown.label, f"{unknown.lower:g} .. {unknown.upper:g}", *cells))
    sizes = [directions(end)[0] for end in ends]
    for at in range(len(CELLS)):
        rows.append((f"singular value {at + 1}", "", *(f"{size[at]:.2g}" for size in sizes)))
    replaced = [int(rough(end).sum()) for end in ends]
    rows.append(("derivatives replaced by differences", "", *replaced))
    return tuple(rows)


def _columns(ends: Sequence[SearchEnd]) -> dict[str, list[Any]]:
    columns: dict[str, list[Any]] = {
        "reading": [end.reading for end in ends],
        "start": [end.number for end in ends],
        "ended": [end.why for end in ends],
        "rms_error_percent": [rms(end) for end in ends],
    }
    cells = [f"link{link:02d}_{air}_air" for air in ("with", "without") for link in LINKS]
    for at, name in enumerate(cells):
        columns[f"{name}_percent"] = [end.out.cells[at] for end in ends]
    for at, (name, unknown) in enumerate(UNKNOWNS.items()):
        columns[f"{name}_at_start"] = [end.start[at] / unknown.unit for end in ends]
        columns[name] = [end.end[at] / unknown.unit for end in ends]
    for at in range(len(CELLS)):
        columns[f"singular_value_{at + 1}"] = [directions(end)[0][at] for end in ends]
    return columns


def _record(end: SearchEnd) -> dict[str, Any]:
    sizes, rows = directions(end)
    free = READINGS[end.reading].free
    return {
        "reading": end.reading,
        "meaning": READINGS[end.reading].label,
        "start": end.number,
        "ended": end.why,
        "iterations": end.iterations,
        "cells_percent": end.out.cells,
        "rms_error_percent": rms(end),
        "arm_crosses_zero": {
            f"link{n}": bool(c) for n, c in zip(LINKS, end.out.crossed, strict=True)
        },
        "at_an_end_of_its_range": end.at_bounds(),
        "free": list(free),
        "jacobian": end.jacobian,
        "jacobian_by_differences": end.checked,
        "by_differences": [name for name, so in zip(free, rough(end), strict=True) if so],
        "singular_values": sizes,
        "right_singular_vectors": rows,
        "directions": [in_words(row, free) for row in rows],
    }
