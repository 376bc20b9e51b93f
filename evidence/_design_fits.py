"""Fits of designed experiments, for an arm as assumed by the design and for another one."""

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
# An arm with joint memory takes several times as many integration steps, so fewer are fitted.
FEWER = 2
FIRST = 3
# Parameters freed in the fits of the unknown arm, in order, with their start values. The wind
# perpendicular to the plane of the motion and the view has no effect on the recording.
ASKED: tuple[dict[str, float], ...] = (
    {"air.wind[0]": 0.0, "air.wind[2]": 0.0},
    {"joints.memory.strength": 0.04, "joints.memory.yield_angle": 0.006},
)
# Parts of the model that these parameters require.
SWITCHED: tuple[dict[str, Any], ...] = ({"air.wind": [0.0, 0.0, 0.0]}, MEMORY)


def fits(plan: Any, size: int, entropy: list[int], *, unknown: bool) -> Figures:
    """Return the estimates of C_D from fits of recordings of one experiment."""
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
    """Return the first suspects of fits of the unknown arm with fewer free parameters."""
    import giajax

    recording = _recorded(plan, [*entropy, 0], None)
    fitted = (_fit(*_asked(count), recording) for count in range(len(ASKED)))
    return [
        [row.path for row in giajax.suspects(one, recording).promising[:FIRST]] for one in fitted
    ]


def _asked(count: int) -> tuple[Any, dict[str, float]]:
    """Return a model with the first `count` additions, and the initial guess of its fits."""
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
    """Return a recording of a motion; None simulates the unknown arm in new gusts."""
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
