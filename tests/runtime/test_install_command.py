"""The command that installs a missing extra: from an index, or from the current checkout."""

import importlib.metadata
import json
import sys
from types import SimpleNamespace

import pytest

from giajax.runtime.text import install_command

pytestmark = pytest.mark.quick


def installed(monkeypatch, origin):
    """Simulate how giajax was installed; None means from an index."""
    text = None if origin is None else json.dumps(origin)
    known = SimpleNamespace(read_text=lambda name: text if name == "direct_url.json" else None)
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: known)


@pytest.mark.parametrize("editable", [True, False])
def test_from_a_checkout_it_is_by_its_folder(monkeypatch, tmp_path, editable):
    folder = tmp_path / "my work"
    folder.mkdir()
    origin = {"url": folder.as_uri(), "dir_info": {"editable": True} if editable else {}}
    installed(monkeypatch, origin)
    # The checkout no longer exists.
    assert install_command("ros") == "pip install 'giajax[ros]'"
    (folder / "pyproject.toml").write_text("")
    option = "-e " if editable else ""
    assert install_command("ros") == f"{sys.executable} -m pip install {option}'{folder}[ros]'"


@pytest.mark.parametrize(
    "origin",
    [None, {"url": "file:///tmp/giajax-0.1.0-py3-none-any.whl", "archive_info": {}}],
    ids=["index", "wheel"],
)
def test_else_it_is_by_its_name(monkeypatch, origin):
    installed(monkeypatch, origin)
    assert install_command("report") == "pip install 'giajax[report]'"


def test_where_nobody_knows_it_is_by_its_name(monkeypatch):
    def unknown(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", unknown)
    assert install_command("view") == "pip install 'giajax[view]'"
