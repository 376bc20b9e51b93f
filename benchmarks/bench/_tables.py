"""The measurements as tables."""

from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks import right_model
from benchmarks.bench._fit import CLOSE
from benchmarks.bench._process import REFITS, REPEATS
from benchmarks.bench._ratios import LIMITS, held
from benchmarks.measuring import spread


def show(found: dict[str, Any], console: Console) -> None:
    """Print all measurements."""
    for name, sentence in found["absent"].items():
        console.print(f"{name} is left out: {sentence}")
    console.print(_runs(found))
    console.print("error: largest of the columns, each for a parameter that doubles")
    console.print(_evaluations(found["evaluations"]))
    items = found["problem"]["batch"]
    batch = _table(f"{items} evaluations on two cores, us an item: min / median")
    for name, times in found["batch"].items():
        batch.add_row(name, spread(times, 1e6))
    console.print(batch)
    if found["gpu"]:
        gpu = _table("Evaluations on the GPU, us an item: min / median")
        for name, times in found["gpu"].items():
            gpu.add_row(name, spread(times, 1e6))
        console.print(gpu)
    console.print(right_model.table(found | found["problem"]))
    console.print(_fits(found["fits"]))
    if found["processes"] is not None:
        console.print(_processes(found["processes"]))
    ratios = _table("Ratios of minima within this run", "", "at least", "")
    holds = held(found["ratios"])
    for name, ratio in found["ratios"].items():
        limit = f"{LIMITS[name]:.2f}" if name in LIMITS else ""
        ratios.add_row(name, f"{ratio:.2f}", limit, "missed" if not holds.get(name, True) else "")
    console.print(ratios)
    load = found["machine"]
    if load["load_before"] > 0.5 * (load["cores"] or 1):
        console.print(f"The machine was busy (load {load['load_before']:.1f}): trust ratios only.")


def _table(title: str, *headings: str) -> Table:
    """Return a table with names in the first column and numbers in the others."""
    table = Table(title=title)
    table.add_column("")
    for heading in headings or ("",):
        table.add_column(heading, justify="right")
    return table


def _runs(found: dict[str, Any]) -> Table:
    problem = found["problem"]
    title = f"{problem['links']} links, {problem['seconds']:g} s; times: min / median"
    headings = ("setting", "tip error, m", "run, ms", "value + 4 columns, ms", "error, m")
    table = _table(title, *headings)
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
    return table


def _evaluations(evaluations: dict[Any, Any]) -> Table:
    names = list(dict.fromkeys(name for each in evaluations.values() for name in each))
    table = _table("One evaluation, us: min / median", *names)
    table.columns[0].header = "links"
    for count, each in evaluations.items():
        table.add_row(
            str(count), *(spread(each[name], 1e6) if name in each else "" for name in names)
        )
    return table


def _fits(fits: dict[str, Any]) -> Table:
    table = _table("The fit from half the drag and stiffness", "s", "runs", "optimum")
    for name, each in fits.items():
        off = each["standard_errors_off"]
        reached = "reached" if off < CLOSE else f"{off:.2g} standard errors off"
        table.add_row(name, spread(each, 1), str(each.get("runs", "")), reached)
    return table


def _processes(processes: dict[str, Any]) -> Table:
    title = "The base-step fit as a process"
    table = _table(title, "s", "compiling, s", "iterations", "peak, MB")
    for name, words in (
        ("cold", "a cold process"),
        ("next", f"a warm process, least of {REPEATS}"),
    ):
        each = processes[name]
        times = (f"{each['wall']:.1f}", f"{each['compile']:.1f}")
        table.add_row(words, *times, str(each["iterations"]), f"{each['peak_megabytes']:.0f}")
    table.add_row(f"{REFITS} refits", f"{processes['refits']:.1f}")
    return table
