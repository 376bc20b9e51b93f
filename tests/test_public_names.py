"""The public names: listed once, complete, typed, and sufficient for the examples of the pages."""

import ast
import importlib
import inspect
import json
import os
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import ModuleType

import pytest

import giajax

ROOT = Path(__file__).resolve().parents[1]
STUB = ROOT / "src" / "giajax" / "__init__.pyi"


def listed():
    """Return the names in the stub, with repetitions."""
    tree = ast.parse(STUB.read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return [alias.asname for node in imports for alias in node.names]


ROOMS = [name for name in listed() if (STUB.parent / name).is_dir()]


@pytest.mark.quick
def test_every_name_is_there_and_listed_once():
    names = listed()
    assert 40 < len(names) == len(set(names)) <= 72
    assert sorted(names) == sorted(giajax.__all__) == sorted(dir(giajax))
    for name in names:
        assert getattr(giajax, name) is not None


@pytest.mark.quick
def test_every_model_and_what_users_reach_for_is_there():
    models = {kind.model.partition(":")[2] for kind in giajax.schema.KINDS.values()}
    assert models <= vars(giajax.models).keys()
    wanted = {
        "FitResult",
        "FitTask",
        "Run",
        "sensitivity",
        "simulate",
        "synthesise",
        "write_result",
    }
    assert wanted <= set(listed())


@pytest.mark.quick
def test_signatures_are_complete():
    """Each keyword is listed with its default; presets pass their keywords to `chain`."""
    things = {name: getattr(giajax, name) for name in listed()}
    vague = {
        name
        for name, thing in things.items()
        if callable(thing) and not isinstance(thing, type)
        for each in inspect.signature(thing).parameters.values()
        if each.kind == each.VAR_KEYWORD
    }
    assert vague == {"pendulum", "preset", "takeichi_20m", "takeichi_20m_full"}
    shown = {
        name: (each.kind.name, each.default)
        for name, each in inspect.signature(giajax.multi_start).parameters.items()
    }
    stated = giajax.FitSettings()
    for name in ("free", "loss", "max_iterations", "spread"):
        assert shown[name] == ("KEYWORD_ONLY", getattr(stated, name))
    assert (shown["max_iterations"][1], shown["starts"][1]) == (50, 8)
    assert "spread" not in inspect.signature(giajax.fit).parameters


@pytest.mark.quick
def test_the_version_is_that_of_the_installation():
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", giajax.__version__)


@pytest.mark.quick
def test_no_two_public_things_share_a_name():
    """A name means the same in every package that has it, and in `giajax` itself."""
    things = defaultdict(dict)
    for room in ["", *ROOMS]:
        module = importlib.import_module(f"giajax.{room}".rstrip("."))
        for name in listed() if module is giajax else vars(module):
            thing = getattr(module, name)
            if not name.startswith("_") and not isinstance(thing, ModuleType):
                things[name][id(thing)] = room
    assert len(things) > 200
    assert {name: list(rooms.values()) for name, rooms in things.items() if len(rooms) > 1} == {}


def shown():
    """Yield the Python code in README, documentation and notebooks, with the name of its page."""
    for page in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]:
        text = page.read_text(encoding="utf-8")
        for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
            yield page.name, block
    for page in (ROOT / "notebooks").glob("*.ipynb"):
        for cell in json.loads(page.read_text(encoding="utf-8"))["cells"]:
            if cell["cell_type"] == "code":
                lines = [line for line in cell["source"] if not line.startswith("%")]
                yield page.name, "".join(lines)


@pytest.mark.quick
def test_what_pages_use_of_giajax_is_public():
    used = set()
    for page, code in shown():
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                if node.value.id == "giajax":
                    used.add((page, node.attr))
            elif isinstance(node, ast.ImportFrom) and node.module == "giajax":
                used |= {(page, alias.name) for alias in node.names}
    assert len(used) > 20
    assert {(page, name) for page, name in used if name not in listed()} == set()


def test_names_load_when_they_are_used():
    """Before that, neither JAX nor any package is imported."""
    code = (
        "import giajax, sys\n"
        "assert not {'jax', 'numpy', 'giajax.mechanics.arm'} & set(sys.modules)\n"
        "giajax.InputError\n"
        "assert 'jax' not in sys.modules\n"
        "giajax.mechanics.arm.chain\n"
        "assert 'jax' in sys.modules\n"
        "from giajax.report import first_suspects, summary\n"
        "assert 'matplotlib' not in sys.modules"
    )
    environment = {key: value for key, value in os.environ.items() if key != "EAGER_IMPORT"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
