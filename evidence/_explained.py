"""Explanations: `giajax explain` for recordings with five simultaneous omissions.

The motions are those of `_omissions`. Each recording has one effect from each of five groups of
`GROUPS`, selected at random, that the paper's model does not have. The findings are compared with a
fit of the model that a person who knows all five effects would build.
"""

import dataclasses
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _omissions as omissions
from ._omissions import AND, OFF, START, shown
from ._study import Figures, Study

if TYPE_CHECKING:
    from giajax import FitResult

DRAG = "air.drag_coefficient"
SENSORS = "12 of 10 mm"
LIMIT = 15 * 60.0  # time limit of an explanation, s


@dataclasses.dataclass(frozen=True)
class ByHand:
    """Additions to the paper's model that describe an omission correctly.

    Attributes:
        free: additional free parameters.
        arm: keys of `[arm]`.
        start: start values.
        loss: loss function of the fit.
    """

    free: tuple[str, ...] = ()
    arm: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    start: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    loss: str = "linear"


GROUPS: dict[str, dict[str, ByHand]] = {
    "time of the camera": {
        "camera 50 ms late": ByHand(("camera.delay",)),
        "clock 0.5 % slow": ByHand(("camera.clock_rate",)),
    },
    "place of the camera": {
        "camera turned 2 deg": ByHand(("camera.rotation",)),
        "camera 2 cm aside": ByHand(("camera.origin",)),
        "lens with k1 = -0.05": ByHand(("camera.lens_k1",)),
    },
    "drives": {
        "drives with a lag of 0.4 s": ByHand(("joints.drive_lag",)),
        "drives reach 97 %": ByHand(("joints.drive_gain",)),
    },
    "air": {
        "wind of 5 cm/s": ByHand(("air.wind",)),
        "drag along the links": ByHand(arm={"drag": "strip"}),
    },
    "joints": {
        "stiffness leaks by 30 %": ByHand(("joints.stiffness_drift",)),
        "joints remember 0.03 N m": ByHand(
            ("joints.memory.strength", "joints.memory.yield_angle"),
            start={"joints.memory.strength": 0.02, "joints.memory.yield_angle": 0.02},
        ),
        "joints harden": ByHand(
            ("joints.laws.hardening.cubic",), arm={"joint_laws": ["hardening"]}
        ),
    },
    "cells": {"2 % of cells wrong by 0.3 m": ByHand(loss="huber")},
}


def drawn(seed: int, number: int) -> str:
    """Return the joined names of five omissions, one from each group except one."""
    random = np.random.default_rng([seed, number])
    left_out = random.choice(list(GROUPS))
    chosen = [str(random.choice(list(of))) for name, of in GROUPS.items() if name != left_out]
    return AND.join(chosen)


def run(size: int, seed: int) -> Figures:
    """Return the findings for `size` recordings, two at a time on one core each."""
    names = [drawn(seed, number) for number in range(size)]
    arguments = [{"name": name, "entropy": [seed, at]} for at, name in enumerate(names)]
    found = omissions.kept(one, arguments, every=1)
    return {f"{at}: {name}": each for at, (name, each) in enumerate(zip(names, found, strict=True))}


def part(size: int, seed: int) -> Figures:
    """Return the fit by hand of a recording without joint memory, which would take minutes."""
    number = next(at for at in range(100) if "remember" not in drawn(seed, at))
    name = drawn(seed, number)
    result, truth = by_hand(name, [seed, number])
    return {f"{number}: {name}": {"by hand": of_drag(result, truth)}}


def one(name: str, entropy: list[int], code: str | None) -> Figures:
    """Return the explanation of one recording; `code` is the commit of giajax."""
    del code
    from giajax.studies import explain

    recording, _ = omissions.recorded(name, SENSORS, entropy)
    begun = time.perf_counter()
    found = explain(omissions.fitted(recording), recording, budget_s=LIMIT)
    minutes = (time.perf_counter() - begun) / 60
    hand, truth = by_hand(name, entropy)
    drag = next(each for each in found.record.parameters if each.path == DRAG)
    return {
        "minutes": round(minutes, 1),
        "ended": found.record.ended,
        "sentences": list(found.record.sentences),
        "steps": [step.change for step in found.record.steps[1:] if step.kind != "data"],
        "explained": of_drag(found.result, truth, drag.total_error),
        "by hand": of_drag(hand, truth),
    }


def by_hand(name: str, entropy: list[int]) -> tuple["FitResult", float]:
    """Fit the model with all omitted effects and no others; also return the true C_D."""
    import giajax

    known = {one: hand for of in GROUPS.values() for one, hand in of.items()}
    parts = [known[one] for one in name.split(AND)]
    arm = {key: value for each in parts for key, value in each.arm.items()}
    recording, truth = omissions.recorded(name, SENSORS, entropy, **arm)
    model: Any = giajax.model_for([recording])
    start = {path: value for each in parts for path, value in each.start.items()}
    losses = [each.loss for each in parts if each.loss != "linear"]
    result = giajax.fit(
        model,
        recording,
        free=[*START, *(path for each in parts for path in each.free)],
        start={**START, **start},
        loss=losses[0] if losses else "linear",
        check=False,
    )
    return result, truth[DRAG]


def of_drag(
    result: "FitResult", truth: float, error: float | None = None
) -> dict[str, float | None]:
    """Return the drag coefficient, its error, and its deviation in units of this error."""
    found = result.parameters[DRAG]
    error = found.standard_error if error is None else error
    off = None if error is None else (found.value - truth) / error
    return {"value": found.value, "error": error, "off": off}


def _is_right(each: Figures) -> bool:
    off = each["explained"]["off"]
    return off is not None and abs(off) <= OFF


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report a wrong drag from the fit by hand; explanations take too long to be repeated."""
    del stored
    offs = {name: each["by hand"]["off"] for name, each in new.items()}
    return [
        f"{name}: the C_D of the reference model deviates by {off} standard errors"
        for name, off in offs.items()
        if off is None or abs(off) > OFF + 1
    ]


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each recording."""
    rows = [
        "| omitted effects | steps | minutes on one core | verdict | C_D; deviation | C_D of the "
        "reference model; deviation | ratio of the standard error to that of the reference |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        explained, hand = each["explained"], each["by hand"]
        wider = (
            f"{explained['error'] / hand['error']:.2f}"
            if explained["error"] and hand["error"]
            else "-"
        )
        values = [
            f"{of['value']:.4g} +- {of['error']:.2g}, {of['off']:+.1f}"
            if of["error"]
            else f"{of['value']:.4g}"
            for of in (explained, hand)
        ]
        steps = ", ".join(f"`{step}`" for step in each["steps"]) or "-"
        omitted = shown(name.partition(": ")[2].replace(AND, "; "))
        against = len(each["sentences"])
        told = f"{against} objections" if against else "adequate"
        if each["ended"] != "selected":
            told = f"{told}, {each['ended']}"
        cells = [omitted, steps, f"{each['minutes']:g}", told, *values, wider]
        rows.append(f"| {' | '.join(cells)} |")
    right = sum(map(_is_right, figures.values()))
    return [
        *rows,
        "",
        f"The drag coefficient is within three standard errors of the truth in {right} of "
        f"{len(figures)} cases.",
    ]


EXPLAINED = Study(
    name="explained",
    meaning=(
        "MuJoCo simulates recordings of an arm of 12 links with five effects that the initial "
        "model omits. The effects are drawn at random from six groups. `giajax explain` is "
        "applied to these recordings. The table lists the resulting changes of the paper's model. "
        "It compares the estimated drag coefficient with the estimate of a reference model, which "
        "contains all five effects and is built by hand. The true drag coefficient is 1.18. "
        "Standard errors are total errors from noise and from the selection. Deviations from the "
        "truth are divided by the standard error. Each run is limited to 15 minutes on one core. "
        "A run that reaches this limit returns the best model so far."
    ),
    size=10,
    seed=2,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
