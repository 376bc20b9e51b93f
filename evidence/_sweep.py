"""Sweeps of many small fits by killed processes: lost, repeated and different results."""

import contextlib
import itertools
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ._record import ROOT
from ._study import Figures, Study

# A play of threshold 0.2 and a spring, with an offset that each fit holds at another value.
DEFINITION = """
model = "hysteresis"
[hysteresis]
operator = "prandtl_ishlinskii"
thresholds = [0.2]
[fit]
data = ["loops.csv"]
free = ["elastic", "weights[0]"]
[fit.start]
"weights[0]" = 0.3
"""
PLAN = """
fit = "loops_fit.toml"
[sample]
count = {count}
seed = {seed}
[sample.fix]
offset = {{ normal = [0.1, 0.02] }}
[sample.start]
elastic = {{ log_uniform = [0.2, 2.0] }}
"""
KILLS = 3
ROUNDS = 7

CLUSTER = """
import sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        print(cluster.scheduler_address, flush=True)
        sys.stdin.read()
"""


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` fits by each kind of workers."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_plan(folder, size, seed)
        _end(_sweep(folder, "serial"))
        moments = random.Random(seed)
        figures = {"two processes": _killed(folder, size, moments, "processes", ["--workers", "2"])}
        with _cluster(folder) as address:
            words = ["--scheduler", address]
            figures["a cluster of two"] = _killed(folder, size, moments, "cluster", words)
        figures["speed"] = _speed(folder, max(size // 20, 8))
    return figures


def _write_plan(folder: Path, count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turns = itertools.pairwise((0, 1, -0.8, 0.7, -0.4, 0.5))
    inputs = np.concatenate([np.linspace(a, b, 12)[1:] for a, b in turns])
    play, rows = 0.0, ["input,output"]
    for value in inputs:
        play = min(max(play, value - 0.2), value + 0.2)
        output = 0.5 * value + 0.8 * play + 0.1 + 0.005 * rng.normal()
        rows.append(f"{value:.9g},{output:.9g}")
    (folder / "loops.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "loops_fit.toml").write_text(DEFINITION, encoding="utf-8")
    text = PLAN.format(count=count, seed=seed)
    (folder / "plan.toml").write_text(text, encoding="utf-8")


def _sweep(folder: Path, out: str, words: Sequence[str] = ()) -> "subprocess.Popen[str]":
    command = ["sweep", "plan.toml", "--out", out, "--quiet", *words]
    return subprocess.Popen(
        [sys.executable, "-m", "giajax", *command],
        cwd=folder,
        env=_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _environment() -> dict[str, str]:
    # Results must be bit-identical, so each process, including the serial one, uses one core.
    cache = str(ROOT / ".jax_cache")
    return {**os.environ, "GIAJAX_CORES": "1", "JAX_COMPILATION_CACHE_DIR": cache}


def _killed(
    folder: Path, size: int, moments: random.Random, out: str, words: Sequence[str]
) -> Figures:
    """Run a sweep that is killed three times, and then kill one of its workers."""
    fits = folder / out / "fits"
    at = sorted(moments.sample(range(1, max(size - 1, KILLS + 2)), KILLS + 1))
    written: dict[str, int] = {}
    rewritten = kills = 0
    began = time.monotonic()
    for number, count in enumerate(at):
        running = _sweep(folder, out, words)
        # Wait for at least one fit by this process, so it has a worker to kill.
        _until(fits, max(count, len(written) + 1), running)
        if number < KILLS:
            kills += running.poll() is None
            running.kill()
            running.communicate()
            time.sleep(1.0)  # a worker of a cluster completes its current fit
        else:
            worker_killed = _kill_a_worker(fits)
            _end(running)
        now = {path.name: path.stat().st_mtime_ns for path in fits.glob("*.json")}
        rewritten += sum(now.get(name) != when for name, when in written.items())
        written = now
    serial, table = _table(folder / "serial"), _table(folder / out)
    return {
        "fits": size,
        "kills": kills,
        "workers_killed": int(worker_killed),
        "rows": len(table),
        "lost": size - len(set(table["key"]) & {path.stem for path in fits.glob("*.json")}),
        "done_twice": rewritten + len(table) - len(set(table["key"])),
        "failed": int((table["status"] == "failed").sum()),
        "identical_to_serial": bool(table.equals(serial)),
        "seconds": round(time.monotonic() - began, 1),
    }


def _until(fits: Path, count: int, running: "subprocess.Popen[str]") -> None:
    """Wait until `count` fits are complete, or the process has ended."""
    while running.poll() is None and len(list(fits.glob("*.json"))) < count:
        time.sleep(0.05)


def _kill_a_worker(fits: Path) -> bool:
    """Kill the process that wrote the newest file; return whether it existed."""
    newest = max(fits.glob("*.json"), key=lambda path: path.stat().st_mtime_ns)
    worker = json.loads(newest.read_text(encoding="utf-8"))["worker"]
    with contextlib.suppress(ProcessLookupError):
        os.kill(int(worker.rpartition(":")[2]), signal.SIGKILL)
        return True
    return False


def _end(running: "subprocess.Popen[str]") -> None:
    _, messages = running.communicate(timeout=3600)
    if running.returncode:
        raise RuntimeError(f"a sweep ended with status {running.returncode}:\n{messages}")


def _table(folder: Path) -> Any:
    """Return the table without the columns that differ between runs: duration and worker."""
    import polars as pl

    return pl.read_parquet(folder / "sweep.parquet").drop("seconds", "worker")


@contextlib.contextmanager
def _cluster(folder: Path) -> Iterator[str]:
    """Start a local cluster of two processes, and yield its address."""
    script = folder / "cluster.py"
    script.write_text(CLUSTER, encoding="utf-8")
    running = subprocess.Popen(
        [sys.executable, str(script)],
        env=_environment(),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert running.stdout is not None
    try:
        yield running.stdout.readline().strip()
    finally:
        running.communicate()


def _speed(folder: Path, count: int) -> Figures:
    """Measure the time of the same compiled fits with one worker and with two, in turn."""
    from giajax.runtime.execution import Processes, run_tasks
    from giajax.tasks import Plan

    tasks = Plan.load(folder / "plan.toml").tasks()[:count]
    os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
    seconds: dict[int, list[float]] = {1: [], 2: []}
    with Processes(1) as one, Processes(2) as two:
        pools = {1: one, 2: two}
        for pool in pools.values():
            run_tasks(tasks, executor=pool)
        for _, (workers, pool) in itertools.product(range(ROUNDS), pools.items()):
            began = time.perf_counter()
            run_tasks(tasks, executor=pool)
            seconds[workers].append(time.perf_counter() - began)
    ratios = [one / two for one, two in zip(seconds[1], seconds[2], strict=True)]
    return {
        "fits": len(tasks),
        "rounds": ROUNDS,
        "seconds_by_one": round(statistics.median(seconds[1]), 3),
        "seconds_by_two": round(statistics.median(seconds[2]), 3),
        "times_faster": round(statistics.median(ratios), 3),
        "least": round(min(ratios), 3),
        "most": round(max(ratios), 3),
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report lost, repeated or different fits, which do not occur by chance, unlike the speed."""
    if stored.keys() != new.keys():
        return ["the cases differ from the stored cases: run the study again"]
    return [
        f"{name}: {each['lost']} fits lost, {each['done_twice']} done twice, "
        f"{each['failed']} failed, {each['rows']} rows of {each['fits']}, and the table is "
        f"{'' if each['identical_to_serial'] else 'not '}that of a serial run"
        for name, each in new.items()
        if name != "speed" and not _is_as_serial(each)
    ]


def _is_as_serial(each: Figures) -> bool:
    """Return whether all fits occur once, without failures, as in a serial run.

    The number of effective kills is not compared, because it is random in a small run.
    """
    wrong = each["lost"] or each["done_twice"] or each["failed"]
    return not wrong and each["rows"] == each["fits"] and bool(each["identical_to_serial"])


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each kind of workers, and a sentence on speed."""
    rows = [
        "| workers | fits | kills of the command | killed workers | lost fits | fits computed "
        "twice | same table as a serial sweep |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        if name != "speed":
            same = "yes, bit for bit" if each["identical_to_serial"] else "no"
            rows.append(
                f"| {name.replace('a cluster of two', 'a cluster of two workers')} | "
                f"{each['fits']} | {each['kills']} | {each['workers_killed']} | "
                f"{each['lost']} | {each['done_twice']} | {same} |"
            )
    words = _in_words(figures["speed"])
    return [*rows, "", f"{words} Other programs ran on the machine during this measurement."]


def run_speed(size: int, seed: int) -> Figures:
    """Return the speed of two workers relative to one for `size` fits."""
    with tempfile.TemporaryDirectory() as folder:
        _write_plan(Path(folder), size, seed)
        return _speed(Path(folder), size)


def speed_disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report nothing, because the speed of a machine depends on its load."""
    return []


def speed_table(figures: Figures) -> list[str]:
    """Return a sentence on the speed."""
    return [_in_words(figures)]


def _in_words(speed: Figures) -> str:
    return (
        f"Two workers take {speed['seconds_by_two']:.1f} s for {speed['fits']} fits, and one "
        f"worker takes {speed['seconds_by_one']:.1f} s. The speed-up is "
        f"{speed['times_faster']:.2f} (median of {speed['rounds']} successive pairs; range "
        f"{speed['least']:.2f} to {speed['most']:.2f})."
    )


SWEEP = Study(
    name="sweep",
    meaning=(
        "Small fits are computed by `giajax sweep` with two spawned processes, or with a "
        "dask.distributed cluster of two workers. The command is killed three times at random "
        "moments and restarted, and one worker is killed. The table lists whether each fit occurs "
        "exactly once, with the same numbers as in a serial sweep."
    ),
    size=2000,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
)

SWEEP_SPEED = Study(
    name="sweep_speed",
    meaning=(
        "The speed-up of a sweep with two spawned workers over one worker is measured on a "
        "machine of two cores without other load."
    ),
    size=60,
    seed=1,
    run=run_speed,
    disagreements=speed_disagreements,
    table=speed_table,
)
