"""`giajax unroll`: the table, files and figure of an unrolling."""

import csv
import json

import pytest

from giajax.cli import main

DEFINITION = """
[arm]
links = 3

[filling]
supply_flow_l_per_min = 60.0

[unrolling]
order = "by gas"
roll_radius_mm = 60.0
"""


def refused(capsys, arguments, sentence):
    assert main(["unroll", *map(str, arguments)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_it_writes_what_it_says(tmp_path, capsys):
    (tmp_path / "three.toml").write_text(DEFINITION)
    out = tmp_path / "new" / "out"
    command = ["unroll", str(tmp_path / "three.toml"), "--out", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    names = {f"{of}.{kind}" for of in ("unrolling", "filling") for kind in ("json", "csv", "png")}
    names.add("inflation.toml")
    assert {path.name for path in out.iterdir()} == names
    assert all(name in printed for name in names)
    assert (out / "unrolling.png").read_bytes().startswith(b"\x89PNG")
    facts = json.loads((out / "unrolling.json").read_text())
    assert facts["finished"]
    assert facts["unrolling"]["order"] == "by gas"
    assert facts["unrolling"]["roll_radius_mm"] == 60.0
    assert facts["filling"]["supply_flow_l_per_min"] == pytest.approx(60)
    assert facts["imbalance"] < 1e-10
    assert facts["energy_imbalance_J"] < 1e-7
    assert facts["paid_out_m"] == pytest.approx(2.97)
    assert f"unrolled after {facts['unrolled_s'] / 60:.2f} min" in printed
    assert f"full after {facts['duration_s'] / 60:.2f} min" in printed
    assert f"lifts itself after {facts['arm_lift_off_s'] / 60:.2f} min" in printed
    assert facts["links"]["link03"]["full_s"] == pytest.approx(facts["duration_s"])
    with (out / "unrolling.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["paid_out_m"]) == pytest.approx(0.1)
    assert float(rows[-1]["time_s"]) == pytest.approx(facts["unrolled_s"])
    assert float(rows[-1]["gas_work_J"]) == pytest.approx(facts["works_J"]["gas"])
    assert float(rows[-1]["radius_m"]) == pytest.approx(0.05)
    with (out / "filling.csv").open() as file:
        filled = next(csv.DictReader(file))
    assert float(filled["supplied_kg"]) == pytest.approx(facts["gas_kg"])
    refused(capsys, command[1:], "exists and is not overwritten")


def test_options_change_what_is_printed(tmp_path, capsys):
    (tmp_path / "three.toml").write_text("[arm]\nlinks = 3\n")
    command = ["unroll", str(tmp_path / "three.toml")]
    assert main([*command, "--json"]) == 0
    usual = json.loads(capsys.readouterr().out)
    assert usual["unrolling"]["order"] == "roll first"
    assert usual["unrolled_s"] == pytest.approx((2.97 - 0.1) / 0.1)
    assert main([*command, "--json", "--set", "hand.speed=0.2"]) == 0
    assert json.loads(capsys.readouterr().out)["unrolled_s"] == pytest.approx(2.87 / 0.2)
    assert main([*command, "--json", "--by-gas"]) == 0
    assert json.loads(capsys.readouterr().out)["unrolling"]["order"] == "by gas"
    assert main([*command, "--set", "links.mass=1"]) == 0
    assert "the lift is too small to carry the arm" in capsys.readouterr().out


def test_what_is_too_weak_is_said(tmp_path, capsys):
    weak = '[arm]\nlinks = 3\n[unrolling]\nhand = "force"\nhand_force_N = 0.1\n'
    (tmp_path / "weak.toml").write_text(weak)
    out = tmp_path / "out"
    assert main(["unroll", str(tmp_path / "weak.toml"), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "not fully unrolled after 360 min (unrolled length " in printed
    assert "the hand is too weak" in printed
    assert {path.suffix for path in out.iterdir()} == {".json", ".csv", ".png"}
    assert len(list(out.iterdir())) == 3
    assert json.loads((out / "unrolling.json").read_text())["unrolled_s"] is None


BAD = {
    "unknown key": ("roll_radius_m = 8.0", "unknown key unrolling.roll_radius_m: did you mean"),
    "no number": ("roll_radius_mm = 'wide'", "must be a positive number"),
    "negative": ("peel_force_N = -1.0", "= -1.0 must be zero or a positive number"),
    "too large": ("film_creep = 2.0", "= 2.0 must be a number from 0 to 1"),
    "no order": ('order = "both"', 'must be "roll first" or "by gas"'),
    "no hand": ('hand = "foot"', 'must be "speed" or "force"'),
    "no yes": ("carried = 1", "must be true or false"),
    "a small roll": (
        "roll_radius_mm = 40.0",
        "the radius of the roll is 40 mm, but its core has a radius",
    ),
    "thick film": (
        "film_thickness_mm = 2.0",
        "a layer of the roll is only 1.19 mm thick, but two film",
    ),
    "paid out": ("start_length_m = 30.0", "30 m are paid out at the start, but the arm is only"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_definition_is_one_sentence(case, tmp_path, capsys):
    text, sentence = BAD[case]
    path = tmp_path / "bad.toml"
    path.write_text(f"[unrolling]\n{text}\n")
    refused(capsys, [path], sentence)


def test_bad_options_are_one_sentence(tmp_path, capsys):
    refused(capsys, [tmp_path / "none.toml"], "does not exist: give the path of a TOML file")
    refused(capsys, ["--set", "roll.radios=1"], "there is no parameter 'roll.radios'")
    refused(capsys, ["--set", "film.peel=-1"], "film.peel = -1 N is outside its bounds")
    refused(
        capsys,
        ["--by-gas", "--set", "supply.flow=0"],
        "the arm is set to unroll by gas, but no gas flows with supply",
    )
    (tmp_path / "file").write_text("")
    refused(capsys, ["--out", tmp_path / "file"], "is a file")
