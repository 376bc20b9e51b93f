"""Time of one evaluation with each option of the arm, relative to the plain arm.

The plain arm is the paper's 20-link arm. Each contender evaluates the accelerations many times in
one compiled loop, in which each evaluation depends on the previous one. The contenders take turns.
An omitted effect must cost nothing. The limit for an included effect is 1.5 times the plain
evaluation, and twice the plain evaluation for strip drag with 3 points per link.

    python -m benchmarks.options [--quick] [--out FILE]
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from rich.table import Table

from benchmarks.measuring import columns, in_turns, report, spread
from giajax.mechanics.arm import Arm, PointMasses, acceleration, takeichi_20m, takeichi_20m_full
from giajax.runtime.programs import program
from peers.arms import random_states


def variants(links: int) -> dict[str, tuple[Arm, float | None]]:
    """Return an arm for each option, and its limit relative to the plain arm; None for no limit."""

    def arm(**changes: Any) -> Arm:
        return takeichi_20m(links, **changes)

    def having(**values: Any) -> dict[str, Any]:
        return {"parameters": {path.replace("__", "."): value for path, value in values.items()}}

    def masses(**places: float) -> PointMasses:
        row = {name: jnp.full(2, value) for name, value in places.items()}
        return PointMasses(links=(1, links), mass=jnp.full(2, 0.003), **row)

    floating: dict[str, Any] = {"gravity": 9.81, "trim": True}
    depth = having(buoyancy__trim_depth=0.15)
    strip: dict[str, Any] = {"drag": "strip"}
    return {
        "plain": (arm(), 1.0),
        "gravity": (arm(gravity=9.81), 1.5),
        "Coulomb friction": (arm(**having(joints__friction=0.1)), 1.5),
        "armature": (arm(**having(joints__armature=1e-3)), 1.5),
        "constant wind": (arm(**having(air__wind=[0.1, 0.1, 0.1])), 1.5),
        "C_D by Reynolds number": (arm(drag_curve="cylinder"), 1.5),
        "added mass": (arm(**having(air__added_mass_coefficient=1.0)), 1.5),
        "buoyancy, trimmed": (arm(**floating), 1.5),
        "the same, trim below the axis": (arm(**floating, **depth), 1.5),
        "lift left over": (arm(**floating, **having(buoyancy__imbalance=0.01)), 1.5),
        "point masses on the axis": (arm(point_masses=masses(position=0.9)), 1.5),
        "point masses off the axis": (
            arm(point_masses=masses(position=0.9, left=0.1, up=0.1)),
            1.5,
        ),
        "muscles in the pitch joints": (arm(muscles="pitch"), None),
        "muscles in all joints": (arm(muscles="all"), None),
        "strip drag, 3 points": (arm(**strip), 2.0),
        "the same, with axial drag": (arm(**strip, **having(air__axial_coefficient=0.02)), 2.0),
        "the same, C_D by Reynolds number": (arm(**strip, drag_curve="cylinder"), None),
        "all of it (takeichi_20m_full)": (takeichi_20m_full(links), None),
    }


def evaluations(arms: dict[str, Arm], loop: int, repeats: int) -> dict[str, dict[str, float]]:
    """Measure the seconds of one evaluation of each arm."""
    links = next(iter(arms.values())).count
    state = {name: value[0] for name, value in random_states(links, 1).items()}
    start = tuple(state[name] for name in ("angles", "rates", "command"))

    # Use the compiler options of a simulation. With other options, XLA passes small operations
    # from thread to thread, which doubles the times of some processes but not of others.
    @program
    def many(arm: Arm, angles: Any, rates: Any, command: Any) -> Any:
        # Each evaluation depends on the previous one, so XLA cannot omit or merge any.
        def again(_: Any, angles: Any) -> Any:
            return angles + 1e-9 * acceleration(arm, angles, rates, command)

        return jax.lax.fori_loop(0, loop, again, angles)

    def contender(arm: Arm) -> Callable[[], Any]:
        return lambda: jax.block_until_ready(many(arm, *start))

    found = in_turns({name: contender(arm) for name, arm in arms.items()}, repeats)
    return {
        name: {key: value / loop for key, value in each.items()} for name, each in found.items()
    }


def measure(quick: bool) -> dict[str, Any]:
    links, loop, repeats = (3, 50, 1) if quick else (20, 5_000, 25)
    options = variants(links)
    found = evaluations({name: arm for name, (arm, _) in options.items()}, loop, repeats)
    plain = found["plain"]["min"]
    return {
        "links": links,
        "options": {
            name: {**found[name], "ratio": found[name]["min"] / plain, "allowed": allowed}
            for name, (_, allowed) in options.items()
        },
    }


def table(found: dict[str, Any]) -> Table:
    rows = columns(
        f"One evaluation of {found['links']} links", "", "us: min / median", "over plain", "allowed"
    )
    for name, each in found["options"].items():
        allowed = each["allowed"]
        rows.add_row(
            name,
            spread(each, 1e6),
            f"{each['ratio']:.2f}",
            "" if allowed is None else f"{allowed:g}",
        )
    return rows


def main() -> None:
    report(__doc__, "options", measure, table)


if __name__ == "__main__":
    main()
