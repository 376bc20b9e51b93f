"""Fits of what a designed experiment records, of an arm as foreseen and of one that was not."""

import math
from typing import Any

import numpy as np

from ._study import Figures

TRUTH = {
    "air.drag_coefficient": 1.12,
    "joints.pitch_stiffness": 2.7,
    "joints.damping": 0.065,
}
START = {
    "air.drag_coefficient": 0.9,
    "joints.pitch_stiffness": 3.2,
    "joints.damping": 0.09,
}
DRAG = "air.drag_coefficient"
MEMORY = {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.01}
GUSTS: dict[str, Any] = {"mean": [0.01, 0.005, 0.005], "intensity": 0.3, "length_scale": 5.0}
CHANNELS = [f"link{link:02d}_z" for link in (2, 6, 12, 20)]
NOISE = 0.02
TOLERANCE = 1e-5
# An arm that remembers takes several times as many steps, and a fit of it as much longer.
FEWER = 2
FIRST = 3
# What the fits of the unknown arm have free, in the order in which it is asked for, with its start.
# Across the plane in which the arm moves and is seen, no wind shows.
ASKED: tuple[dict[str, float], ...] = (
    {"air.wind[0]": 0.0, "air.wind[2]": 0.0},
    {"joints.memory.strength": 0.04, "joints.memory.yield_angle": 0.006},
)
# What has to be there for that.
SWITCHED: tuple[dict[str, Any], ...] = ({"air.wind": [0.0, 0.0, 0.0]}, MEMORY)


def fits(plan: Any, size: int, entropy: list[int], *, unknown: bool) -> Figures:
    """What fits of recordings of one experiment make of C_D."""
    import giajax

    fitted, start = _asked(len(ASKED) if unknown else 0)
    still = None if unknown else giajax.predict(giajax.replace(fitted, TRUTH), plan, CHANNELS)
    values, errors, converged, covered = [], [], 0, 0
    for number in range(size):
        result = _fit(fitted, start, _recorded(plan, [*entropy, number], still))
        converged += result.status == "converged"
        estimate = result.parameters[DRAG]
        values.append(float(estimate.value))
        errors.append(estimate.standard_error or math.nan)
        low, high = estimate.interval or (math.nan, math.nan)
        covered += low <= TRUTH[DRAG] <= high
    return {
        "fits": size,
        "converged": converged,
        "covered": covered,
        "mean": float(np.mean(values)),
        "spread": float(np.std(values, ddof=1)),
        "stated": float(np.nanmean(errors)),
    }


def suggested(plan: Any, entropy: list[int]) -> list[list[str]]:
    """The first suspects, as many as a ladder tries, of fits of the unknown arm with less free."""
    import giajax

    recording = _recorded(plan, [*entropy, 0], None)
    fitted = (_fit(*_asked(count), recording) for count in range(len(ASKED)))
    return [
        [row.path for row in giajax.suspects(one, recording).promising[:FIRST]] for one in fitted
    ]


def _asked(count: int) -> tuple[Any, dict[str, float]]:
    """A model that has so much of what is asked for, and where its fits begin."""
    import giajax

    start, extras = dict(START), {}
    for more, switched in zip(ASKED[:count], SWITCHED, strict=False):
        start.update(more)
        extras.update(switched)
    return model_of(giajax.takeichi_20m(20, parameters=extras)), start


def _fit(model: Any, start: dict[str, float], recording: Any) -> Any:
    import giajax

    return giajax.fit(model, recording, free=list(start), start=start, check=False)


def _recorded(plan: Any, entropy: list[int], motion: dict[str, np.ndarray] | None) -> Any:
    """A recording of a motion, or where there is none, of the unknown arm in gusts of its own."""
    import giajax

    random = np.random.default_rng(entropy)
    if motion is None:
        unknown = model_of(giajax.takeichi_20m(20, parameters={**TRUTH, **MEMORY}))
        motion = _in_gusts(unknown, plan, int(random.integers(1 << 31)))
    return giajax.Run.from_arrays(
        plan.times,
        {
            **plan.commands,
            **{key: row + NOISE * random.normal(size=len(row)) for key, row in motion.items()},
        },
        noise={"position": NOISE},
        definition={"arm": {"links": 20}},
    )


def model_of(arm: Any) -> Any:
    import giajax

    return giajax.ArmModel(arm).with_integration(solver=None, tolerance=TOLERANCE)


def _in_gusts(model: Any, plan: Any, seed: int) -> dict[str, np.ndarray]:
    import giajax

    wind = giajax.gusts(**GUSTS, duration=float(plan.times[-1]), seed=seed)
    inputs = {**plan.commands, **wind.at(plan.times)}
    run = giajax.synthesise(model, plan.times, inputs, CHANNELS)
    return {name: run.observations[name] for name in CHANNELS}
