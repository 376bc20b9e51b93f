"""Time of each command as a process with cold and warm caches, and the programs that it compiles.

A cold process starts with an empty cache. The warm process after it uses the cache that it filled.
The times are wall times, because these are what a user waits for, so the machine must be otherwise
idle. The exit status is 1 if a warm process exceeds its limit.

    python -m benchmarks.commands [--quick] [--only NAME ...] [--beside CHECKOUT] [--out FILE]
"""

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.fit_process import process
from benchmarks.measuring import RESULTS, checkouts_of, columns, store

RUN = "data/synthetic/base_step.csv"
AIR = "--wind 0,0.4,0.1 --gusts 0.2:2 --coherence 12"
MOST = 8.0  # s, for a command that is not a study
ALL_AT_ONCE = (
    "air.drag_coefficient",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
    "joints.memory.strength",
    "joints.memory.yield_angle",
    "air.wind",
    "camera.rotation",
    "camera.delay",
)


@dataclasses.dataclass(frozen=True)
class Command:
    """A command with its arguments.

    In the arguments, `{out}` is an empty folder, `{fit}` the folder of a fit, and `{made}` the
    folder of the data that the command in `after` has written.

    Attributes:
        most: limit of the time of a warm process, s.
        after: command that writes the data and is not measured.
    """

    arguments: str
    most: float = MOST
    after: str | None = None


COMMANDS = {
    "check": Command(f"check --data {RUN}"),
    "simulate": Command("simulate --ramp 1=30 --to {out}/run.csv --force"),
    "fit": Command("fit fits/base_step.toml --out {out} --force"),
    "fit of joints that remember": Command(
        "fit fits/independent_friction.toml --no-figures --out {out} --force", 20.0
    ),
    "fit of all at once": Command(
        f"fit --data {{made}}/run.csv {' '.join(f'--free {path}' for path in ALL_AT_ONCE)} "
        "--start joints.memory.strength=0.02 --start joints.memory.yield_angle=0.02 "
        "--loss huber --no-figures --out {out} --force",
        60.0,
        "simulate --links 12 --ramp 1=30 --ramp 4=20 --ramp 7=-25 --rate 10 "
        "--channels link04 --channels link08 --channels link12 --channels tip "
        "--set joints.memory.strength=0.05 --set joints.memory.yield_angle=0.005 "
        "--wind 0,0.05,0.02 --set camera.rotation=0,0.03,0 --set camera.delay=0.08 "
        "--noise position_m=0.01 --to {made}/run.csv",
    ),
    "suspects": Command("suspects {fit} --out {out} --force"),
    "influence": Command("influence {fit} --out {out} --force"),
    "predict": Command(f"predict {{fit}} --data {RUN} --to {{out}}/table.csv --force"),
    "report": Command("report {fit} --page {out}/report.html --force"),
    "track": Command(f"track {RUN} --model {{fit}} --wind 0,0.2,0 --out {{out}} --force"),
    "plan": Command("plan {fit} --pose 1=20 --out {out} --force"),
    "shape": Command(f"shape {RUN} --model {{fit}} --out {{out}} --force"),
    "joint": Command("joint --out {out} --force"),
    "fill": Command("fill --out {out} --force"),
    "unroll": Command("unroll --by-gas --out {out} --force"),
    "mission": Command("mission missions/naraha.toml --out {out} --force", 10.0),
    "life": Command("life missions/naraha.toml --out {out} --force", 30.0),
    "wind": Command(
        "wind --data {made}/resting.csv --wind 0,0.3,0.075 --highest 0.5 --out {out} --force",
        20.0,
        f"simulate --links 6 {AIR} --duration 630 --rate 5 --channels all "
        "--noise position_m=0.001 --to {made}/resting.csv",
    ),
    "design": Command("design {fit} --parameter air.drag_coefficient --out {out} --force", 60.0),
    "posterior": Command("posterior {fit} --out {out} --force", 180.0),
}
QUICK = ("check", "fit")


def measure(
    names: Iterable[str], checkouts: dict[str, Path], console: Console
) -> dict[str, dict[str, Any]]:
    """Measure a cold and a warm process of each command with each checkout."""
    found: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        fits = {which: root / f"fit {which}" for which in checkouts}
        for which, checkout in checkouts.items():
            process(
                checkout, root / "others", _of(COMMANDS["fit"].arguments, fits[which], root, root)
            )
        for name in names:
            found[name] = {"most_s": COMMANDS[name].most}
            for which, checkout in checkouts.items():
                cache, made = root / f"{name} {which}", root / f"{name} made {which}"
                command, processes = COMMANDS[name], []
                made.mkdir()
                if command.after is not None:
                    process(checkout, root / "others", _of(command.after, made, fits[which], made))
                for turn in ("cold", "warm"):
                    out = root / f"{name} {which} {turn}"
                    out.mkdir()
                    arguments = _of(command.arguments, out, fits[which], made)
                    processes.append(process(checkout, cache / "cache", arguments))
                cold, warm = processes
                found[name][which] = {"cold": cold, "warm": warm}
            console.print(f"{name}: done")
    return found


def _of(arguments: str, out: Path, fit: Path, made: Path) -> list[str]:
    return [part.format(out=out, fit=fit, made=made) for part in arguments.split()]


def table(found: dict[str, dict[str, Any]]) -> Table:
    """Return a table with a row for each command and checkout."""
    rows = columns(
        "giajax as a process",
        "",
        "cold, s",
        "programs",
        "warm, s (at most)",
        "of it processor time, s",
        "compiled again",
    )
    for name, each in found.items():
        for which in [key for key in each if key != "most_s"]:
            cold, warm = each[which]["cold"], each[which]["warm"]
            rows.add_row(
                name if which == "here" else f"{name}, {which}",
                f"{cold['clock_s']:.1f}",
                str(cold["compiled"]),
                f"{warm['clock_s']:.1f} ({each['most_s']:g})",
                f"{warm['processor_s']:.1f}",
                str(warm["compiled"] - warm["cached"]),
            )
    return rows


def are_held(found: dict[str, dict[str, Any]]) -> bool:
    """Return whether all warm processes ended within their limits."""
    return all(each["here"]["warm"]["clock_s"] <= each["most_s"] for each in found.values())


def main() -> int:
    """Measure, print and store; return exit status 1 if a limit is exceeded."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="two commands: does it run?")
    parser.add_argument("--only", action="append", choices=COMMANDS, help="a command; repeatable")
    parser.add_argument("--beside", type=Path, help="a checkout to measure, too")
    parser.add_argument("--out", type=Path, default=RESULTS / "commands.json", help="JSON to write")
    arguments = parser.parse_args()
    names = arguments.only or (QUICK if arguments.quick else tuple(COMMANDS))
    console = Console()
    found = measure(names, checkouts_of(arguments.beside), console)
    console.print(table(found))
    store(found, arguments.out)
    console.print(f"written to {arguments.out}")
    return int(not arguments.quick and not are_held(found))


if __name__ == "__main__":
    sys.exit(main())
