"""Time of `giajax fit` as a process with cold and warm caches, and time to the first iteration.

A cold process starts with an empty cache. The warm processes after it use the cache that it filled.
If another checkout is given, the two checkouts take turns, each with its own cache. The reported
time is the least processor time, which depends less on the load of the machine than wall time.
With `--steps`, the benchmark also measures the least time of a step (value and Jacobian) for four
definitions. The limits, relative to d753237 (the last version without XLA options), are 0.75
(cold), 0.45 (warm) and 0.5 (step). The exit status is 1 if a limit is exceeded.

    python -m benchmarks.fit_process [--quick] [--steps] [--beside CHECKOUT] [--out FILE]
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.measuring import (
    RESULTS,
    checkouts_of,
    command_line,
    source_of,
    store,
)

FIT = "fits/base_step.toml"
STEPS = ("base_step", "pitch_yaw", "wind", "full_air")
MOST = {"cold": 0.75, "warm": 0.45}
MOST_OF_A_STEP = 0.5

# The process runs this code in place of the command. It counts the programs that JAX compiles and
# those that JAX reads from the cache. JAX counts the latter as compiled, too.
_PROCESS = """
import json, resource, sys, time
began = time.process_time(), time.perf_counter()
counts = {"compiled": 0, "cached": 0, "first_iteration_s": None, "step_s": None}

def listen():
    from jax import monitoring

    def compiled(name, duration, **_):
        counts["compiled"] += name.endswith("backend_compile_duration")

    def cached(name, **_):
        counts["cached"] += name.endswith("cache_hits")

    monitoring.register_event_duration_secs_listener(compiled)
    monitoring.register_event_listener(cached)

class Lines:
    # Progress goes to standard error; the row of the start is numbered 0.
    def __init__(self, stream):
        self.stream = stream
        self.last = None

    def write(self, text):
        row, now = (text.split() or [""])[0], time.process_time()
        if row == "0" and counts["first_iteration_s"] is None:
            counts["first_iteration_s"] = now - began[0]
        if row.isdigit():
            if self.last is not None:
                counts["step_s"] = min(now - self.last, counts["step_s"] or now)
            self.last = now
        return self.stream.write(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)

sys.stderr = Lines(sys.stderr)
try:
    from giajax.__main__ import main
except ImportError:  # Of the first versions.
    from giajax.cli import main
listen()
try:
    status = main()
except SystemExit as end:
    status = end.code
processor, clock = time.process_time() - began[0], time.perf_counter() - began[1]
# Linux reports kB, macOS reports bytes.
unit = 1024**2 if sys.platform == "darwin" else 1024
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
found = {"status": status, "processor_s": processor, "clock_s": clock, "peak_megabytes": peak}
print(json.dumps(found | counts), file=sys.stderr)
"""


def process(checkout: Path, cache: Path, command: Sequence[str]) -> dict[str, Any]:
    """Run a command in a separate process on the CPU, with the source of a checkout.

    Arguments:
        checkout: root of the project, in this or another version.
        cache: cache directory of the user.
        command: words after `giajax`.

    Returns:
        The times in s, the largest memory in MB, and the numbers of compiled and cached programs.
    """
    environment = source_of(checkout) | {"XDG_CACHE_HOME": str(cache), "JAX_PLATFORMS": "cpu"}
    for name in ("COMPILATION_CACHE_DIR", "PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"):
        environment.pop(f"JAX_{name}", None)
    # An installed package comes with its bytecode.
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    done = subprocess.run(
        [sys.executable, "-c", _PROCESS, *command],
        capture_output=True,
        text=True,
        env=environment,
        cwd=checkout,
    )
    last = (done.stderr.splitlines() or [""])[-1]
    if done.returncode or not last.startswith("{"):
        raise SystemExit(f"{command[0]} by {checkout} ended with {done.returncode}: {done.stderr}")
    found: dict[str, Any] = json.loads(last)
    return found


def fitted(
    checkout: Path, cache: Path, out: Path, options: list[str], fit: Path | None = None
) -> dict[str, Any]:
    """Run a fit in a separate process on the CPU, with the source of a checkout.

    Arguments:
        checkout: root of the project, in this or another version.
        cache: cache directory of the user.
        out: folder of the result.
        options: further options of `giajax fit`.
        fit: definition file; by default, the base-step definition of the checkout.

    Returns:
        The times in s, the numbers of compiled and cached programs, and the estimates by path.
    """
    command = ["fit", str(fit or checkout / FIT), "--out", str(out), "--force", *options]
    found = process(checkout, cache, command)
    result = json.loads((out / "result.json").read_text())
    free = {path: each for path, each in result["parameters"].items() if each["free"]}
    found["estimates"] = {path: each["value"] for path, each in free.items()}
    return found


def measure(checkouts: dict[str, Path], cold: int, warm: int, options: list[str]) -> dict[str, Any]:
    """Measure the least cold and warm times of each checkout; the checkouts take turns.

    Arguments:
        checkouts: root of each checkout, by name.
        cold, warm: number of processes of each kind.
        options: further options of `giajax fit`.
    """
    kinds: dict[str, dict[str, list[dict[str, Any]]]] = {
        name: {"cold": [], "warm": []} for name in checkouts
    }
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for turn in range(cold):
            for name, path in checkouts.items():
                cache = root / f"cache {name} {turn}"
                kinds[name]["cold"].append(fitted(path, cache, root / name, options))
        for _ in range(warm):
            for name, path in checkouts.items():
                cache = root / f"cache {name} {cold - 1}"
                kinds[name]["warm"].append(fitted(path, cache, root / name, options))
    return {
        name: {kind: _least(processes) for kind, processes in each.items()}
        for name, each in kinds.items()
    }


def steps(checkouts: dict[str, Path], options: list[str]) -> dict[str, dict[str, float]]:
    """Measure the least processor time of a step for each definition and checkout, s.

    Arguments:
        checkouts: root of each checkout, by name.
        options: further options of `giajax fit`.
    """
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for each in STEPS:
            found[each] = {}
            for name, path in checkouts.items():
                # Each version reads the definitions of its own checkout.
                file = path / "fits" / f"{each}.toml"
                process = fitted(path, root / f"cache {name}", root / name, options, file)
                found[each][name] = process["step_s"]
    return found


def _least(processes: list[dict[str, Any]]) -> dict[str, Any]:
    times = {
        key: min(process[key] for process in processes)
        for key in ("processor_s", "clock_s", "first_iteration_s")
    }
    return {**processes[-1], **times}


def ratios(found: dict[str, Any]) -> dict[str, float]:
    """Return the processor time of this checkout divided by that of the other, cold and warm."""
    here, beside = found["here"], found["beside"]
    return {kind: here[kind]["processor_s"] / beside[kind]["processor_s"] for kind in here}


def show(found: dict[str, Any], console: Console) -> None:
    table = Table(title=f"giajax fit {FIT}, s")
    headings = ("", "processor", "clock", "to the first iteration", "compiled", "of them cached")
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    for name, kinds in found["processes"].items():
        for kind, each in kinds.items():
            seconds = (each[key] for key in ("processor_s", "clock_s", "first_iteration_s"))
            counts = (str(each["compiled"]), str(each["cached"]))
            table.add_row(f"{name}, {kind}", *(f"{value:.2f}" for value in seconds), *counts)
    console.print(table)
    for kind, ratio in found.get("ratios", {}).items():
        console.print(f"{kind}: {ratio:.2f} of the processor time of the other")
    for fit, times in found.get("steps", {}).items():
        here, other = times["here"], times.get("beside")
        ratio = "" if other is None else f", {here / other:.2f} of that of the other"
        console.print(f"a step of {fit}: {1e3 * here:.0f} ms{ratio}")


def are_held(found: dict[str, Any]) -> bool:
    """Return whether all limits are respected; without another checkout, there are no limits."""
    beside = [each for each in found.get("steps", {}).values() if "beside" in each]
    return all(ratio <= MOST[kind] for kind, ratio in found.get("ratios", {}).items()) and all(
        each["here"] <= MOST_OF_A_STEP * each["beside"] for each in beside
    )


def main() -> int:
    """Measure, print and store; return exit status 1 if a limit is exceeded."""
    paths = {"beside": "another checkout of giajax"}
    switches = {"steps": "measure a step of four definitions, too"}
    out = RESULTS / "fit_process.json"
    arguments = command_line(__doc__, out, paths=paths, switches=switches)
    checkouts = checkouts_of(arguments.beside)
    options = ["--max-iterations", "1", "--no-figures"] if arguments.quick else []
    cold, warm = (1, 1) if arguments.quick else (2, 7)
    found: dict[str, Any] = {"processes": measure(checkouts, cold, warm, options)}
    if arguments.beside is not None:
        found["ratios"] = ratios(found["processes"])
    if arguments.steps:
        found["steps"] = steps(checkouts, ["--no-figures"] if arguments.beside is None else [])
    console = Console()
    show(found, console)
    store(found, arguments.out)
    console.print(f"written to {arguments.out}")
    return int(not arguments.quick and not are_held(found))


if __name__ == "__main__":
    sys.exit(main())
