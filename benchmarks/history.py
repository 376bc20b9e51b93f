"""The ratios of `make bench` by commit, and whether one has fallen.

`history.jsonl` has a line for each commit that was recorded; only ratios can be compared between
machines. A ratio is what a peer takes over what giajax takes: one that falls by a fifth against the
last line for the same problem, or is not measured any more, is a failure. Ratios of giajax's own
solvers, and those of two cores, which move with the load of a machine, are stored and not judged.

    python -m benchmarks.history BENCH_JSON [--history FILE]
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

HISTORY = Path(__file__).resolve().parent / "history.jsonl"
FALL = 0.2
NOT_JUDGED = ("batch:", "giajax:", "run: Tsit5", "gradient: Tsit5")


def record(found: Mapping[str, Any], path: Path = HISTORY) -> None:
    """Append the ratios of a measurement, with the commit that they are of."""
    kept = ("date", "machine", "versions", "problem", "ratios")
    line = {"commit": _commit(), **{key: found[key] for key in kept}}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def fallen(found: Mapping[str, Any], path: Path = HISTORY) -> list[str]:
    """A sentence for each ratio that fell by a fifth or is missing; none if nothing is stored."""
    before = last(found["problem"], path)
    if before is None:
        return []
    now = found["ratios"]
    judged = {k: old for k, old in before["ratios"].items() if not k.startswith(NOT_JUDGED)}
    missing = [
        f"{name!r} was {old:.2f} ({before['commit']}) and was not measured: see which peer is left "
        "out, and why"
        for name, old in judged.items()
        if name not in now
    ]
    return missing + [
        f"{name!r} fell from {old:.2f} ({before['commit']}) to {now[name]:.2f}: find out what made "
        "giajax slower, or record the new one with --record"
        for name, old in judged.items()
        # Written so that a NaN has fallen.
        if name in now and not now[name] >= (1 - FALL) * old
    ]


def last(problem: Mapping[str, Any], path: Path = HISTORY) -> dict[str, Any] | None:
    """The last line for a problem."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    entries = [json.loads(line) for line in lines if line.strip()]
    return next((each for each in reversed(entries) if each["problem"] == problem), None)


def _commit() -> str:
    """Of the working tree, with a mark where it has been changed since."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, cwd=HISTORY.parent)
    except OSError:
        return "unknown"
    return ended.stdout.strip() or "unknown"


def judge(found: Mapping[str, Any], path: Path = HISTORY) -> int:
    """Print what fell; returns the exit status, 1 where something did."""
    if last(found["problem"], path) is None:
        print(f"{path.name} has nothing to compare this problem with: --record stores it")
    sentences = fallen(found, path)
    for sentence in sentences:
        print(sentence, file=sys.stderr)
    return int(bool(sentences))


def main() -> int:
    """Judge a file that `make bench` wrote."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("found", type=Path, help="what `python -m benchmarks.bench` wrote")
    parser.add_argument("--history", type=Path, default=HISTORY, help="ratios to compare with")
    arguments = parser.parse_args()
    return judge(json.loads(arguments.found.read_text(encoding="utf-8")), arguments.history)


if __name__ == "__main__":
    sys.exit(main())
