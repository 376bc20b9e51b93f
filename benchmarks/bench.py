"""Side by side with MuJoCo and scipy, on one chain, in one run: `make bench`.

The paper's arm, joints 1 and 2 driven, 25 s. Machines differ and are noisy, so what counts is the
ratio of two figures of the same run. Every contender integrates as coarsely as keeps its tip
within 1e-4 m of a tight reference, and says how coarsely that is.
"""

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

import giajax
from arms import driven_arm
from giajax.simulation import Signal
from mujoco_chain import MujocoChain
from scipy_chain import ScipyChain

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "data" / "synthetic" / "base_step.csv"
TIP_ERROR = 1e-4  # m
TIMES = np.linspace(0.0, 25.0, 251)
PATHS = (
    "air.drag_coefficient",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
)
Figure = dict[str, Any]


def timed(contenders: dict[str, Callable[[], Any]], repeats: int) -> dict[str, Figure]:
    """Seconds of each contender, taken in turn so that a slow moment meets all of them."""
    for run in contenders.values():
        run()
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(repeats):
        for name, run in contenders.items():
            began = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - began)
    return {
        name: {"min_s": min(taken), "median_s": float(np.median(taken)), "repeats": repeats}
        for name, taken in seconds.items()
    }


def evaluation_loop(arm: giajax.Arm, command: Signal, count: int) -> Callable[[], Any]:
    """Evaluations of the equation of motion inside one compiled loop, each fed by the last."""
    target = command(jnp.asarray(2.0))

    @jax.jit
    def loop(arm: giajax.Arm, angles: jax.Array, rates: jax.Array) -> Any:
        def body(_: Any, state: Any) -> Any:
            angles, rates = state
            return angles + 1e-4 * rates, rates + 1e-4 * giajax.acceleration(
                arm, angles, rates, target
            )

        return jax.lax.fori_loop(0, count, body, (angles, rates))

    still = jnp.zeros(arm.count)
    return lambda: jax.block_until_ready(loop(arm, still, still))


def measure_evaluation(arm: giajax.Arm, command: Signal, repeats: int) -> dict[str, Figure]:
    """One evaluation of the accelerations, microseconds."""
    random = np.random.default_rng(0)
    angles, rates = random.normal(size=(2, arm.count)) * 0.3
    target = np.asarray(command(jnp.asarray(2.0)))
    counts = {"giajax": 5000, "MuJoCo": 500, "scipy": 200}
    mujoco, scipy = MujocoChain(arm), ScipyChain(arm)
    found = timed(
        {
            "giajax": evaluation_loop(arm, command, counts["giajax"]),
            "MuJoCo": lambda: [
                mujoco.acceleration(angles, rates, target) for _ in range(counts["MuJoCo"])
            ],
            "scipy": lambda: [
                scipy.acceleration(angles, rates, target) for _ in range(counts["scipy"])
            ],
        },
        repeats,
    )
    for name, figure in found.items():
        figure["min_us"] = figure["min_s"] / counts[name] * 1e6
        figure["median_us"] = figure["median_s"] / counts[name] * 1e6
    return found


def coarsest(
    settings: Sequence[float], run: Callable[[float], np.ndarray], reference: np.ndarray
) -> tuple[float, float]:
    """The first setting, from coarse to fine, whose tip stays within the allowed error."""
    for setting in settings:
        try:
            error = float(np.abs(run(setting) - reference).max())
        except FloatingPointError:
            continue  # unstable with so long a step
        if error <= TIP_ERROR:
            return setting, error
    raise RuntimeError("no setting reaches the wanted accuracy")


def measure_run(arm: giajax.Arm, command: Signal, repeats: int) -> dict[str, Figure]:
    """The 25 s run at the same accuracy of the tip, and value with 4-column Jacobian."""
    times = jnp.asarray(TIMES)
    tight = giajax.simulate(arm, command, times, solver="dopri8", rtol=1e-12, atol=1e-12)
    reference = np.asarray(tight.tip)
    mujoco, scipy = MujocoChain(arm, command), ScipyChain(arm, command)

    def by_giajax(tolerance: float) -> np.ndarray:
        motion = giajax.simulate(arm, command, times, rtol=tolerance, atol=tolerance)
        return np.asarray(motion.tip)

    def by_mujoco(step: float) -> np.ndarray:
        return scipy.tip(mujoco.trajectory(TIMES, step)[:, 0])

    def by_scipy(tolerance: float) -> np.ndarray:
        return scipy.tip(scipy.trajectory(TIMES, rtol=tolerance, atol=tolerance)[:, 0])

    loose = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7]
    steps = [0.05, 0.025, 0.02, 0.0125, 0.01, 0.005, 0.0025, 0.001]
    chosen = {
        "giajax": coarsest(loose, by_giajax, reference),
        "MuJoCo": coarsest(steps, by_mujoco, reference),
        "scipy": coarsest(loose, by_scipy, reference),
    }
    tolerance, step, scipy_tolerance = (chosen[name][0] for name in chosen)
    value, jacobian = derivatives(arm, command, times, tolerance)
    start = jnp.asarray([float(giajax.get(arm, path)) for path in PATHS])
    found = timed(
        {
            "giajax": lambda: jax.block_until_ready(
                giajax.simulate(arm, command, times, rtol=tolerance, atol=tolerance).angles
            ),
            "MuJoCo": lambda: mujoco.trajectory(TIMES, step),
            "scipy": lambda: scipy.trajectory(TIMES, rtol=scipy_tolerance, atol=scipy_tolerance),
            "giajax, plain": lambda: jax.block_until_ready(value(start)),
            "giajax, value and Jacobian": lambda: jax.block_until_ready(jacobian(start)),
        },
        repeats,
    )
    for name, (setting, error) in chosen.items():
        found[name]["setting"] = f"{'step' if name == 'MuJoCo' else 'tolerance'} {setting:g}"
        found[name]["tip_error_m"] = error
    # Without derivatives of their own, the others pay a run for each parameter and one more.
    for name in ("MuJoCo", "scipy"):
        found[f"{name}, value and differences"] = {
            key: figure * (len(PATHS) + 1)
            for key, figure in found[name].items()
            if key in ("min_s", "median_s")
        } | {"setting": f"{len(PATHS) + 1} runs"}
    return found


def derivatives(
    arm: giajax.Arm, command: Signal, times: jax.Array, tolerance: float
) -> tuple[Callable, Callable]:
    """All link centres over time, without and with their Jacobian by the four parameters."""

    def centres(values: jax.Array) -> jax.Array:
        changed = giajax.replace(arm, {path: values[i] for i, path in enumerate(PATHS)})
        motion = giajax.simulate(
            changed, command, times, rtol=tolerance, atol=tolerance, throw=False
        )
        return motion.link_centres

    def with_jacobian(values: jax.Array) -> Any:
        push = lambda tangent: jax.jvp(centres, (values,), (tangent,))  # noqa: E731
        return jax.vmap(push, out_axes=(None, -1))(jnp.eye(len(PATHS)))

    return jax.jit(centres), jax.jit(with_jacobian)


FIT = """
import json, resource, sys, time
began = time.perf_counter()
from giajax.cli import main
status = main(sys.argv[1:])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"status": status, "process_s": time.perf_counter() - began, "peak_MB": peak}),
      file=sys.stderr)
"""


def measure_fit(repeats: int) -> dict[str, Figure]:
    """The whole fit: a first process, the next one, and a second call within a process."""
    found: dict[str, Figure] = {}
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": f"{folder}/cache"}
        environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.5"
        for name in ("cold process, empty cache", "process, warm cache"):
            out = f"{folder}/{name.partition(',')[0]}"
            arguments = ["fit", "--data", str(RUN), "--out", out, "--quiet", *away_from_truth()]
            ended = subprocess.run(
                [sys.executable, "-c", FIT, *arguments],
                env=environment,
                capture_output=True,
                text=True,
                check=True,
            )
            result = giajax.load_result(out)
            said = json.loads(ended.stderr.strip().splitlines()[-1])
            found[name] = {
                "min_s": said["process_s"],
                "iterations": result.iterations,
                "compile_s": result.seconds["compile"],
                "run_s": result.seconds["run"],
                "peak_MB": said["peak_MB"],
            }
    run = giajax.read_run(RUN)
    model = giajax.model_for([run])
    start = {path: float(value) for path, value in map(split, away_from_truth()[1::2])}
    fits = timed({"fit": lambda: giajax.fit(model, run, start=start)}, repeats)
    iterations = giajax.fit(model, run, start=start).iterations
    found["second call in a process"] = {**fits["fit"], "iterations": iterations}
    return found


def away_from_truth() -> list[str]:
    """Options that start the fit at half the drag and stiffness, and three times the damping."""
    starts = {"air.drag_coefficient": 0.6, "joints.pitch_stiffness": 1.2, "joints.damping": 0.2}
    return [item for path, value in starts.items() for item in ("--start", f"{path}={value}")]


def split(pair: str) -> tuple[str, float]:
    """A parameter path and its value."""
    path, _, value = pair.partition("=")
    return path, float(value)


def measure_links(repeats: int, counts: Sequence[int]) -> dict[str, Figure]:
    """One evaluation for chains of several lengths, microseconds."""
    loops = {}
    for links in counts:
        loops[f"{links} links"] = evaluation_loop(*driven_arm(links), 2000)
    found = timed(loops, repeats)
    for figure in found.values():
        figure["min_us"] = figure["min_s"] / 2000 * 1e6
        figure["median_us"] = figure["median_s"] / 2000 * 1e6
    return found


def ratio(numerator: Figure, denominator: Figure) -> float:
    """Ratio of the medians of two figures of this run."""
    return numerator["median_s"] / denominator["median_s"]


def measure(repeats: int, links: Sequence[int], *, fit: bool) -> dict[str, Any]:
    """Everything, as plain data."""
    arm, command = driven_arm()
    evaluation = measure_evaluation(arm, command, repeats)
    run = measure_run(arm, command, repeats)
    record: dict[str, Any] = {
        "evaluation": evaluation,
        "run": run,
        "fit": measure_fit(repeats) if fit else {},
        "links": measure_links(repeats, links),
        "ratios": {
            "run: MuJoCo with a Python callback / giajax": ratio(run["MuJoCo"], run["giajax"]),
            "run: scipy / giajax": ratio(run["scipy"], run["giajax"]),
            "giajax: value and Jacobian / plain run": ratio(
                run["giajax, value and Jacobian"], run["giajax, plain"]
            ),
            "4 derivatives: MuJoCo by differences / giajax": ratio(
                run["MuJoCo, value and differences"], run["giajax, value and Jacobian"]
            ),
            "4 derivatives: scipy by differences / giajax": ratio(
                run["scipy, value and differences"], run["giajax, value and Jacobian"]
            ),
        },
        "machine": {
            "cores": os.cpu_count(),
            "platform": platform.platform(),
            "date": time.strftime("%Y-%m-%d"),
            "peak_MB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        },
        "versions": {
            name: version(name) for name in ("giajax", "jax", "diffrax", "mujoco", "scipy")
        },
    }
    return record


def show(record: dict[str, Any]) -> None:
    """The tables."""
    console = Console()
    titles = {
        "evaluation": "one evaluation of the accelerations",
        "run": f"25 s, joints 1 and 2 driven, tip within {TIP_ERROR:g} m",
        "fit": "the fit of data/synthetic/base_step.csv",
        "links": "one evaluation by number of links",
    }
    for key, title in titles.items():
        if not record[key]:
            continue
        columns = list(dict.fromkeys(name for row in record[key].values() for name in row))
        table = Table(title=title, title_justify="left", box=None)
        table.add_column("")
        for column in columns:
            table.add_column(column, justify="right")
        for name, row in record[key].items():
            table.add_row(name, *(cell(row.get(column)) for column in columns))
        console.print(table)
        console.print()
    for name, value in record["ratios"].items():
        console.print(f"{value:8.3g}  {name}")


def cell(value: Any) -> str:
    """A cell of a table."""
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Measure, print the tables, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few repeats, no fit: a smoke test")
    parser.add_argument("--out", type=Path, default=ROOT / "benchmarks" / "results" / "bench.json")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    repeats = 2 if options.quick else 7
    links = (10, 20) if options.quick else (10, 20, 40, 80)
    record = measure(repeats, links, fit=not options.quick)
    show(record)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(record, indent=2) + "\n")
    print(f"\nwrote {options.out}")


if __name__ == "__main__":
    main()
