"""`giajax cache`: what is kept, and its end."""

import pytest

from giajax.cli import main

pytestmark = pytest.mark.quick


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    programs = tmp_path / "giajax" / "programs"
    programs.mkdir(parents=True)
    (programs / "step-1.stablehlo").write_bytes(bytes(1_500_000))
    (tmp_path / "giajax" / "jit_step-cache").write_bytes(b"")
    (tmp_path / "giajax" / "of another").write_bytes(b"")
    return tmp_path / "giajax"


def test_it_says_what_is_there(folder, capsys):
    assert main(["cache"]) == 0
    shown = capsys.readouterr().out
    assert str(folder) in shown
    assert shown.split()[-6:] == ["traced", "1", "1.5", "compiled", "1", "0.0"]


def test_it_clears_what_giajax_wrote(folder, capsys):
    assert main(["cache", "--clear"]) == 0
    assert "removed 2 of 2 programs" in capsys.readouterr().out
    assert {path.name for path in folder.rglob("*")} == {"programs", "of another"}


def test_a_cache_that_others_share_keeps_their_programs(folder, monkeypatch, capsys):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(folder))
    assert main(["cache", "--clear"]) == 0
    assert "removed 1 of 2 programs" in capsys.readouterr().out
    assert (folder / "jit_step-cache").exists()


def test_there_may_be_none(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("")
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert main(["cache"]) == 0
    assert "nothing is kept" in capsys.readouterr().out
