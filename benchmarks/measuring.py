"""Functions that the benchmarks share: options, timing, tables, and the file of results."""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"


def command_line(
    description: str | None,
    out: Path,
    what: str = "JSON file to write",
    *,
    paths: Mapping[str, str] | None = None,
    switches: Mapping[str, str] | None = None,
    **numbers: int,
) -> Any:
    """Parse the command line of a benchmark: `--quick`, `--out`, and further options.

    Arguments:
        description: description of the benchmark; the help shows its first line.
        out: default of `--out`.
        what: help text of `--out`.
        paths: help text of each further option that takes a file or folder, by name.
        switches: help text of each further option without a value, by name.
        numbers: default of each further option that takes a number, by name.
    """
    parser = argparse.ArgumentParser(description=(description or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="a short arm, once: does it run?")
    parser.add_argument("--out", type=Path, default=out, help=what)
    for name, meaning in (paths or {}).items():
        parser.add_argument(f"--{name}", type=Path, help=meaning)
    for name, meaning in (switches or {}).items():
        parser.add_argument(f"--{name}", action="store_true", help=meaning)
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    return parser.parse_args()


def checkouts_of(beside: Path | None) -> dict[str, Path]:
    """Return this checkout as "here" and, if given, another one as "beside".

    Raises:
        SystemExit: the other checkout has no giajax, so the installed version would be measured.
    """
    if beside is None:
        return {"here": ROOT}
    if not (beside / "src" / "giajax").is_dir():
        raise SystemExit(f"{beside} has no giajax in src: give the root of a checkout")
    return {"here": ROOT, "beside": beside.resolve()}


def source_of(checkout: Path) -> dict[str, str]:
    """Return the environment of a process that imports giajax from a checkout."""
    paths = filter(None, [str(checkout / "src"), os.environ.get("PYTHONPATH")])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def fastest(call: Callable[[], object], repeats: int) -> float:
    """Return the least time of several calls, s, after one warm-up call.

    The call must wait for its own result.
    """
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return min(times)


def in_turns(
    contenders: Mapping[str, Callable[[], object]], repeats: int
) -> dict[str, dict[str, float]]:
    """Return the least and the median time of each contender, s.

    The contenders take turns. The first call of each is not measured.
    """
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for repeat in range(repeats + 1):
        for name, call in contenders.items():
            began = time.perf_counter()
            call()
            if repeat:
                seconds[name].append(time.perf_counter() - began)
    return {
        name: {"min": min(each), "median": statistics.median(each)}
        for name, each in seconds.items()
    }


def spread(times: Mapping[str, float], unit: float) -> str:
    """Format the least and the median time for a cell of a table."""
    return f"{times['min'] * unit:.3g} / {times['median'] * unit:.3g}"


def report(
    description: str | None,
    name: str,
    measure: Callable[[bool], dict[str, Any]],
    table: Callable[[dict[str, Any]], Table],
) -> None:
    """Run a benchmark: measure in 64-bit arithmetic, print a table and write the figures.

    Arguments:
        description: description of the benchmark; the help shows its first line.
        name: name of the default file in `RESULTS`.
        measure: returns the figures; its argument is whether the measurement must be quick.
        table: returns the table of the figures.
    """
    import jax

    arguments = command_line(description, RESULTS / f"{name}.json")
    jax.config.update("jax_enable_x64", True)
    found = measure(arguments.quick)
    console = Console()
    console.print(table(found))
    store(found, arguments.out)
    console.print(f"written to {arguments.out}")


def columns(title: str, *headings: str) -> Table:
    """Return an empty table; columns without a heading hold text, the others hold numbers."""
    table = Table(title=title)
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    return table


def store(found: dict[str, Any], path: Path) -> None:
    """Write figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=2) + "\n")
