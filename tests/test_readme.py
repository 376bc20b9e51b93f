"""What the documentation shows must run: the README's Python, and the examples of docstrings."""

import doctest
import importlib
import pkgutil
import re
import shlex
from pathlib import Path

import pytest
import typer

import giajax
from giajax.cli import _app
from giajax.joint import Friction

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_python_of_the_readme_runs():
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 5
    names = {}
    for block in blocks:
        assert "assert" in block
        exec(compile(block, "README.md", "exec"), names)


def modules():
    found = pkgutil.walk_packages(giajax.__path__, "giajax.")
    return [module.name for module in found if not module.name.endswith("__main__")]


@pytest.mark.slow
@pytest.mark.parametrize("name", modules())
def test_the_examples_of_docstrings_run(name):
    results = doctest.testmod(importlib.import_module(name), raise_on_error=False)
    assert results.failed == 0


def commands():
    """Command lines that README and docs show, with the name of the page."""
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        found = re.findall(r"^```(\w*)\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
        for block in (block for language, block in found if language in ("", "console")):
            for line in block.replace("\\\n", " ").splitlines():
                match = re.match(r"(?:\$ )?giajax (.*)", line)
                if match is not None:
                    yield page.name, match[1]


@pytest.mark.quick
def test_the_commands_of_the_pages_are_there_with_their_options():
    """Each is parsed as the command line would, and nothing is run."""
    shown = [(page, line) for page, line in commands() if not line.startswith("columns")]
    assert len(shown) > 25
    for page, line in shown:
        words = shlex.split(line, comments=True)
        group = typer.main.get_command(_app._app_for(words))
        assert words[0] in group.commands, (page, line)
        command = group.commands[words[0]]
        try:
            command.make_context(words[0], words[1:])
        except Exception as error:
            pytest.fail(f"{page}: giajax {line}: {error}")


def test_the_readme_starts_with_the_two_commands():
    assert README.index("make demo") < README.index("make test") < 200


def assumed_rows(model):
    rows = []
    for path, parameter in giajax.declared(model).items():
        declaration = parameter.declaration
        if declaration.assumed:
            unit = declaration.unit or "-"
            rows.append(f"| `{path}` | {declaration.default:g} | {unit} | {declaration.doc} |")
    return rows


MODELS = {
    "arm": lambda: giajax.ArmModel(giajax.takeichi_20m()),
    "joint": lambda: giajax.JointModel(giajax.Joint()),
    "braided": lambda: giajax.MuscleModel(friction=Friction()),
}


@pytest.mark.parametrize("name", MODELS)
def test_every_assumed_number_is_in_the_readme(name):
    rows = ["| parameter | assumed | unit | meaning |", "| --- | --- | --- | --- |"]
    table = "\n".join([*rows, *assumed_rows(MODELS[name]())])
    assert table in README, f"the table must read\n{table}"


@pytest.mark.parametrize("law", [giajax.EmpiricalMuscle, giajax.Piston])
def test_the_other_muscle_laws_are_there_too(law):
    missing = [row for row in assumed_rows(giajax.MuscleModel(law())) if row not in README]
    assert missing == []
