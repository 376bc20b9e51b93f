"""Time and peak memory of large problems: long recordings, many runs, many samples.

The benchmark fits 30,000 rows of an arm with a smooth logged command (limits: 60 s and 1.5 GB), 100
runs, and a hysteresis loop of 100,000 samples. Each fit runs in a separate process, so its peak
memory can be measured. The times include compilation.

    python -m benchmarks.size [--quick] [--out FILE]
"""

import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from benchmarks.measuring import RESULTS, ROOT, command_line, store
from giajax import FitResult, Run, fit, model_for, predict

START = {"air.drag_coefficient": 0.6, "joints.pitch_stiffness": 2.0, "joints.damping": 0.1}
MOST_SECONDS, MOST_MEGABYTES = 60.0, 1500.0


def driven(rows: int, rate: float, links: int, seed: int = 0) -> Run:
    """Simulate the recording of an arm with a smooth logged command, at `rate` rows per second."""
    times = np.arange(rows) / rate
    random = np.random.default_rng(seed)
    phase = random.uniform(0, 2 * np.pi, 3)
    first = 0.3 * np.sin(2 * np.pi * times / 17 + phase[0])
    second = 0.2 * np.sin(2 * np.pi * times / 7.3 + phase[1])
    third = 0.2 * np.sin(2 * np.pi * times / 11 + phase[2])
    seen = [f"link{link:02d}_{axis}" for link in (links // 2, links) for axis in "yz"]
    commands = {"joint01_command": first + second, "joint02_command": third}
    about = {"arm": {"links": links}, "noise": {"position_m": 0.02}}
    name = f"run{seed}"

    def recorded(values: dict[str, np.ndarray]) -> Run:
        return Run.from_arrays(times, {**commands, **values}, name=name, definition=about)

    plan = recorded(dict.fromkeys(seen, np.zeros(rows)))
    motion = predict(model_for([plan]), plan)
    return recorded({name: motion[name] + 0.02 * random.normal(size=rows) for name in seen})


def loop(rows: int) -> Run:
    """Simulate a hysteresis loop of a play operator with many turning points."""
    times = np.linspace(0.0, 100.0, rows)
    size = 1 + 0.5 * np.sin(0.37 * times)
    plan = {"input": size * np.sin(times), "output": np.zeros(rows)}
    about = {"hysteresis": {"operator": "prandtl_ishlinskii"}, "noise": {"output": 0.01}}
    run = Run.from_arrays(times, plan, definition=about)
    output = predict(model_for([run]), run)["output"]
    noise = 0.01 * np.random.default_rng(0).normal(size=rows)
    return Run.from_arrays(times, {**plan, "output": output + noise}, definition=about)


def long_recording(quick: bool) -> dict[str, Any]:
    run = driven(300 if quick else 30_000, 30.0, 3 if quick else 20)
    return fitted([run], START)


def many_runs(quick: bool) -> dict[str, Any]:
    count, rows, links = (3, 50, 3) if quick else (100, 250, 20)
    return fitted([driven(rows, 10.0, links, seed) for seed in range(count)], START)


def many_samples(quick: bool) -> dict[str, Any]:
    return fitted([loop(1_000 if quick else 100_000)], {})


def fitted(runs: list[Run], start: dict[str, float]) -> dict[str, Any]:
    """Fit the runs, and return the time and how the fit ended."""
    began = time.perf_counter()
    result: FitResult = fit(model_for(runs), runs, start=start)
    return {
        "seconds": time.perf_counter() - began,
        "rows": sum(len(next(iter(run.observations.values()))) for run in runs),
        "status": result.status,
        "iterations": result.iterations,
        "verdict": result.verdict.status,
    }


CASES: dict[str, Callable[[bool], dict[str, Any]]] = {
    "30,000 rows": long_recording,
    "100 runs": many_runs,
    "100,000 samples": many_samples,
}


def alone(case: str, quick: bool) -> dict[str, Any]:
    """Run a case in a separate process, and return its figures with the peak memory."""
    command = [sys.executable, "-m", "benchmarks.size", case, *(["--quick"] if quick else [])]
    # The command line uses one BLAS thread, too.
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env=environment)
    if ended.returncode:
        raise RuntimeError(f"{case} ended with status {ended.returncode}: {ended.stderr[-500:]}")
    return dict(json.loads(ended.stdout.splitlines()[-1]))


def main() -> int:
    """Measure, print and store; return exit status 1 if a limit is exceeded."""
    jax.config.update("jax_enable_x64", True)
    if len(sys.argv) > 1 and sys.argv[1] in CASES:
        found = CASES[sys.argv[1]]("--quick" in sys.argv)
        # Linux reports kB, macOS reports bytes.
        unit = 1024**2 if sys.platform == "darwin" else 1024
        found["peak_megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
        print(json.dumps(found))
        return 0
    options = command_line(__doc__, RESULTS / "size.json")
    results = {}
    for case in CASES:
        results[case] = alone(case, options.quick)
        print(case, json.dumps(results[case]), flush=True)
    store({"load": os.getloadavg()[0], **results}, options.out)
    longest = results["30,000 rows"]
    held = longest["seconds"] <= MOST_SECONDS and longest["peak_megabytes"] <= MOST_MEGABYTES
    held = held and all(each["status"] == "converged" for each in results.values())
    return int(not held)


if __name__ == "__main__":
    sys.exit(main())
