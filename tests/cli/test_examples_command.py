"""`giajax examples`: the list of the examples, and a copy of them."""

from pathlib import Path

import pytest

from giajax.cli import _data as _examples, main
from giajax.recordings import Definition, read_run

pytestmark = pytest.mark.quick

ROOT = Path(__file__).parents[2]


def names(folder, pattern):
    return sorted(path.relative_to(folder).as_posix() for path in folder.glob(pattern))


def test_everything_that_ships_is_listed(capsys):
    assert main(["examples"]) == 0
    lines = capsys.readouterr().out.splitlines()
    listed = {line.split()[0] for line in lines if line}
    shipped = ("fits/*.toml", "missions/*.toml", "data/synthetic/*.csv")
    assert {name for pattern in shipped for name in names(ROOT, pattern)} <= listed
    line = next(line for line in lines if line.startswith("fits/base_step.toml"))
    assert "air.drag_coefficient" in line
    assert "base_step.csv" in line


def test_a_copy_can_be_read_and_is_complete(tmp_path, capsys):
    target = tmp_path / "new" / "work"
    assert main(["examples", "--copy", str(target)]) == 0
    assert str(target) in capsys.readouterr().out
    data = ("data/synthetic/*.csv", "data/synthetic/inputs/*.csv")
    for pattern in ("fits/*.toml", "missions/*.toml", *data):
        assert names(target, pattern) == names(ROOT, pattern) != []
    assert names(target, "data/recorded/*/LICENSE") == names(ROOT, "data/recorded/*/LICENSE") != []
    assert names(target, "**/*.py") == []
    for path in (target / "fits").glob("*.toml"):
        definition = Definition.load(path)
        for name in definition.fit.data:
            run = read_run(path.parent / name, definition=definition)
            assert run.definition.sha256 is not None or "recorded" in name


def test_nothing_is_written_over_without_force(tmp_path, capsys):
    kept = tmp_path / "fits" / "wind.toml"
    kept.parent.mkdir()
    kept.write_text("mine")
    assert main(["examples", "--copy", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "wind.toml exists" in err
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [kept]
    assert kept.read_text() == "mine"
    assert main(["examples", "--copy", str(tmp_path), "--force"]) == 0
    assert kept.read_text() == (ROOT / "fits" / "wind.toml").read_text()


def test_a_folder_that_is_a_file(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["examples", "--copy", str(tmp_path / "file")]) == 2
    assert (
        "is a file, but the output must be a folder: give another name" in capsys.readouterr().err
    )


def test_an_installed_package_has_them_inside(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "giajax"
    package.mkdir(parents=True)
    monkeypatch.setattr("importlib.resources.files", lambda _: package)
    with pytest.raises(ValueError, match="not part of this installation"):
        _examples.examples_root()
    for folder in _examples._FOLDERS:
        (package / "_examples" / folder).mkdir(parents=True)
    assert _examples.examples_root() == package / "_examples"
