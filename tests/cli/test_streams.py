"""Closed, full or limited standard streams, names that are not text, and signals."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from giajax.cli import main
from giajax.fitting import load_result
from giajax.recordings import read_run, write_files
from giajax.runtime.files import check_path
from giajax.runtime.text import InputError

pytestmark = pytest.mark.skipif(os.name != "posix", reason="of a POSIX shell")

MUSCLE = Path(__file__).resolve().parents[1] / "earlier" / "results" / "muscle"
GIAJAX = f"{sys.executable} -m giajax"
FIT = "fit --data run.csv --no-figures --no-suspects"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return the current folder, which contains a run of a muscle."""
    monkeypatch.chdir(tmp_path)
    for name in ("run.csv", "run.toml"):
        shutil.copy(MUSCLE / name, tmp_path)
    return tmp_path


def shell(line, **variables):
    """Return exit status, output and errors of a bash line in which `giajax` is the command."""
    line = f'set -o pipefail; giajax() {{ {GIAJAX} "$@"; }}; {line}'
    ended = subprocess.run(
        ["bash", "-c", line], capture_output=True, check=False, env={**os.environ, **variables}
    )
    out, err = (text.decode(errors="replace") for text in (ended.stdout, ended.stderr))
    assert "Traceback" not in out + err
    assert "Exception ignored" not in err
    return ended.returncode, out, err


LOST = (
    "giajax: standard output cannot be written to (No space left on device): the rest of the "
    "output is lost, but all files that were written are complete\n"
)


@pytest.mark.parametrize(
    ("streams", "ends"),
    [
        (">&-", (0, "", "")),
        ("2>&-", (0, None, "")),
        (">&- 2>&- <&-", (0, "", "")),
        (">/dev/full", (4, "", LOST)),
        (">/dev/full 2>/dev/full", (4, "", "")),
        ("| true", (141, None, "")),  # the reader ends before any line; with head, it may not
        ("2>&1 >/dev/full | head -1", (4, LOST, "")),
    ],
)
def test_output_that_nobody_takes(folder, streams, ends):
    status, out, err = ends
    given = shell(f"giajax check --data run.csv {streams}")
    assert given[0] == status
    assert out is None or given[1] == out
    assert given[2] == err
    # The file is written nevertheless.
    (folder / "run.toml").unlink()
    assert shell(f"giajax init --data run.csv {streams}")[0] in (status, 0)
    assert "[noise]" in (folder / "run.toml").read_text()
    assert "wrote" not in (folder / "run.toml").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("streams", [">&-", ">/dev/full", "2>/dev/full", "2>&1 | head -1"])
def test_a_fit_is_written_whoever_reads(folder, streams):
    assert shell(f"giajax {FIT} --out out {streams}")[0] in (0, 4, 141)
    assert load_result("out").status == "converged"


@pytest.mark.parametrize("variables", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C"}])
def test_a_terminal_of_few_characters(folder, variables):
    shutil.copy("run.csv", "Prüfling.csv")
    assert shell("giajax check --data Prüfling.csv --json", **variables)[0] == 0
    status, out, err = shell("giajax check --data Prüfling.csv", **variables)
    assert (status, err) == (0, "")
    assert "Prüfling" in out or r"Pr\xfcfling" in out
    assert shell("giajax check --data kein-Prüfling.csv", **variables)[0] == 2


REOPENED = (
    "import os, subprocess, sys; from giajax.__main__ import _open_streams; _open_streams()\n"
    "print('\\udcfc', file=sys.stdout); print(sys.stdout.errors)\n"
    "assert all(map(os.get_inheritable, range(3)))"
)


def test_streams_that_were_closed_are_as_others(folder):
    """They accept all characters, and so do those of child processes."""
    line = 'exec "$0" -c "$1" >&- <&-'
    words = ["bash", "-c", line, sys.executable, REOPENED]
    ended = subprocess.run(words, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_name_that_is_not_utf_8_is_refused(folder):
    os.rename(b"run.csv", b"r\xfcn.csv")
    before = sorted(os.listdir(b"."))
    by_data = [rf"{name} --data $'r\xfcn.csv'" for name in ("check", "init", "fit")]
    for words in (*by_data, r"import a.csv --frame-rate 1 --to $'\xfc.csv'"):
        status, out, err = shell(f"giajax {words}")
        assert (status, out) == (2, "")
        assert r"\udcfc" in err
        assert "is not UTF-8" in err
    with pytest.raises(InputError, match="is not UTF-8"):  # nor a character split in two
        check_path(os.fsdecode(b"\xc3/\xbc"))
    assert sorted(os.listdir(b".")) == before


@pytest.mark.slow
def test_a_folder_whose_name_is_not_utf_8_is_no_matter(folder):
    os.mkdir(b"\xfc")
    for name in ("run.csv", "run.toml"):
        shutil.copy(name, os.path.join(b"\xfc", name.encode()))
    with contextlib.chdir(b"\xfc"):
        status, out, err = shell(f"giajax {FIT} --report --out out && giajax compare out out")
        assert (status, "converged" in out.lower()) == (0, True), err
        assert load_result("out").status == "converged"


@pytest.mark.parametrize(
    "words",
    [
        "check --data folder", "check --data folder.csv", "init --data folder.csv",
        "fit folder.toml", "compare folder",
        "fit --data folder.csv", "parameters --arm folder.toml", "sweep folder.toml",
        "check --data run.csv --rename", "import folder.csv --frame-rate 1 --to o.csv",
        "mjcf folder.xml", "init --data other.csv --force",
        "compensate --loop run.csv --target run.csv --to folder.csv",
        "mission folder.toml", "fill folder.toml", "drive --pad folder.toml --replay run.csv",
        "drive --replay folder.csv", "view folder", "predict folder --data run.csv",
        "fit --data run.csv --out run.csv", "fit --resume folder", "fit --again folder",
        "joint folder.toml --out j", "explain --data folder.csv --out e",
        "simulate --step 1=2 --to folder.csv", "simulate --arm folder.toml --to s.csv",
        "choose --data folder.csv", "wind --data folder.csv", "synth --data folder.csv --to n.csv",
    ],
)  # fmt: skip
def test_a_folder_for_a_file(folder, capsys, words):
    for name in ("folder", "folder.csv", "folder.toml", "folder.xml", "other.toml"):
        (folder / name).mkdir()
    shutil.copy("run.csv", "other.csv")
    before = sorted(os.listdir())
    assert main(words.split()) == 2
    out, err = capsys.readouterr()
    assert (out, err.splitlines()[-1][:8]) == ("", "giajax: ")
    assert sorted(os.listdir()) == before


HANG_UP_IGNORED = "trap '' HUP; "
SLOW_FIT = (
    "import sys, time, giajax.tasks; from giajax.__main__ import main\n"
    "append = giajax.tasks.Journal.append\n"
    "giajax.tasks.Journal.append = lambda *given: (append(*given), time.sleep(0.5))\n"
    f"sys.argv[1:] = {(FIT + ' --out out').split()!r}\nsys.exit(main())\n"
)


@pytest.mark.slow
def test_who_hangs_up_has_the_best_so_far(folder):
    for ignored, status in ((False, 129), (True, 0)):
        shutil.rmtree("out", ignore_errors=True)
        line = f'{HANG_UP_IGNORED * ignored}exec {sys.executable} -c "$1"'
        # `nohup` may run these tests, and every child process inherits its signal setting.
        usual = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n" * (not ignored)
        running = subprocess.Popen(
            ["bash", "-c", line, "bash", usual + SLOW_FIT],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        while not (Path("out/journal.jsonl").exists() and Path("out/journal.jsonl").stat().st_size):
            time.sleep(0.05)
        running.send_signal(signal.SIGHUP)
        _, err = running.communicate(timeout=120)
        assert (running.returncode, b"Traceback" in err) == (status, False)
        ended = "converged" if ignored else "interrupted"
        assert load_result("out").status == ended


def full_after(room, monkeypatch):
    """Let the disk accept this number of files from `write_files`."""
    written = []

    def replace(part, path, replace=os.replace):
        if str(path).endswith((".json", ".csv", ".toml", ".png", ".html")):
            written.append(path)
            if len(written) > room:
                raise OSError(28, "No space left on device", str(path))
        replace(part, path)

    monkeypatch.setattr("os.replace", replace)


@pytest.mark.slow
@pytest.mark.parametrize("room", [0, 1, 3, 4, 6, 8])
def test_a_disk_that_is_full_after_the_result(folder, capsys, monkeypatch, room):
    """The disk has room for the result only, for the prediction, the suspects, or some figures."""
    full_after(room, monkeypatch)
    status = main(["fit", "--data", "run.csv", "--out", "out", "--self-test", "--report"])
    out, err = capsys.readouterr()
    assert "Traceback" not in err
    assert err.count("No space left on device") >= 1
    if room == 0:
        assert status == 2
        assert json.loads(out)["status"] == "converged"
        return
    assert status == 0
    assert "giajax: the result was written, but out/" in err
    assert load_result("out").status == "converged"


def test_what_cannot_be_written_is_named(folder, monkeypatch):
    full_after(0, monkeypatch)
    with pytest.raises(InputError, match=r"a.csv cannot be written \(No space left on device\)"):
        write_files({folder / "a.csv": b""}, force=False)
    assert sorted(os.listdir()) == ["run.csv", "run.toml"]


PAD = "time_s,axis0,axis1\n0,0,-1\n300,0.5,0.5\n301,0,0\n"


@pytest.mark.slow
def test_a_drive_that_is_killed_is_there(folder):
    """All but the last second is a run; a drive that ends normally leaves no such file."""
    (folder / "arm.toml").write_text('[arm]\npreset = "takeichi_20m"\nlinks = 3\n')
    (folder / "pad.csv").write_text(PAD)
    code = (
        "import sys, time, giajax.apps.driving as d; from giajax.__main__ import main\n"
        "advance = d.Session.advance\n"
        "def slowly(session, now): advance(session, now); time.sleep(1 / 30)\n"
        "d.Session.advance = slowly\n"
        "sys.argv[1:] = 'drive arm.toml --replay pad.csv --to run-2.csv'.split()\n"
        "sys.exit(main())\n"
    )
    running = subprocess.Popen([sys.executable, "-c", code])
    part = folder / "run-2-unfinished.csv"
    while not (part.exists() and part.read_bytes().count(b"\n") > 30):
        time.sleep(0.05)
    began = time.monotonic()
    rows = part.read_bytes().count(b"\n")
    time.sleep(2.0)
    running.kill()
    running.wait()
    run = read_run(part)
    # At most 30 rows per second; those of the last second may be lost.
    assert len(run.times) >= rows + 0.5 * 30 * (time.monotonic() - began - 1.0)
    assert run.values["joint01_command"].max() > 0
    assert run.definition.contents()["arm"]["links"] == 3
    assert "joint03_angle" in run.observations
    assert main(["drive", "arm.toml", "--replay", "pad.csv", "--to", "run-2.csv"]) == 2
    part.unlink()
    part.with_suffix(".toml").unlink()
    (folder / "pad.csv").write_text(PAD.replace("300", "3").replace("301", "4"))
    assert main(["drive", "arm.toml", "--replay", "pad.csv", "--to", "run-2.csv"]) == 0
    assert not part.exists()
