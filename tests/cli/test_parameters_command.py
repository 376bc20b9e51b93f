"""`giajax parameters`: the parameter declarations as a table and as JSON."""

import io
import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from giajax import ArmModel, Definition, FitTask, InputError, declared, takeichi_20m
from giajax.cli import main
from giajax.schema.parameters import default_free, left_out

SYNTHETIC = Path(__file__).resolve().parents[2] / "data" / "synthetic"
MODEL = ArmModel(takeichi_20m())


def listed(capsys, *options):
    assert main(["parameters", "--json", *options]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    return {fact["path"]: fact for fact in json.loads(out)}


def test_the_table_has_a_row_for_every_declaration(capsys):
    assert main(["parameters"]) == 0
    heading, *rows = capsys.readouterr().out.splitlines()
    assert heading.split()[:4] == ["parameter", "unit", "value", "bounds"]
    known = {**declared(MODEL), **left_out(MODEL)}
    assert [row.split()[0] for row in rows] == list(known)
    for row, (path, parameter) in zip(rows, known.items(), strict=True):
        assert (" off " in row) == (not parameter.is_on(MODEL))
        declaration = parameter.declaration
        assert row.endswith(declaration.meaning), path
        assert f" {declaration.default:.10g} " in row
        assert ("free" in row.split()) == (not declaration.frozen)
        assert ("assumed" in row.split()) == declaration.assumed
        if np.isfinite(declaration.upper):
            assert f"{declaration.lower:g} to {declaration.upper:g}" in row


def test_on_a_terminal_it_is_text_without_codes(monkeypatch):
    """The content of a file must not control the terminal, so no output contains codes."""

    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr("sys.stdout", terminal)
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["parameters"]) == 0
    assert terminal.getvalue().split()[:4] == ["parameter", "unit", "value", "bounds"]
    assert "x1b" not in terminal.getvalue()


def test_json_says_what_is_declared(capsys):
    facts = listed(capsys)
    assert tuple(path for path, fact in facts.items() if fact["free"]) == default_free(MODEL)
    for path, parameter in declared(MODEL).items():
        declaration = parameter.declaration
        assert facts[path]["unit"] == declaration.unit
        assert facts[path]["meaning"] == declaration.meaning
        assert facts[path]["upper"] == (
            declaration.upper if np.isfinite(declaration.upper) else None
        )
        value = np.asarray(parameter.value(MODEL))
        assert facts[path]["elements"] == (None if value.ndim == 0 else value.size)
        # The default of the declaration equals the value in the preset.
        np.testing.assert_allclose(value, facts[path]["default"], rtol=1e-12)


def test_the_number_of_links_is_that_of_the_arrays(capsys):
    assert listed(capsys, "--links", "6")["links.mass"]["elements"] == 6


def test_an_arm_without_links(capsys):
    assert main(["parameters", "--links", "0"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert "arm.links = 0 must be a whole number from 1 to 1000" in err


def test_a_run_decides_the_model(capsys):
    folder = Path(__file__).parents[2] / "data" / "synthetic"
    joint = listed(capsys, "--data", str(folder / "joint.csv"))
    assert joint["geometry.wire_length"]["assumed"]
    assert joint["alpha.threshold"]["free"]
    muscle = listed(capsys, "--data", str(folder / "muscle.csv"))
    assert muscle["friction.half_width"]["elements"] == 1
    assert main(["parameters", "--data", str(folder / "none.csv")]) == 2
    assert "does not exist" in capsys.readouterr().err


def test_units_of_a_loop_are_those_of_its_columns_in_si(capsys, tmp_path):
    path = tmp_path / "loop.csv"
    path.write_text("input_kPa,output_mm\n0,0\n100,2\n50,1.5\n")
    path.with_suffix(".toml").write_text('model = "hysteresis"\n')
    facts = listed(capsys, "--data", str(path))
    # The listed values can be used with --start and --fix.
    assert facts["thresholds"]["value"][-1] == pytest.approx(100e3 / 2 * 10 / 11)
    units = {name: facts[name]["unit"] for name in ("thresholds", "elastic", "offset")}
    assert units == {"thresholds": "Pa", "elastic": "m/Pa", "offset": "m"}
    path.write_text("command_deg,angle_deg\n0,0\n10,2\n5,1.5\n")
    facts = listed(capsys, "--data", str(path))
    assert (facts["thresholds"]["unit"], facts["elastic"]["unit"]) == ("rad", "")


def test_what_an_arm_file_or_preset_switches_on_is_on(capsys, tmp_path):
    plain = listed(capsys)
    assert not plain["air.added_mass_coefficient"]["on"]
    assert plain["air.added_mass_coefficient"]["default"] == 1.0
    assert plain["camera.origin"]["elements"] == 3
    assert listed(capsys, "--preset", "takeichi_20m_full")["air.added_mass_coefficient"]["on"]
    path = tmp_path / "arm.toml"
    path.write_text("[arm]\nlinks = 3\n[sensors]\ncamera_scale = 1.1\n")
    assert listed(capsys, "--arm", str(path), "--preset", "takeichi_20m")["camera.scale"]["on"]
    assert main(["parameters", "--json", "--arm", str(path)]) == 0
    out, err = capsys.readouterr()
    mine = {fact["path"]: fact for fact in json.loads(out)}
    assert "[arm] names no preset: the constants of the preset takeichi_20m are assumed" in err
    assert mine["camera.scale"]["on"]
    assert mine["links.mass"]["elements"] == 3
    assert main(["parameters", "--preset", "none"]) == 2
    assert "no arm preset 'none'" in capsys.readouterr().err
    assert main(["parameters", "--preset", "chain", "--links", "2"]) == 2
    assert "lacks links.length (link_length_m), links.diam" in capsys.readouterr().err


RUN = """\
time_s,joint01_command_deg,link03_z_m
0,0,0.1
0.1,30,
0.2,30,-0.3
"""
SIDECAR = """
[arm]
links = 4
link_mass_kg = [0.06, 0.05, 0.04, 0.03]
link_length_m = 0.8
gravity_m_per_s2 = 9.81
[arm.parameters]
"joints.damping" = 0.125
"air.added_mass_coefficient" = 0.9
[sensors]
camera_origin_m = [0.0, 0.25, 0.0]
"""


def test_a_run_shows_the_values_of_its_sidecar(capsys, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(RUN)
    path.with_suffix(".toml").write_text(SIDECAR)
    facts = listed(capsys, "--data", str(path))
    expected = {
        "links.mass": [0.06, 0.05, 0.04, 0.03],
        "links.length": [0.8] * 4,
        "gravity": 9.81,
        "joints.damping": 0.125,
        "air.added_mass_coefficient": 0.9,
        "camera.origin": [0.0, 0.25, 0.0],
        "air.drag_coefficient": 1.2,
        "camera.scale": None,
    }
    assert {name: facts[name]["value"] for name in expected} == expected
    assert facts["joints.damping"]["default"] == 0.05
    assert main(["parameters", "--data", str(path)]) == 0
    rows = {row.split()[0]: row for row in capsys.readouterr().out.splitlines()}
    for name, value in {
        "links.mass": "0.03 to 0.06", "links.length": "0.8", "gravity": "9.81",
        "joints.damping": "0.125", "camera.origin": "0, 0.25, 0", "camera.scale": "1",
    }.items():  # fmt: skip
        assert f"  {value}  " in rows[name]


def test_a_run_of_another_kind_shows_the_values_of_its_sidecar(capsys, tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("angle_deg,side,force_N\n1,inner,1\n")
    path.with_suffix(".toml").write_text("[joint]\nwire_length_m = 0.36\n")
    facts = listed(capsys, "--data", str(path))
    assert facts["geometry.wire_length"]["value"] == 0.36
    assert facts["geometry.wire_length"]["default"] == 0.34


# Further settings that each parameter requires, as the error says.
NEED_MORE = {
    "joints.memory.nu": "choose a value strictly between 1 and 20",  # its default is a bound
    "air.axial_coefficient": "use drag = 'strip'",
}


@pytest.mark.parametrize("name", ["base_step", "joint", "muscle", "joint_loops", "pixels_side"])
def test_each_name_of_the_table_can_be_pasted_behind_free(capsys, name):
    run = str(SYNTHETIC / f"{name}.csv")
    assert main(["parameters", "--data", run]) == 0
    paths = [line.split()[0] for line in capsys.readouterr().out.splitlines()[1:]]
    assert len(paths) > 3
    for path in paths:
        assert shlex.split(path) == [path]
        task = FitTask(Definition()).on_top(data=[run], free=[path], origin="the test")
        if path in NEED_MORE:
            with pytest.raises(InputError, match=NEED_MORE[path]):
                task.prepare()
        else:
            fitted = [each.path.partition("[")[0] for each in task.prepare().setup.parameters]
            assert path in fitted
