"""Parameter settings: in a file, overridden by options, and used by the fit."""

import pytest

from giajax import FitTask, InputError, Prior
from giajax.cli import main
from giajax.recordings import Definition, FitSettings, TaskKeywords

DEFINITION = """
[fit]
data = ["a.csv", "b.csv"]
free = ["air.drag_coefficient", "links.mass", "joints.damping"]
per_run = ["camera.delay"]
priors.air.drag_coefficient = { value = 1.1, deviation = 0.2 }
[fit.priors."links.mass[0]"]
value = 0.05
factor = 1.5
[fit.bounds]
joints.damping = [0.01, 1]
[fit.ties]
links.mass = "links.mass[0]"
"joints.yaw_stiffness" = "1.5 * joints.pitch_stiffness"
[fit.groups]
camera.scale = [["a"], ["b"]]
"""

RUN = "time_s,joint01_command_deg,link02_y_m\n" + "".join(f"{i},0,0.{i}\n" for i in range(9))


@pytest.fixture
def path(tmp_path):
    for name in "ab":
        (tmp_path / f"{name}.csv").write_text(RUN.replace("0.3", f"0.{ord(name)}"))
        (tmp_path / f"{name}.toml").write_text("[arm]\nlinks = 2\n")
    (tmp_path / "both.toml").write_text(DEFINITION)
    return tmp_path / "both.toml"


@pytest.mark.quick
def test_a_definition_says_it_all_and_is_written_again(path):
    settings = FitTask.load(path).definition.fit
    assert settings.priors["air.drag_coefficient"].prior() == Prior(1.1, deviation=0.2)
    assert settings.priors["links.mass[0]"].prior() == Prior(0.05, factor=1.5)
    assert settings.bounds == {"joints.damping": [0.01, 1.0]}
    assert settings.ties["joints.yaw_stiffness"] == "1.5 * joints.pitch_stiffness"
    written = FitTask.load(path).definition.to_toml()
    path.write_text(written)
    assert Definition.load(path).fit == settings


def test_it_reaches_the_fit(path):
    setup = FitTask.load(path).prepare().setup
    paths = [parameter.path for parameter in setup.parameters]
    # The nuisance parameters that the settings do not mention.
    assert setup.nuisances == ("camera.clock_rate", "links.diameter[0]")
    assert [path for path in paths if path not in setup.nuisances] == [
        *("air.drag_coefficient", "links.mass[0]", "joints.damping"),
        *("camera.delay", "camera.scale"),
    ]
    damping = setup.parameters[2].declaration
    assert (damping.lower, damping.upper) == (0.01, 1.0)
    assert setup.groups == {"camera.delay": ((0,), (1,)), "camera.scale": ((0,), (1,))}
    ties = [tie.path for tie in setup.ties if tie.path != "links.diameter"]
    assert ties == ["links.mass", "joints.yaw_stiffness"]
    assert setup.priors["links.mass[0]"] == Prior(0.05, factor=1.5)
    assert float(setup.model.arm.joints.yaw_stiffness) == pytest.approx(
        1.5 * float(setup.model.arm.joints.pitch_stiffness)
    )


@pytest.mark.quick
def test_the_last_word_on_a_parameter_counts(path):
    task = FitTask.load(path)
    fixed = task.on_top(fix={"air.drag_coefficient": 1, "joints.damping": 0.1, "camera.delay": 0})
    settings = fixed.definition.fit
    assert list(settings.priors) == ["links.mass[0]"]
    assert not settings.bounds
    assert not settings.per_run
    assert settings.free == ["links.mass"]
    tied = fixed.on_top(
        ties={"camera.scale": "1 + camera.delay", "joints.damping": "0.1 * air.density"}
    )
    assert tied.definition.fit.groups == {}
    assert list(tied.definition.fit.fix) == ["air.drag_coefficient", "camera.delay"]
    freed = task.on_top(
        free=["joints.yaw_stiffness"],
        priors={"joints.yaw_stiffness": Prior(4.0, factor=1.1)},
        bounds={"joints.yaw_stiffness": [1, 9]},
    ).definition.fit
    assert list(freed.ties) == ["links.mass"]
    assert freed.priors["joints.yaw_stiffness"].factor == 1.1
    assert freed.bounds["joints.yaw_stiffness"] == [1.0, 9.0]
    moved = task.on_top(per_run=["camera.scale"]).definition.fit
    assert (moved.per_run, moved.groups) == (["camera.scale"], {})
    moved = task.on_top(groups={"camera.delay": [["a", "b"]]}).definition.fit
    assert not moved.per_run
    assert set(moved.groups) == {"camera.scale", "camera.delay"}


@pytest.mark.quick
@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ('priors."a" = { value = 1 }', r"\[fit.priors.a\] must have a deviation, or a factor"),
        ('priors."a" = { value = 1, deviation = 0 }', "deviation = 0 must be a positive number"),
        (
            'priors."a" = { value = 1, factor = 0.5 }',
            "the factor of the prior is 0.5: give a number above 1",
        ),
        ('priors."a" = { value = 0, factor = 2 }', "a factor and the value 0: give a positive"),
        ('priors."a" = { deviation = 1 }', "priors.a.value is missing, and must be a number"),
        ('priors."a" = { value = 1, deviaton = 1 }', "did you mean fit.priors.a.deviation?"),
        ('priors."a" = 1', r"\[fit.priors.a\] must be a table of keys"),
        ('bounds."a" = [1]', r"fit.bounds.a = \[1\] must be a list of two numbers, \[low, high\]"),
        ('bounds."a" = [1, nan]', "fit.bounds.a = nan must be a list of two numbers"),
        ('ties."a" = 2', "fit.ties.a = 2 must be an expression in quotes"),
        ('ties."a" = "2"', "fit.ties is not valid for a, because the expression '2' contains no"),
        ('ties."a" = "f(b)"', "expression 'f.b.' may contain only numbers, parameter"),
        ('groups."a" = ["x"]', "must be a list of lists of run names"),
        ('per_run = "a"', "fit.per_run = 'a' must be a list of parameter paths"),
    ],
)
def test_what_is_wrong_in_a_file_is_one_sentence(tmp_path, text, sentence):
    (tmp_path / "fit.toml").write_text(f"[fit]\n{text}\n")
    with pytest.raises(InputError, match=sentence) as caught:
        FitTask.load(tmp_path / "fit.toml")
    assert "\n" not in str(caught.value)


@pytest.mark.quick
def test_each_setting_is_a_keyword_and_an_option(capsys):
    """Exceptions are the files, which have other arguments, and Python objects."""
    files = {"data", "validation", "out"}
    assert set(TaskKeywords.__annotations__) | files == set(FitSettings.model_fields)
    assert main(["fit", "--help"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    called = {"priors": "prior", "ties": "tie", "groups": "group"}
    for name, field in FitSettings.model_fields.items():
        option = f" --{called.get(name, name).removesuffix('_s').replace('_', '-')} "
        assert option in shown or name in files | {"optimiser"}, option
        if field.default not in (None, False, True, [], {}):
            about = shown.rpartition(option)[0] if name in files else shown.partition(option)[2]
            assert f"[default: {field.default}]" in about.partition(" --")[0], option
