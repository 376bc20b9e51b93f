"""Influence: compare one step from the optimum with a fit without the run or marker.

For shipped fits, the effect of each marker or run on each parameter is computed by a first-order
step and by a fit. The rank correlation (Spearman) is that of all shifts, in units of the standard
error, over parts and parameters.
"""

from collections.abc import Iterable

import numpy as np

from ._record import ROOT
from ._study import Figures, Study

# Name of each case -> the fit, and the kind of parts that are left out.
CASES = {
    "base_step, its markers": ("base_step", "marker"),
    "pitch_yaw, its markers": ("pitch_yaw", "marker"),
    "two_runs, its runs": ("two_runs", "run"),
}


def run(size: int, seed: int, names: Iterable[str] = tuple(CASES)) -> Figures:
    """Return the figures of each case, which do not depend on random numbers."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return {name: _compared(*CASES[name]) for name in names}


def part(size: int, seed: int) -> Figures:
    """Return the figures of the fastest case."""
    return run(size, seed, ("base_step, its markers",))


def _compared(fit: str, kind: str) -> Figures:
    from scipy.stats import spearmanr

    import giajax

    ready = giajax.FitTask.load(ROOT / "fits" / f"{fit}.toml").prepare()
    result = ready.run()
    parts = giajax.influence(result, ready.runs, exact=True, spans=1).of_kind(kind)
    pairs = np.asarray(
        [
            (step, part.exact[path])
            for part in parts
            if part.exact is not None
            for path, step in part.steps.items()
            if step is not None and part.exact[path] is not None
        ]
    )
    steps, exact = pairs.T
    return {
        "parts": len(parts),
        "parameters": len(parts[0].steps),
        "converged": sum(not part.reason for part in parts),
        "rank_correlation": round(float(spearmanr(steps, exact).statistic), 4),
        "largest_shift": round(float(np.max(np.abs(exact))), 3),
        "largest_difference": round(float(np.max(np.abs(steps - exact))), 3),
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report rank correlations that are lower than the stored ones."""
    return [
        f"{name}: the rank correlation is {one['rank_correlation']}, and "
        f"{stored[name]['rank_correlation']} is stored"
        for name, one in new.items()
        if one["rank_correlation"] < stored[name]["rank_correlation"] - 0.01
    ]


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each case."""
    rows = [
        "| fit; data omitted one at a time | converged fits | rank correlation | largest shift | "
        "largest difference between step and fit |",
        "| --- | --- | --- | --- | --- |",
    ]
    rows += [
        f"| {name.replace(', its ', '; ')} | {one['converged']} of {one['parts']} | "
        f"{one['rank_correlation']:.3f} | {one['largest_shift']:.2f} | "
        f"{one['largest_difference']:.2f} |"
        for name, one in figures.items()
    ]
    return rows


INFLUENCE = Study(
    name="influence",
    meaning=(
        "The effect of each marker or run on each parameter is estimated by one step from the "
        "optimum (`giajax influence`), for fits that come with giajax. The estimate is compared "
        "with a complete fit without that marker or run. The table summarises the shifts of all "
        "parameters, divided by their standard errors."
    ),
    size=1,
    seed=0,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
