"""giajax beside MuJoCo and scipy on one chain, in one run: `make bench`.

Every contender solves the same problem: the 20-link arm of the paper, joints 1 and 2 driven, 25 s.
Each takes the coarsest step or tolerance that keeps the tip within 1e-4 m of a tight reference;
the table shows which. Times are wall time, minimum and median of the repeats; contenders take
turns, so that another load on the machine falls on all of them. Compare ratios, not seconds.

    python -m benchmarks.bench [--quick] [--out FILE]
"""

import datetime
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

import giajax.parameters
from benchmarks.measuring import RESULTS, command_line, store
from giajax.arm import Arm, acceleration
from giajax.simulation import Signal, simulate
from peers.arms import driven_arm, random_states
from peers.mujoco_chain import MujocoChain
from peers.scipy_chain import ScipyChain

ROOT = Path(__file__).resolve().parents[1]
RUN = ROOT / "data" / "synthetic" / "base_step.csv"

ACCURACY = 1e-4  # m, at the tip
SAMPLE = 0.5  # s; divides the corners of the command, so that every step SAMPLE / n fits
PARAMETERS = {
    "air.drag_coefficient": 1.2,
    "joints.pitch_stiffness": 3.0,
    "joints.yaw_stiffness": 30.0,
    "joints.damping": 0.05,
}
START = {"air.drag_coefficient": 0.6, "joints.pitch_stiffness": 1.2, "joints.damping": 0.2}
TOLERANCES = [10.0 ** (-exponent / 2) for exponent in range(4, 17)]


class Problem:
    """The chain, its command and a tight reference for the path of its tip."""

    def __init__(self, links: int, seconds: float) -> None:
        self.arm, self.command = driven_arm(links)
        self.times = np.linspace(0.0, seconds, round(seconds / SAMPLE) + 1)
        self.numpy = ScipyChain(self.arm, self.command)
        tight = simulate(
            self.arm, self.command, self.times, solver="dopri8", rtol=1e-11, atol=1e-11
        )
        self.reference = np.asarray(tight.tip)

    def error(self, tip: Any) -> float:
        """Largest distance of a path of the tip from the reference, m."""
        return float(np.linalg.norm(np.asarray(tip) - self.reference, axis=1).max())

    def with_parameters(self, values: Iterable[float]) -> Arm:
        """The arm with other values of the four parameters."""
        return giajax.parameters.replace(self.arm, dict(zip(PARAMETERS, values, strict=True)))


# The three contenders: the path of the tip for one setting (a tolerance, or a step in seconds).


@eqx.filter_jit
def giajax_tip(values: Any, problem: Any, tolerance: Any) -> Any:
    arm, command, times = problem
    arm = giajax.parameters.replace(arm, dict(zip(PARAMETERS, values, strict=True)))
    options = {"rtol": tolerance, "atol": tolerance, "throw": False}
    return simulate(arm, command, times, **options).tip


@eqx.filter_jit
def giajax_tip_and_jacobian(values: Any, problem: Any, tolerance: Any) -> Any:
    def push(direction: Any) -> Any:
        return jax.jvp(lambda x: giajax_tip(x, problem, tolerance), (values,), (direction,))

    return jax.vmap(push, out_axes=(None, -1))(jnp.eye(len(values)))


def mujoco_tip(problem: Problem, arm: Arm, step: float) -> np.ndarray:
    states = MujocoChain(arm, problem.command).trajectory(problem.times, step)
    return problem.numpy.tip(states[:, 0])


def scipy_tip(problem: Problem, method: str, arm: Arm, tolerance: float) -> np.ndarray:
    chain = ScipyChain(arm, problem.command)
    options: dict[str, Any] = {"method": method, "rtol": tolerance, "atol": tolerance}
    return problem.numpy.tip(chain.trajectory(problem.times, **options)[:, 0])


def scipy_differences(problem: Problem, method: str, tolerance: float) -> np.ndarray:
    return central_differences(
        lambda x: scipy_tip(problem, method, problem.with_parameters(x), tolerance)
    )


def coarsest(
    problem: Problem, tip: Callable[[float], Any], settings: Iterable[float]
) -> tuple[float, float]:
    """The first setting that keeps the tip within the accuracy, and the error it has."""
    for setting in settings:
        try:
            error = problem.error(tip(setting))
        except FloatingPointError:
            continue
        if error < ACCURACY:
            return setting, error
    raise RuntimeError(f"no setting keeps the tip within {ACCURACY:g} m")


def central_differences(tip: Callable[[Any], np.ndarray]) -> np.ndarray:
    values = np.array(list(PARAMETERS.values()))
    columns = []
    for index, value in enumerate(values):
        # Below this the steps that the solver takes otherwise are seen, not the parameter.
        step = 1e-2 * value
        forth, back = (np.array(values) for _ in range(2))
        forth[index] += step
        back[index] -= step
        columns.append((tip(forth) - tip(back)) / (2 * step))
    return np.stack(columns, axis=-1)


def timed(contenders: dict[str, Callable[[], Any]], repeats: int) -> dict[str, dict[str, float]]:
    """Seconds of each contender, in turns, after one call that does not count."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for repeat in range(repeats + 1):
        for name, call in contenders.items():
            began = time.perf_counter()
            jax.block_until_ready(call())
            if repeat:
                seconds[name].append(time.perf_counter() - began)
    return {
        name: {"min": min(each), "median": statistics.median(each)}
        for name, each in seconds.items()
    }


def evaluation(links: int, repeats: int, loop: int) -> dict[str, Any]:
    """One evaluation of the accelerations, s."""
    arm, _ = driven_arm(links)
    state = {name: value[0] for name, value in random_states(links, 1).items()}
    given = {name: np.asarray(value) for name, value in state.items() if name != "wind"}

    @jax.jit
    def many(arm: Arm, angles: Any, rates: Any, command: Any) -> Any:
        # Each evaluation needs the one before: none may be left out or done at once.
        def again(_: Any, angles: Any) -> Any:
            return angles + 1e-9 * acceleration(arm, angles, rates, command)

        return jax.lax.fori_loop(0, loop, again, angles)

    numpy, engine = ScipyChain(arm), MujocoChain(arm)
    engine.data.qpos[:], engine.data.qvel[:] = given["angles"], given["rates"]

    def forward() -> None:
        with engine.forces():
            for _ in range(few):
                mujoco.mj_forward(engine.model, engine.data)

    few = max(loop // 20, 10)
    found = timed(
        {
            "giajax": lambda: many(arm, state["angles"], state["rates"], state["command"]),
            "MuJoCo": forward,
            "numpy": lambda: [numpy.acceleration(**given) for _ in range(few)],
        },
        repeats,
    )
    return {
        name: {key: value / (loop if name == "giajax" else few) for key, value in each.items()}
        for name, each in found.items()
    }


def run_and_gradient(problem: Problem, repeats: int) -> dict[str, Any]:
    """The whole run at one accuracy, and its derivatives by four parameters."""
    values = jnp.asarray(list(PARAMETERS.values()))
    inputs: tuple[Arm, Signal, Any] = (problem.arm, problem.command, jnp.asarray(problem.times))

    def mine(tolerance: float) -> Any:
        return giajax_tip(values, inputs, jnp.asarray(tolerance))

    began = time.perf_counter()
    jax.block_until_ready(mine(1e-6))
    compile_run = time.perf_counter() - began
    began = time.perf_counter()
    jax.block_until_ready(giajax_tip_and_jacobian(values, inputs, jnp.asarray(1e-6)))
    compile_gradient = time.perf_counter() - began

    tolerance, error = coarsest(problem, mine, TOLERANCES)
    chosen = {"giajax Tsit5": {"setting": f"tolerance {tolerance:.0e}", "error": error}}
    tight = jnp.asarray(tolerance)
    steps = (SAMPLE / n for n in range(8, 200))
    step, error = coarsest(problem, lambda step: mujoco_tip(problem, problem.arm, step), steps)
    chosen["MuJoCo RK4"] = {"setting": f"step {step * 1e3:.1f} ms", "error": error}
    runs: dict[str, Callable[[], Any]] = {
        "giajax Tsit5": lambda: giajax_tip(values, inputs, tight),
        "MuJoCo RK4": lambda: mujoco_tip(problem, problem.arm, step),
    }
    gradients: dict[str, Callable[[], Any]] = {
        "giajax Tsit5": lambda: giajax_tip_and_jacobian(values, inputs, tight)[1],
        "MuJoCo RK4": lambda: central_differences(
            lambda x: mujoco_tip(problem, problem.with_parameters(x), step)
        ),
    }
    for method in ("RK45", "DOP853", "LSODA"):
        tip = partial(scipy_tip, problem, method)
        loosest, error = coarsest(problem, partial(tip, problem.arm), TOLERANCES)
        name = f"scipy {method}"
        chosen[name] = {"setting": f"tolerance {loosest:.0e}", "error": error}
        runs[name] = partial(tip, problem.arm, loosest)
        gradients[name] = partial(scipy_differences, problem, method, loosest)

    run = timed(runs, repeats)
    fastest = min((name for name in runs if "scipy" in name), key=lambda name: run[name]["min"])
    compared = {name: gradients[name] for name in ("giajax Tsit5", "MuJoCo RK4", fastest)}
    gradient = timed(compared, max(repeats // 3, 1))
    # The quick one again, as often as the run that it is compared with.
    gradient["giajax Tsit5"] = timed({"": compared["giajax Tsit5"]}, repeats)[""]
    exact = np.asarray(giajax_tip_and_jacobian(values, inputs, jnp.asarray(1e-10))[1])
    for name, call in compared.items():
        # Of the columns, each for a parameter that doubles: m at the tip.
        gradient[name]["error"] = float(np.abs((np.asarray(call()) - exact) * values).max())
    return {
        "chosen": chosen,
        "run": run,
        "gradient": gradient,
        "compile": {"run": compile_run, "gradient": compile_gradient},
    }


def whole_fit(repeats: int) -> dict[str, Any] | None:
    """The base-step fit from far off: as a cold process, as the next one, and again in this one."""
    if not RUN.exists():
        return None
    with tempfile.TemporaryDirectory() as folder:
        # An empty folder: nothing was compiled before the first of the two processes.
        environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "cache")}
        processes = {
            name: fit_process(Path(folder) / name, environment) for name in ("cold", "next")
        }

    from giajax.fitting import fit
    from giajax.models import model_for
    from giajax.runs import read_run

    run = read_run(RUN)
    model = model_for([run])
    return processes | {"warm": timed({"": lambda: fit(model, run, start=START)}, repeats)[""]}


def fit_process(out: Path, environment: dict[str, str]) -> dict[str, Any]:
    """`giajax fit` as a process of its own: wall time, peak memory and what it says itself."""
    starts = [word for path, value in START.items() for word in ("--start", f"{path}={value}")]
    program = [sys.executable, "-c", "from giajax.cli import main; raise SystemExit(main())"]
    options = ["--data", str(RUN), "--out", str(out), "--quiet", *starts]
    began = time.perf_counter()
    with subprocess.Popen([*program, "fit", *options], env=environment) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - began
    if process.returncode != 0:
        raise RuntimeError(f"giajax fit ended with status {process.returncode}")
    result = json.loads((out / "result.json").read_text())
    # Linux counts in kB, macOS in bytes.
    unit = 1024**2 if sys.platform == "darwin" else 1024
    return {
        "wall": wall,
        "peak_megabytes": usage.ru_maxrss / unit,
        "iterations": result["iterations"],
        "compile": result["seconds"]["compile"],
        "run": result["seconds"]["run"],
    }


def measure(quick: bool, console: Console) -> dict[str, Any]:
    links, seconds, repeats = (3, 2.0, 1) if quick else (20, 25.0, 9)
    loop = 200 if quick else 20_000
    load = os.getloadavg()[0]
    with console.status("one evaluation ..."):
        sizes = (links,) if quick else (10, 20, 40, 80)
        evaluations = {count: evaluation(count, repeats, loop) for count in sizes}
    with console.status("the run and its derivatives ..."):
        both = run_and_gradient(Problem(links, seconds), repeats)
    with console.status("the whole fit ..."):
        fitted = None if quick else whole_fit(3)
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "load_before": load,
            "load_after": os.getloadavg()[0],
        },
        "versions": {
            name: version(name)
            for name in ("giajax", "jax", "diffrax", "equinox", "mujoco", "numpy", "scipy")
        }
        | {"python": platform.python_version()},
        "problem": {"links": links, "seconds": seconds, "tip_accuracy_m": ACCURACY},
        "evaluation": evaluations,
        **both,
        "fit": fitted,
        "ratios": ratios(evaluations[links], both),
    }


def ratios(evaluations: dict[str, Any], both: dict[str, Any]) -> dict[str, float]:
    """Minima over minima, within this run: another load can only add to a time."""

    def over(table: dict[str, Any], name: str) -> float:
        mine = next(key for key in table if key.startswith("giajax"))
        return table[name]["min"] / table[mine]["min"]

    run, gradient = both["run"], both["gradient"]
    best = min((name for name in run if "scipy" in name), key=lambda name: run[name]["min"])
    return {
        "evaluation: MuJoCo over giajax": over(evaluations, "MuJoCo"),
        "evaluation: numpy over giajax": over(evaluations, "numpy"),
        "run: MuJoCo over giajax": over(run, "MuJoCo RK4"),
        "run: best of scipy over giajax": over(run, best),
        "gradient: MuJoCo over giajax": over(gradient, "MuJoCo RK4"),
        "giajax: value and Jacobian over the run": gradient["giajax Tsit5"]["min"]
        / run["giajax Tsit5"]["min"],
    }


def show(found: dict[str, Any], console: Console) -> None:
    problem = found["problem"]
    table = Table(title=f"{problem['links']} links, {problem['seconds']:g} s; times: min / median")
    for heading in ("", "setting", "tip error, m", "run, ms", "value + 4 columns, ms", "error, m"):
        table.add_column(heading, justify="left" if heading in ("", "setting") else "right")
    for name, setting in found["chosen"].items():
        gradient = found["gradient"].get(name)
        table.add_row(
            name,
            setting["setting"],
            f"{setting['error']:.1e}",
            spread(found["run"][name], 1e3),
            spread(gradient, 1e3) if gradient else "",
            f"{gradient['error']:.0e}" if gradient else "",
        )
    console.print(table)
    console.print("error: largest of the columns, each for a parameter that doubles")
    table = Table(title="One evaluation, us: min / median")
    table.add_column("links", justify="right")
    for name in ("giajax", "MuJoCo", "numpy"):
        table.add_column(name, justify="right")
    for count, each in found["evaluation"].items():
        table.add_row(str(count), *(spread(times, 1e6) for times in each.values()))
    console.print(table)
    if found["fit"] is None:
        console.print("The whole fit was not measured.")
    else:
        table = Table(title="The base-step fit, from half the drag and stiffness")
        for heading in ("", "s", "compiling, s", "iterations", "peak, MB"):
            table.add_column(heading, justify="right" if heading else "left")
        for name, title in (("cold", "a cold process"), ("next", "the next process")):
            each = found["fit"][name]
            times = (f"{each['wall']:.1f}", f"{each['compile']:.1f}")
            table.add_row(title, *times, str(each["iterations"]), f"{each['peak_megabytes']:.0f}")
        table.add_row("again in one process", spread(found["fit"]["warm"], 1))
        console.print(table)
    table = Table(title="Ratios of minima within this run")
    table.add_column("")
    table.add_column("", justify="right")
    for name, ratio in found["ratios"].items():
        table.add_row(name, f"{ratio:.2f}")
    console.print(table)
    load = found["machine"]
    if load["load_before"] > 0.5 * (load["cores"] or 1):
        console.print(f"The machine was busy (load {load['load_before']:.1f}): trust ratios only.")


def spread(times: dict[str, float], unit: float) -> str:
    return f"{times['min'] * unit:.3g} / {times['median'] * unit:.3g}"


def main() -> None:
    arguments = command_line(__doc__, RESULTS / "bench.json")
    jax.config.update("jax_enable_x64", True)
    console = Console()
    found = measure(arguments.quick, console)
    show(found, console)
    store(found, arguments.out)
    console.print(f"written to {arguments.out}")


if __name__ == "__main__":
    main()
