"""Check whether a ratio of `make bench` has decreased since an earlier commit.

`history.jsonl` has one line for each commit that was recorded. It stores ratios, because times
cannot be compared between machines. A ratio is the time of another program, of the plain arm, of
five runs or of ten fits, divided by a time of giajax. The check fails if a ratio is a fifth smaller
than in the last line for the same problem, or if it is no longer measured. Ratios of giajax's own
solvers, of studies and of two cores are stored but not checked, because they depend on the load of
the machine.

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
NOT_JUDGED = ("batch:", "giajax:", "studies:", "run: Tsit5", "gradient: Tsit5")


def record(found: Mapping[str, Any], path: Path = HISTORY) -> None:
    """Append the ratios of a measurement, with the current commit."""
    kept = ("date", "machine", "versions", "problem", "ratios")
    line = {"commit": _commit(), **{key: found[key] for key in kept}}
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(line) + "\n")


def fallen(found: Mapping[str, Any], path: Path = HISTORY) -> list[str]:
    """Return a sentence for each ratio that decreased by a fifth or is missing.

    The list is empty if no measurement is stored.
    """
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
        # The condition also selects a NaN.
        if name in now and not now[name] >= (1 - FALL) * old
    ]


def last(problem: Mapping[str, Any], path: Path = HISTORY) -> dict[str, Any] | None:
    """Return the last line for a problem, or None."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    entries = [json.loads(line) for line in lines if line.strip()]
    return next((each for each in reversed(entries) if each["problem"] == problem), None)


def _commit() -> str:
    """Return the commit of the working tree, marked as dirty if files have been changed."""
    command = ["git", "describe", "--always", "--dirty", "--abbrev=10", "--exclude=*"]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, cwd=HISTORY.parent)
    except OSError:
        return "unknown"
    return ended.stdout.strip() or "unknown"


def judge(found: Mapping[str, Any], path: Path = HISTORY) -> int:
    """Print the ratios that decreased, and return the exit status, 1 if there are any."""
    if last(found["problem"], path) is None:
        print(f"{path.name} has nothing to compare this problem with: --record stores it")
    sentences = fallen(found, path)
    for sentence in sentences:
        print(sentence, file=sys.stderr)
    return int(bool(sentences))


def main() -> int:
    """Check a file that `make bench` has written."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("found", type=Path, help="what `python -m benchmarks.bench` wrote")
    parser.add_argument("--history", type=Path, default=HISTORY, help="ratios to compare with")
    arguments = parser.parse_args()
    return judge(json.loads(arguments.found.read_text(encoding="utf-8")), arguments.history)


if __name__ == "__main__":
    sys.exit(main())
