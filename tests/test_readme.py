"""The Python code and commands of README and pages, and the examples in docstrings, must run."""

import doctest
import importlib
import pkgutil
import re
import shlex
import tomllib
from pathlib import Path

import pytest
import typer

import giajax
from giajax.cli import _app, main
from giajax.schema import PadFile
from giajax.tasks import Plan

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = {page.name: page for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]}
# Their Python code runs in tests/test_architecture.py, as new files, and tests/test_newcomer.py.
ELSEWHERE = {"architecture.md", "README.md"}


def python(name):
    """Return the Python blocks of a page."""
    return re.findall(r"```python\n(.*?)```", PAGES[name].read_text(encoding="utf-8"), re.DOTALL)


COMPILE_NOTHING = {"assumed.md", "own_recording.md", "parameters.md", "sweep.md"}
# These take minutes.
LONG = {
    *("unrolling.md", "film.md", "own_arm.md"),
    *("giajax.apps.planning._plan", "giajax.apps.shaping"),
}


def tier(name):
    """Return the mark of the test of a page or module."""
    return pytest.mark.long if name in LONG else pytest.mark.slow


SHOWN = [
    pytest.param(name, marks=() if name in COMPILE_NOTHING else tier(name))
    for name in PAGES
    if name not in ELSEWHERE and python(name)
]


@pytest.mark.usefixtures("own_kinds")
@pytest.mark.parametrize("name", SHOWN)
def test_the_python_of_a_page_runs(name, monkeypatch):
    """The blocks run from top to bottom, in one namespace."""
    monkeypatch.chdir(ROOT)
    names = {}
    for block in python(name):
        assert "assert" in block
        exec(compile(block, name, "exec"), names)


def toml():
    """Return the TOML blocks of the pages, each with the name of its page."""
    for name in PAGES.keys() - ELSEWHERE:
        text = PAGES[name].read_text(encoding="utf-8")
        yield from ((name, block) for block in re.findall(r"```toml\n(.*?)```", text, re.DOTALL))


@pytest.mark.quick
def test_the_files_that_pages_show_are_legal():
    shown = list(toml())
    assert len(shown) > 6
    for name, block in shown:
        if name == "sweep.md":
            assert Plan.parse(tomllib.loads(block), ROOT / "fits", name).tasks()
        elif block.startswith("[pad]"):
            assert PadFile(**tomllib.loads(block)).pad.axes
        else:
            giajax.Definition.parse(tomllib.loads(block), name)


@pytest.mark.parametrize(
    ("page", "folder", "truth"),
    [
        pytest.param(page, folder, truth, marks=tier(page))
        for page, folder, truth in (("own_arm.md", "mine", 1.3), ("film.md", "tube", 1.15))
    ],
)
def test_the_files_and_commands_of_a_page_run(page, folder, truth, tmp_path, monkeypatch, capsys):
    """Blocks that start with a name are files; the fit must find the simulated C_D."""
    said = {}
    monkeypatch.chdir(tmp_path)
    # Without model variants, because each would compile a program that is not checked.
    monkeypatch.setattr(giajax.ArmModel, "variants", lambda self: {})
    text = PAGES[page].read_text(encoding="utf-8")
    (tmp_path / "robot.xml").write_text(ROBOT)
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE):
        if language == "toml":
            (tmp_path / block.split()[1]).write_text(block)
        for line in () if language else block.replace("\\\n", "").splitlines():
            words = shlex.split(line)[1:]
            assert main(words) == 0, line
            said[words[0]] = capsys.readouterr().out
    result = giajax.load_result(folder)
    drag = result.parameters["air.drag_coefficient"]
    assert abs(drag.value - truth) < 3 * drag.standard_error < 0.3
    assert result.verdict.status == "adequate"
    if page == "own_arm.md":
        assert (tmp_path / "exported" / "arm.xml").exists()
        return
    seen, pictures = re.search(r"found in (\d+) of (\d+) pictures", text).groups()
    assert f"{seen} of {pictures} points found" in said["import"]
    printed = table(said["fit"])
    assert len(table(text)) == 5
    for name, numbers in table(text).items():
        for shown, found in zip(numbers, printed[name], strict=True):
            # Except for the last digit, which depends on the processor.
            assert abs(float(shown) - float(found)) < 1.1 * 10.0 ** -len(shown.partition(".")[2])


def table(text):
    """Return the numbers in the rows of a parameter table, by parameter."""
    rows = [line for line in text.splitlines() if re.match(r"\w+\.[\w\[\]]+ +-?\d", line)]
    return {line.split()[0]: re.findall(r"-?\d+\.\d+", line) for line in rows}


ROBOT = """<mujoco><compiler angle="radian"/><worldbody><body><joint axis="0 -1 0" damping="0.01"
stiffness="1"/><geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.05" mass="0.03"/>
<body pos="0.4 0 0"><joint axis="0 -1 0" damping="0.01" stiffness="1"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.05" mass="0.02"/></body></body>
</worldbody></mujoco>"""


def modules():
    found = pkgutil.walk_packages(giajax.__path__, "giajax.")
    return [module.name for module in found if not module.name.endswith("__main__")]


@pytest.mark.parametrize("name", [pytest.param(name, marks=tier(name)) for name in modules()])
def test_the_examples_of_docstrings_run(name):
    results = doctest.testmod(importlib.import_module(name), raise_on_error=False)
    assert results.failed == 0


def commands():
    """Return the command lines in README and docs, with the name of the page."""
    for name, page in PAGES.items():
        text = page.read_text(encoding="utf-8")
        found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
        for block in (block for language, block in found if language in ("", "console")):
            for line in block.replace("\\\n", " ").splitlines():
                match = re.match(r"(?:\$ )?giajax (.*)", line)
                if match is not None:
                    yield name, match[1]


@pytest.mark.quick
def test_the_commands_of_the_pages_are_there_with_their_options(capsys):
    """Each is parsed as in the command line but not run, and none has an old form."""
    shown = [(page, line) for page, line in commands() if not line.startswith("columns")]
    assert len(shown) > 60
    for page, line in shown:
        words = shlex.split(line, comments=True)
        group = typer.main.get_command(_app._app_for(words))
        assert words[0] in group.commands, (page, line)
        command = group.commands[words[0]]
        try:
            command.make_context(words[0], words[1:])
        except Exception as error:
            pytest.fail(f"{page}: giajax {line}: {error}")
        assert capsys.readouterr().err == "", page


@pytest.mark.quick
def test_the_readme_starts_with_the_two_commands_and_is_a_screen():
    assert README.index("make demo") < README.index("make test") < 200
    assert len(README.splitlines()) <= 80
