"""`giajax check`, and the grammar that all commands share."""

import json
import re
import subprocess
import sys

import pytest

from giajax.cli import main
from giajax.runtime.execution import run_tasks
from giajax.runtime.tasks import Task

pytestmark = pytest.mark.quick

CSV = "time_s,joint01_command_deg,link06_z_m\n0,0,0.1\n0.1,30,\n0.2,30,-0.3\n"


@pytest.fixture
def run(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(CSV)
    return path


def test_check_says_what_a_file_holds(run, capsys):
    assert main(["check", "--data", str(run)]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines == [line.rstrip() for line in lines]
    assert "link06_z         measured  m          2       33.3  -0.3  0.1      -" in lines
    for part in [str(run), "arm", "0 to 0.2 s, every 0.1 s", "joint01_command; linear", "none",
                 "note: the noise is not specified"]:  # fmt: skip
        assert part in out


def test_check_prints_json(run, capsys):
    assert main(["check", "--data", str(run), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (facts["model"], facts["rows"]) == ("arm", 3)


def test_check_renames(run, capsys):
    run.write_text(CSV.replace("time_s", "t=s").replace("link06_z_m", "z"))
    arguments = ["check", "--data", str(run), "--rename", "t=s=time_s", "--rename", "z=link07_z_m"]
    assert main(arguments) == 0
    assert "link07_z" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        ([], ["missing option '--data'"]),
        (["--data", "{run}", "extra"], ["extra"]),
        (["--data", "{run}", "--jsn"], ["--jsn"]),
        (["--data", "{run}", "--rename"], ["--rename"]),
        (["--data", "{run}", "--rename", "z"], ["'z'", "OLD=NEW"]),
        (["--data", "{run}", "--rename", "=z"], ["'=z'", "OLD=NEW"]),
        (["--data", "{run}", "--rename", "q=tip_x_m"], ["no column 'q'"]),
        (
            ["--data", "{run}", "--rename", "link06_z_m=tip_x_m", "--rename", "link06_z_m=tip_y_m"],
            ["twice"],
        ),
        (["--data", "{run}", "--rename", "link06_z_m=time_s"], ["'time_s' is given twice"]),
        (
            ["--data", "{run}", "--rename", "link06_z_m=hight"],
            ["'hight' is not in the column table"],
        ),
    ],
)
def test_wrong_usage_is_one_line(run, capsys, arguments, parts):
    assert main(["check", *(item.format(run=run) for item in arguments)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("giajax: ")
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


def test_an_unknown_command_is_one_line_with_a_suggestion(capsys):
    assert main(["chek", "run.csv"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("giajax: no such command 'chek': did you mean 'check'")


@pytest.mark.parametrize("arguments", [[], ["--help"], ["check", "--help"], ["init", "-h"]])
def test_help_has_examples(capsys, arguments):
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert "Example" in out
    assert "giajax check" in out


def test_version(capsys, monkeypatch):
    monkeypatch.setattr("importlib.metadata.version", lambda name: f"1.2.3 of {name}")
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == "giajax 1.2.3 of giajax\n"


def test_an_interruption_has_its_own_status(run, capsys, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("giajax.recordings.read_run", interrupt)
    assert main(["check", "--data", str(run)]) == 130
    assert capsys.readouterr().err == "giajax: interrupted\n"


def test_a_file_that_the_system_refuses_is_one_sentence(run, capsys, monkeypatch):
    """This holds wherever the name is read; here a plan has a name that no file can have."""
    (run.parent / "fit.toml").write_text(f'[fit]\ndata = ["{"q" * 300}.csv"]\n')
    plan = run.parent / "plan.toml"
    plan.write_text('fit = "fit.toml"\n[grid]\nloss = ["linear", "huber"]\n')
    assert main(["sweep", str(plan), "--dry-run"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "cannot be used (File name too long): give another path" in err


def test_what_a_file_says_commands_no_terminal(tmp_path, capsys):
    film = tmp_path / "film.csv"
    film.write_text("scorer,a,a\nbodyparts,\x1b[2J\x07end,\x1b[2J\x07end\ncoords,x,y\n0,1,2\n")
    assert main(["import", str(film), "--frame-rate", "9", "--to", str(tmp_path / "o.csv")]) == 2
    assert "\\x1b[2J\\x07end" in capsys.readouterr().err


WITHOUT = """
import sys
from giajax.cli import main
heavy, *commands = (words.split() for words in sys.argv[1:])
for arguments in commands:
    status = main(arguments)
    loaded = set(heavy) & set(sys.modules)
    if loaded or status:
        sys.exit(f"{arguments} imported {loaded}" if loaded else status)
"""
JAX = "jax equinox diffrax matplotlib"
# The help reads no run and prints no table. benchmarks.startup measures its time.
SLOW_TO_IMPORT = f"{JAX} numpy pydantic polars rich.console rich.table"


@pytest.mark.parametrize("reads", [False, True])
def test_no_command_on_files_imports_jax(run, reads):
    commands = [f"check --data {run}", f"init --data {run}"] if reads else ["--version", "--help"]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, JAX if reads else SLOW_TO_IMPORT, *commands],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stderr, done.returncode) == ("", 0)


def test_a_closed_pipe_is_no_complaint(run):
    # The reading end is closed before anything is written.
    code = "import sys, time; time.sleep(0.3); from giajax.cli import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", code, "check", "--data", str(run)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait() == 141


def test_what_nobody_expects_is_a_sentence_and_a_file(run, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("giajax.recordings.describe", lambda run: 1 / 0)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["check", "--data", str(run)]) == 4
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert err.startswith("giajax: internal error (ZeroDivisionError (")
    (file,) = tmp_path.glob("giajax-*.txt")
    assert f"report it with {file}, which contains the traceback" in err
    assert f" check --data {run}\n\nTraceback (most recent call last):\n" in file.read_text()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    assert main(["check", "--data", str(run)]) == 4
    err = capsys.readouterr().err
    assert err.startswith("Traceback (most recent call last):\n")
    assert "which cannot be written to a file (No such file or directory)" in err
    # An interruption that a foreign library converts to another exception.
    monkeypatch.setattr("giajax.cli._commands.is_stopped", lambda: True)
    assert main(["check", "--data", str(run)]) == 130
    assert capsys.readouterr().err == "giajax: interrupted\n"


def test_a_panic_of_a_library_is_a_sentence(run, tmp_path, capsys, monkeypatch):
    """Polars raises a panic, which is not an `Exception`; in a task, it becomes the outcome."""

    class PanicException(BaseException):
        pass

    def panic(*_):
        raise PanicException("index out of bounds")

    monkeypatch.setattr("giajax.recordings.describe", panic)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert main(["check", "--data", str(run)]) == 4
    assert "internal error (PanicException (test_check.py, line " in capsys.readouterr().err
    monkeypatch.setattr("os.getcwd", panic)
    (outcome,) = run_tasks([Task("os:getcwd")])
    assert (outcome.status, "PanicException" in outcome.message) == ("failed", True)


def test_a_list_of_commands_and_each_of_their_helps_are_there(capsys):
    """The list shows the commands without their options; the help of each command shows them."""
    assert main(["--help"]) == 0
    listed = capsys.readouterr().out.split("First day:")[1].split("Examples:")[0]
    names = re.findall(r"^  (\w+)", listed, re.MULTILINE)
    assert {"check", "fit", "init", "predict", "synth"} <= set(names)
    for name in names:
        assert main([name, "--help"]) == 0
        assert f"Usage: giajax {name} [OPTIONS]" in " ".join(capsys.readouterr().out.split())
    assert main(["chek"]) == 2
    assert "did you mean 'check'" in capsys.readouterr().err
