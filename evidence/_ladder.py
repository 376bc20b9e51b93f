"""Stepwise model selection from the paper's model to an arm in full air.

The recording `data/synthetic/full_air.csv` is from an arm with trim weights, added mass and drag
along its links. The ladder starts from a fit of the paper's model, which has none of these effects
and 0.047 kg per link, and receives no information on the missing effects. Positions determine
forces relative to mass. With the moving mass of a link, which the recording does not determine, all
parameters follow.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ._record import ROOT
from ._study import Figures, Study

if TYPE_CHECKING:
    from giajax import FitResult, Run
    from giajax.studies import Step, StepwiseSelection

START = {
    "air.drag_coefficient": 0.6,
    "joints.pitch_stiffness": 1.6,
    "joints.yaw_stiffness": 15.0,
    "joints.damping": 0.15,
}
RECORDING = ROOT / "data" / "synthetic" / "full_air.csv"
# Number of steps, equal to the default of the command.
MOST = 8
# Tolerances for rounding errors on another machine: relative for chi-square, and in standard errors
# for parameters.
SAME, NEAR = 1e-2, 0.1


def run(size: int, seed: int) -> Figures:
    """Return the figures of the ladder for the stored recording; size and seed are not used."""
    return {"scale": _scale(), **_climbed(MOST)}


def part(size: int, seed: int) -> Figures:
    """Return the first fit only, because the suspects of a ladder take minutes to compile."""
    return _climbed(0)


def _climbed(most: int) -> Figures:
    """Return the steps of a ladder with at most `most` steps, and the result of the last one."""
    return _figures(climbed(RECORDING, START, most))


def climbed(path: Path, start: Mapping[str, float], most: int) -> "StepwiseSelection":
    """Return a ladder with at most `most` steps on a recording, from the paper's model."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import giajax

    recording = giajax.read_run(path)
    model = giajax.ArmModel(giajax.takeichi_20m())
    # Only complete ladders estimate correlated noise. The part of the study uses white noise.
    noise = "correlated" if most else "white"
    first = giajax.fit(
        model, recording, free=list(start), start=start, check=False, noise_model=noise
    )
    return giajax.ladder(first, recording, most=most)


def _recording() -> "Run":
    import giajax

    return giajax.read_run(RECORDING)


def _moving_mass(model: Any) -> float:
    """Return the mass that moves with a link without added mass, kg; equal for all links."""
    import giajax.mechanics.arm

    return float(np.mean(giajax.mechanics.arm.bodies(model.arm).mass))


def _figures(steps: "StepwiseSelection") -> Figures:
    import giajax

    recording = _recording()
    truth = recording.definition.truth
    moving = _moving_mass(giajax.model_for([recording]))
    last = steps.result
    per = _moving_mass(last.model)
    return {
        "rungs": [rung_of(rung) for rung in steps.steps],
        "ending": steps.ending,
        "moving_mass": moving,
        "for_their_mass": {
            path: {**_estimate(last, path, per), "truth": truth[path] / moving} for path in START
        },
        "with_the_mass": {
            path: {**_estimate(last, path, per / moving), "truth": truth[path]} for path in START
        },
        "imitated": _imitated(steps),
    }


def rung_of(rung: "Step") -> dict[str, Any]:
    return {
        "change": rung.change,
        "chi_square": rung.chi_square,
        "values": rung.values,
        "bic": rung.bic,
        "moving_mass": _moving_mass(rung.result.model),
        "parameters": {path: _estimate(rung.result, path) for path in rung.result.free},
    }


def _estimate(result: "FitResult", path: str, per: float = 1.0) -> dict[str, float | None]:
    """Return value and standard error of a parameter, divided by `per`."""
    one = result.parameters[path]
    error = None if one.standard_error is None else one.standard_error / per
    return {"value": one.value / per, "error": error}


def _imitated(steps: "StepwiseSelection") -> list[str]:
    """Return the suspects that the fitted parameters of the last tested fit imitate."""
    asked = [rung.suspects for rung in steps.steps if rung.suspects is not None]
    return [row.path for row in asked[-1].untestable if "imitates" in row.note] if asked else []


def _scale() -> dict[str, Any]:
    """Return the parameters without a standard error in a fit with free masses."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import giajax

    recording = _recording()
    model = giajax.ArmModel(giajax.takeichi_20m())
    links = model.arm.links
    ties = {"links.mass": "links.mass[0]"}
    for name in ("inertia_transverse", "inertia_axial"):
        ratio = float(getattr(links, name)[0] / links.mass[0])
        ties[f"links.{name}"] = f"{ratio} * links.mass"
    free = ["links.mass", *START]
    result = giajax.fit(model, recording, free=free, start=START, ties=ties, check=False)
    return {
        "without_error": [path for path, one in result.free.items() if one.standard_error is None],
        "findings": [finding.code for finding in result.findings],
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report fits that end elsewhere, although the recording is the same."""
    sentences: list[str] = []
    # The part of the study contains only the first fit.
    if 1 < len(new["rungs"]) != len(stored["rungs"]):
        sentences.append(f"{len(new['rungs'])} fits in place of {len(stored['rungs'])}")
    for before, after in zip(stored["rungs"], new["rungs"], strict=False):
        name = after["change"]
        if name != before["change"]:
            return [*sentences, f"{name}: {before['change']} is stored"]
        if abs(after["chi_square"] / before["chi_square"] - 1) > SAME:
            now, then = after["chi_square"], before["chi_square"]
            sentences.append(f"{name}: chi-square is {now:.6g}, and was {then:.6g}")
        for path, one in after["parameters"].items():
            other = before["parameters"][path]
            if abs(one["value"] - other["value"]) > NEAR * (other["error"] or np.inf):
                now, then = one["value"], other["value"]
                sentences.append(f"{name}: {path} is {now:.6g}, and was {then:.6g}")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each fit."""
    shown = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.damping")
    rows = [
        "| fit | chi-square | moving mass, kg | C_D | k, N m/rad | c, N m s/rad |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for rung in figures["rungs"]:
        cells = [cell(rung["parameters"][path]) for path in shown]
        change = "the paper's model" if rung["change"] == "-" else f"`{rung['change']}`"
        rows.append(
            f"| {change} | {rung['chi_square']:,.0f} | {rung['moving_mass']:.4f} | "
            f"{' | '.join(cells)} |"
        )
    values, mass = figures["rungs"][-1]["values"], figures["moving_mass"]
    true = [f"{figures['with_the_mass'][path]['truth']:g}" for path in shown]
    return [*rows, f"| truth | {values:,} values | {mass:.4f} | {' | '.join(true)} |"]


def cell(estimate: Mapping[str, float | None]) -> str:
    error = estimate["error"]
    said = "-" if error is None else f"{error:.4f}"
    return f"{estimate['value']:.4f} +- {said}"


LADDER = Study(
    name="ladder",
    title="Stepwise model selection",
    meaning=(
        "`giajax suspects --ladder` is applied to `data/synthetic/full_air.csv`, starting from a "
        "fit of the paper's model. That model omits trim weights, added mass and distributed drag "
        "along the links. The command has no information about the omitted effects."
    ),
    size=1,
    seed=1,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
