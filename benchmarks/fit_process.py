"""`giajax fit` as a process, first and later, and what of it comes before the first iteration.

A cold process begins with an empty cache, which the warm ones after it find filled. Beside another
checkout of giajax the two take turns, each with a cache of its own, and the least of each counts:
processor time, which another program beside them lengthens less than the time on the clock.
With `--steps` also the least time of a step (value and Jacobian) of four definitions.
Beside the version before programs had options of XLA (d753237) the limits are 0.75 cold, 0.45 warm,
and 0.5 for a step; the exit status says whether they are held.

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

# What a process runs, in place of the command: it counts what JAX compiles, reads from the cache
# (which JAX counts as compiled, too) and traces.
_PROCESS = """
import json, sys, time
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
print(json.dumps({"status": status, "processor_s": processor, "clock_s": clock, **counts}),
      file=sys.stderr)
"""


def process(checkout: Path, cache: Path, command: Sequence[str]) -> dict[str, Any]:
    """Run a command by the source of a checkout in a process of its own.

    Arguments:
        checkout: root of the project, of this or of another version.
        cache: of the user.
        command: as after `giajax`.

    Returns:
        Its times in s, and what it compiled.
    """
    environment = source_of(checkout) | {"XDG_CACHE_HOME": str(cache)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    # An installed package has its bytecode.
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
    """Run a fit by the source of a checkout in a process of its own.

    Arguments:
        checkout: root of the project, of this or of another version.
        cache: of the user.
        out: folder of the result.
        options: further ones of `giajax fit`.
        fit: its definition; by default its own of the base step.

    Returns:
        Its times in s, what it compiled, and its estimates by path.
    """
    command = ["fit", str(fit or checkout / FIT), "--out", str(out), "--force", *options]
    found = process(checkout, cache, command)
    result = json.loads((out / "result.json").read_text())
    free = {path: each for path, each in result["parameters"].items() if each["free"]}
    found["estimates"] = {path: each["value"] for path, each in free.items()}
    return found


def measure(checkouts: dict[str, Path], cold: int, warm: int, options: list[str]) -> dict[str, Any]:
    """Least times of each checkout, cold and warm, which take turns.

    Arguments:
        checkouts: by name.
        cold, warm: processes of each.
        options: further ones of `giajax fit`.
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
    """Least processor time of a step of the fits of each checkout, s, by definition.

    Arguments:
        checkouts: by name.
        options: further ones of `giajax fit`.
    """
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for each in STEPS:
            found[each] = {}
            for name, path in checkouts.items():
                # Each version reads its own definitions.
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
    """Processor time of this checkout over that of the other, cold and warm."""
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
    """Whether the limits are, where there is something to compare with."""
    beside = [each for each in found.get("steps", {}).values() if "beside" in each]
    return all(ratio <= MOST[kind] for kind, ratio in found.get("ratios", {}).items()) and all(
        each["here"] <= MOST_OF_A_STEP * each["beside"] for each in beside
    )


def main() -> int:
    """Measure, print, store, and say by the exit status whether the limits are held."""
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
