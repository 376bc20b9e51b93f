"""`giajax compensate`, `choose` and `hysteresis`, and a fit of a hysteresis run."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from giajax import fit, model_for, predict, read_run
from giajax.apps.control import compensator_for_loop
from giajax.cli import main

LOOPS = "data/synthetic/joint_loops.csv"


@pytest.fixture(scope="module")
def fitted(request, tmp_path_factory):
    run = read_run(request.config.rootpath / LOOPS)
    folder = tmp_path_factory.mktemp("fit")
    (folder / "result.json").write_text(fit(model_for([run]), run).to_json())
    return folder


@pytest.fixture
def loops(request):
    return str(request.config.rootpath / LOOPS)


def target_file(path, angles):
    rows = [f"{5 * k},{angle:g}" for k, angle in enumerate(angles)]
    path.write_text("\n".join(["time_s,angle_deg", *rows]) + "\n")
    return str(path)


ANGLES = [*range(0, 31, 2), *range(30, -21, -2), *range(-20, 11, 2)]


def test_commands_take_the_fitted_joint_to_its_target(fitted, tmp_path, capsys):
    target = target_file(tmp_path / "target.csv", ANGLES)
    out = tmp_path / "command.csv"
    arguments = ["compensate", str(fitted), "--target", target, "--to", str(out)]
    assert main(arguments) == 0
    assert "commands from" in capsys.readouterr().out
    run = read_run(out)
    assert list(run.commands) == ["command"]
    assert run.channels["command"].unit == "deg"
    np.testing.assert_allclose(np.rad2deg(run.values["angle"]), ANGLES, atol=1e-6)
    assert np.max(np.abs(run.values["command"] - run.values["angle"])) > 0.05
    from giajax import load_result

    again = predict(load_result(fitted).model, run)["angle"]
    np.testing.assert_allclose(np.rad2deg(again), ANGLES, atol=1e-5)
    # No file is overwritten.
    assert main(arguments) == 2
    assert main([*arguments, "--force"]) == 0


def test_eq_12_from_a_loop(loops, tmp_path):
    target = target_file(tmp_path / "target.csv", ANGLES)
    out = tmp_path / "command.csv"
    arguments = ["compensate", "--loop", loops, "--travel", "10", "--target", target]
    assert main([*arguments, "--to", str(out)]) == 0
    run = read_run(out)
    assert not run.observations
    expected = compensator_for_loop(read_run(loops), np.deg2rad(10)).commands(np.deg2rad(ANGLES))
    np.testing.assert_allclose(run.values["command"], expected, atol=1e-6)


def test_a_prediction_is_a_run_of_the_same_operator(loops, tmp_path):
    assert main(["fit", "--data", loops, "--out", str(tmp_path / "fit"), "--quiet"]) == 0
    run = read_run(tmp_path / "fit" / "prediction.csv")
    stated = run.definition.hysteresis
    assert stated.operator == "prandtl_ishlinskii"
    assert stated.thresholds == read_run(loops).definition.hysteresis.thresholds
    # A fit of the prediction, which has no noise, reproduces it.
    again = fit(model_for([run]), run, check=False)
    assert again.runs[0].channels["angle"].rmse < 1e-3


def test_a_sidecar_offers_the_operators(tmp_path, capsys):
    path = tmp_path / "loops.csv"
    path.write_text("time_s,command_deg,angle_deg\n0,0,0\n1,9,5\n2,0,3\n")
    assert main(["init", "--data", str(path)]) == 0
    text = (tmp_path / "loops.toml").read_text()
    assert "[hysteresis]" in text
    assert '# operator = "prandtl_ishlinskii"' in text
    assert "# rows = 40" in text
    capsys.readouterr()
    assert main(["check", "--data", str(path)]) == 0
    assert "[hysteresis] specifies no operator" in capsys.readouterr().out


def refused(capsys, arguments, words):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said


@pytest.mark.quick
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ([], "exactly one source of commands: give either a fit"),
        (["--loop", "a.csv", "b"], "or --loop with a run"),
        (["b", "--travel", "3"], "--travel is only used with --loop: give both"),
        (["--loop", "a.csv", "--travel", "-3"], "--travel is -3: give a positive number"),
        (["--loop", "a.csv", "--travel", "nan"], "--travel is 'nan': give a number"),
    ],
)
def test_sources_that_cannot_be(capsys, options, sentence):
    refused(capsys, ["compensate", *options, "--target", "t.csv", "--to", "x.csv"], sentence)


def test_bad_input_is_one_sentence(fitted, loops, tmp_path, capsys):
    good = target_file(tmp_path / "target.csv", ANGLES)
    far = target_file(tmp_path / "far.csv", [0, 20, 85])
    out = ["--to", str(tmp_path / "x.csv")]
    model = ["compensate", str(fitted)]
    refused(
        capsys,
        [*model, "--target", far, *out],
        "is 85 deg in sample 3, outside the reachable range of",
    )
    refused(capsys, ["compensate", "--loop", loops, "--target", far, *out], "outside the reachable")
    refused(capsys, ["compensate", "--target", good, *out], "give either a fit, or --loop")
    refused(
        capsys,
        [*model, "--travel", "3", "--target", good, *out],
        "--travel is only used with --loop",
    )
    lone = tmp_path / "lone.csv"
    lone.write_text("time_s,command_deg\n0,0\n1,1\n2,2\n")
    nothing = ["compensate", "--loop", loops, "--travel", "3", "--target", str(lone), *out]
    refused(capsys, nothing, "has 0 output or angle columns")
    unordered = tmp_path / "unordered.csv"
    unordered.write_text("time_s,angle_deg\n0,0\n2,1\n1,2\n")
    refused(capsys, [*model, "--target", str(unordered), *out], "must strictly increase")
    gap = tmp_path / "gap.csv"
    gap.write_text("time_s,angle_deg\n0,0\n1,\n2,2\n")
    refused(
        capsys,
        [*model, "--target", str(gap), *out],
        "sample 2 of 'gap' has no target value for angle",
    )
    short = tmp_path / "short.csv"
    short.write_text("time_s,command_deg,angle_deg\n0,0,0\n1,9,5\n2,0,3\n")
    refused(capsys, ["fit", "--data", str(short)], "3 measured values cannot determine")
    refused(capsys, ["choose", "--data", str(short)], "measured values to fit or to validate on")
    rising = tmp_path / "rising.csv"
    rows = [f"{k},{k},{k}" for k in range(40)]
    rising.write_text("\n".join(["time_s,command_deg,angle_deg", *rows]) + "\n")
    refused(capsys, ["fit", "--data", str(rising)], "never turns back")
    refused(capsys, ["hysteresis", "--out", str(short)], "is a file")
    refused(capsys, ["hysteresis", "--out", str(tmp_path), "--travel", "-1"], "positive number")
    assert sorted(path.name for path in tmp_path.glob("x*")) == []


def test_the_choice_is_a_table(loops, capsys):
    arguments = [
        "choose",
        "--data",
        loops,
        "--operator",
        "play",
        "--operator",
        "prandtl_ishlinskii",
    ]
    assert main(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    headings = "model parameters RMSE held out deg RMSE fitted deg delta AIC delta BIC status"
    assert " ".join(lines[0].split()) == headings
    assert lines[1].startswith("prandtl_ishlinskii ")
    assert main([*arguments, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["unit"] == "deg"
    first, second = record["candidates"]
    assert (first["model"], second["model"]) == ("prandtl_ishlinskii", "play")
    assert first["delta_aic"] == first["delta_bic"] == 0
    # The residual is as small as the noise of 0.3 deg; that of a single play is larger.
    assert first["held_out_rmse"] < 0.4 < second["held_out_rmse"]


def test_the_choice_holds_out_what_a_fit_would(loops, tmp_path, capsys):
    other = tmp_path / "other.csv"
    other.write_bytes(Path(loops).read_bytes())
    other.with_suffix(".toml").write_bytes(Path(loops).with_suffix(".toml").read_bytes())

    def chosen(*words):
        assert main(["choose", "--data", loops, "--operator", "play", *words]) == 0
        return capsys.readouterr()

    usual, half = chosen(), chosen("--hold-out", "last:0.5")
    assert chosen("--hold-out", "last:0.3").out == usual.out != half.out
    earlier = chosen("--fraction", "0.5")
    assert earlier.out == half.out
    assert "--fraction F is now giajax choose --hold-out last:F;" in earlier.err
    judged = chosen("--validation", str(other))
    assert chosen("--data", str(other), "--hold-out", "other").out == judged.out
    words = ["choose", "--data", loops, "--hold-out"]
    refused(capsys, [*words, "last:1"], "with a number between 0 and 1")
    refused(capsys, [*words, "nothing"], "is neither a run nor a channel")


@pytest.mark.slow
def test_the_experiment_writes_its_figure_and_numbers(tmp_path, capsys):
    out = tmp_path / "fig12"
    assert main(["hysteresis", "--out", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()[:7]
    with (out / "errors.csv").open() as file:
        errors = list(csv.DictReader(file))
    for line, row in zip(printed[1:], errors, strict=True):
        cells = line.split()
        assert cells[:2] == [row["history"], row["compensation"]]
        assert float(cells[2]) == pytest.approx(float(row["mean_error_deg"]), abs=0.006)
    # The numbers of the figure equal those of the table.
    with (out / "fig12.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["angle_deg"]]
    for row in errors:
        found = [
            abs(float(r["angle_deg"]) - float(r["target_deg"]))
            for r in rows
            if (r["history"], r["compensation"]) == (row["history"], row["compensation"])
        ]
        assert np.mean(found) == pytest.approx(float(row["mean_error_deg"]), abs=2e-4)
        assert np.max(found) == pytest.approx(float(row["largest_error_deg"]), abs=2e-4)
    assert (out / "fig12.png").read_bytes()[:4] == b"\x89PNG"
    assert read_run(out / "recording.csv").model == "hysteresis"
    # The fit that the command wrote can be used.
    target = target_file(tmp_path / "target.csv", ANGLES)
    command = ["compensate", str(out), "--target", target]
    assert main([*command, "--to", str(tmp_path / "command.csv")]) == 0
    capsys.readouterr()
    refused(capsys, ["hysteresis", "--out", str(out)], "exists and is not overwritten")
