"""Many arms at once: time of one evaluation and one run per item, by batch size and layout.

The items differ in drag, stiffnesses, damping and command. The layouts are one vmap over the first
axis, one vmap over the last axis, a loop over items (chunk 1), and a loop over chunks, each a vmap.
In a vmap, all items take as many steps as the slowest one. In a chunk, an item waits for fewer
others.

    python -m benchmarks.batch [--quick] [--out FILE]
"""

import os
import time
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.measuring import RESULTS, command_line, fastest, store
from giajax.mechanics.arm import Arm, acceleration
from giajax.runtime.programs import program
from giajax.schema.parameters import replace
from giajax.simulation import Signal, simulate
from peers.arms import driven_arm, random_states

SOLVERS = ("springs5", "tsit5")
NAMES = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping")

LAYOUTS: dict[str, int | None] = {
    "items first": None,
    "items last": None,
    "one by one": 1,
    "chunks of 4": 4,
    "chunks of 16": 16,
    "chunks of 64": 64,
}
# One run of the largest batch takes minutes, so not all layouts are measured.
LARGE = 1024
LARGE_LAYOUTS = ("items first", "one by one", "chunks of 16")


def items(count: int) -> Any:
    """Return four parameters and the scale of the command of each item, shape (item, 5)."""
    random = np.random.default_rng(0)
    middle = np.array([1.2, 3.0, 30.0, 0.05, 1.0])
    return jnp.asarray(middle * random.uniform(0.7, 1.3, (count, 5)))


def spread_over(one: Any, values: Any, layout: str) -> Any:
    """Apply a function of one item to all items, which lie along the first or the last axis."""
    if layout == "items first":
        return jax.vmap(one)(values)
    if layout == "items last":
        return jax.vmap(one, in_axes=-1, out_axes=-1)(values)
    return jax.lax.map(one, values, batch_size=LAYOUTS[layout])


def arranged(values: Any, layout: str) -> Any:
    """Move the axis of the items to where the layout expects it."""
    last = layout == "items last"
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, -1) if last else leaf, values)


def evaluate(arm: Arm, states: dict[str, Any], layout: str, loop: Any) -> Any:
    """Compute `loop` dependent evaluations of every item."""

    def one(item: dict[str, Any]) -> Any:
        def again(_: Any, angles: Any) -> Any:
            return angles + 1e-9 * acceleration(arm, angles, item["rates"], item["command"])

        return jax.lax.fori_loop(0, loop, again, item["angles"])

    return spread_over(one, states, layout)


# With the XLA options of giajax, which are those of a CPU.
evaluations = program(evaluate)


@eqx.filter_jit
def runs(arm: Arm, command: Signal, times: Any, values: Any, layout: str, solver: str) -> Any:
    """Return the path of the tip of every item."""

    def one(value: Any) -> Any:
        changed = replace(arm, dict(zip(NAMES, value[:4], strict=True)))
        driven = eqx.tree_at(
            lambda signal: (signal.values, signal.slopes),
            command,
            (command.values * value[4], command.slopes * value[4]),
        )
        options: dict[str, Any] = {"solver": solver, "rtol": 1e-5, "atol": 1e-5, "throw": False}
        return simulate(changed, driven, times, **options).tip

    return spread_over(one, values, layout)


def layouts_for(size: int) -> list[str]:
    """Return the layouts that differ for this batch size: those with chunks smaller than it."""
    return [name for name, chunk in LAYOUTS.items() if size > (chunk or 0) or name == "items first"]


def waited(function: Any, *arguments: Any) -> Any:
    """Call a function and wait for its result."""
    return jax.block_until_ready(function(*arguments))


def seconds_of_runs(*arguments: Any) -> float:
    """Return the time of one batch of runs without compilation, s."""
    function: Any = runs
    compiled = function.lower(*arguments).compile()
    began = time.perf_counter()
    waited(compiled, *arguments)
    return time.perf_counter() - began


def measure(quick: bool, console: Console) -> dict[str, Any]:
    """Measure the seconds per item, by "layout, size" and, for runs, by solver."""
    links, seconds, repeats = (3, 1.0, 1) if quick else (20, 25.0, 3)
    sizes = (1, 4) if quick else (1, 16, 256, 4096)
    arm, command = driven_arm(links)
    times = jnp.linspace(0.0, seconds, round(seconds * 10) + 1)
    evaluation: dict[str, float] = {}
    run: dict[str, float] = {}
    for size in sizes:
        states = random_states(links, size)
        states.pop("wind")
        loop = max(2, (200 if quick else 4_000) // size)
        for layout in layouts_for(size):
            batch = arranged(states, layout)
            took = fastest(partial(waited, evaluations, arm, batch, layout, loop), repeats)
            evaluation[f"{layout}, {size}"] = took / loop / size
    console.print("evaluations: done")
    for size in sizes:
        for solver in SOLVERS[:1] if quick or size > LARGE else SOLVERS:
            for layout in layouts_for(size):
                if size > LARGE and layout not in LARGE_LAYOUTS:
                    continue
                values = arranged(items(size), layout)
                took = seconds_of_runs(arm, command, times, values, layout, solver)
                run[f"{layout}, {size}, {solver}"] = took / size
                console.print(f"{size} items, {layout}, {solver}: {1e3 * took / size:.3g} ms")
    problem = {"links": links, "seconds": seconds, "sizes": sizes}
    return {"problem": problem, "evaluation": evaluation, "run": run}


def show(found: dict[str, Any], console: Console) -> None:
    problem = found["problem"]
    title = f"{problem['links']} links, {problem['seconds']:g} s, an item: evaluation, us; run, ms"
    table = Table(title=title)
    for heading in ("batch", "layout", "evaluation", *SOLVERS):
        table.add_column(heading, justify="left" if heading == "layout" else "right")
    for size in problem["sizes"]:
        for layout in layouts_for(size):
            name = f"{layout}, {size}"
            cells = [(found["evaluation"].get(name), 1e6)]
            cells += [(found["run"].get(f"{name}, {solver}"), 1e3) for solver in SOLVERS]
            text = ["-" if value is None else f"{value * unit:.3g}" for value, unit in cells]
            table.add_row(str(size), layout, *text)
    console.print(table)


def main() -> None:
    arguments = command_line(__doc__, RESULTS / "batch.json")
    jax.config.update("jax_enable_x64", True)
    console = Console()
    before = os.getloadavg()[0]
    found = measure(arguments.quick, console)
    show(found, console)
    load = {"cores": os.cpu_count(), "load_before": before, "load_after": os.getloadavg()[0]}
    store({"machine": load, **found}, arguments.out)
    console.print(f"written to {arguments.out}")


if __name__ == "__main__":
    main()
