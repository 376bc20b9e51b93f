"""Correct models: how often they are judged inadequate, and the coverage of their intervals.

The recordings are those of `_omissions`, without an omission. Delay, rate and scale of the camera
and the width of the arm are exact, or all sampled from their usual errors, or one of them is.
"""

from typing import TYPE_CHECKING, Any

import numpy as np

from . import _omissions as omissions
from ._omissions import MEMORY, NOTHING, SINGLE, START, TRUTH, UNCERTAIN, USUAL, shown
from ._study import PROBABILITY, Figures, Study
from ._suspects import differing

if TYPE_CHECKING:
    from giajax import FitResult, Run

CASES = (NOTHING, MEMORY, USUAL, SINGLE)


def run(size: int, seed: int, names: tuple[str, ...] = CASES) -> Figures:
    """Return the figures of `size` recordings of each case and sensor set."""
    found = omissions.repeated(size, seed, names, one)
    return {cell: figures(of_cell) for cell, of_cell in found.items()}


def part(size: int, seed: int) -> Figures:
    """Return the figures for exact devices and for the usual errors of camera and arm."""
    return run(size, seed, (NOTHING, USUAL))


def one(name: str, sensors: str, entropy: list[int], code: str | None) -> Figures:
    """Return the figures of the fit of one recording; `code` is the commit of giajax."""
    del code
    recording, truth = omissions.recorded(name, sensors, entropy)
    result = omissions.fitted(recording)
    found = omissions.judged(omissions.CASES[name], result, truth)
    if name == SINGLE:
        found["wider"] = _wider(result, recording, entropy[-1])
    return found


def _wider(result: "FitResult", recording: "Run", number: int) -> dict[str, float]:
    """Return the ratio of the errors to those of a fit that knows which quantity is not exact."""
    import giajax

    path = UNCERTAIN[number % len(UNCERTAIN)]
    priors, ties = (
        {label: of for label, of in result.config.get(key, {}).items() if label.startswith(path)}
        for key in ("priors", "ties")
    )
    model: Any = giajax.model_for([recording])
    informed = giajax.fit(
        model,
        recording,
        free=[*START, *priors],
        start=START,
        priors=priors,
        ties=ties,
        nuisances=False,
        check=False,
    )
    return {
        path: float((result.parameters[path].standard_error or np.inf) / error)
        for path in TRUTH
        if (error := informed.parameters[path].standard_error)
    }


def figures(found: list[Figures]) -> Figures:
    """Return counts, and medians of the ratios of errors."""
    counts = omissions.counted(found)
    if wider := [each["wider"] for each in found if "wider" in each]:
        ratios = {path: [each[path] for each in wider if path in each] for path in TRUTH}
        medians = {path: round(float(np.median(of)), 3) for path, of in ratios.items()}
        every = np.median([ratio for of in ratios.values() for ratio in of])
        counts["wider"] = {**medians, "all": round(float(every), 3)}
    return counts


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report counts of this study that differ by more than by chance."""
    from scipy.stats import binomtest

    counts = {"adequate": "judged adequate in", "with suspects": "accused by a suspect in"}
    sentences = differing(stored, new, counts)
    for name, each in new.items():
        # The intervals of one fit are correlated, so each recording counts as one test.
        share, size = each["covered"] / len(TRUTH), each["recordings"]
        if binomtest(round(share), size, 0.95).pvalue < PROBABILITY:
            sentences.append(f"{name}: {share / size:.1%} of the values are in their intervals")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each kind of recording and sensor set."""
    rows = [
        "| recording | verdict `adequate` | verdict `doubtful` | false alarms | deviation above 3 "
        "standard errors | values within their 95 % intervals | ratio of the standard errors to "
        "those of a fit that frees only the drawn quantity |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        count, wider = each["recordings"], each.get("wider", {})
        accused = each["with suspects" if name.startswith(MEMORY) else "accused"]
        several = (each["adequate"], each["doubtful"], accused, each["off"])
        cells = " | ".join(f"{cell} of {count}" for cell in several)
        values = count * len(TRUTH)
        covered = f"{each['covered']} of {values} ({each['covered'] / values:.1%})"
        wider_by = ", ".join(f"{path} {times:.2f}" for path, times in wider.items()) or "-"
        rows.append(f"| {shown(name)} | {cells} | {covered} | {wider_by} |")
    return rows


RIGHT_MODELS = Study(
    name="right_models",
    meaning=(
        "MuJoCo simulates recordings with the same model that is fitted. A false alarm is a "
        "verdict other than `adequate`, or a significant suspect. With correlated noise (rho 0.9) "
        "that is not stated, the verdict has to be `inadequate`, and only a named suspect is a "
        "false alarm. If delay, frame rate, scale and link widths are drawn from their usual "
        "uncertainty, the intervals are computed from the total error. If only one of these "
        "quantities is drawn, the standard errors are compared with the standard errors of a fit "
        "that frees only this quantity, with the same prior."
    ),
    size=167,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
