"""What the documentation shows must run: the README's Python, and the examples of docstrings."""

import doctest
import importlib
import pkgutil
import re
from pathlib import Path

import pytest

import giajax
from giajax.joint import Friction

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_python_of_the_readme_runs():
    blocks = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == 4
    names = {}
    for block in blocks:
        assert "assert" in block
        exec(compile(block, "README.md", "exec"), names)


def modules():
    found = pkgutil.walk_packages(giajax.__path__, "giajax.")
    return [module.name for module in found if not module.name.endswith("__main__")]


@pytest.mark.parametrize("name", modules())
def test_the_examples_of_docstrings_run(name):
    results = doctest.testmod(importlib.import_module(name), raise_on_error=False)
    assert results.failed == 0


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
