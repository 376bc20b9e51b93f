"""Design: value of the experiment from `giajax design`, from fits of simulated recordings.

The study uses the paper's arm, its base step and its four markers, seen from the side with 20 mm of
noise. The design has the same joint, angle, rate and duration, and prior standard deviations of a
fifth for drag, stiffness and damping. Both experiments are then recorded repeatedly and fitted from
an initial guess away from the truth. One arm is as assumed by the design. The other one is not: its
joints have a memory, and there are gusts that nothing records. Its recordings are fitted as a user
would after an examination of the residuals: first with a free mean wind, and then with a joint
memory as well, each of which is among the first suspects of the previous fit (`--ladder` tries
three of them and keeps the best). The remaining effect of the gusts is treated as noise.
"""

import math

from ._design_fits import CHANNELS, DRAG, FEWER, NOISE, TRUTH, fits, model_of, suggested
from ._study import PROBABILITY, Figures, Study


def run(size: int, seed: int) -> Figures:
    """Return figures of the design, `size` fits per experiment, and half as many with memory."""
    import jax

    import giajax

    jax.config.update("jax_enable_x64", True)
    arm = giajax.takeichi_20m(20)
    model = model_of(giajax.replace(arm, TRUTH))
    found = giajax.design_experiment(
        model,
        [DRAG],
        giajax.apps.design.Limits(),
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
                "as_foreseen": fits(expected.run, size, [seed, place], unknown=False),
                "unknown": fits(
                    expected.run, max(2, size // FEWER), [seed, place, 1], unknown=True
                ),
                "suggested": suggested(expected.run, [seed, place, 1]),
            }
            for place, (name, expected) in enumerate(experiments.items())
        },
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report another design, or spreads that differ by more than by chance (F test)."""
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
    """Return a table with a row for each experiment and arm."""
    rows = [
        "| arm | experiment | converged | expected standard error of C_D | standard error in the "
        "fits | standard deviation of C_D | mean of C_D (truth 1.12) | 95 % intervals that contain "
        "the truth |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for world, what in (
        ("as_foreseen", "as assumed in the design"),
        ("unknown", "with memory and gusts"),
    ):
        for name, each in figures["experiments"].items():
            one = each[world]
            foreseen = f"{each['expected']:.5f}" if world == "as_foreseen" else "-"
            error = one["spread"] / math.sqrt(2 * (one["fits"] - 1))
            rows.append(
                f"| {what} | {name} | {one['converged']} of {one['fits']} | {foreseen} | "
                f"{one['stated']:.5f} | {one['spread']:.5f} +- {error:.5f} | {one['mean']:.4f} | "
                f"{one['covered']} |"
            )
    low, high = figures["over_draws"]
    asked = [
        f"{name.capitalize()}: "
        + "; then ".join(", ".join(f"`{path}`" for path in few) for few in each["suggested"])
        for name, each in figures["experiments"].items()
    ]
    rows += [
        "",
        "These are the first suspects in fits of the arm with memory and gusts: first for a model "
        "without both effects, and then for a model with a free mean wind. "
        f"{'. '.join(asked)}.",
        "",
        f"The expected standard error of the design is {figures['ratio']:.3f} times that of the "
        f"base step, after {figures['evaluations']} evaluations. For sampled values of the "
        f"uncertain parameters, it is {low:.2f} to {high:.2f} times its nominal value.",
    ]
    return rows


DESIGN = Study(
    name="design",
    meaning=(
        "The experiment that `giajax design` finds for C_D is compared with the paper's base step "
        "of the same joint, angle, rate and duration. The comparison uses the expected standard "
        "error of C_D and the standard deviation of C_D over fits of repeated recordings. Half as "
        "many recordings are simulated with an arm that has effects which the design did not "
        "assume: joints with memory (Dahl friction), and unrecorded gusts. Fits of these "
        "recordings free the effects that are among the first suspects of the simpler fits: first "
        "a mean wind, and then the memory."
    ),
    size=200,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)
