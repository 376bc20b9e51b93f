"""Shaping: residual swing after shaped commands on sampled arms.

The stiffness, drag and damping of an arm in full air are sampled. Some arms have joints with
memory. A base joint moves by an angle within half, one and one and a half periods of the slowest
mode. The command is shaped for this arm. It then drives this arm, and arms whose stiffness differs
by a quarter.
"""

from typing import Any

import numpy as np

from ._study import Figures, Study

DURATIONS = (0.5, 1.0, 1.5)
# Standard deviations of the logarithms.
SPREAD = {"joints.pitch_stiffness": 0.2, "air.drag_coefficient": 0.2, "joints.damping": 0.5}
MEMORY = {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.001}
ANGLES = (5.0, 30.0)  # deg
LINKS = 20
# Largest allowed residual swing, % of the travel, also with a stiffness changed by a quarter.
MOST = {"right": 2.0, "stiffness_off": 5.0}
BEYOND = 1.5  # factor on this limit for a single arm


def run(size: int, seed: int, links: int = LINKS) -> Figures:
    """Return the figures of `size` arms, every fourth of which has joints with memory."""
    import jax

    jax.config.update("jax_enable_x64", True)
    shaped: dict[str, dict[str, list[list[float]]]] = {f"{each:g}": {} for each in DURATIONS}
    for number in range(size):
        for duration, rows in _arm(number, np.random.default_rng([seed, number]), links).items():
            for name, shares in rows.items():
                shaped[duration].setdefault(name, []).append(shares)
    return {
        "links": links,
        "durations": {
            duration: {
                name: {
                    "right": [each[0] for each in shares],
                    "stiffness_off": [each[1] for each in shares],
                    "settled_s": [each[2] for each in shares],
                }
                for name, shares in rows.items()
            }
            for duration, rows in shaped.items()
        },
    }


def part(size: int, seed: int) -> Figures:
    """Return the figures of short arms."""
    return run(size, seed, 6)


def _arm(number: int, rng: np.random.Generator, links: int) -> dict[str, dict[str, list[float]]]:
    """Return residuals (% of the travel; right and wrong stiffness) and time to rest, s."""
    from giajax import ArmModel
    from giajax.apps.shaping import Command, modes_after, shape_command

    arm = drawn_arm(links, MEMORY if number % 4 == 3 else None, rng)
    angles = np.zeros((2, links))
    angles[1, 0] = np.deg2rad(rng.uniform(*ANGLES)) * rng.choice([-1, 1])
    period = modes_after(arm, Command(np.array([0.0, 0.01]), angles))[0].period
    found = {}
    for duration in DURATIONS:
        command = Command(np.array([0.0, duration * period]), angles)
        shaping = shape_command(ArmModel(arm), command)
        found[f"{duration:g}"] = {
            row.name: [
                round(100 * row.residual / shaping.travel, 3),
                round(100 * max(row.soft, row.stiff) / shaping.travel, 3),
                -1.0 if row.settled is None else round(row.settled, 1),
            ]
            for row in shaping.rows
        }
    return found


def drawn_arm(links: int, parameters: Any, rng: np.random.Generator) -> Any:
    """Return the paper's arm in full air, with sampled stiffness, drag and damping."""
    from giajax import replace, takeichi_20m_full

    arm = takeichi_20m_full(links, parameters=parameters)
    drawn = {path: np.exp(deviation * rng.normal()) for path, deviation in SPREAD.items()}
    drawn["joints.yaw_stiffness"] = drawn["joints.pitch_stiffness"]
    return replace(arm, {path: _value(arm, path) * factor for path, factor in drawn.items()})


def _value(arm: Any, path: str) -> Any:
    from giajax.schema.parameters import find

    return find(arm, path).value(arm)


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report shapers whose residual exceeds the limit or that of the unshaped command."""
    del stored  # the limits apply to every arm
    sentences = []
    for duration, rows in new["durations"].items():
        for name, row in rows.items():
            if name == "unshaped":
                continue
            for what, most in MOST.items():
                if name == "ZV" and what != "right":
                    continue
                if max(row[what]) > BEYOND * most:
                    sentences.append(
                        f"{duration} periods, {name}, {what}: {max(row[what]):.3g} % is left, and "
                        f"{most:g} % is to be"
                    )
            if np.any(np.asarray(row["right"]) >= rows["unshaped"]["right"]):
                sentences.append(f"{duration} periods, {name}: as much is left as without it")
    return sentences


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each duration and shaper."""
    rows = [
        "| duration of the move, periods | shaper | residual, median | residual, largest | arms "
        "with at most 2 % | residual with a stiffness changed by a quarter, median | largest "
        "residual with this stiffness | arms with at most 5 % with this stiffness | time until the "
        "tip is at rest, median, s |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for duration, each in figures["durations"].items():
        for name, row in each.items():
            cells = []
            for what, most in MOST.items():
                shares = np.asarray(row[what])
                within = f"{np.count_nonzero(shares <= most)} of {len(shares)}"
                cells += [f"{np.median(shares):.2f} %", f"{np.max(shares):.2f} %", within]
            settled = np.asarray(row["settled_s"])
            middle = np.median(np.where(settled < 0, np.inf, settled))
            ended = f"{middle:.0f}" if np.isfinite(middle) else "later"
            rows.append(f"| {duration} | {name} | {' | '.join(cells)} | {ended} |")
    drawn = ", ".join(f"`{path}` {deviation:g}" for path, deviation in SPREAD.items())
    return [
        *rows,
        "",
        "The following parameters are sampled for each arm, with these standard deviations of "
        f"their logarithms: {drawn}. "
        f"The angle of the base joint is uniform from {ANGLES[0]:g} to {ANGLES[1]:g} degrees. "
        "Every fourth arm has joints with memory. Residuals are relative to the travel of the tip.",
    ]


SHAPING = Study(
    name="shaping",
    meaning=(
        "The residual swing of the paper's arm in full air is measured after an unshaped command, "
        "and after the same command shaped by `giajax shape`. It is measured for the arm for "
        "which the shaper was designed, and for an arm whose stiffness differs by a quarter."
    ),
    size=16,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
