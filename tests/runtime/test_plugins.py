"""Plug-ins: files that register what is not in the package."""

import importlib
import sys

import pytest

import giajax
from giajax import InputError
from giajax.runtime.plugins import checksum, load_plugin, plugins, registered, sources_of
from giajax.runtime.programs import content, structure

pytestmark = pytest.mark.quick

LAW = """
import giajax
from giajax.mechanics.arm import AbstractDragLaw

@giajax.register
class {name}(AbstractDragLaw):
    points: int = 0

    def force(self, stream):
        return -{factor} * stream.velocity
"""


def test_an_edited_plug_in_is_another_program_and_another_task(tmp_path):
    path = tmp_path / "edited_law.py"
    texts = []
    for factor in (1.0, 1.0, 2.0):
        path.write_text(LAW.format(name="EditedLaw", factor=factor))
        # As a new process would.
        sys.modules.pop("edited_law", None)
        plugins_of = importlib.import_module("giajax.runtime.plugins")
        plugins_of._PLUGINS.clear()
        checksum.cache_clear()
        load_plugin(path)
        law = registered("drag", "EditedLaw")()
        texts.append((structure(law), content(law)))
        assert list(sources_of(type(law))) == ["edited_law.py"]
    assert texts[0] == texts[1]
    assert texts[0][0] != texts[2][0]
    assert texts[0][1] != texts[2][1]
    assert plugins() == (path,)


def test_code_of_giajax_and_of_libraries_has_no_sum():
    assert checksum("giajax.models._arm") == checksum("numpy") == checksum("json") == ""
    assert checksum("nowhere") == ""
    assert checksum(__name__) != ""


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("law.txt", "", "is no plug-in: give a Python file"),
        ("my-law.py", "", "is no plug-in"),
        ("absent_law.py", None, "there is no plug-in .*absent_law.py: correct the path"),
        ("json.py", "", "is called as the module 'json': give it another name"),
        ("wrong_law.py", "1 / 0", r"cannot be imported \(ZeroDivisionError: division by zero\)"),
        ("wrong_words.py", "def", r"cannot be imported \(SyntaxError"),
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
    with pytest.raises(InputError, match="int is of no class that giajax takes: derive it"):
        giajax.register(int)

    def made(module):
        body = {"__module__": module, "points": 0, "force": lambda self, stream: None}
        return type("Twice", (giajax.mechanics.arm.AbstractDragLaw,), body)

    first = giajax.register(made("one"))
    assert registered("drag", "Twice") is first
    # A cell of a notebook that is run again.
    second = giajax.register(made("one"))
    assert registered("drag", "Twice") is second
    with pytest.raises(InputError, match="there is a drag 'Twice' of one already: give two's"):
        giajax.register(made("two"))


def test_a_package_is_found_by_its_entry_point(monkeypatch):
    class Entry:
        def load(self):
            body = {"__module__": "law_package", "points": 0, "force": lambda self, stream: None}
            return type("Packaged", (giajax.mechanics.arm.AbstractDragLaw,), body)

    def entries(group, name):
        return [Entry()] if (group, name) == ("giajax.drags", "Packaged") else []

    monkeypatch.setattr("giajax.runtime.plugins.entry_points", entries)
    assert registered("drag", "Packaged").__module__ == "law_package"
    assert registered("drag", "Other") is None
