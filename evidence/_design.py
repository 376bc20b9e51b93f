"""Design: what the experiment that `giajax design` finds is worth, in fits of what it records.

The paper's arm, its base step and its four markers, seen from the side with 20 mm of noise. The
design has the same joint, angle, rate and duration, and knows drag, stiffness and damping to a
fifth. Then both experiments are recorded again and again and fitted from a start away from the
truth: once by an arm that is as the design took it to be, and once by one that the design did not
know, whose joints remember and which hangs in gusts that nobody recorded. The fit of the latter has
the strength of the joints' memory free, too, and takes the gusts for noise.
"""

import math
from typing import Any

import numpy as np

from ._study import Figures, Study

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
FEWER = 20
# Of a disagreement by chance, for each of the comparisons.
PROBABILITY = 1e-4


def run(size: int, seed: int) -> Figures:
    """The design, `size` fits of each experiment, and a twentieth of them where joints remember."""
    import jax

    import giajax

    jax.config.update("jax_enable_x64", True)
    arm = giajax.takeichi_20m(20)
    model = _model(giajax.replace(arm, TRUTH))
    found = giajax.design_experiment(
        model,
        [DRAG],
        giajax.Limits(),
        free=list(TRUTH),
        channels=CHANNELS,
        noise={"position": NOISE},
        draw_count=2,
        starts=3,
        follow=1,
        iterations=20,
    )
    experiments = {"base step": found.base_step, "design": found.designed}
    return {
        "ratio": round(found.ratio or math.nan, 4),
        "over_draws": [round(share, 3) for share in found.spread],
        "evaluations": len(found.evaluations),
        "corners": {
            "time_s": found.designed.drive.times.tolist(),
            "angle_deg": [
                round(math.degrees(angle), 3)
                for angle in found.designed.drive.values["joint01_command"]
            ],
        },
        "experiments": {
            name: {
                "expected": expected.errors[DRAG],
                "as_foreseen": _fits(expected.run, size, [seed, place], unknown=False),
                "unknown": _fits(
                    expected.run, max(2, size // FEWER), [seed, place, 1], unknown=True
                ),
            }
            for place, (name, expected) in enumerate(experiments.items())
        },
    }


def _fits(plan: Any, size: int, entropy: list[int], *, unknown: bool) -> Figures:
    """What fits of recordings of one experiment make of C_D."""
    import giajax

    more = MEMORY if unknown else {}
    arm = giajax.takeichi_20m(20, parameters=more)
    fitted = _model(arm)
    true = giajax.replace(fitted, TRUTH)
    start = {**START, **({"joints.memory.strength": 0.04} if unknown else {})}
    values, errors, converged = [], [], 0
    still = None if unknown else giajax.predict(true, plan, CHANNELS)
    for number in range(size):
        random = np.random.default_rng([*entropy, number])
        motion = _in_gusts(true, plan, int(random.integers(1 << 31))) if still is None else still
        recorded = giajax.Run.from_arrays(
            plan.times,
            {
                **plan.commands,
                **{key: row + NOISE * random.normal(size=len(row)) for key, row in motion.items()},
            },
            noise={"position": NOISE},
            definition={"arm": {"links": 20}},
        )
        result = giajax.fit(fitted, recorded, free=list(start), start=start, check=False)
        converged += result.status == "converged"
        estimate = result.parameters[DRAG]
        values.append(float(estimate.value))
        errors.append(estimate.standard_error or math.nan)
    return {
        "fits": size,
        "converged": converged,
        "mean": float(np.mean(values)),
        "spread": float(np.std(values, ddof=1)),
        "stated": float(np.nanmean(errors)),
    }


def _model(arm: Any) -> Any:
    import giajax

    return giajax.ArmModel(arm).with_integration(solver=None, tolerance=TOLERANCE)


def _in_gusts(model: Any, plan: Any, seed: int) -> dict[str, np.ndarray]:
    import giajax

    wind = giajax.gusts(**GUSTS, duration=float(plan.times[-1]), seed=seed)
    inputs = {**plan.commands, **wind.at(plan.times)}
    run = giajax.synthesise(model, plan.times, inputs, CHANNELS)
    return {name: run.observations[name] for name in CHANNELS}


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Another design, or spreads that differ by more than chance lets them (an F test)."""
    from scipy import stats

    sentences = []
    if abs(stored["ratio"] - new["ratio"]) > 0.02:
        sentences.append(f"the ratio is {new['ratio']}, and {stored['ratio']} is stored")
    for name, before in stored["experiments"].items():
        after = new["experiments"][name]
        for world in ("as_foreseen", "unknown"):
            a, b = before[world], after[world]
            ratio = stats.f(b["fits"] - 1, a["fits"] - 1)
            square = (b["spread"] / a["spread"]) ** 2
            if min(ratio.cdf(square), ratio.sf(square)) < PROBABILITY / 2:
                sentences.append(
                    f"{name}, {world}: C_D spreads by {b['spread']:.2g}, and did by "
                    f"{a['spread']:.2g}"
                )
    return sentences


def table(figures: Figures) -> list[str]:
    """A row for each experiment and arm."""
    rows = [
        "| arm | experiment | fits | error of C_D expected | stated by the fits | spread of C_D "
        "| mean (1.12) |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for world, what in (("as_foreseen", "as foreseen"), ("unknown", "with memory and gusts")):
        for name, each in figures["experiments"].items():
            one = each[world]
            foreseen = f"{each['expected']:.5f}" if world == "as_foreseen" else "-"
            error = one["spread"] / math.sqrt(2 * (one["fits"] - 1))
            rows.append(
                f"| {what} | {name} | {one['converged']} of {one['fits']} | {foreseen} | "
                f"{one['stated']:.5f} | {one['spread']:.5f} +- {error:.5f} | {one['mean']:.4f} |"
            )
    low, high = figures["over_draws"]
    rows += [
        "",
        f"Expected is {figures['ratio']:.3f} times the error of the base step, after "
        f"{figures['evaluations']} evaluations; {low:.2f} to {high:.2f} times the error of the "
        "design over the draws of what it did not know.",
    ]
    return rows


DESIGN = Study(
    name="design",
    meaning=(
        "The experiment that `giajax design` finds for C_D, with joint, angle, rate and duration "
        "of the paper's base step, beside that: the standard error to expect, and the spread of "
        "C_D in fits of repeated recordings. Of an arm that the design did not know there are a "
        "twentieth as many: its joints remember (Dahl), which the fit has free, and it hangs in "
        "gusts that nobody recorded."
    ),
    size=200,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
