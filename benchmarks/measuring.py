"""What the benchmarks share: their options, the least time of a call, and the file of figures."""

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
    """The parsed command line of a benchmark: `quick`, `out`, and what else it may be told.

    Arguments:
        description: of the benchmark; its first line is shown.
        out: where it writes by default.
        what: meaning of `out`.
        paths: further files or folders, and what each is for.
        switches: further options without a value, and what each is for.
        numbers: further numbers with their defaults.
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
    """This checkout as "here" and, where one is given, another as "beside".

    Raises:
        SystemExit: the other has no giajax, so that the installed one would be measured.
    """
    if beside is None:
        return {"here": ROOT}
    if not (beside / "src" / "giajax").is_dir():
        raise SystemExit(f"{beside} has no giajax in src: give the root of a checkout")
    return {"here": ROOT, "beside": beside.resolve()}


def source_of(checkout: Path) -> dict[str, str]:
    """The environment of a process that imports the giajax of a checkout."""
    paths = filter(None, [str(checkout / "src"), os.environ.get("PYTHONPATH")])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}


def fastest(call: Callable[[], object], repeats: int) -> float:
    """Least time of some calls after a first one, s; each must wait for its own result."""
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
    """Least and median seconds of each contender, in turns, after one call that does not count."""
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
    """Least and median time as a cell of a table."""
    return f"{times['min'] * unit:.3g} / {times['median'] * unit:.3g}"


def report(
    description: str | None,
    name: str,
    measure: Callable[[bool], dict[str, Any]],
    table: Callable[[dict[str, Any]], Table],
) -> None:
    """The whole of a benchmark: measure in 64-bit, show a table and write the figures.

    Arguments:
        description: of the benchmark; its first line is shown.
        name: of its file among `RESULTS`, where no other is asked for.
        measure: the figures; quickly, if so told.
        table: of the figures.
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
    """An empty table whose cells, apart from those below an empty heading, are figures."""
    table = Table(title=title)
    for heading in headings:
        table.add_column(heading, justify="right" if heading else "left")
    return table


def store(found: dict[str, Any], path: Path) -> None:
    """Write figures as JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(found, indent=2) + "\n")
