"""`giajax init`: a sidecar that the user completes."""

import pytest

from giajax.cli import main
from giajax.recordings import Definition, read_run

pytestmark = pytest.mark.quick

CSV = "time_s,joint01_command_deg,link06_z_m\n0,0,0.1\n0.1,30,\n0.2,30,-0.3\n"


@pytest.fixture
def run(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(CSV)
    return path


def test_init_writes_a_sidecar_that_is_read(run, capsys):
    assert main(["init", "--data", str(run)]) == 0
    sidecar = run.with_suffix(".toml")
    assert str(sidecar) in capsys.readouterr().out
    assert Definition.load(sidecar).sha256 == read_run(run).sha256
    text = sidecar.read_text()
    for line in [
        'model = "arm"',
        'preset = "takeichi_20m"',
        "# link_mass_kg = 0.047",
        '# interpolation = "linear"',
        "# position_m = 0.01",
        "# link06_z_m = 0.01",
    ]:
        assert f"\n{line}" in text


def test_init_writes_over_a_sidecar_only_by_force(run, capsys):
    sidecar = run.with_suffix(".toml")
    sidecar.write_text("broken")
    assert main(["init", "--data", str(run)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "run.toml exists" in err
    assert sidecar.read_text() == "broken"
    assert main(["init", "--data", str(run), "--force"]) == 0
    assert Definition.load(sidecar).model == "arm"


def test_init_of_foreign_names(run, capsys):
    run.write_text(CSV.replace("link06_z_m", "z"))
    assert main(["init", "--data", str(run)]) == 2
    assert "'z' is not in the column table" in capsys.readouterr().err
    assert not run.with_suffix(".toml").exists()
    assert main(["init", "--data", str(run), "--rename", "z=tip_z_m"]) == 0
    assert "# tip_z_m = 0.01" in run.with_suffix(".toml").read_text()


def test_init_needs_a_file_that_is_there(tmp_path, capsys):
    assert main(["init", "--data", str(tmp_path / "none.csv")]) == 2
    assert "does not exist" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
