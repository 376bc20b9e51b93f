"""Damaged files as input of the command: one sentence, soon, with little memory."""

import os
import random
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "wait4"), reason="needs the memory of a child process"),
]

ROOT = Path(__file__).resolve().parents[1]
# Cases that import JAX take seconds each. `test_fuzz.py` tests many more cases with the readers.
CASES = {"run.csv": 8, "run.toml": 8, "fit.toml": 5, "result.json": 5}
MOST_SECONDS, MOST_KIB = 5.0, 1024 * 1024

RUN = (ROOT / "data" / "synthetic" / "joint_loops.csv").read_bytes()
SIDECAR = (ROOT / "data" / "synthetic" / "joint_loops.toml").read_bytes()
DEFINITION = (ROOT / "fits" / "joint_loops.toml").read_bytes()
RESULT = (ROOT / "tests" / "earlier" / "hysteresis" / "result.json").read_bytes()
PIECES = [
    b"", b"\0", b"\xff", b"nan", b"1e300", b"1e999", b"-", b'"', b"{", b"[[", b"]\n[", b"= 9\n",
    b"9" * 5_000, b"[" * 5_000, b",1" * 20_000, b"q" * 200_000, b"\n" * 20_000, b"links = 1e9\n",
]  # fmt: skip


def damaged(data, rng):
    """Return the data with one to three parts removed, repeated or replaced."""
    for _ in range(rng.randint(1, 3)):
        start = rng.randrange(len(data))
        piece = rng.choice(
            [*PIECES, data[start : start + rng.randint(1, 200)] * rng.randint(2, 50)]
        )
        data = data[:start] + piece + data[start + rng.choice([0, 1, 10, 1_000]) :]
    return data


def command(folder, name, rng):
    """Return a command whose named file is damaged."""
    files = {"run.csv": RUN, "run.toml": SIDECAR, "fit.toml": DEFINITION, "result.json": RESULT}
    files["fit.toml"] = DEFINITION.replace(b"../data/synthetic/joint_loops.csv", b"run.csv")
    for file, data in files.items():
        (folder / file).write_bytes(damaged(data, rng) if file == name else data)
    return {
        "fit.toml": ["fit", "fit.toml", "--no-figures", "--out", "out", "--max-iterations", "1"],
        "result.json": ["suspects", "result.json", "--data", "run.csv"],
    }.get(name, ["check", "--data", "run.csv"])


# The launcher is a separate process, because the memory of a child includes that of the process
# which starts it, and the workers of the tests use much memory.
LAUNCHER = """
import os, subprocess, sys
running = subprocess.Popen([sys.executable, *sys.argv[2:]], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(running.pid, 0)
running.returncode = os.waitstatus_to_exitcode(status)
with open(sys.argv[1], "w") as file:
    print(running.returncode, usage.ru_utime + usage.ru_stime, usage.ru_maxrss, file=file)
"""


def used(words, folder):
    """Return exit status, standard error, seconds and memory of a command."""
    launched = [sys.executable, "-c", LAUNCHER, "usage", *words]
    ended = subprocess.run(launched, cwd=folder, capture_output=True, check=True)
    status, seconds, memory = (folder / "usage").read_text().split()
    # Processor time, which does not include the time of other programs.
    return int(status), ended.stderr.decode(errors="replace"), float(seconds), int(memory)


@pytest.fixture(scope="module")
def imports(tmp_path_factory):
    """Measure the seconds for importing JAX, which do not depend on the files."""
    return used(["-c", "import giajax.fitting"], tmp_path_factory.mktemp("imports"))[2]


@pytest.mark.parametrize(
    ("name", "seed"), [(name, seed) for name, count in CASES.items() for seed in range(count)]
)
def test_a_command_reads_or_refuses(tmp_path, imports, name, seed):
    words = command(tmp_path, name, random.Random(f"{name} {seed}"))
    status, message, seconds, memory = used(["-m", "giajax", *words], tmp_path)
    assert status in (0, 1, 2), message
    assert "Traceback" not in message
    if status == 2:
        assert len(message) < 2_500
        assert seconds < MOST_SECONDS + imports
        assert memory < MOST_KIB
