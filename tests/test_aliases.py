"""Former names still work, name their replacement, and are listed on a page."""

import importlib
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import giajax
from giajax.runtime.aliases import MOVED, RENAMED, UNTIL

pytestmark = pytest.mark.quick

PAGE = (Path(__file__).resolve().parents[1] / "docs" / "migration.md").read_text(encoding="utf-8")

# One public name of each module of version 0.1.
NAMES = {
    "arm": "chain", "control": "Compensator", "design": "Limits", "diagnosis": "suspects",
    "driving": "Cockpit", "execution": "Task", "experiments": "figure_12", "filling": "fill",
    "hysteresis": "BoucWen", "joint": "JointPair", "kinds": "KINDS", "mission": "Mission",
    "obstacles": "Lines", "paper": "reproduce", "parameters": "replace", "quantities": "Prior",
    "repetitions": "bootstrap", "runs": "read_run", "study": "profile", "sweeping": "sweep",
    "synthetic": "gusts", "verdict": "Verdict", "viewer": "Viewer", "wind": "fit_wind",
}  # fmt: skip


@pytest.mark.parametrize("name", MOVED)
def test_a_module_that_has_moved_warns_and_has_its_names(name, monkeypatch):
    monkeypatch.delitem(sys.modules, f"giajax.{name}", raising=False)
    with pytest.warns(DeprecationWarning, match=f"giajax.{name} is now giajax.*until {UNTIL}"):
        module = importlib.import_module(f"giajax.{name}")
    places = [importlib.import_module(f"giajax.{place}") for place in MOVED[name]]
    wanted = NAMES[name]
    assert any(getattr(module, wanted) is getattr(place, wanted, None) for place in places)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        module.nothing  # noqa: B018


def test_it_is_found_as_an_attribute_and_by_its_names(monkeypatch):
    for name in ("study", "runs"):
        monkeypatch.delitem(sys.modules, f"giajax.{name}", raising=False)
        # Without accessing the attribute, which would import it.
        monkeypatch.delitem(vars(giajax), name, raising=False)
    with pytest.warns(DeprecationWarning, match=r"giajax\.study is now giajax\.studies"):
        assert giajax.study.profile is giajax.profile
    with pytest.warns(DeprecationWarning, match="is now giajax.recordings") as told:
        from giajax.runs import read_run
    assert told[0].filename == __file__
    assert read_run is giajax.read_run


@pytest.mark.parametrize("room", RENAMED)
def test_a_name_that_has_moved_or_changed_warns(room):
    with warnings.catch_warnings():
        # The module of the name has moved, too.
        warnings.simplefilter("ignore", DeprecationWarning)
        module = importlib.import_module(f"giajax.{room}".rstrip("."))
    for before, now in RENAMED[room].items():
        with pytest.warns(DeprecationWarning, match=f"{room}.{before} is now giajax.{now}") as told:
            found = getattr(module, before)
        assert told[0].filename == __file__
        where, _, name = now.rpartition(".")
        assert found is getattr(importlib.import_module(f"giajax.{where}"), name)


def test_the_page_has_all_of_them():
    assert UNTIL in PAGE
    for name, places in MOVED.items():
        assert f"| `giajax.{name}` | {', '.join(f'`giajax.{place}`' for place in places)} |" in PAGE
    for room, names in RENAMED.items():
        for before, now in names.items():
            earlier = f"`giajax.{room}.{before}`".replace("..", ".")
            assert earlier in PAGE or f"`{before}`" in PAGE, before
            assert now.rpartition(".")[2] in PAGE


def test_a_name_that_never_was_is_no_module():
    code = "import giajax\ntry: import giajax.nothing\nexcept ModuleNotFoundError: print('none')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ended.stdout == "none\n"
