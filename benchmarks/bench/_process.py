"""The base-step fit as a separate process, with cold and warm caches, and its bootstrap."""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

RUN = Path(__file__).resolve().parents[2] / "data" / "synthetic" / "base_step.csv"
REFITS = 60
REPEATS = 3
START = {"air.drag_coefficient": 0.6, "joints.pitch_stiffness": 1.2, "joints.damping": 0.2}


def processes() -> dict[str, Any]:
    """Run the fit from a distant initial guess as a cold process and as the next process.

    `refits` is the wall time of its bootstrap in one process with a warm cache, s. The times with a
    warm cache are the least of several.
    """
    with tempfile.TemporaryDirectory() as folder:
        # The cache is empty, so the first process compiles everything.
        environment = os.environ | {
            "JAX_COMPILATION_CACHE_DIR": str(Path(folder) / "cache"),
            "JAX_PLATFORMS": "cpu",
        }
        found = {"cold": _fit(Path(folder) / "cold", environment)}
        warm = [_fit(Path(folder) / f"warm {turn}", environment) for turn in range(REPEATS)]
        found["next"] = min(warm, key=lambda each: each["wall"])
        study = ["bootstrap", str(Path(folder) / "warm 0"), "--size", str(REFITS)]
        # The first process of the study compiles.
        studies = [
            _process([*study, "--no-figures", "--quiet", "--force"], environment)[0]
            for _ in range(1 + REPEATS)
        ]
        return found | {"refits": min(studies[1:])}


def _process(command: list[str], environment: dict[str, str]) -> tuple[float, Any]:
    """Run a command of giajax in a separate process; return its wall time, s, and its usage."""
    program = [sys.executable, "-m", "giajax"]
    began = time.perf_counter()
    with subprocess.Popen([*program, *command], env=environment) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    wall = time.perf_counter() - began
    if process.returncode != 0:
        raise RuntimeError(f"giajax {command[0]} ended with status {process.returncode}")
    return wall, usage


def _fit(out: Path, environment: dict[str, str]) -> dict[str, Any]:
    """Run the fit in a separate process; return wall time, peak memory and its own figures."""
    starts = [word for path, value in START.items() for word in ("--start", f"{path}={value}")]
    options = ["--data", str(RUN), "--out", str(out), "--no-figures", "--quiet", *starts]
    wall, usage = _process(["fit", *options], environment)
    result = json.loads((out / "result.json").read_text())
    # Linux reports kB, macOS reports bytes.
    unit = 1024**2 if sys.platform == "darwin" else 1024
    return {
        "wall": wall,
        "peak_megabytes": usage.ru_maxrss / unit,
        "iterations": result["iterations"],
        "compile": result["seconds"]["compile"],
        "run": result["seconds"]["run"],
    }
