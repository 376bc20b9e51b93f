"""Stiff joints: computing time of each method for a given error, and the order of `springs5`.

The problem is the paper's 20-link arm with joints 1 and 2 driven, for 25 s and several yaw
stiffnesses. The time for a given error of the tip is interpolated between two tolerances of the
work-precision curve. The order of convergence is measured with steps of fixed length on a shorter
arm, at the steps and between them.

    python -m benchmarks.stiffness [--quick] [--out DIR]
"""

import os
import time
from pathlib import Path
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.measuring import RESULTS, command_line, store
from giajax.mechanics.arm import Arm, takeichi_20m
from giajax.report import new_figure, plain, to_png
from giajax.schema.parameters import replace
from giajax.simulation import Signal, constant, simulate, solver as solver_named
from giajax.simulation._motion import Inputs, motion
from peers.arms import driven_arm

STIFFNESSES = (30.0, 300.0, 3000.0)  # N m/rad
ERRORS = (1e-3, 1e-4)  # m, at the tip
TOLERANCES = {
    "tsit5": [10.0 ** (-exponent / 2) for exponent in range(5, 11)],
    "springs5": [10.0 ** (-exponent / 2) for exponent in range(6, 13)],
    "kvaerno5": [10.0 ** (-exponent / 2) for exponent in range(6, 13, 2)],
}


@eqx.filter_jit
def tip(arm: Arm, command: Signal, times: Any, tolerance: Any, solver: str) -> Any:
    motion = simulate(
        arm, command, times, solver=solver, rtol=tolerance, atol=tolerance, throw=False
    )
    return motion.tip, motion.steps


def curves(
    links: int, seconds: float, stiffness: float, repeats: int, console: Console
) -> dict[str, list[dict[str, float]]]:
    """Measure the tolerance, the error at the tip (m), the steps and the seconds of each method."""
    arm, command = driven_arm(links)
    arm = replace(arm, {"joints.yaw_stiffness": stiffness})
    times = jnp.linspace(0.0, seconds, round(seconds / 0.1) + 1)
    exact, _ = tip(arm, command, times, jnp.asarray(1e-11), "dopri8")
    found: dict[str, list[dict[str, float]]] = {}
    for solver, tolerances in TOLERANCES.items():
        found[solver] = []
        for tolerance in tolerances:
            call = (arm, command, times, jnp.asarray(tolerance), solver)
            path, steps = jax.block_until_ready(tip(*call))
            took = []
            for _ in range(repeats):
                began = time.perf_counter()
                jax.block_until_ready(tip(*call))
                took.append(time.perf_counter() - began)
            error = float(np.linalg.norm(path - exact, axis=1).max())
            point = {"tolerance": tolerance, "error": error, "seconds": min(took)}
            found[solver].append(point | {"steps": int(steps.sum())})
            if error < 0.3 * min(ERRORS):
                break
        console.print(f"yaw stiffness {stiffness:g}, {solver}: done")
    return found


def cost(curve: list[dict[str, float]], error: float) -> float | None:
    """Interpolate the time for an error on a curve, s; None if the error is never reached."""
    best = None
    for before, after in zip([None, *curve[:-1]], curve, strict=True):
        if not after["error"] <= error:
            continue
        if before is None or not before["error"] > error or not np.isfinite(before["error"]):
            here = after["seconds"]
        else:
            logs = np.log([after["error"], before["error"]])
            here = float(np.interp(np.log(error), logs, [after["seconds"], before["seconds"]]))
        best = here if best is None else min(best, here)
    return best


def pushed(stiffness: float, steps: int, solver: str, times: Any) -> Any:
    """Simulate one second of an arm of 6 links with steps of fixed length.

    The arm starts from rest in a cross-wind.
    """
    arm = takeichi_20m(6)
    arm = replace(arm, {"joints.yaw_stiffness": stiffness, "joints.damping": 0.3})
    target = constant([0.6, 0.0, 0.3, 0.0, 0.0, 0.0])
    return diffrax.diffeqsolve(
        diffrax.ODETerm(motion),
        solver_named(solver),
        t0=times[0],
        t1=times[-1],
        dt0=jnp.asarray(1 / steps),
        y0=jnp.zeros((2, 6)),
        args=Inputs(arm, target, constant([0.1, 0.5, 0.2]), None, jnp.ones(())),
        saveat=diffrax.SaveAt(ts=times),
        max_steps=None,
    ).ys


def convergence(quick: bool, console: Console) -> dict[str, Any]:
    """Return the largest error of an angle, rad, by the number of steps per second."""
    counts = [16, 32, 64] if quick else [8, 16, 32, 64, 128, 256, 512]
    times = np.linspace(0.0, 1.0, 41)
    found: dict[str, Any] = {"steps": counts}
    for stiffness in (3.0, 300.0, 3000.0):
        exact = pushed(stiffness, 512 if quick else 4096, "springs5", times)
        errors = [np.abs(pushed(stiffness, n, "springs5", times) - exact)[:, 0] for n in counts]
        found[f"{stiffness:g}"] = {
            "at every time": [float(error.max()) for error in errors],
            "at the end": [float(error[-1].max()) for error in errors],
        }
    console.print("order: done")
    return found


def draw_order(found: dict[str, Any], path: Path) -> None:
    what = (
        "Largest error of an angle versus the number of steps, and the slope of order 5 (dotted)."
    )
    figure = new_figure(7, 4.5, "springs5: steps of one length", what)
    axes = figure.subplots()
    steps = np.asarray(found["steps"], dtype=float)
    for index, stiffness in enumerate(key for key in found if key != "steps"):
        for where, line in (("at every time", "o-"), ("at the end", "s--")):
            label = f"yaw stiffness {stiffness} N m/rad, {where}"
            axes.loglog(steps, found[stiffness][where], line, color=f"C{index}", label=label)
    start = found["3"]["at every time"][0]
    axes.loglog(steps, start * (steps[0] / steps) ** 5 / 3, "k:", label="order 5")
    axes.set_xlabel("steps in 1 s")
    axes.set_ylabel("largest error of an angle, rad")
    plain(axes)
    axes.legend(fontsize=7)
    path.write_bytes(to_png(figure))


def draw_cost(found: dict[str, Any], path: Path) -> None:
    what = "Computing time versus the error of the tip, for each yaw stiffness and method."
    figure = new_figure(11, 4, "25 s of the arm, joints 1 and 2 driven", what)
    panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
    for axes, (stiffness, curves) in zip(panels, found.items(), strict=True):
        for solver, curve in curves.items():
            axes.loglog(
                [point["error"] for point in curve],
                [1e3 * point["seconds"] for point in curve],
                "o-",
                label=solver,
            )
        axes.set_xlabel("largest error at the tip, m")
        plain(axes, f"yaw stiffness {stiffness} N m/rad")
        axes.invert_xaxis()
    panels[0].set_ylabel("run, ms")
    panels[0].legend()
    path.write_bytes(to_png(figure))


def main() -> None:
    arguments = command_line(__doc__, RESULTS / "stiffness", "folder to write to")
    jax.config.update("jax_enable_x64", True)
    console = Console()
    links, seconds, repeats = (4, 2.0, 1) if arguments.quick else (20, 25.0, 4)
    load = os.getloadavg()[0]
    order = convergence(arguments.quick, console)
    work = {
        f"{stiffness:g}": curves(links, seconds, stiffness, repeats, console)
        for stiffness in (STIFFNESSES[:1] if arguments.quick else STIFFNESSES)
    }
    table = Table(title=f"{links} links, {seconds:g} s: milliseconds for an error at the tip")
    for heading in ("yaw stiffness", "error, m", *TOLERANCES):
        table.add_column(heading, justify="right")
    costs: dict[str, Any] = {}
    for stiffness, each in work.items():
        costs[stiffness] = {}
        for error in ERRORS:
            row = {solver: cost(curve, error) for solver, curve in each.items()}
            costs[stiffness][f"{error:g}"] = row
            cells = ["-" if took is None else f"{1e3 * took:.3g}" for took in row.values()]
            table.add_row(stiffness, f"{error:g}", *cells)
    console.print(table)
    load_of = {"load_before": load, "load_after": os.getloadavg()[0], "cores": os.cpu_count()}
    found = {"machine": load_of, "order": order, "work": work, "seconds_at_error": costs}
    store(found, arguments.out / "stiffness.json")
    draw_order(order, arguments.out / "order.png")
    draw_cost(work, arguments.out / "work_precision.png")
    console.print(f"written to {arguments.out}")


if __name__ == "__main__":
    main()
