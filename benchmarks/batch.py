"""Many arms at once: what one evaluation and one run cost an item, by batch size and by layout.

Items differ in drag, stiffnesses, damping and command. A layout is a vmap of everything, or a
`lax.map` over chunks of vmaps: within a chunk each item takes its own steps, and the chunk ends
with its slowest item.

    python benchmarks/batch.py [--quick] [--out FILE]
"""

import argparse
import json
import os
import time
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from arms import driven_arm, random_states
from giajax.arm import Arm, acceleration
from giajax.parameters import replace
from giajax.simulation import Signal, simulate

RESULTS = Path(__file__).resolve().parents[1] / "benchmarks" / "results" / "batch.json"
SOLVERS = ("springs5", "tsit5")
NAMES = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping")


def items(count: int) -> Any:
    """Parameters and the size of the command of each item, shape (item, 5)."""
    random = np.random.default_rng(0)
    middle = np.array([1.2, 3.0, 30.0, 0.05, 1.0])
    return jnp.asarray(middle * random.uniform(0.7, 1.3, (count, 5)))


@partial(jax.jit, static_argnames=("chunk", "loop"))
def evaluations(arm: Arm, state: dict[str, Any], chunk: int | None, loop: int) -> Any:
    """`loop` dependent evaluations of every item."""

    def one(item: dict[str, Any]) -> Any:
        def again(_: Any, angles: Any) -> Any:
            return angles + 1e-9 * acceleration(arm, angles, item["rates"], item["command"])

        return jax.lax.fori_loop(0, loop, again, item["angles"])

    return jax.vmap(one)(state) if chunk is None else jax.lax.map(one, state, batch_size=chunk)


@eqx.filter_jit
def runs(arm: Arm, command: Signal, times: Any, values: Any, chunk: int | None, solver: str) -> Any:
    """Path of the tip of every item, shape (item, sample, 3), and its steps."""

    def one(value: Any) -> Any:
        changed = replace(arm, dict(zip(NAMES, value[:4], strict=True)))
        driven = eqx.tree_at(
            lambda signal: (signal.values, signal.slopes),
            command,
            (command.values * value[4], command.slopes * value[4]),
        )
        options: dict[str, Any] = {"solver": solver, "rtol": 1e-5, "atol": 1e-5, "throw": False}
        motion = simulate(changed, driven, times, **options)
        return motion.tip, motion.steps

    return jax.vmap(one)(values) if chunk is None else jax.lax.map(one, values, batch_size=chunk)


def allowed(chunks: tuple[int | None, ...], size: int) -> list[int | None]:
    """Chunks that divide a batch; None is one vmap of all."""
    return [chunk for chunk in chunks if chunk is None or chunk < size]


def fastest(call: Any, repeats: int) -> float:
    jax.block_until_ready(call())
    took = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(call())
        took.append(time.perf_counter() - began)
    return min(took)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a short arm, once: does it run?")
    parser.add_argument("--out", type=Path, default=RESULTS, help="JSON file to write")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    console, quick = Console(), arguments.quick
    links, seconds, repeats = (3, 1.0, 1) if quick else (20, 25.0, 3)
    sizes = (1, 4) if quick else (1, 16, 256, 4096)
    chunks = (None, 2) if quick else (None, 1, 4, 16, 64)
    arm, command = driven_arm(links)
    times = jnp.linspace(0.0, seconds, round(seconds * 10) + 1)
    found: dict[str, Any] = {"load_before": os.getloadavg()[0], "evaluation": {}, "run": {}}
    for size in sizes:
        state = random_states(links, size)
        state.pop("wind")
        loop = max(2, (200 if quick else 4_000) // size)
        for chunk in allowed(chunks, size):
            took = fastest(partial(evaluations, arm, state, chunk, loop), repeats)
            found["evaluation"][f"{size} {chunk}"] = took / loop / size
    console.print("evaluations: done")
    for solver in SOLVERS[:1] if quick else SOLVERS:
        for size in sizes:
            values = items(size)
            # The largest batch takes minutes, whatever the layout.
            for chunk in allowed(chunks, size) if size < 4096 else (None,):
                took = fastest(partial(runs, arm, command, times, values, chunk, solver), 1)
                found["run"][f"{solver} {size} {chunk}"] = took / size
                console.print(f"{solver}, {size} items, chunk {chunk}: {1e3 * took / size:.3g} ms")
    found["load_after"] = os.getloadavg()[0]
    table = Table(title=f"{links} links, {seconds:g} s, an item: evaluation, us, and run, ms")
    for heading in ("batch", "chunk", "evaluation", "springs5", "tsit5"):
        table.add_column(heading, justify="right")
    for size in sizes:
        for chunk in allowed(chunks, size):
            cells = [found["evaluation"].get(f"{size} {chunk}")]
            cells += [found["run"].get(f"{solver} {size} {chunk}") for solver in SOLVERS]
            units = (1e6, 1e3, 1e3)
            text = ["-" if x is None else f"{x * u:.3g}" for x, u in zip(cells, units, strict=True)]
            table.add_row(str(size), "all" if chunk is None else str(chunk), *text)
    console.print(table)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
