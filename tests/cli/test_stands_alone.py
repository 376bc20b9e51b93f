"""A result is self-contained: every command on it, and every printed hint, works.

The fit has renamed columns and names with spaces. The commands run in another folder, and after
files have been moved.
"""

import html
import re
import shlex
import shutil

import pytest

from giajax.cli import main
from giajax.models import ArmModel
from small_arm import STARTS, make_run

RENAMED = {"t": "time_s", "first": "joint01_command_deg", "high up": "link04_z_m"}
# Commands that a user can type; "giajax profile" within a sentence only names a command.
HINT = re.compile(r"(?:: |^ *|`)giajax ((?!\d)\w+ [^`]*)")


@pytest.fixture
def world(tmp_path, monkeypatch):
    """A folder with a recording whose columns are renamed; the commands start in this folder."""
    here = tmp_path / "my arm"
    here.mkdir()
    monkeypatch.chdir(here)
    path = make_run(here, "the run")
    head, rest = path.read_text().split("\n", 1)
    for new, old in RENAMED.items():
        head = head.replace(old, new)
    path.write_text(f"{head}\n{rest}")
    sidecar = path.with_suffix(".toml")
    lines = sidecar.read_text().splitlines()
    sidecar.write_text("\n".join(line for line in lines if "sha256" not in line) + "\n")
    return here


def options():
    return [part for new, old in RENAMED.items() for part in ("--rename", f"{new}={old}")]


def ran(capsys, *arguments, status=0):
    found = main(list(map(str, arguments)))
    said = capsys.readouterr()
    assert found == status, said.err
    return said.out + said.err


def fitted(capsys, *more, status=0):
    return ran(capsys, "fit", "--data", "the run.csv", *options(), *STARTS, "--no-figures",
               "--out", "out of it/fit", *more, status=status)  # fmt: skip


def hints(said):
    """Return the commands that a text suggests, as lists of words."""
    found = [HINT.search(line) for line in said.splitlines()]
    return [shlex.split(match[1].removesuffix(":")) for match in found if match]


def test_the_hint_of_a_fit_that_needs_more_iterations_works(world, capsys):
    said = fitted(capsys, "--max-iterations", "3", "--no-suspects", status=1)
    (resume,) = hints(said)
    assert resume[:3] == ["fit", "--resume", "out of it/fit"]
    assert "converged in" in ran(capsys, *resume, "--no-figures", "--no-suspects")
    ran(capsys, "fit", "--data", "the run.csv", *options(), "--from", "out of it/fit",
        "--out", "o 2", "--no-figures", "--no-suspects")  # fmt: skip
    ran(capsys, "predict", "out of it/fit", "--data", "the run.csv")
    ran(capsys, "report", "out of it/fit")
    page = (world / "out of it" / "fit" / "report.html").read_text()
    (again,) = set(re.findall(r"giajax (fit --again [^<]*)", html.unescape(page)))
    ran(capsys, *shlex.split(again), "--no-figures", "--no-suspects")
    (check,) = hints(ran(capsys, "init", "--data", "the run.csv", *options(), "--force"))
    ran(capsys, *check)


FIT = "out of it/fit"
ON_A_RESULT = (
    ["suspects", FIT],
    ["influence", FIT, "--no-figures"],
    ["profile", FIT, "--parameter", "joints.damping", "--no-figures"],
    ["bootstrap", FIT, "--size", "2", "--no-figures"],
    ["posterior", FIT, "--chains", "1", "--draws", "8", "--warmup", "4"],
    ["view", FIT, "--page", "page.html"],
    ["report", FIT],
    ["compare", FIT, FIT],
    ["predict", FIT, "--data", "the run.csv", "--to", "a prediction.csv"],
    ["design", FIT, "--parameter", "air.drag_coefficient", "--out", "a design", "--duration", "2",
     "--rate", "5", "--knots", "3", "--candidates", "1", "--follow", "1", "--max-iterations",
     "1", "--scenarios", "1"],
    ["sweep", "a plan.toml"],
)  # fmt: skip
# Commands that generate a run from existing files, and suggest the next command.
ON_A_RUN = (
    ["simulate", "--links", "2", "--duration", "1", "--step", "1=5", "--to", "a new run.csv"],
    ["import", "the run.csv", *options(), "--to", "an import.csv"],
    ["explain", "--data", "the run.csv", *options(), *STARTS, "--max-steps", "1", "--tries", "1",
     "--no-figures", "--out", "an explanation"],
    ["check", "--data", "the run.csv", *options()],
    ["init", "--data", "the run.csv", *options(), "--force"],
)  # fmt: skip


@pytest.mark.long
def test_every_hint_of_every_command_works(world, capsys, monkeypatch):
    """Every printed command is run, and every command that it prints, too."""
    # Without model variants, because each would compile a program and only add a table row.
    monkeypatch.setattr(ArmModel, "variants", lambda self: {})
    said = fitted(capsys, "--max-iterations", "3", "--no-suspects", status=1)
    (resume,) = hints(said)
    said += ran(capsys, *resume, "--no-figures", "--no-suspects")
    (world / "a plan.toml").write_text(f'fit = "{FIT}"\n[grid]\nloss = ["linear", "huber"]\n')
    for words in (*ON_A_RESULT, *ON_A_RUN):
        said += ran(capsys, *words)
    typed = [resume]
    for _ in range(2):
        new = [each for each in hints(said) if each not in typed]
        typed += new
        said = "".join(ran(capsys, *each) for each in new)
    assert {each[0] for each in typed} >= {"fit", "check", "init"}


@pytest.mark.long
def test_studies_of_windows_work_where_the_recording_has_moved(world, capsys, tmp_path):
    """Each window has its own state, and the files are in the folder of the result."""
    sidecar = world / "the run.toml"
    sidecar.write_text(sidecar.read_text() + "\n[initial]\nfirst_row = true\nfree = true\n")
    fitted(capsys, "--window", "2", "--no-suspects")
    for name in ("the run.csv", "the run.toml"):
        shutil.move(world / name, world / "out of it" / name)
    (world / "a plan.toml").write_text(f'fit = "{FIT}"\n[grid]\nloss = ["linear", "huber"]\n')
    ran(capsys, "fit", "--again", FIT, "--no-figures", "--no-suspects")
    for words in ON_A_RESULT:
        if words[0] in ("influence", "report", "sweep"):
            ran(capsys, *words)


def test_a_result_is_asked_from_elsewhere_and_with_files_that_have_moved(
    world, capsys, tmp_path, monkeypatch
):
    fitted(capsys, "--no-suspects")
    monkeypatch.chdir(tmp_path)
    ran(capsys, "influence", "my arm/out of it/fit", "--no-figures")
    ran(capsys, "fit", "--again", "my arm/out of it/fit", "--no-figures", "--no-suspects",
        "--out", "again")  # fmt: skip
    shelf = tmp_path / "my arm" / "out of it"
    for name in ("the run.csv", "the run.toml"):
        shutil.move(world / name, shelf / name)
    ran(capsys, "influence", "my arm/out of it/fit", "--no-figures", "--force")
    ran(capsys, "fit", "--again", "my arm/out of it/fit", "--no-figures", "--no-suspects",
        "--out", "again 2")  # fmt: skip
    changed = shelf / "the run.csv"
    changed.write_text(changed.read_text().replace("0.0", "0.1", 1))
    assert "does not exist" in ran(
        capsys, "influence", "my arm/out of it/fit", "--no-figures", "--force", status=2
    )
