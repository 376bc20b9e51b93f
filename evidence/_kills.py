"""Interrupted processes: a killed and resumed fit gives the same numbers as an uninterrupted one.

A robust fit of `fits/joint_loops.toml` runs in processes that are killed (SIGKILL) at random times
after their start and resumed until one ends. Its steps are slowed down to those of a long arm, so
that it lasts long enough to be killed.
"""

import json
import os
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ._record import ROOT
from ._study import Figures, Study

FIT = ("fit", str(ROOT / "fits" / "joint_loops.toml"), "--loss", "soft_l1", "--no-figures")
CASES = {"one start": (), "three starts": ("--starts", "3")}

# A process whose fits take as long as those of a long arm, so it can be killed during a fit. The
# duration of a step, s, is inserted by `format`.
SLOWLY = """
import sys, time
import giajax.cli._fit as command
from giajax.__main__ import main
shown = command.Progress.__call__
def slowly(self, iteration):
    shown(self, iteration)
    time.sleep({seconds})
command.Progress.__call__ = slowly
sys.exit(main())
"""


def run(size: int, seed: int, names: Iterable[str] = tuple(CASES)) -> Figures:
    """Return the figures of `size` kills of each case."""
    figures: Figures = {}
    moments = random.Random(seed)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            figures[name] = _killed(Path(folder), CASES[name], size, moments)
    return figures


def part(size: int, seed: int) -> Figures:
    """Return the figures of one case, in which each of the two fits takes half a minute."""
    return run(size, seed, ("one start",))


def _killed(folder: Path, options: tuple[str, ...], size: int, moments: random.Random) -> Figures:
    """Run fits in a folder until `size` processes were killed; resume each fit to its end."""
    whole, out = folder / "whole", folder / "out"
    began = time.monotonic()
    _end(_process(*FIT, *options, "--out", str(whole)))
    longest = time.monotonic() - began
    kills = within = fits = same = unreadable = 0
    while kills < size:
        again = (*FIT, *options, "--out", str(out), "--force")
        words, fits = again, fits + 1
        while kills < size:
            running = _process(*words)
            try:
                running.wait(timeout=moments.uniform(0.5, longest))
                break
            except subprocess.TimeoutExpired:
                running.kill()
                running.communicate()
            kills += 1
            journal = out / "journal.jsonl"
            within += journal.exists()
            unreadable += not _is_readable(out)
            words = ("fit", "--resume", str(out), "--no-figures") if journal.exists() else again
        else:
            running = _process(*words)
        _end(running)
        same += _numbers(out) == _numbers(whole)
    return {
        "kills": kills,
        "within_the_fit": within,
        "unreadable_journals": unreadable,
        "fits": fits,
        "same_numbers": same,
    }


def _process(*words: str) -> "subprocess.Popen[str]":
    environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".jax_cache")}
    return subprocess.Popen(
        [sys.executable, "-c", SLOWLY.format(seconds=0.2), *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    )


def _end(running: "subprocess.Popen[str]") -> None:
    _, messages = running.communicate(timeout=600)
    if running.returncode:
        raise RuntimeError(f"a fit ended with status {running.returncode}:\n{messages}")


def _is_readable(folder: Path) -> bool:
    """Return whether the journal can be read, including one with an incomplete last line."""
    from giajax.tasks import read_journal

    try:
        read_journal(folder)
    except (ValueError, OSError):
        return False
    return True


def _numbers(folder: Path) -> dict[str, Any]:
    """Return all numbers of a result, without its duration and task."""
    record: dict[str, Any] = json.loads((folder / "result.json").read_text("utf-8"))
    del record["seconds"], record["task"]
    return record


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report different numbers after a kill, and unreadable journals; neither occurs by chance."""
    if not stored.keys() >= new.keys():
        return ["the cases differ from the stored cases: run the study again"]
    return [
        f"{name}: {each['fits'] - each['same_numbers']} of {each['fits']} fits ended at other "
        f"numbers, and {each['unreadable_journals']} journals could not be read"
        for name, each in new.items()
        if each["same_numbers"] < each["fits"] or each["unreadable_journals"]
    ]


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each case."""
    rows = [
        "| starts of the fit | kills | kills after the journal was opened | unreadable journals | "
        "fits with the same numbers |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        rows.append(
            f"| {name} | {each['kills']} | {each['within_the_fit']} | "
            f"{each['unreadable_journals']} | {each['same_numbers']} of {each['fits']} |"
        )
    return rows


KILLS = Study(
    name="kills",
    title="Interrupted processes",
    meaning=(
        "Fits of `fits/joint_loops.toml` with a robust loss are killed at random moments after "
        "the start of the process and resumed until they end. The table lists whether each "
        "resumed fit has the same numbers as an uninterrupted fit, bit for bit."
    ),
    size=10,
    seed=1,
    run=run,
    part=part,
    disagreements=disagreements,
    table=table,
)
