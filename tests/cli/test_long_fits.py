"""Long fits as processes: signals, full disks, budgets, and two fits at a time.

The study `evidence/_kills.py` shows that a killed fit continues to the same numbers.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from evidence._kills import SLOWLY
from giajax import load_result
from giajax.cli import main
from giajax.cli._fit import TimeLeft
from giajax.tasks import read_journal
from small_loops import write_task

FIT = ("fit", "loops_fit.toml", "--no-figures", "--out", "out")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_task(tmp_path)
    return tmp_path


RUNNING = []


@pytest.fixture(autouse=True)
def nothing_goes_on():
    """End processes that a failed test has left running."""
    yield
    while RUNNING:
        running = RUNNING.pop()
        if running.poll() is None:
            running.kill()
            running.communicate()


def process(*words, seconds=0.0, code=None, cwd=None):
    code = code or (SLOWLY.format(seconds=seconds) if seconds else None)
    start = ["-m", "giajax"] if code is None else ["-c", code]
    pipe = subprocess.PIPE
    running = subprocess.Popen(
        [sys.executable, *start, *words], stdout=pipe, stderr=pipe, text=True, cwd=cwd
    )
    RUNNING.append(running)
    return running


def ended(running):
    """Wait for the end; return exit status, standard output and standard error."""
    out, err = running.communicate(timeout=120)
    return running.returncode, out, err


def wait_for(running, word):
    """Wait until a progress line starts with a word."""
    for line in running.stderr:
        if line.split()[:1] == [word]:
            return
    pytest.fail(f"{word} never came")


def numbers(path):
    """Return all numbers of a result, without times and paths."""
    record = json.loads((Path(path) / "result.json").read_text())
    del record["seconds"], record["task"]
    return record


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Return the numbers of a fit that is not disturbed."""
    home = tmp_path_factory.mktemp("plain")
    write_task(home)
    running = process(*FIT, cwd=home)
    status, _, err = ended(running)
    assert status == 0, err
    assert sorted(os.listdir(home / "out")) == ["prediction.csv", "prediction.toml", "result.json"]
    return numbers(home / "out")


@pytest.mark.parametrize(
    ("number", "status"),
    [
        pytest.param(signal.SIGTERM, 143, marks=pytest.mark.long),
        pytest.param(signal.SIGINT, 130, marks=pytest.mark.slow),
    ],
)
def test_a_signal_writes_the_best_so_far(folder, plain, number, status):
    running = process(*FIT, seconds=0.5)
    wait_for(running, "5")
    running.send_signal(number)
    code, out, err = ended(running)
    assert (code, "Traceback" in err) == (status, False)
    assert "interrupted after" in out
    assert "to continue the fit: giajax fit --resume out" in out
    result = load_result("out")
    assert (result.status, result.iterations) in [("interrupted", 5), ("interrupted", 6)]
    assert "fit.lock" not in os.listdir("out")
    code, out, err = ended(process("fit", "--resume", "out", "--no-figures"))
    assert (code, "continuing from the end of out/journal.jsonl" in err) == (0, True)
    assert numbers("out") == plain
    assert not Path("out/journal.jsonl").exists()


STOPPED_AT = """
import os, signal, sys
class Stop:
    def find_spec(self, name, *_):
        if name == {module!r}:
            os.kill(os.getpid(), signal.SIGTERM)
sys.meta_path.insert(0, Stop())
from giajax.__main__ import main
sys.exit(main())
"""


@pytest.mark.parametrize("module", ["giajax.cli", "numpy", "equinox"])
def test_a_signal_before_anything_is_computed_is_one_line(folder, module):
    """This holds from the first import on."""
    before = sorted(os.listdir())
    running = process(*FIT, code=STOPPED_AT.format(module=module))
    assert ended(running) == (143, "", "giajax: interrupted\n")
    assert sorted(os.listdir()) == before


@pytest.mark.slow
def test_a_second_signal_ends_it_at_once(folder):
    """This also holds while the first one is delayed, here by a slow writer."""
    code = SLOWLY.format(seconds=0.5).replace(
        "sys.exit",
        "import giajax.report\n"
        "giajax.report.write_result = lambda *a, **k: time.sleep(100)\n"
        "sys.exit",
    )
    running = subprocess.Popen(
        [sys.executable, "-c", code, *FIT], stderr=subprocess.PIPE, text=True
    )
    wait_for(running, "3")
    running.send_signal(signal.SIGINT)
    time.sleep(2.0)
    assert running.poll() is None
    running.send_signal(signal.SIGINT)
    running.communicate(timeout=5)
    assert running.returncode == 130
    assert len(read_journal(Path("out")).of(1).lines) >= 4


@pytest.mark.slow
def test_two_fits_in_one_folder_do_not_mix(folder, plain):
    first = process(*FIT, seconds=0.1)
    wait_for(first, "1")
    first.send_signal(signal.SIGSTOP)  # paused until the second fit has tried to write
    status, out, err = ended(process(*FIT))
    first.send_signal(signal.SIGCONT)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert f"another fit is writing to out (process {first.pid} on " in err
    assert ended(first)[0] == 0
    assert numbers("out") == plain


@pytest.fixture
def small_disk(folder):
    """Return a disk of 48 kB, if this user may mount one."""
    home = folder / "disk"
    home.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=48k", "none", str(home)]
    if os.name != "posix" or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no disk may be mounted here")
    yield home
    subprocess.run(["umount", str(home)], check=True)


@pytest.mark.slow
@pytest.mark.parametrize("room", [0, 8_192, 40_960])
def test_a_small_disk_loses_no_number(small_disk, plain, room):
    """Content without space on the disk goes to standard output, even if that is a file there."""
    (small_disk / "filler").write_bytes(bytes(48 * 1024 - room))
    words = [*FIT[:-1], str(small_disk / "out")]
    status, out, err = ended(process(*words))
    assert "Traceback" not in err
    if status == 0:
        result = json.loads((small_disk / "out" / "result.json").read_text())
    else:
        assert status == 2
        assert "No space left on device" in err
        result = json.loads(out)
    for key in ("parameters", "history", "cost", "correlation"):
        assert result[key] == plain[key], key


@pytest.mark.slow
def test_a_budget_ends_with_the_best_so_far(folder, plain):
    status, out, _ = ended(process(*FIT, "--budget", "1.2s", seconds=0.4))
    assert status == 1
    assert "NOT CONVERGED: the time budget of 1.2 s was exhausted after" in out
    assert "giajax fit --resume out" in out
    result = load_result("out")
    assert result.iterations < plain["iterations"]
    words = ["fit", "--resume", "out", "--budget", "10m", "--no-figures"]
    assert ended(process(*words))[0] == 0
    after, expected = numbers("out"), plain
    assert after["config"].pop("budget_s") == 600.0
    assert after == expected


@pytest.mark.slow
def test_a_budget_in_a_definition(folder, capsys):
    path = folder / "loops_fit.toml"
    path.write_text(path.read_text().replace("[fit]", '[fit]\nbudget = "0s"'))
    assert main([*FIT]) == 1
    assert "the time budget of 0 s was exhausted after 0 iterations" in capsys.readouterr().out


@pytest.mark.slow
def test_again_and_from(folder, capsys):
    assert main([*FIT]) == 0
    first = numbers("out")
    assert main(["fit", "--again", "out/result.json", "--no-figures"]) == 0
    assert "all numbers are identical, bit for bit" in capsys.readouterr().out
    assert numbers("out-again") == first
    assert main([*FIT[:-1], "on", "--from", "out", "--free", "elastic"]) == 0
    assert load_result("on").parameters["weights"].value == [
        first["parameters"]["weights[0]"]["value"]
    ]
    capsys.readouterr()
    assert main(["fit", "--resume", "out"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("the fit in out has ended and cannot be continued")


WRONG = {
    "no journal": (["--resume", "nowhere"], "nowhere has no journal"),
    "no result": (["--again", "nowhere"], "does not exist: give"),
    "no beginning": (["--data", "loops.csv", "--from", "nowhere"], "does not exist: give"),
    "no unit": (["loops_fit.toml", "--budget", "10"], 'such as "90s", "10m" or "2h"'),
    "again and data": (["--again", "out", "--data", "loops.csv"], "omit the other options"),
    "again and resume": (["--again", "out", "--resume", "out"], "omit the other options"),
    "a journal of words": (
        ["--resume", "words"],
        "is damaged at line 1, or is not a giajax journal",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_question_is_one_line(folder, capsys, case):
    words, part = WRONG[case]
    (folder / "words").mkdir()
    (folder / "words" / "journal.jsonl").write_text("not a journal\n")
    before = sorted(os.listdir())
    assert main(["fit", *words]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert part in err
    assert sorted(os.listdir()) == before


def test_the_time_left_is_said_as_far_as_it_is_known(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])

    def told(left, seconds, numbers):
        said = []
        for number in numbers:
            clock[0] += seconds
            said.append(left.after(number))
        return [sentence for sentence in said if sentence]

    assert told(TimeLeft(50), 0.2, range(20)) == []
    sentences = told(TimeLeft(50), 10.0, range(12))
    assert len(sentences) == 2
    assert sentences[0] == (
        "at most 8 min left: 48 steps of 10 s, but most fits need far fewer steps"
    )
    (sentence,) = told(TimeLeft(50, budget_s=100.0), 10.0, range(5))
    assert sentence == "at most 1.2 min left until the budget ends the fit"
    several = TimeLeft(50, starts=8)
    several.start()
    told(several, 10.0, range(10))
    several.start()
    (sentence, *_) = told(several, 10.0, range(8))
    assert sentence.startswith("about ")
    assert sentence.endswith(
        "left until the fits from all 8 initial guesses are done, estimated from the previous fits"
    )
