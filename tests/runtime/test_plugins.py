"""Plug-ins: files that register classes outside the package."""

import os
import subprocess
import sys
from typing import NamedTuple

import pytest

import giajax
from giajax import InputError
from giajax.runtime import plugins as _plugins
from giajax.runtime.plugins import (
    check_sources,
    hint,
    load_plugin,
    plugins,
    registered,
    source,
    sources_named,
    sources_of,
)
from giajax.runtime.programs import content, structure

pytestmark = pytest.mark.quick

LAW = """
import giajax
from giajax.mechanics.arm import AbstractDragLaw

@giajax.register
class {name}(AbstractDragLaw):
    points = 0

    def force(self, stream):
        return -{factor} * stream.velocity
"""


@pytest.fixture(autouse=True)
def no_plugins(monkeypatch):
    """Keep the plug-ins of these tests out of the keys of other tests."""
    monkeypatch.setattr(_plugins, "_PLUGINS", {})


def loaded_anew(path):
    """Load a plug-in as a new process would."""
    sys.modules.pop(path.stem, None)
    _plugins._PLUGINS.clear()
    source.cache_clear()
    load_plugin(path)
    return registered("drag", "EditedLaw")()


class Air(NamedTuple):
    velocity: float


def test_an_edited_plug_in_is_another_program_and_another_task(tmp_path):
    path, texts = tmp_path / "edited_law.py", []
    for factor in (1.0, 1.0, 2.0):
        # The file changes within a second and keeps its length, so old bytecode could be used for
        # it.
        path.write_text(LAW.format(name="EditedLaw", factor=factor))
        law = loaded_anew(path)
        texts.append((structure(law), content(law)))
        assert list(sources_of(law)) == ["edited_law.py"]
        assert law.force(Air(-1.0)) == factor
    assert texts[0] == texts[1]
    assert texts[0][0] != texts[2][0]
    assert texts[0][1] != texts[2][1]


def test_a_plug_in_of_a_command_computes_as_the_command_does(tmp_path):
    path = tmp_path / "precise_law.py"
    path.write_text(
        "import os, jax.numpy\nprint(os.environ['EQX_ON_ERROR'], jax.numpy.ones(1).dtype)"
    )
    words = [sys.executable, "-m", "giajax", "parameters", "--plugin", str(path)]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("EQX", "JAX_ENABLE"))}
    shown = subprocess.run(words, capture_output=True, text=True, check=True, env=environment)
    assert shown.stdout.startswith("nan float64")


def test_results_and_workers_are_of_the_plug_in_that_was_used(tmp_path):
    path = tmp_path / "used_law.py"
    path.write_text(LAW.format(name="UsedLaw", factor=1.0))
    load_plugin(path)
    versions = {"jax": "1", **sources_of(registered("drag", "UsedLaw")())}
    digest = plugins()[path]
    check_sources(versions)
    with pytest.raises(
        InputError, match=r"used_law.py has changed since the fit: restore the former version"
    ):
        check_sources({"used_law.py": "sha256 0"})
    _plugins._PLUGINS.clear()
    del sys.modules["used_law"]
    assert "give --plugin used_law.py" in hint(versions)
    path.write_text(LAW.format(name="UsedLaw", factor=2.0))
    with pytest.raises(InputError, match=r"used_law.py has changed while it was in use"):
        load_plugin(path, digest)
    assert "no-such-package 2.0: install this package" in hint({"no-such-package": "2.0"})


def test_a_class_of_that_name_in_another_file_is_not_that_of_the_result(tmp_path, monkeypatch):
    versions = {}
    for name in ("first_laws.py", "other_laws.py"):
        monkeypatch.setattr(_plugins, "_CLASSES", {})
        (tmp_path / name).write_text(LAW.format(name="MovedLaw", factor=len(versions) + 1))
        load_plugin(tmp_path / name)
        versions = versions or sources_of(registered("drag", "MovedLaw")())
    assert list(sources_named("drag = 'MovedLaw'")) == ["other_laws.py"]
    check_sources(versions, "drag = 'strip'")
    said = r"used a class of first_laws.py, which other_laws.py now defines: restore"
    with pytest.raises(InputError, match=said):
        check_sources(versions, "drag = 'MovedLaw'")


def test_a_base_that_has_changed_is_seen(monkeypatch):
    base = type("BaseLaw", (), {"__module__": "base_law"})
    monkeypatch.setattr(_plugins, "_CLASSES", {"drag": {"Derived": type("Derived", (base,), {})}})
    monkeypatch.setattr(_plugins, "source", {"base_law": ("base_law.py", "sha256 2")}.get)
    with pytest.raises(InputError, match=r"base_law.py has changed since"):
        check_sources({"base_law.py": "sha256 1"})


def test_code_of_giajax_and_of_its_libraries_has_no_mark():
    for module in ("giajax.models._arm", "numpy", "json", "nowhere"):
        assert source(module) is None
    assert source("pytest") == ("pytest", pytest.__version__)
    assert source(__name__)[0] == "test_plugins.py"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("law.txt", "", "is not a plug-in: give a Python file"),
        ("my-law.py", "", "is not a plug-in"),
        ("absent_law.py", None, "the plug-in .*absent_law.py does not exist: correct the path"),
        ("json.py", "", "has the name of another module, 'json': rename the file"),
        ("wrong_law.py", "1 / 0", r"cannot be imported \(ZeroDivisionError: division by zero\)"),
        ("wrong_words.py", "def", r"cannot be imported \(SyntaxError"),
        ("wrong_end.py", "raise SystemExit(0)", r"cannot be imported \(SystemExit: 0\)"),
    ],
)
def test_what_is_no_plug_in_is_refused(tmp_path, name, text, said):
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=said):
        load_plugin(path)
    assert path not in plugins()


def test_what_is_registered_is_of_a_class_that_giajax_takes_and_has_a_name_of_its_own():
    with pytest.raises(InputError, match="int is not derived from a giajax class: derive it"):
        giajax.register(int)

    def made(module):
        body = {"__module__": module, "points": 0, "force": lambda self, stream: None}
        return type("Twice", (giajax.mechanics.arm.AbstractDragLaw,), body)

    first = giajax.register(made("one"))
    assert registered("drag", "Twice") is first
    # A notebook cell that is run again.
    second = giajax.register(made("one"))
    assert registered("drag", "Twice") is second
    with pytest.raises(
        InputError, match="a drag named 'Twice' already exists: choose another name"
    ):
        giajax.register(made("two"))
    for name in ("strip", "a+b"):
        body = {"points": 0, "force": lambda self, stream: None, "kind": name}
        with pytest.raises(InputError, match="already exists: choose another name"):
            giajax.register(type(name, (giajax.mechanics.arm.AbstractDragLaw,), body))


def test_a_package_is_found_by_its_entry_point(monkeypatch):
    class Entry:
        def load(self):
            body = {"__module__": "law_package", "points": 0, "force": lambda self, stream: None}
            return type("Packaged", (giajax.mechanics.arm.AbstractDragLaw,), body)

    def entries(group, name):
        return [Entry()] if (group, name) == ("giajax.drags", "Packaged") else []

    monkeypatch.setattr("importlib.metadata.entry_points", entries)
    assert registered("loss", "Packaged") is None
    assert registered("drag", "Packaged").__module__ == "law_package"
    assert registered("drag", "Other") is None
