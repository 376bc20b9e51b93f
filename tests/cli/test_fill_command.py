"""`giajax fill`: tables, files and figures of a filling."""

import csv
import json

import numpy as np
import pytest

from giajax.cli import main

DEFINITION = """
[arm]
links = 3

[filling]
supply = "regulator"
supply_pressure_bar = 1.5
port_diameter_mm = [8.0, 9.0]
"""


def refused(capsys, arguments, sentence):
    assert main(["fill", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_it_writes_what_it_says(tmp_path, capsys):
    (tmp_path / "three.toml").write_text(DEFINITION)
    out = tmp_path / "new" / "out"
    command = ["fill", str(tmp_path / "three.toml"), "--minutes", "4", "--out", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    names = {
        "filling.json",
        "filling.csv",
        "filling.png",
        "inflation.toml",
        "curve.csv",
        "curve.png",
    }
    assert {path.name for path in out.iterdir()} == names
    assert all(name in printed for name in names)
    for name in ("filling.png", "curve.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")
    facts = json.loads((out / "filling.json").read_text())
    assert facts["finished"]
    assert facts["filling"]["port_diameter_mm"] == [8.0, 9.0]
    assert facts["imbalance"] < 1e-10
    assert "note: 3 of 3 links withstand less than the 50.1 N" in printed
    assert facts["collapse"] in printed
    assert f"full after {facts['duration_s'] / 60:.2f} min" in printed
    assert facts["links"]["link03"]["full_s"] == facts["duration_s"]
    assert facts["links"]["link01"]["lift_off_s"] < facts["arm_lift_off_s"] < facts["duration_s"]
    with (out / "filling.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["time_s"]) == pytest.approx(facts["duration_s"])
    assert float(rows[-1]["link03_fullness"]) == pytest.approx(1, abs=1e-3)
    assert float(rows[0]["link01_fullness"]) == 0
    with (out / "curve.csv").open() as file:
        curve = list(csv.DictReader(file))
    flows = [float(row["supply_flow_l_per_min"]) for row in curve]
    diameters = [float(row["port_diameter_mm"]) for row in curve]
    # Three links of 70 l in four minutes. A narrower port needs a larger supply.
    assert flows[-1] == pytest.approx(3 * np.pi * 0.15**2 * 0.99 / 4 * 1e3, rel=0.01)
    assert np.all(np.diff(flows) < 0)
    assert np.all(np.diff(diameters) > 0)
    assert facts["curve"]["supply"] == "supply.pressure"
    refused(capsys, command[1:], "exists and is not overwritten")


def test_options_change_what_is_printed(tmp_path, capsys):
    (tmp_path / "three.toml").write_text(DEFINITION)
    command = ["fill", str(tmp_path / "three.toml"), "--no-curve"]
    assert main([*command, "--json"]) == 0
    usual = json.loads(capsys.readouterr().out)
    assert "curve" not in usual
    assert main([*command, "--json", "--set", "supply.pressure=6e5"]) == 0
    quicker = json.loads(capsys.readouterr().out)
    assert quicker["duration_s"] < 0.6 * usual["duration_s"]
    assert main([*command, "--set", "links.mass=1"]) == 0
    assert "the lift is too small to carry the arm" in capsys.readouterr().out


def test_a_supply_that_is_too_weak_is_said(tmp_path, capsys):
    (tmp_path / "little.toml").write_text(DEFINITION.replace("1.5", "1e-9"))
    assert main(["fill", str(tmp_path / "little.toml"), "--no-curve"]) == 0
    assert "not full after 360 min: the supply is too weak or holds too" in capsys.readouterr().out


BAD = {
    "unknown key": ("port_diametre_mm = 8.0", "unknown key filling.port_diametre_mm: did you mean"),
    "no number": ("port_diameter_mm = 'wide'", "must be a positive number or a list of them"),
    "negative": ("supply_flow_l_per_min = -1.0", "= -1.0 must be a positive number"),
    "too large": ("skin_slack = 0.5", "= 0.5 must be a number between 0 and 0.1"),
    "no supply": ('supply = "pump"', 'must be "flow", "regulator" or "bottle"'),
    "not neighbours": ("shared = [[1, 3]]", "the links [1, 3] share a bag, but must be neighbours"),
    "no such link": ("shared = [[20, 21]]", "but the arm has only 20 links: correct the number"),
    "link zero": ("shared = [[0, 1]]", "must be a list of lists of link numbers"),
    "too many ports": ("port_diameter_mm = [8.0, 9.0]", "the ports have 2 values of diameter, but"),
}


@pytest.mark.quick
@pytest.mark.parametrize("case", BAD)
def test_a_bad_definition_is_one_sentence(case, tmp_path, capsys):
    text, sentence = BAD[case]
    path = tmp_path / "bad.toml"
    path.write_text(f"[filling]\n{text}\n")
    refused(capsys, [path], sentence)


def test_bad_options_are_one_sentence(tmp_path, capsys):
    refused(capsys, [tmp_path / "none.toml"], "does not exist: give the path of a TOML file")
    refused(capsys, ["--minutes", "0"], "--minutes is 0: give a positive number")
    refused(capsys, ["--minutes", "1e300"], "--minutes is 1e+300: give a positive number of at mo")
    refused(capsys, ["--set", "ports.diametre=1"], "there is no parameter 'ports.diametre'")
    refused(capsys, ["--set", "supply.flow=-1"], "supply.flow = -1 m^3/s is outside its bounds")
    refused(capsys, ["--set", "supply.flow=0"], "supply.flow = 0 m^3/s is outside its bounds")
    (tmp_path / "file").write_text("")
    refused(capsys, ["--out", tmp_path / "file"], "is a file")
