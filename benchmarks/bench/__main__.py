"""`python -m benchmarks.bench`: measure, print, store, and compare with the stored ratios."""

import datetime
import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import jax
from rich.console import Console

import benchmarks.bench
from benchmarks import right_model
from benchmarks.bench._batch import ITEMS, batch, on_gpu
from benchmarks.bench._evaluation import evaluation
from benchmarks.bench._fit import base_step, fits, small_run
from benchmarks.bench._problem import ACCURACY, Problem
from benchmarks.bench._process import processes
from benchmarks.bench._ratios import ratios
from benchmarks.bench._run import run_and_gradient
from benchmarks.bench._tables import show
from benchmarks.history import judge, record
from benchmarks.measuring import RESULTS, command_line, store

PACKAGES = ("giajax", "jax", "diffrax", "equinox", "mujoco", "casadi", "numpy", "scipy")


def measure(quick: bool, console: Console) -> dict[str, Any]:
    """Run all measurements; `quick` uses a short arm and measures once."""
    links, seconds, repeats = (3, 2.0, 1) if quick else (20, 25.0, 9)
    loop = 200 if quick else 20_000
    load = os.getloadavg()[0]
    problem = Problem(links, seconds)
    with console.status("compiling the peers ..."):
        generated, engine = problem.casadi, problem.mujoco
    console.print("peers: compiled")
    with console.status("one evaluation ..."):
        sizes = (links,) if quick else (10, 20, 40, 80)
        evaluations = {
            count: evaluation(count, repeats, loop, generated if count == links else None)
            for count in sizes
        }
    console.print("evaluations: done")
    with console.status("many evaluations ..."):
        many = batch(links, repeats, max(loop // 1000, 2), engine)
    console.print("two cores: done")
    with console.status("the run and its derivatives ..."):
        both = run_and_gradient(problem, repeats, quick)
    console.print("the run and its derivatives: done")
    with console.status("the whole fit ..."):
        whole = fits(small_run() if quick else base_step(), min(repeats, 3))
        alone = None if quick else processes()
    with console.status("arms with more physics ..."):
        physics = right_model.measure(quick)
    with console.status("a GPU, if there is one ..."):
        try:
            gpu = on_gpu(links, repeats, loop // 1000)
        except Exception as error:  # for example, its memory is in use: keep all other rows
            console.print(f"the GPU is left out: {error}")
            gpu = {}
    found = {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "machine": {
            "processor": platform.machine(),
            "cores": os.cpu_count(),
            "load_before": load,
            "load_after": os.getloadavg()[0],
        },
        "versions": _versions(),
        "problem": {
            "links": links, "seconds": seconds, "tip_accuracy_m": ACCURACY, "batch": ITEMS,
        },
        "evaluation": evaluations[links],
        "evaluations": evaluations,
        "batch": many,
        **both,
        "arms": physics["arms"],
        "each": physics["each"],
        "gpu": gpu,
        "fits": whole,
        "processes": alone,
    }  # fmt: skip
    return found | {"ratios": ratios(found)}


def _versions() -> dict[str, str | None]:
    found: dict[str, str | None] = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found


def main() -> int:
    """Run the benchmark; return exit status 1 if a ratio has decreased since it was stored."""
    arguments = command_line(
        benchmarks.bench.__doc__,
        RESULTS / "bench.json",
        switches={
            "record": "append the ratios to benchmarks/history.jsonl",
            "check": "fail when a ratio fell by a fifth against the last of these",
        },
    )
    if arguments.quick and (arguments.record or arguments.check):
        sys.exit("a quick run is too inaccurate for --record and --check: omit --quick or both")
    jax.config.update("jax_enable_x64", True)
    # All measurements except those of the GPU use the CPU.
    jax.config.update("jax_platforms", "cpu")
    console = Console()
    found = measure(arguments.quick, console)
    show(found, console)
    store(found, arguments.out)
    console.print(f"written to {arguments.out}")
    status = judge(found) if arguments.check else 0
    if arguments.record:
        record(found)
    return status


if __name__ == "__main__":
    sys.exit(main())
