"""`giajax simulate`: a run that can be read, checked and fitted, or one error message."""

import re
import shlex
import subprocess
import sys
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from giajax import ArmModel, get, model_for, read_run, register
from giajax.cli import main
from giajax.cli._simulate import gusts_of
from giajax.fitting import predict
from giajax.mechanics.arm import AbstractWind, bodies
from giajax.models import arm_from_definition
from giajax.recordings import Definition, describe
from giajax.schema.parameters import replace

SHORT = ["--links", "3", "--duration", "2"]


@pytest.fixture
def out(tmp_path):
    return tmp_path / "run.csv"


def simulate(out, *options, status=0):
    assert main(["simulate", "--to", str(out), *options]) == status
    return read_run(out) if status == 0 else None


def reproduced(run):
    """Return the prediction of a run by its true values, from its files alone."""
    truth = run.definition.truth
    return predict(replace(ArmModel(arm_from_definition(run.definition)), truth), run)


@pytest.mark.slow
def test_a_run_is_complete(out, capsys):
    options = ["--ramp", "1=30", "--noise", "position_m=0.02", "--missing", "10", "--seed", "7"]
    run = simulate(out, *SHORT, *options, "--set", "air.drag_coefficient=0.9")
    assert "run.csv" in capsys.readouterr().out
    assert main(["check", "--data", str(out)]) == 0
    definition = run.definition
    assert definition.sha256 == run.sha256
    assert definition.arm.links == 3
    assert definition.noise.position_m == 0.02
    assert definition.command.interpolation == "linear"
    assert definition.truth["air.drag_coefficient"] == 0.9
    assert definition.truth["joints.damping"] == 0.05
    assert definition.origin.startswith("giajax 0.")
    for word in ("--links 3", "--ramp 1=30", "--seed 7", "--missing 10"):
        assert word in definition.origin
    assert "run.csv" not in definition.origin
    assert list(run.observations) == [f"{point}_{c}" for point in ("link02", "tip") for c in "xyz"]
    np.testing.assert_allclose(run.times, np.linspace(0, 2, 21), atol=1e-12)
    np.testing.assert_allclose(np.rad2deg(run.values["joint01_command"][[5, 10, 15]]), [0, 15, 30])
    for name, exact in reproduced(run).items():
        error = run.values[name] - exact
        assert np.isnan(error).sum() == 2
        assert 0.5 * 0.02 < np.nanstd(error) < 1.6 * 0.02


def test_its_command_line_makes_it_again(out, tmp_path):
    first = simulate(
        out,
        *SHORT,
        "--step",
        "2=-20@0.3",
        "--noise",
        "position_m=0.01",
        "--set",
        "links.mass[1]=0.1",
    )
    words = shlex.split(first.definition.origin)
    again = tmp_path / "again.csv"
    assert main([*words[2:], "--to", str(again)]) == 0
    assert again.read_bytes() == out.read_bytes()
    assert again.with_suffix(".toml").read_bytes() == out.with_suffix(".toml").read_bytes()


@pytest.mark.slow
def test_a_value_for_each_element(out):
    options = ["--ramp", "1=30", "--channels", "tip", "--set", "camera.origin=0.1,0,-0.2"]
    seen = simulate(out, *SHORT, *options)
    assert seen.definition.truth["camera.origin"] == [0.1, 0.0, -0.2]
    plain = simulate(out, *SHORT, *options[:4], "--force")
    np.testing.assert_allclose(seen.values["tip_x"], plain.values["tip_x"] - 0.1, atol=1e-8)
    np.testing.assert_allclose(seen.values["tip_z"], plain.values["tip_z"] + 0.2, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("digits", ["4", "9"])
def test_steps_off_the_samples_are_read_back_as_they_were(out, digits):
    options = ["--step", "1=30@0.517", "--step", "1=0@1.23", "--step", "2=-10", "--digits", digits]
    run = simulate(out, *SHORT, *options, "--channels", "joints,link03", "--channels", "tip_z")
    assert run.definition.command.interpolation == "zoh"
    assert len(run.times) == 21 + 2
    assert list(run.observations)[:3] == ["joint01_angle", "joint02_angle", "joint03_angle"]
    for name, exact in reproduced(run).items():
        np.testing.assert_allclose(
            run.values[name], exact, rtol=10.0 ** (1 - int(digits)), atol=1e-6
        )


@pytest.mark.slow
def test_commands_and_wind_of_a_recorded_run(out, tmp_path):
    recorded = tmp_path / "recorded.csv"
    recorded.write_text(
        "time_s,joint01_command_deg,link03_z_m,wind_y_m_per_s\n"
        "1,0,0,0\n1.5,10,,0.5\n2.04,10,0,0.5\n3.09,-5,0,0\n"
    )
    recorded.with_suffix(".toml").write_text(
        '[command]\ninterpolation = "zoh"\n[arm]\nlinks = 4\nlink_mass_kg = 9.0\n'
    )
    run = simulate(out, "--links", "3", "--command", str(recorded), "--channels", "tip")
    # The arm is that of this command, not that of the recording with the commands.
    assert (run.definition.arm.links, run.definition.arm.link_mass_kg) == (3, 0.047)
    assert (run.times[0], run.times[-1]) == (1.0, 3.0)
    at = {round(time, 6): row for row, time in enumerate(run.times)}
    commands, wind = np.rad2deg(run.values["joint01_command"]), run.values["wind_y"]
    np.testing.assert_allclose([commands[at[t]] for t in (1.4, 1.5, 2.04, 3.0)], [0, 10, 10, 10])
    np.testing.assert_allclose(wind[at[1.2]], 0.2)
    for name, exact in reproduced(run).items():
        np.testing.assert_allclose(run.values[name], exact, atol=1e-6)
    longer = simulate(
        out,
        "--links",
        "3",
        "--command",
        str(recorded),
        "--channels",
        "tip",
        "--duration",
        "4",
        "--force",
    )
    assert longer.times[-1] == 5.0
    np.testing.assert_allclose(np.rad2deg(longer.values["joint01_command"][-1]), -5)


@pytest.mark.slow
def test_an_arm_of_ones_own(out, tmp_path):
    arm = tmp_path / "pendulum.toml"
    arm.write_text(
        '[arm]\nlinks = 2\nlink_mass_kg = [1.0, 0.5]\njoint_axes = ["pitch", "pitch"]\n'
        "gravity_m_per_s2 = 9.81\n[initial]\nangle_deg = [-80, 5]\n"
        "[wind]\nvelocity_m_per_s = [0.0, 0.0, 0.1]\n"
    )
    run = simulate(out, "--arm", str(arm), "--duration", "1", "--channels", "joint02_rate,joints")
    assert run.definition.free_motion
    assert run.definition.arm.link_mass_kg == [1.0, 0.5]
    assert run.definition.wind.velocity_m_per_s == [0.0, 0.0, 0.1]
    np.testing.assert_allclose(np.rad2deg(run.values["joint02_angle"][0]), 5)
    assert not np.allclose(run.values["joint02_rate"], 0)
    windy = simulate(out, "--arm", str(arm), "--duration", "1", "--wind", "-1,0,0", "--force")
    assert windy.definition.wind.velocity_m_per_s == [-1.0, 0.0, 0.0]


@pytest.mark.slow
def test_wind_alone_moves_the_arm(out):
    run = simulate(out, *SHORT, "--wind", "0,0,0.2", "--channels", "all")
    assert run.definition.free_motion
    assert list(run.observations) == [f"link{i:02d}_{c}" for i in (1, 2, 3) for c in "xyz"]
    assert run.values["link03_z"][-1] > 1e-3


@register
class Upwards(AbstractWind):
    """A user-defined wind that a file names."""

    def __call__(self, position, time):
        return jnp.broadcast_to(jnp.asarray([0.0, 0.0, 0.2]), position.shape)


@pytest.mark.slow
def test_a_wind_field_alone_moves_the_arm(out, tmp_path):
    (tmp_path / "arm.toml").write_text('[arm]\nwind_field = "Upwards"\n')
    run = simulate(out, *SHORT, "--arm", str(tmp_path / "arm.toml"), "--channels", "link03_z")
    assert run.definition.arm.wind_field == "Upwards"
    steady = simulate(
        tmp_path / "steady.csv", *SHORT, "--wind", "0,0,0.2", "--channels", "link03_z"
    )
    assert np.allclose(run.values["link03_z"], steady.values["link03_z"], atol=1e-9)
    assert run.values["link03_z"][-1] > 1e-3


@pytest.mark.slow
def test_what_is_written_of_an_own_arm_begins_at_that_arm(out, tmp_path, capsys):
    """No note mentions a preset that was not given, and the true values are not initial guesses."""
    (tmp_path / "own.toml").write_text(
        '[arm]\npreset = "chain"\nlinks = 2\nlink_length_m = 0.5\nlink_diameter_m = 0.05\n'
        'link_mass_kg = 0.1\njoint_axes = ["pitch", "pitch"]\n'
        "link_inertia_kg_m2 = [2e-3, 3e-3, 4e-3, 0.0, 0.0, 0.0]\n"
        '[arm.parameters]\n"joints.pitch_stiffness" = 2.0\n"joints.damping" = 0.05\n'
    )
    own = ("--arm", str(tmp_path / "own.toml"), "--set", "joints.pitch_stiffness=3")
    run = simulate(out, "--duration", "2", *own, "--ramp", "1=10", "--channels", "link02_z")
    model = model_for([run])
    assert float(model.arm.joints.pitch_stiffness) == 2.0
    assert float(get(model, "joints.damping")) == 0.05
    assert np.allclose(bodies(model.arm).mass, 0.1)
    (sentence,) = model.conditions(["joints.damping"], [run])
    assert "structural point masses give the mass of links 1, 2" in sentence
    assert "links.mass" not in sentence
    paper = simulate(tmp_path / "paper.csv", *SHORT, "--ramp", "1=10", "--channels", "link02_z")
    assert paper.definition.arm.preset == "takeichi_20m"
    for each in (run, paper):
        assert not [note for note in describe(each)["notes"] if "preset" in note]


REFUSED = {
    "nothing moves": ([], ["the arm does not move", "--step"]),
    "joint beyond the arm": (["--links", "3", "--ramp", "4=10"], ["joint 4", "joints 1 to 3"]),
    "steps and ramps": (["--step", "1=10", "--ramp", "2=5"], ["mixed"]),
    "bad step": (["--step", "1:30"], ["JOINT=DEG[@T]"]),
    "step with a duration": (["--step", "1=30@1:2"], ["JOINT=DEG[@T]"]),
    "bad ramp": (["--ramp", "one=30"], ["JOINT=DEG[@START:DURATION]"]),
    "ramp without duration": (["--ramp", "1=30@1:0"], ["duration of 0", "--step"]),
    "too late": (["--step", "1=30@30"], ["outside the run"]),
    "overlap": (["--ramp", "1=30@1:2", "--ramp", "1=0@2:1"], ["overlap"]),
    "command and step": (["--command", "x.csv", "--step", "1=1"], ["only one source"]),
    "no command file": (["--command", "none.csv"], ["none.csv does not exist"]),
    "no arm file": (["--arm", "none.toml", "--ramp", "1=1"], ["none.toml does not exist"]),
    "unknown parameter": (["--ramp", "1=1", "--set", "air.drag=1"], ["'air.drag_coefficient'"]),
    "outside its bounds": (["--ramp", "1=1", "--set", "joints.damping=-1"], ["outside its bounds"]),
    "no value": (["--ramp", "1=1", "--set", "joints.damping"], ["PATH=VALUE"]),
    "not a number": (["--ramp", "1=1", "--set", "joints.damping=nan"], ["PATH=VALUE"]),
    "set twice": (["--ramp", "1=1", *["--set", "joints.damping=1"] * 2], ["twice"]),
    "massless": (["--ramp", "1=1", "--set", "links.mass=0"], ["link_mass_kg", "positive"]),
    "wind of two": (["--wind", "1,2"], ["three numbers"]),
    "wind of text": (["--wind", "1,2,north"], ["three numbers"]),
    "no links": (["--links", "0", "--ramp", "1=1"], ["at least 1 link"]),
    "link beyond the arm": (["--ramp", "1=1", "--channels", "link21"], ["link 21", "20 links"]),
    "joint not there": (["--ramp", "1=1", "--channels", "joint21_angle"], ["joint 21"]),
    "misspelt channel": (["--ramp", "1=1", "--channels", "link6"], ["'link06_x'"]),
    "command as channel": (
        ["--ramp", "1=1", "--channels", "joint01_command"],
        ["is not a channel of an arm"],
    ),
    "negative noise": (
        ["--ramp", "1=1", "--noise", "position_m=-1"],
        ["position_m=-1' is negative"],
    ),
    "noise of nothing": (
        ["--ramp", "1=1", "--channels", "joints", "--noise", "position_m=1"],
        ["none of the"],
    ),
    "noise of no quantity": (
        ["--ramp", "1=1", "--noise", "0.01"],
        ["KEY=VALUE", "position_m=0.01"],
    ),
    "noise of no key": (["--ramp", "1=1", "--noise", "height=1"], ["height"]),
    "list too short": (["--ramp", "1=1", "--set", "camera.origin=1,2"], ["2 values", "3 elements"]),
    "angle noise of nothing": (["--ramp", "1=1", "--noise", "angle_deg=1"], ["none of the"]),
    "all missing": (["--ramp", "1=1", "--missing", "100"], ["less than 100"]),
    "half a sample": (["--ramp", "1=1", "--duration", "2.55"], ["use 2.6 s"]),
    "no samples": (["--ramp", "1=1", "--rate", "0"], ["no samples"]),
    "unknown solver": (["--ramp", "1=1", "--solver", "euler"], ["'euler'", "tsit5"]),
    "no tolerance": (["--ramp", "1=1", "--tolerance", "0"], ["--tolerance is 0"]),
    "negative seed": (["--ramp", "1=1", "--seed", "-1"], ["--seed"]),
    "unknown option": (["--ramp", "1=1", "--nose", "1"], ["--noise"]),
}


@pytest.mark.parametrize(("options", "said"), REFUSED.values(), ids=list(REFUSED))
def test_one_sentence(out, capsys, monkeypatch, options, said):
    monkeypatch.chdir(out.parent)
    simulate(out, *options, status=2)
    printed, error = capsys.readouterr()
    assert printed == ""
    assert error.startswith("giajax: ")
    assert error.count("\n") == 1
    for words in said:
        assert words in error
    assert list(out.parent.iterdir()) == []


def test_an_arm_file_of_another_model(out, tmp_path, capsys):
    (tmp_path / "muscle.toml").write_text('model = "muscle"\n')
    simulate(out, "--arm", str(tmp_path / "muscle.toml"), "--ramp", "1=1", status=2)
    assert "describes a muscle" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["run.csv", "run.toml"])
def test_nothing_is_written_over_without_force(out, tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    simulate(out, *SHORT, "--ramp", "1=1", status=2)
    assert f"{name} exists" in capsys.readouterr().err
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "mine")]
    assert len(simulate(out, *SHORT, "--ramp", "1=1", "--force").times) == 21


def test_where_it_cannot_be_written(tmp_path, capsys):
    simulate(tmp_path / "run.txt", "--ramp", "1=1", status=2)
    assert ".csv" in capsys.readouterr().err
    simulate(tmp_path / "none" / "run.csv", "--ramp", "1=1", status=2)
    assert "does not exist" in capsys.readouterr().err


@pytest.mark.slow
def test_a_simulation_that_fails_is_one_sentence_and_status_1(out, capsys):
    options = [
        "--links",
        "1",
        "--ramp",
        "1=1",
        "--set",
        "joints.damping=100",
        "--set",
        "links.mass=1e-6",
    ]
    options += ["--set", "links.inertia_transverse=1e-6", "--solver", "tsit5"]
    simulate(out, *options, status=1)
    printed, error = capsys.readouterr()
    assert printed == ""
    assert "step limit" in error
    assert error.count("\n") == 1
    assert list(out.parent.iterdir()) == []


def test_help_imports_no_jax():
    commands = ["--help", "simulate --help", "parameters --help", "examples"]
    code = (
        "import sys\nfrom giajax.cli import main\n"
        "for words in sys.argv[1:]:\n"
        "    status = main(words.split())\n"
        "    if status or 'jax' in sys.modules:\n"
        "        sys.exit(f'{words}: {status}')\n"
        "    print('-' * 99)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *commands], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    said = done.stdout.split("-" * 99)
    assert ["giajax" in each for each in said[:-1]] == [True] * len(commands)


@pytest.mark.slow
def test_gusts_are_recorded_about_the_mean_wind(out, capsys):
    """The arm moves in the gusts alone."""
    run = simulate(out, *SHORT, "--wind", "0,0.3,0", "--gusts", "0.4,0.2,0:2")
    assert "--gusts 0.4,0.2,0:2" in run.definition.origin
    command, note = run.definition.origin.split("  # ")
    assert shlex.split(run.definition.origin, comments=True) == shlex.split(command)
    assert f"{note} (see --rate)" in capsys.readouterr().out
    along, level = (float(share) for share in re.findall(r"([\d.]+)% a", note))
    assert 0 < along < level < 10
    # All true values are values of parameters.
    replace(ArmModel(arm_from_definition(run.definition)), run.definition.truth)
    assert run.definition.wind.velocity_m_per_s is None
    across = run.values["wind_y"]
    assert 0.02 < np.ptp(across) < 1
    np.testing.assert_allclose(run.values["wind_z"], 0, atol=1e-9)
    assert run.values["tip_y"][-1] > 1e-3
    np.testing.assert_allclose(run.values["tip_z"], 0, atol=1e-9)


@pytest.mark.slow
def test_each_link_has_gusts_of_its_own(out):
    """The recorded winds are those that moved the arm, so the prediction of the run agrees."""
    run = simulate(
        out, *SHORT, "--wind", "0,0.3,0", "--gusts", "0.4:1", "--coherence", "12",
        "--set", "air.added_mass_coefficient=1", "--channels", "tip",
    )  # fmt: skip
    assert len(run.winds) == 9
    assert np.ptp([run.values[f"link{link:02d}_wind_y"] for link in (1, 2, 3)], axis=0).max() > 0.05
    again = predict(ArmModel.for_runs([run]), run, ("tip_y", "tip_z"))
    assert np.abs(again["tip_y"]).max() > 1e-3
    for channel, values in again.items():
        np.testing.assert_allclose(values, run.values[channel], atol=1e-6)


def test_coherence_is_of_gusts(out, capsys):
    simulate(out, *SHORT, "--wind", "0,0.3,0", "--coherence", "12", status=2)
    assert "add --gusts" in capsys.readouterr().err
    windy = (*SHORT, "--wind", "0,0.3,0", "--gusts", "0.3:5")
    simulate(out, *windy, "--coherence", "-1", status=2)
    assert "--coherence is -1: give a non-negative decay coefficient" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("intensity", "ways"),
    [("2,0,0", ["along"]), ("0,0,1", ["across"]), ("0.3", ["along", "across"])],
)
def test_what_is_left_out_of_gusts_is_of_those_there_are(intensity, ways):
    definition = Definition.parse({"wind": {"velocity_m_per_s": [0, 0.2, 0]}})
    arm = SimpleNamespace(count=3)
    sampling = {"start": 0.0, "duration": 1.0, "rate": 10.0, "seed": 0}
    _, note = gusts_of(f"{intensity}:2", definition, None, arm, coherence=None, **sampling)
    assert re.findall(r"% (\w+)", note) == ways
    assert note.endswith(" the mean wind")


@pytest.mark.parametrize("text", ["0.3", "0.3:", "0.3,0.1:5", "a:5", "0.3:5:1"])
def test_gusts_that_are_none_are_refused(out, text, capsys):
    simulate(out, *SHORT, "--wind", "0,0.3,0", "--gusts", text, status=2)
    assert f"--gusts is '{text}'" in capsys.readouterr().err


def test_gusts_need_a_mean_wind(out, capsys):
    simulate(out, *SHORT, "--gusts", "0.3:5", status=2)
    assert "add --wind" in capsys.readouterr().err
