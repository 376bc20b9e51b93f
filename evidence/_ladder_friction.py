"""The ladder on a recording of another engine: from the paper's model to joints with memory.

`data/independent/friction.csv` has Dahl's friction in every joint, drag along the links, and added
mass without its products of velocities, none of which the paper's model has. The fit that the
ladder starts from is that model's, and no step is told what comes next.
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
# The engine's: 0.09 N m at 45 N m/rad.
TRUTH = {
    "air.drag_coefficient": 0.95,
    "joints.pitch_stiffness": 3.3,
    "joints.damping": 0.05,
    "joints.memory.strength": 0.09,
    "joints.memory.yield_angle": 0.002,
}
# Steps, as many as the command takes.
MOST = 8


def run(size: int, seed: int) -> Figures:
    """Figures of the ladder; the recording is the stored one, whatever size and seed."""
    return _climbed(MOST)


def part(size: int, seed: int) -> Figures:
    """The first fit: what the ladder asks of it takes minutes to compile."""
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
    """A row for each fit."""
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
    meaning=(
        "`giajax suspects --ladder` is applied to `data/independent/friction.csv`, a recording "
        "simulated by MuJoCo, starting from a fit of the paper's model. That model omits Dahl "
        "friction, distributed drag along the links, and added mass without its velocity "
        "products. The command is not told which effects are omitted."
    ),
    size=1,
    seed=1,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
