"""Stepwise model selection on a recording of another engine, up to joints with memory.

The recording `data/independent/friction.csv` has Dahl friction in every joint, drag along the
links, and added mass without its velocity-product terms. The paper's model has none of these
effects. The ladder starts from a fit of this model, and no step receives information on the next
one.
"""

from typing import Any

from ._ladder import cell, climbed, disagreements, rung_of
from ._record import ROOT
from ._study import Figures, Study

START = {
    "air.drag_coefficient": 0.6,
    "joints.pitch_stiffness": 2.0,
    "joints.damping": 0.15,
}
# Parameters of the engine: 0.09 N m at 45 N m/rad.
TRUTH = {
    "air.drag_coefficient": 0.95,
    "joints.pitch_stiffness": 3.3,
    "joints.damping": 0.05,
    "joints.memory.strength": 0.09,
    "joints.memory.yield_angle": 0.002,
}
# Number of steps, equal to the default of the command.
MOST = 8


def run(size: int, seed: int) -> Figures:
    """Return the figures of the ladder for the stored recording; size and seed are not used."""
    return _climbed(MOST)


def part(size: int, seed: int) -> Figures:
    """Return the first fit only, because the suspects of a ladder take minutes to compile."""
    return _climbed(0)


def _climbed(most: int) -> Figures:
    steps = climbed(ROOT / "data" / "independent" / "friction.csv", START, most)
    found: Any = steps.result
    return {
        "rungs": [rung_of(rung) for rung in steps.steps],
        "ending": steps.ending,
        "found": {
            path: {
                "value": found.free[path].value,
                "error": found.free[path].standard_error,
                "truth": truth,
            }
            for path, truth in TRUTH.items()
            if path in found.free
        },
        "air": {
            "drag": found.model.arm.air.drag,
            "added_mass": found.model.arm.air.added_mass,
            "has_added_mass": found.model.arm.air.added_mass_coefficient is not None,
        },
    }


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each fit."""
    rows = [
        "| fit | chi-square | C_D | k, N m/rad | c, N m s/rad | strength, N m | yield angle, rad |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for rung in figures["rungs"]:
        found = rung["parameters"]
        cells = [cell(found[path]) if path in found else "-" for path in TRUTH]
        change = "the paper's model" if rung["change"] == "-" else f"`{rung['change']}`"
        rows.append(f"| {change} | {rung['chi_square']:,.0f} | {' | '.join(cells)} |")
    values = figures["rungs"][-1]["values"]
    true = " | ".join(f"{truth:g}" for truth in TRUTH.values())
    return [*rows, f"| truth | {values:,} values | {true} |"]


LADDER_FRICTION = Study(
    name="ladder_friction",
    title="Stepwise model selection with friction",
    meaning=(
        "`giajax suspects --ladder` is applied to `data/independent/friction.csv`, a recording "
        "simulated by MuJoCo, starting from a fit of the paper's model. That model omits Dahl "
        "friction, distributed drag along the links, and added mass without its velocity "
        "products. The command has no information about the omitted effects."
    ),
    size=1,
    seed=1,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
