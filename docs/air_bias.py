"""Bias of a fit whose model omits effects of the air: the table of docs/air.md.

    python docs/air_bias.py             measure, and write the table into docs/air.md
    python docs/air_bias.py --print     measure and print

Simulated runs of the arm with all effects of the air are fitted with the model that generated them
and with models that omit some effects. The bias is that of the estimate, in per cent of the true
value. The standard error is the one that the fit reports.
"""

import dataclasses
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from giajax import FitResult, Run, fit, read_run, replace, takeichi_20m
from giajax.apps.synthetic import synthesise
from giajax.mechanics.arm import Arm
from giajax.models import ArmModel, model_for

ROOT = Path(__file__).resolve().parents[1]
CALM = read_run(ROOT / "data" / "synthetic" / "full_air.csv")
TRUTH: dict[str, float] = CALM.definition.truth
PAGE = Path(__file__).with_name("air.md")
BEGIN, END = "<!-- air_bias.py writes from here -->\n", "<!-- to here -->\n"

START = {
    "air.drag_coefficient": 0.6,
    "joints.pitch_stiffness": 1.6,
    "joints.yaw_stiffness": 15.0,
    "joints.damping": 0.15,
}
BREEZE = (0.03, 0.04, 0.05)


def _with_air(arm: Arm, **changes: Any) -> Arm:
    return dataclasses.replace(arm, air=dataclasses.replace(arm.air, **changes))


def _arm_model(run: Run) -> ArmModel:
    model = model_for([run])
    assert isinstance(model, ArmModel)
    return model


def breezy() -> Run:
    """Simulate the same run in a steady breeze that is not recorded."""
    assert CALM.times is not None
    truth = replace(_arm_model(CALM), {**TRUTH, "air.wind": BREEZE})
    return synthesise(
        truth,
        CALM.times,
        CALM.commands,
        sorted(CALM.observations),
        noise={"position": 0.01},
        seed=6,
        definition={"arm": {"links": truth.arm.count}},
    )


# For each row: the run, the change of the true arm, and the free parameters besides those of START.
ROWS: dict[str, tuple[str, Callable[[Arm], Arm], tuple[str, ...]]] = {
    "generating model": ("calm", lambda arm: arm, ()),
    "no added mass": (
        "calm",
        lambda arm: _with_air(arm, added_mass_coefficient=None),
        (),
    ),
    "drag at the centres of the links (eq. 1)": (
        "calm",
        lambda arm: _with_air(arm, drag="centre"),
        (),
    ),
    "the paper's model: eq. (1), 0.047 kg per link": (
        "calm",
        lambda arm: takeichi_20m(arm.count),
        (),
    ),
    "generating model, with the wind as parameters": (
        "breeze",
        lambda arm: _with_air(arm, wind=0.0),
        ("air.wind",),
    ),
    "generating model, without the wind": ("breeze", lambda arm: arm, ()),
}


def fitted(row: str, runs: dict[str, Run]) -> FitResult:
    """Fit one row of the table."""
    which, change, more = ROWS[row]
    model = ArmModel(change(_arm_model(runs["calm"]).arm))
    start = {**START, **{f"{path}[{axis}]": 0.0 for path in more for axis in range(3)}}
    # White noise, because correlated noise would partly absorb the missing physics.
    return fit(
        model,
        runs[which],
        free=[*TRUTH, *more],
        start=start,
        noise_model="white",
        check=False,
    )


def line(row: str, result: FitResult) -> str:
    """Return one row of the table."""
    drag, stiffness = (
        result.parameters[path] for path in ("air.drag_coefficient", "joints.pitch_stiffness")
    )
    cells = [ROWS[row][0], row]
    for estimate, path in ((drag, "air.drag_coefficient"), (stiffness, "joints.pitch_stiffness")):
        bias = 100 * (estimate.value / TRUTH[path] - 1)
        error = estimate.standard_error
        said = "-" if error is None else f"{error:.2g}"
        cells += [f"{estimate.value:.3f}", said, f"{bias:+.1f} %"]
    assert result.reduced_chi_square is not None
    cells.append(f"{np.sqrt(result.reduced_chi_square):.2f}")
    return "| " + " | ".join(cells) + " |"


def table(runs: dict[str, Run]) -> str:
    """Return the whole table as Markdown."""
    heads = ["air", "fitted with", "C_D", "error", "bias", "k, N m/rad", "error", "bias"]
    heads.append("residuals over noise")
    lines = ["| " + " | ".join(heads) + " |", "| --- | --- |" + " --- |" * 7]
    for row in ROWS:
        result = fitted(row, runs)
        if result.status != "converged":
            raise SystemExit(f"the fit with {row} {result.status}: {result.message}")
        lines.append(line(row, result))
        print(lines[-1], flush=True)
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> int:
    """Measure, then write or print the table; return the exit status."""
    if arguments not in ([], ["--print"]):
        print(f"usage: {Path(__file__).name} [--print]", file=sys.stderr)
        return 2
    jax.config.update("jax_enable_x64", True)
    found = table({"calm": CALM, "breeze": breezy()})
    if not arguments:
        before, _, rest = PAGE.read_text().partition(BEGIN)
        PAGE.write_text(before + BEGIN + "\n" + found + "\n" + END + rest.partition(END)[2])
        print(f"written to {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
