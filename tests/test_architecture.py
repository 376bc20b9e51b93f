"""Statements of docs/architecture.md hold: its examples are applied to a copy, and run."""

import csv
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_structure import ROOMS, test_nobody_asks_what_kind_a_model_is as nobody_asks

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
COMMAND = "import sys; from giajax.cli import main; sys.exit(main())"


def section(heading):
    """Return the text of a section without its heading."""
    (text,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", PAGE, re.DOTALL | re.MULTILINE)
    return text


def blocks(text):
    """Return the code blocks in order: language and contents."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def changed(text, diff):
    """Apply the hunks of a diff to a text: context, removed and added lines, without numbers."""
    for hunk in diff.split("@@\n"):
        lines = hunk.splitlines(keepends=True)
        assert lines, "a hunk is empty"
        assert {line[0] for line in lines} <= set(" +-")
        before = "".join(line[1:] for line in lines if line[0] != "+")
        after = "".join(line[1:] for line in lines if line[0] != "-")
        assert text.count(before) == 1, f"is there {text.count(before)} times:\n{before}"
        text = text.replace(before, after)
    return text


def done_to(tree, text):
    """Apply the changes of a section to a copy of the project; return new and changed files."""
    new, edited = [], []
    for language, block in blocks(text):
        marked = re.match(r"# (new|in): (\S+)\n", block)
        if marked is None:
            continue
        path, contents = tree / marked[2], block[marked.end() :]
        if marked[1] == "new":
            assert language == "python"
            assert not path.exists()
            path.write_text(contents, encoding="utf-8")
            new.append(marked[2])
        else:
            assert language == "diff"
            path.write_text(changed(path.read_text(encoding="utf-8"), contents), encoding="utf-8")
            edited.append(marked[2])
    return new, edited


@pytest.fixture
def tree(tmp_path):
    """Return a copy of the project's source."""
    shutil.copytree(
        ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__", "_examples")
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


@pytest.fixture
def giajax(tree):
    """Return a function that runs a command line of the copy in its folder, and its output."""

    def run(*arguments, code=COMMAND):
        environment = {**os.environ, "PYTHONPATH": str(tree / "src")}
        packages = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
        packages = [path for path in packages if not (Path(path) / "giajax").exists()]
        environment["PYTHONPATH"] = os.pathsep.join([str(tree / "src"), *packages])
        ended = subprocess.run(
            [sys.executable, "-c", code, *arguments],
            cwd=tree, env=environment, capture_output=True, text=True,
        )  # fmt: skip
        assert ended.returncode == 0, ended.stdout + ended.stderr
        return ended.stdout

    where = run(code="import giajax; print(giajax.__file__)")
    assert Path(where.strip()) == tree / "src" / "giajax" / "__init__.py"
    return run


def printed(giajax, text):
    """Return the output of the commands of a section: `$ giajax ...` in its console blocks."""
    lines = [block for language, block in blocks(text) if language == "console"]
    commands = re.findall(r"^\$ giajax (.*)$", "".join(lines), re.MULTILINE)
    assert commands
    return [giajax(*command.split()) for command in commands]


def write_table(text, path):
    """Write the CSV file that a section shows."""
    (table,) = [block for language, block in blocks(text) if not language and "," in block]
    path.write_text(table, encoding="utf-8")


def check_style(tree, paths):
    """Check that new and changed files conform to the style of the project."""
    ruff = shutil.which("ruff", path=str(Path(sys.executable).parent)) or shutil.which("ruff")
    if ruff is None:
        return
    for command in (["check"], ["format", "--check"]):
        ended = subprocess.run(
            [ruff, *command, *paths], cwd=tree, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stdout + ended.stderr


@pytest.mark.long
def test_a_kind_of_model_is_two_files_and_a_line(tree, giajax):
    text = section("To add a kind of model")
    new, edited = done_to(tree, text)
    assert new == ["src/giajax/schema/_leak.py", "src/giajax/models/_leak.py"]
    assert edited == ["src/giajax/schema/__init__.py"]
    added = [line for _, block in blocks(text) for line in block.splitlines() if line[:1] == "+"]
    assert len(added) == 1
    check_style(tree, [*new, *edited])
    write_table(text, tree / "leak.csv")
    init, fit = printed(giajax, text)
    assert "wrote leak.toml" in init
    assert "first_fullness" in (tree / "leak.toml").read_text(encoding="utf-8")
    # By hand: the slope of ln(fullness) over time is about -1 / 6330 s.
    (value,) = re.findall(r"^leak_time +([0-9.]+)", fit, re.MULTILINE)
    assert 6000 < float(value) < 6700
    assert (tree / "leak" / "result.json").exists()
    # A prediction is a run, and its model is built from the result.
    again = giajax("fit", "--data", "leak/prediction.csv", "--out", "again")
    assert re.search(r"^leak_time +[0-9.]+", again, re.MULTILINE)


def heights(path):
    """Return the heights of the second link in a run, m."""
    with path.open(newline="", encoding="utf-8") as file:
        return [float(row["link02_z_m"]) for row in csv.DictReader(file)]


@pytest.mark.long
def test_a_parameter_is_its_declaration_and_what_computes_with_it(tree, giajax):
    text = section("To add a parameter")
    new, edited = done_to(tree, text)
    assert new == []
    laws = [f"src/giajax/mechanics/arm/{name}.py" for name in ("_parts", "_joint_laws")]
    assert edited == ["src/giajax/schema/_quantities_arm.py", *laws]
    check_style(tree, edited)
    (arm,) = [block for language, block in blocks(text) if language == "toml"]
    (tree / "arm.toml").write_text(arm, encoding="utf-8")
    *_, parameters = printed(giajax, text)
    assert re.search(r"^joints.quadratic_damping .* N m s\^2/rad\^2 ", parameters, re.MULTILINE)
    sidecar = (tree / "damped.toml").read_text(encoding="utf-8")
    assert "damping of a joint proportional to the square of its rate" in sidecar
    damped, plain = (heights(tree / name) for name in ("damped.csv", "plain.csv"))
    assert 0.1 < max(damped) < 0.9 * max(plain)


@pytest.mark.slow
def test_a_channel_is_two_files(tree, giajax):
    text = section("To add a channel")
    new, edited = done_to(tree, text)
    assert new == []
    assert edited == ["src/giajax/schema/_joint.py", "src/giajax/models/_joint.py"]
    check_style(tree, edited)
    write_table(text, tree / "wire.csv")
    check, fit = printed(giajax, text)
    assert re.search(r"^wire_tension +measured +N ", check, re.MULTILINE)
    assert "alpha." in fit
    assert "wire_tension_N" in (tree / "wire" / "prediction.csv").read_text(encoding="utf-8")


def test_a_command_is_a_file(tree, giajax):
    text = section("To add a command")
    new, edited = done_to(tree, text)
    assert new == ["src/giajax/cli/_columns.py"]
    assert edited == []
    check_style(tree, [*new, *edited])
    (columns,) = printed(giajax, text)
    assert re.search(r"^linkNN_x +arm +output +length$", columns, re.MULTILINE)
    assert "List the columns of each kind of model." in giajax("--help")


@pytest.mark.quick
def test_a_diff_that_does_not_fit_is_seen():
    assert changed("a\nb\nc\n", " a\n-b\n+d\n@@\n c\n+e\n") == "a\nd\nc\ne\n"
    with pytest.raises(AssertionError, match="0 times"):
        changed("a\n", " b\n+c\n")
    with pytest.raises(AssertionError, match="2 times"):
        changed("a\na\n", " a\n+c\n")


@pytest.mark.quick
def test_the_files_that_pages_name_are_there():
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")]:
        text = page.read_text(encoding="utf-8")
        named = set(re.findall(r"`((?:src|tests|docs|fits|data|benchmarks)/[\w./]+)`", text))
        linked = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
        missing = [path for path in named if not (ROOT / path).exists()]
        missing += [path for path in linked if not (page.parent / path).exists()]
        assert missing == [], page.name


@pytest.mark.quick
def test_the_rooms_are_those_of_the_source_in_their_order():
    named = re.findall(r"^### (\w+)$", section("Rooms"), re.MULTILINE)
    assert named == [room for room in ROOMS if room != "__main__"]
    assert all(f"<!-- table: files {room} -->" in PAGE for room in named)


@pytest.mark.quick
def test_no_room_but_models_asks_which_model_it_has():
    """The page states this at its top, and a test of the structure checks it."""
    assert "Only the room `models` depends on the class of a model." in " ".join(PAGE.split())
    assert callable(nobody_asks)
