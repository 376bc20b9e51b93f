"""Studies that are killed (`kill -9`) at any moment continue to the same numbers.

Each study has minimal size, and is slowed down so that the moments differ. A design starts again,
and a drive leaves its recorded part. Tests marked `long` use 30 moments per study, `slow` ones two.
"""

import contextlib
import io
import json
import multiprocessing
import os
import random
import shutil
import sys
import time
from pathlib import Path

import polars as pl
import pytest

import giajax.__main__
from giajax import tasks
from giajax.apps import driving
from giajax.cli import main

ROOT = Path(__file__).resolve().parents[1]
EARLIER = ROOT / "tests" / "earlier"
pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs SIGKILL")

# The command, and the first file that it writes.
STUDIES = {
    "fit": ("fit run_fit.toml --out out --no-figures --no-suspects", "out"),
    "sweep": ("sweep plan.toml --out out", "out"),
    "bootstrap": ("bootstrap fit --size 6 --folder tasks --no-figures --force", "tasks"),
    "profile": ("profile fit --folder tasks --no-figures", "tasks"),
    "posterior": ("posterior fit --chains 3 --draws 8 --warmup 4 --out out --force", "out"),
    "design": (
        "design arm.toml --parameter air.drag_coefficient --out out --force --duration 0.5 --rate 8"
        " --channels tip --knots 3 --candidates 2 --follow 1 --max-iterations 2 --scenarios 1",
        "nothing",
    ),
    "drive": ("drive arm.toml --replay pad.csv --to run-2.csv --force", "run-2-unfinished.csv"),
}
# These take minutes for two moments alone; the long tests kill them at thirty.
LONG = ("design", "posterior", "drive")
# A server with all imports forks a process for each moment, before JAX has started threads.
SERVER = multiprocessing.get_context("forkserver" if os.name == "posix" else None)
if os.name == "posix":
    SERVER.set_forkserver_preload(["giajax.cli", "giajax.studies", "giajax.apps.driving"])


def child(folder, words):
    """Run a command in this process, with delays where it writes."""

    def slow(holder, name, seconds):
        function = getattr(holder, name)

        def call(*given, **named):
            time.sleep(seconds)
            found = function(*given, **named)
            time.sleep(seconds)
            return found

        setattr(holder, name, call)

    slow(os, "replace", 0.1)
    slow(tasks.Journal, "_write", 0.1)
    slow(driving.Session, "advance", 1 / 60)
    os.chdir(folder)
    with open(os.devnull, "w") as nothing:
        sys.stdout = sys.stderr = nothing
        sys.argv[1:] = words.split()
        sys.exit(giajax.__main__.main())


def make(folder, name):
    """Return a folder with the input of a study."""
    of = {"sweep": "studies/sweep", "fit": "studies/journal"}.get(name, "studies/profile")
    shutil.copytree(EARLIER / of, folder, ignore=shutil.ignore_patterns("half", "whole"))
    (folder / "arm.toml").write_text('[arm]\npreset = "takeichi_20m"\nlinks = 2\n')
    (folder / "pad.csv").write_text("time_s,axis0,axis1\n0,0,-1\n1,0.5,0.5\n3,0,0\n")


def do(words):
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words.split())
    assert status == 0, (words, status, err.getvalue())


def go_on(name):
    """Run the command that a user would run after a study was killed."""
    words, _ = STUDIES[name]
    if name == "fit" and Path("out/journal.jsonl").exists():
        words = "fit --resume out --no-figures --no-suspects"
        # A fit killed before its first state cannot be continued.
        if Path("out/journal.jsonl").read_bytes().count(b"\n") < 2:
            words = STUDIES[name][0]
    do(words)


def without_times(data):
    """Return plain data without times and paths."""
    if isinstance(data, dict):
        own = ("seconds", "worker", "task", "path")
        return {key: without_times(one) for key, one in data.items() if key not in own}
    return [without_times(one) for one in data] if isinstance(data, list) else data


def numbers(name):
    """Return all numbers that a study has written."""
    written = sorted([*Path("out").glob("*"), *Path("fit").glob("*"), *Path().glob("run-2*")])
    found = {}
    for path in written:
        if path.suffix == ".json":
            found[str(path)] = without_times(json.loads(path.read_text()))
        elif path.suffix == ".parquet":
            table = pl.read_parquet(path)
            found[str(path)] = repr(table.drop(pl.selectors.contains("second", "worker")).rows())
        elif path.suffix == ".csv" and name != "fit":
            found[str(path)] = path.read_bytes()
    assert found
    return found


def rows_of(path):
    return path.read_bytes().splitlines() if path.exists() else []


@pytest.mark.parametrize(
    ("name", "moments"),
    [
        pytest.param(name, moments, marks=mark)
        for moments, mark in ((2, pytest.mark.slow), (30, pytest.mark.long))
        for name in STUDIES
        if moments > 2 or name not in LONG
    ],
)
def test_a_study_that_is_killed_goes_on(tmp_path, monkeypatch, name, moments):
    words, first = STUDIES[name]
    rng = random.Random(f"{name} {moments}")
    home = tmp_path / "undisturbed"
    make(home, name)
    monkeypatch.chdir(home)
    do(words)
    before = numbers(name)
    began, left, early, torn = None, 0, 0, 0
    for moment in range(-1, moments):
        folder = tmp_path / str(moment)
        make(folder, name)
        monkeypatch.chdir(folder)
        running = SERVER.Process(target=child, args=(str(folder), words))
        running.start()
        start = time.monotonic()
        while first != "nothing" and not os.path.lexists(first) and running.is_alive():
            time.sleep(0.01)
        if moment < 0:  # measures the duration
            appeared = time.monotonic() - start
            running.join()
            began = (appeared, time.monotonic() - start)
            assert running.exitcode == 0
            assert numbers(name) == before
            continue
        assert began is not None
        time.sleep(rng.uniform(0, began[1] - began[0]))
        rows = len(rows_of(Path(first))) if name == "drive" else 0
        running.kill()
        running.join()
        early += running.exitcode == -9
        if name == "drive":
            check_drive(home, Path(first), rows)
        left += any(Path().glob("out/*")) or any(Path().glob("tasks/*"))
        torn += any(Path().rglob("*.part"))
        go_on(name)
        assert numbers(name) == before, f"moment {moment}"
        assert not list(Path().rglob("*.part")), f"moment {moment}"
        shutil.rmtree(folder)
    # Most processes must be killed before they end.
    print(
        f"{name}: {moments} moments, {early} killed before the end, {left} with something kept, "
        f"{torn} with something unfinished"
    )
    # Two moments may both be after the end, by chance or because of other load.
    assert early >= moments / 2 or moments < 30
    assert torn or moments < 30 or name in ("fit", "design", "drive")


def check_drive(home, path, rows):
    """Check that the file of a killed drive contains complete first rows of the whole drive."""
    found = rows_of(path)
    if not found:  # killed after everything was saved
        assert Path("run-2.csv").read_bytes() == (home / "run-2.csv").read_bytes()
        return
    assert len(found) >= rows
    whole = pl.read_csv(home / "run-2.csv")
    here = pl.read_csv(path)
    assert here.width == 1 + 3 * 2 + 3
    command = here["joint01_command_rad"].to_numpy()
    expected = whole["joint01_command_deg"].to_numpy()[: len(command)] * (3.141592653589793 / 180)
    assert len(command) <= len(whole)
    assert abs(command - expected).max(initial=0) < 1e-10
