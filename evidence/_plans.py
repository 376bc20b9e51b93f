"""Plans: compare planned commands with direct and shaped ones on sampled arms.

The stiffness, drag and damping of an arm in full air are sampled. Every fourth arm has joints with
memory. Two joints move by sampled angles. `giajax plan` searches for the fastest command within the
limits; `giajax shape` shapes the direct one.
"""

from typing import Any

import numpy as np

from ._shaping import MEMORY, SPREAD, drawn_arm
from ._study import Figures, Study

ANGLES = (8.0, 25.0)  # deg, of the base joint; another joint moves by half of this angle
LINKS, RATE = 20, 2.0  # deg/s
SHORT, QUICK = 3, 8.0
# Largest allowed error of a plan after its command, % of the travel, and a factor for the tests.
NEAR, BESIDE = 2.0, 1.1
SHAPERS = ("ZVD", "EI")


def run(size: int, seed: int, links: int = LINKS, rate: float = RATE) -> Figures:
    """Return the figures of `size` arms."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return {
        "links": links,
        "rate_deg_per_s": rate,
        "arms": [_arm(n, np.random.default_rng([seed, n]), links, rate) for n in range(size)],
    }


def part(size: int, seed: int) -> Figures:
    """Return the figures of short arms with faster drives."""
    return run(size, seed, SHORT, QUICK)


def _arm(number: int, rng: np.random.Generator, links: int, rate: float) -> dict[str, Any]:
    """Return for each command its end, time to rest (s) and residual swing (% of the travel)."""
    from giajax import ArmModel, InputError
    from giajax.apps.planning import CommandLimits, Pose, plan_command
    from giajax.apps.shaping import shape_command

    remembers = number % 4 == 3
    model = ArmModel(drawn_arm(links, MEMORY if remembers else None, rng))
    pose = np.zeros(links)
    size = np.deg2rad(rng.uniform(*ANGLES))
    pose[0] = size * rng.choice([-1, 1])
    pose[rng.integers(1, links)] = size / 2 * rng.choice([-1, 1])
    found: dict[str, Any] = {"remembers": remembers, "commands": {}}
    try:
        plan = plan_command(model, Pose(pose), limits=CommandLimits(rate=np.deg2rad(rate)))
    except InputError as refused:
        return {**found, "refused": str(refused)}
    shaping = shape_command(model, plan.direct.command, shapers=SHAPERS)
    every: tuple[Any, ...] = (plan.direct, plan.planned, *shaping.rows[1:])
    rows = {row.name: row for row in every}
    for name, row in rows.items():
        wrong = max(row.soft or 0.0, row.stiff or 0.0)
        found["commands"][name] = {
            "ends_s": round(float(row.command.times[-1]), 2),
            "settled_s": None if row.settled is None else round(row.settled, 2),
            "residual": round(100 * row.residual / plan.travel, 3),
            "stiffness_off": round(100 * wrong / plan.travel, 3),
        }
    off = {"missed": round(100 * plan.planned.missed / plan.travel, 3), "steps": plan.steps}
    return {**found, **off, "period_s": round(plan.period, 2)}


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report plans that miss their target, or that are slower than a shaped command."""
    del stored  # the limits apply to every arm
    sentences = []
    for number, each in enumerate(new["arms"]):
        if "refused" in each:
            sentences.append(f"arm {number}: {each['refused']}")
            continue
        if each["missed"] > BESIDE * NEAR:
            sentences.append(
                f"arm {number}: the tip is off by {each['missed']:g} %, and {NEAR:g} % are allowed"
            )
        planned, *others = (
            _or_never(each["commands"][name]["settled_s"]) for name in ("planned", *SHAPERS)
        )
        if planned > min(others):
            sentences.append(f"arm {number}: a shaped command is at rest sooner than the plan")
    return sentences


def _or_never(time: float | None) -> float:
    return float("inf") if time is None else time


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each command, for arms without and with joint memory."""
    rows = [
        "| joints | command | end of the command, median, s | tip at rest, median, s | tip at "
        "rest, latest, s | never at rest | residual, median | residual with a stiffness changed "
        "by a quarter, median | largest residual with this stiffness |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for remembers, what in ((False, "springs only"), (True, "with memory")):
        arms = [
            each
            for each in figures["arms"]
            if each["remembers"] == remembers and "refused" not in each
        ]
        for name in ("direct", *SHAPERS, "planned"):
            some = [each["commands"][name] for each in arms]
            if not some:
                continue
            settled = np.array([_or_never(each["settled_s"]) for each in some])
            middle, known = np.median(settled), settled[np.isfinite(settled)]
            cells = [
                what,
                name,
                f"{np.median([each['ends_s'] for each in some]):.0f}",
                f"{middle:.0f}" if np.isfinite(middle) else "later",
                f"{np.max(known):.0f}" if len(known) else "-",
                f"{len(settled) - len(known)} of {len(settled)}",
                f"{np.median([each['residual'] for each in some]):.1f} %",
                f"{np.median([each['stiffness_off'] for each in some]):.1f} %",
                f"{np.max([each['stiffness_off'] for each in some]):.1f} %",
            ]
            rows.append(f"| {' | '.join(cells)} |")
    arms = [each for each in figures["arms"] if "refused" not in each]
    sooner = [_sooner(each["commands"]) for each in arms]
    missed = [each["missed"] for each in arms]
    drawn = ", ".join(f"`{path}` {deviation:g}" for path, deviation in SPREAD.items())
    return [
        *rows,
        "",
        f"The planner refused {len(figures['arms']) - len(arms)} of {len(figures['arms'])} moves. "
        f"The final distance of the tip from its target is at most {NEAR:g} % of the travel in "
        f"{np.count_nonzero(np.array(missed) <= NEAR)} of {len(arms)} plans, and at most "
        f"{np.max(missed):.2f} % in all plans. The time until the tip is at rest is "
        f"{np.nanmedian(sooner):.2f} times that of the faster shaped command (median; largest "
        f"{np.nanmax(sooner):.2f}). A tip is counted as never at rest if it is not at rest within "
        "three periods of the slowest mode after the end of the command.",
        "",
        "The following parameters are sampled for each arm, with these standard deviations of "
        f"their logarithms: {drawn}. "
        f"The angle of the base joint is uniform from {ANGLES[0]:g} to {ANGLES[1]:g} degrees, and "
        f"another joint moves by half this angle. The largest rate is "
        f"{figures['rate_deg_per_s']:g} degrees per second.",
    ]


def _sooner(commands: dict[str, Any]) -> float:
    """Return the time to rest of the plan relative to that of the faster shaped command."""
    shaped = min(_or_never(commands[name]["settled_s"]) for name in SHAPERS)
    return _or_never(commands["planned"]["settled_s"]) / shaped if np.isfinite(shaped) else np.nan


PLANS = Study(
    name="plans",
    meaning=(
        "The time until the tip of the paper's arm in full air is at rest after a move is "
        "compared for three commands: a direct move at the largest rate, the same command after "
        "shaping, and the command of `giajax plan`. The last columns list the residual swing of "
        "an arm whose stiffness differs by a quarter."
    ),
    size=6,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
