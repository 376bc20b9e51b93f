"""`giajax cache`: the contents of the cache, and its removal."""

import os
import subprocess
import sys

import pytest

from giajax.cli import main
from giajax.runtime import process

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
    assert "compiled programs are not kept" in capsys.readouterr().out


CONFIGURE = (
    "import os, sys; os.umask(0o022); import giajax.runtime.process as p; p.own_process(); "
    "p.configure(); import jax; from giajax.runtime.programs import caches_programs; "
    "print(jax.config.jax_compilation_cache_dir, caches_programs())"
)


def configured(**variables):
    """Return the cache settings of a process of the command line, and its messages."""
    environment = {**os.environ, **{name: str(value) for name, value in variables.items()}}
    if "XDG_CACHE_HOME" in variables:
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", CONFIGURE], capture_output=True, text=True, check=True,
        env=environment,
    )  # fmt: skip
    return done.stdout.split(), done.stderr


@pytest.mark.skipif(os.name != "posix", reason="of POSIX permissions")
@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "JAX_COMPILATION_CACHE_DIR"])
def test_a_folder_of_programs_is_this_accounts_own(tmp_path, variable):
    home = tmp_path / "caches"
    folder = home / "giajax" if variable == "XDG_CACHE_HOME" else home
    assert configured(**{variable: home}) == ([str(folder), "True"], "")
    assert folder.stat().st_mode & 0o777 == 0o700
    assert process.is_private(folder)
    folder.chmod(0o755)  # permissions of an earlier version
    assert process.is_private(folder)
    wrong = folder
    if variable == "XDG_CACHE_HOME":
        wrong = folder / "programs"
        wrong.mkdir()
    for mode in (0o777, 0o775, 0o1777):
        wrong.chmod(mode)
        assert not process.is_private(wrong)
    found, said = configured(**{variable: home})
    assert found == ["None", "False"]
    assert said.startswith(f"giajax: {wrong} can be written by other accounts, belongs to another")
    assert said.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="of POSIX permissions")
def test_a_folder_that_nobody_may_look_at_is_not_used(tmp_path):
    assert process.is_private(tmp_path / "none")  # the folder is created
    (tmp_path / "file").write_text("")
    closed = tmp_path / "file" / "cache"  # like a parent that cannot be entered
    assert not process.is_private(closed)
    found, said = configured(JAX_COMPILATION_CACHE_DIR=closed)
    assert found == ["None", "False"]
    assert said.count("\n") == 1
    assert "cannot be entered" in said


@pytest.mark.skipif(getattr(os, "geteuid", lambda: 1)() != 0, reason="only root gives files away")
def test_a_folder_of_another_account_is_not_used(tmp_path):
    os.chown(tmp_path, 12345, -1)
    found, said = configured(JAX_COMPILATION_CACHE_DIR=tmp_path)
    assert found == ["None", "False"]
    assert "belongs to another" in said


COMPILE = (
    "import warnings, giajax.runtime.process as p; p.own_process(); p.configure(); import jax\n"
    "for power in (2, 3): print(jax.jit(lambda x: x**power)(3.0))\n"
    "warnings.warn('something else')"
)


def test_a_damaged_cache_is_one_sentence(tmp_path):
    environment = {
        "JAX_COMPILATION_CACHE_DIR": str(tmp_path),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "0",
    }

    def compiled():
        ended = subprocess.run(
            [sys.executable, "-c", COMPILE], capture_output=True, text=True, check=True,
            env={**os.environ, **environment},
        )  # fmt: skip
        assert ended.stdout.split() == ["9.0", "27.0"]
        *said, other = ended.stderr.splitlines()
        assert other.endswith("UserWarning: something else")
        return said

    assert compiled() == []
    entries = list(tmp_path.glob("jit_*-cache"))
    assert len(entries) >= 2
    for entry in entries:
        entry.write_bytes(b"damaged")
    (said,) = compiled()
    assert said.startswith(f"giajax: compiled programs in {tmp_path} cannot be read or written (")
    assert said.endswith("so programs are compiled again: see 'giajax cache'")
