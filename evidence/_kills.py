"""Kills: whether a fit that is killed and resumed ends at the numbers of one that is left alone.

`fits/joint_loops.toml`, robust, is fitted by processes that are killed (SIGKILL) at random moments
from their start on and resumed, again and again until one ends. Its steps are slowed down to those
of a long arm, or there would be nothing to kill.
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

# A process whose fits take as long as those of a long arm, so that there is a moment to stop it;
# to be formatted with the seconds of a step.
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
    """Figures of `size` kills of each case."""
    figures: Figures = {}
    moments = random.Random(seed)
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            figures[name] = _killed(Path(folder), CASES[name], size, moments)
    return figures


def part(size: int, seed: int) -> Figures:
    """One case: an untouched fit and its killed twin take half a minute each."""
    return run(size, seed, ("one start",))


def _killed(folder: Path, options: tuple[str, ...], size: int, moments: random.Random) -> Figures:
    """Fits in a folder, until so many were killed; each goes on to its end."""
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
    """A journal that is there can be read, a torn last line included."""
    from giajax.tasks import read_journal

    try:
        read_journal(folder)
    except (ValueError, OSError):
        return False
    return True


def _numbers(folder: Path) -> dict[str, Any]:
    """All numbers of a result; not how long it took, nor where it is."""
    record: dict[str, Any] = json.loads((folder / "result.json").read_text("utf-8"))
    del record["seconds"], record["task"]
    return record


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Numbers that differ after a kill, and journals that cannot be read: none is by chance."""
    if not stored.keys() >= new.keys():
        return ["the cases differ from the stored cases: run the study again"]
    return [
        f"{name}: {each['fits'] - each['same_numbers']} of {each['fits']} fits ended at other "
        f"numbers, and {each['unreadable_journals']} journals could not be read"
        for name, each in new.items()
        if each["same_numbers"] < each["fits"] or each["unreadable_journals"]
    ]


def table(figures: Figures) -> list[str]:
    """A row for each case."""
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
