"""Time to simulate 25 s of the 20-link arm with muscles, relative to the same arm with springs.

The base joint is commanded to 30 degrees within one second. The muscles act in the pitch joints.
The command is either the joint angles, which the controller of the muscles converts, or the
pressures. The contenders take turns.

    python -m benchmarks.muscles [--quick] [--out FILE]
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table

from benchmarks.measuring import columns, in_turns, report, spread
from giajax.mechanics.arm import Arm, takeichi_20m
from giajax.simulation import Pressures, Trajectory, joint_ramps, logged, simulate

SOLVERS = ("tsit5", "springs5")
TOLERANCE = 1e-6


def motions(links: int, seconds: float) -> dict[str, Callable[[], Trajectory]]:
    """Return the simulations by name; they differ in the input of the arm and the method."""
    command = joint_ramps(links, {1: np.deg2rad(30.0)}, start=0.5, duration=1.0)
    springs, muscles = takeichi_20m(links), takeichi_20m(links, muscles="pitch")
    assert muscles.pneumatics is not None
    times = np.linspace(0.0, seconds, round(seconds * 10) + 1)
    rows = [muscles.pneumatics.commanded(command(jnp.asarray(time))).ravel() for time in times]
    supplied = Pressures(logged(times, np.asarray(rows)), muscles.pneumatics.joints)

    def made(arm: Arm, pressure: Pressures | None, solver: str) -> Callable[[], Trajectory]:
        def run() -> Trajectory:
            return jax.block_until_ready(
                simulate(
                    arm,
                    command,
                    times,
                    pressure=pressure,
                    solver=solver,
                    rtol=TOLERANCE,
                    atol=TOLERANCE,
                )
            )

        return run

    found: dict[str, Callable[[], Trajectory]] = {}
    for solver in SOLVERS:
        found[f"springs, {solver}"] = made(springs, None, solver)
        found[f"muscles by angles, {solver}"] = made(muscles, None, solver)
        found[f"muscles by pressures, {solver}"] = made(muscles, supplied, solver)
    return found


def measure(quick: bool) -> dict[str, Any]:
    links, seconds, repeats = (4, 2.0, 2) if quick else (20, 25.0, 15)
    contenders = motions(links, seconds)
    steps = {name: np.asarray(run().steps).tolist() for name, run in contenders.items()}
    found = in_turns(contenders, repeats)
    for name, taken in found.items():
        taken["ratio"] = taken["min"] / found[f"springs, {name.rpartition(', ')[2]}"]["min"]
    return {"links": links, "seconds": seconds, "runs": found, "steps": steps}


def table(found: dict[str, Any]) -> Table:
    rows = columns(
        f"{found['seconds']:g} s of {found['links']} links",
        "",
        "ms: min / median",
        "over springs",
        "steps",
        "rejected",
    )
    for name, taken in found["runs"].items():
        counts = map(str, found["steps"][name])
        rows.add_row(name, spread(taken, 1e3), f"{taken['ratio']:.2f}", *counts)
    return rows


def main() -> None:
    report(__doc__, "muscles", measure, table)


if __name__ == "__main__":
    main()
