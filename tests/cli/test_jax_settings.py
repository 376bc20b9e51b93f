"""JAX settings of the command line: 64-bit arithmetic, and a compilation cache per user."""

import os
import subprocess
import sys

import pytest

from giajax.runtime.process import cache_directory

pytestmark = pytest.mark.quick


def test_the_cache_is_where_the_user_keeps_caches(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_directory() == tmp_path / "caches" / "giajax"
    assert cache_directory().is_dir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    for ignored in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", ignored)
        assert cache_directory() == tmp_path / "home" / ".cache" / "giajax"


def test_there_is_no_cache_where_none_can_be(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert cache_directory() is None


@pytest.mark.parametrize("chosen", [None, "chosen"])
def test_configure(tmp_path, chosen):
    code = (
        "from giajax.runtime.process import configure; import jax; configure(); "
        "print(jax.config.jax_enable_x64, jax.config.jax_compilation_cache_dir)"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    if chosen is not None:
        environment["JAX_COMPILATION_CACHE_DIR"] = str(tmp_path / chosen)
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment
    )
    assert done.stdout.split() == ["True", str(tmp_path / (chosen or "giajax"))]
    assert (tmp_path / "giajax").exists() == (chosen is None)
