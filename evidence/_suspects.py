"""Suspects: whether an omission is detected, and is among the first three suspects.

The arm of `fits/full_air.toml` is simulated with its commands and 10 mm of white noise. The fitted
model lacks one effect (or the recording has one error), and the initial guess is away from the
truth. The omission is seen if the verdict is `inadequate`. It is found if it, or an effect that the
data can hardly distinguish from it, is among the first three suspects. For a random walk in place
of the motion there is no correct answer, so the first suspects are counted.
"""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ._record import ROOT
from ._study import Figures, Study, shares_differ

if TYPE_CHECKING:
    from giajax import FitResult, Run

NOISE = 0.01
FIRST = 3
# Maximum number of steps: with wrong axes or without motion, a fit moves far from the truth.
MOST = 80

START = {
    "air.drag_coefficient": 0.8,
    "joints.pitch_stiffness": 2.2,
    "joints.yaw_stiffness": 20.0,
    "joints.damping": 0.12,
}
# Effects of the simulated arm that the fitted one lacks: the wind is 0.1 m/s, the rotation 3 deg.
ADDED: dict[str, Any] = {
    "air.wind": [0.06, 0.06, 0.053],
    "joints.friction": 0.06,
    "camera.rotation": np.deg2rad([1.73, 1.73, 1.73]).tolist(),
    "camera.delay": 0.2,
}
# Effects that are removed from the fitted arm.
TAKEN = ("air.added_mass_coefficient", "arm.drag = strip", "buoyancy.trim_depth")
AXES, WALK = "axes: y and z swapped", "a random walk"
CASES = (*TAKEN, *ADDED, AXES, WALK)


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` recordings of each case; every other one states the noise.

    Each recording has its own random numbers.
    """
    import jax

    jax.config.update("jax_enable_x64", True)
    return {name: _figures(name, size, [seed, CASES.index(name)]) for name in CASES}


def _figures(name: str, size: int, entropy: list[int]) -> Figures:
    import giajax

    truth, fitted = _models(name)
    motion = giajax.predict(truth, _recording())
    ranks: Counter[int | None] = Counter()
    before: Counter[str] = Counter()
    inadequate = 0
    for number in range(size):
        random = np.random.default_rng([*entropy, number])
        recording = _recorded(name, motion, random, stated=number % 2 == 0)
        result = giajax.fit(
            fitted, recording, free=list(START), start=START, max_iterations=MOST, check=False
        )
        inadequate += result.verdict.status == "inadequate"
        paths = _first(result, recording)
        rank = next((i for i, those in enumerate(paths, 1) if name in those), None)
        ranks[rank] += 1
        if rank != 1:
            before[paths[0][0] if paths else "nothing"] += 1
    return {
        "recordings": size,
        "inadequate": inadequate,
        "found": size - ranks[None],
        "first": ranks[1],
        "confused_with": dict(before.most_common()),
    }


def _first(result: "FitResult", recording: "Run") -> list[tuple[str, ...]]:
    """Return the first suspects, each with those that are indistinguishable."""
    import giajax

    try:
        rows = giajax.suspects(result, recording).promising[:FIRST]
    except giajax.InputError:
        # With all parts switched on, the model may not be computable where the fit ended.
        return []
    return [(row.path.partition("[")[0], *row.alike) for row in rows]


def _models(name: str) -> tuple[Any, Any]:
    """Return the simulated arm and the fitted arm."""
    import giajax

    recording = _recording()
    model: Any = giajax.models.capabilities.with_integration(
        giajax.model_for([recording]), solver="springs5", tolerance=1e-6
    )
    whole = giajax.replace(model, recording.definition.truth)

    def with_arm(change: Callable[[Any], Any]) -> Any:
        return dataclasses.replace(model, arm=change(model.arm))

    def without_air(**choices: Any) -> Any:
        return with_arm(
            lambda arm: dataclasses.replace(arm, air=dataclasses.replace(arm.air, **choices))
        )

    if name == "air.added_mass_coefficient":
        return whole, without_air(added_mass_coefficient=None)
    if name == "arm.drag = strip":
        return whole, without_air(drag="centre")
    if name == "buoyancy.trim_depth":
        bare = dataclasses.replace(model.arm.buoyancy, trim_depth=None)
        return whole, with_arm(lambda arm: dataclasses.replace(arm, buoyancy=bare))
    more = {path: value for path, value in ADDED.items() if path == name}
    return giajax.replace(whole, more), model


def _recording() -> "Run":
    import giajax

    return giajax.read_run(ROOT / "data" / "synthetic" / "full_air.csv")


def _recorded(
    name: str, motion: Mapping[str, np.ndarray], random: np.random.Generator, *, stated: bool
) -> "Run":
    """Return the recording of a motion in the case of this name."""
    import giajax

    values = {key: row + NOISE * random.normal(size=len(row)) for key, row in motion.items()}
    if name == AXES:
        other = {"x": "x", "y": "z", "z": "y"}
        values = {key: values[key[:-1] + other[key[-1]]] for key in values}
    if name == WALK:
        walk = {key: 0.03 * random.normal(size=len(row)) for key, row in values.items()}
        values = {key: np.cumsum(row) for key, row in walk.items()}
    like = _recording()
    sections = like.definition.contents()
    del sections["sha256"]
    sections["noise"] = {"position_m": NOISE} if stated else {}
    return giajax.Run.from_arrays(
        like.times, {**like.commands, **values}, name=name, definition=sections
    )


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report counts that differ with a probability below `PROBABILITY`."""
    return differing(stored, new, {"found": "found in", "inadequate": "judged inadequate in"})


def differing(stored: Figures, new: Figures, counts: Mapping[str, str]) -> list[str]:
    """Report counts that differ with a probability below `PROBABILITY` (Fisher's exact test).

    `counts` maps the keys of counted recordings to their descriptions. The new figures may contain
    only some of the cases.
    """
    sentences = []
    for name, after in new.items():
        before = stored.get(name)
        if before is None:
            sentences.append(f"{name}: no figures of this case are stored: run the study again")
            continue
        n, m = before["recordings"], after["recordings"]
        for key, what in counts.items():
            a, b = before[key], after[key]
            if shares_differ(a, n, b, m):
                sentences.append(f"{name}: {what} {b} of {m} recordings, and {a} of {n} were")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each omission."""
    rows = [
        "| omitted effect | verdict `inadequate` | effect among the first three suspects | effect "
        "is the first suspect | other first suspects |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        rows.append(
            f"| `{name}` | {each['inadequate']} of {each['recordings']} | "
            f"{each['found']} of {each['recordings']} | {each['first']} | "
            f"{listed(each['confused_with'])} |"
        )
    return rows


def listed(counts: Mapping[str, int]) -> str:
    """Return the other first suspects, and how often each occurs."""
    return ", ".join(f"`{path}` ({count})" for path, count in counts.items()) or "-"


SUSPECTS = Study(
    name="suspects",
    meaning=(
        "Runs of the arm of `fits/full_air.toml` have noise of 10 mm, which is stated in every "
        "second run. They are fitted with a model that omits one effect. The table lists how "
        "often the verdict is `inadequate`, and how often the omitted effect, or an effect that "
        "the data can hardly distinguish from it, is among the first three suspects. A random "
        "walk does not correspond to any suspect."
    ),
    size=6,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
