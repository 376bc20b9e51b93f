"""The next experiment of a short arm; all tests share one compiled program."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import giajax
from giajax import ArmModel, InputError, design_experiment, read_run
from giajax.apps.design import (
    CommandSeries,
    Criterion,
    Design,
    Expected,
    Informed,
    Limits,
    RobustError,
    base_step,
    design_json,
    design_rows,
    draws,
    informed,
    question_of,
)
from giajax.cli import main
from giajax.cli._planning import source_of
from giajax.schema.parameters import get
from giajax.studies import expected_errors

EARLIER = Path(__file__).parents[2] / "earlier" / "arm"
C = Criterion("c", (1.2, 0.0))
DRAG, STIFFNESS = "air.drag_coefficient", "joints.pitch_stiffness"
# notebooks/05_next_experiment.ipynb and docs/design.md use the same sizes, so one program suffices.
SMALL = ["--links", "2", "--duration", "4", "--knots", "4", "--free", STIFFNESS]
QUICK = ["--solver", "heun", "--tolerance", "1e-4"]


def arm():
    return ArmModel(giajax.takeichi_20m(2), tolerance=1e-4, solver="heun")


def asked(source=None, **changes):
    options = dict.fromkeys(
        ("free", "channels", "noise", "priors", "ties", "uncertainty", "definition"), None
    )
    options |= {"wanted": [DRAG], "free": [STIFFNESS], **changes}
    wanted = options.pop("wanted")
    return question_of(source or arm(), wanted, Limits(duration=4.0), **options)


@pytest.mark.slow
def test_the_command_its_files_and_what_they_promise(tmp_path, capsys):
    """The files are read back, and the information is compared with finite differences."""
    out = tmp_path / "next"
    search = ["--candidates", "4", "--follow", "1", "--max-iterations", "5", "--markers", "1"]
    words = [
        "design",
        "--parameter",
        DRAG,
        *SMALL,
        *QUICK,
        *search,
        "--scenarios",
        "2",
        "--out",
        str(out),
    ]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "times the error of the base step" in said
    assert (out / "design.png").read_bytes().startswith(b"\x89PNG")
    stored = json.loads((out / "design.json").read_text())
    assert stored["ratio"] < 0.8
    assert stored["design"]["markers"] == ["link02"]
    assert stored["draws"]["count"] == 2
    assert stored["draws"]["smallest"] < stored["draws"]["largest"]
    # The operator's file gives the same motion as the corners of the command, within the limits.
    run = read_run(out / "command.csv")
    rows = run.commands["joint01_command"]
    corners = stored["design"]["corners"]
    np.testing.assert_allclose(
        np.degrees(rows),
        np.interp(run.times, corners["time_s"], corners["angle_deg"]["joint01_command"]),
        atol=1e-9,
    )
    assert np.all(np.abs(np.degrees(rows)) <= 30)
    assert np.all(np.abs(np.degrees(np.diff(rows))) <= 30 * np.diff(run.times) + 1e-12)
    command = arm().prepare(run).command
    np.testing.assert_allclose(
        [command(t)[0] for t in (0.55, 2.05, 3.95)],
        np.interp((0.55, 2.05, 3.95), run.times, rows),
        atol=1e-9,
    )
    # An existing file is not overwritten.
    assert main(words) == 2
    capsys.readouterr()

    question = asked()
    series = CommandSeries.of(question.limits, 4)
    numbers = np.asarray([0.6, -0.3, 0.5, -0.4])
    at = informed(question.experiment, series.at(numbers), question.values[None])
    columns = []
    for index, value in enumerate(question.values):
        step = 1e-4 * value * np.eye(2)[index]
        ahead, behind = (
            informed(question.experiment, series.at(numbers), (question.values + s * step)[None])
            for s in (1, -1)
        )
        columns.append((ahead.predicted - behind.predicted)[0] / 2e-4 / 0.01)
    jacobian = np.stack(columns, axis=-1).reshape(-1, 2)
    whole = at.values[0].sum(axis=0)
    np.testing.assert_allclose(whole, jacobian.T @ jacobian, rtol=1e-3)

    uncertain = draws(question.parameters, question.values, question.deviations, np.eye(2), 2)
    error = RobustError(question.experiment, series, uncertain, question.known, C, 2)
    error.choose(numbers)
    value, slope = error(numbers), error.slope(numbers)
    first = expected_errors(whole)[0] * question.values[0]
    assert np.exp(error.each(numbers)[0]) == pytest.approx(first, rel=1e-5)
    for place in (0, 2):
        way = 1e-3 * np.eye(4)[place]
        difference = (error(numbers + way) - error(numbers - way)) / 2e-3
        assert slope[place] == pytest.approx(difference, rel=0.02)
    assert value == pytest.approx(np.mean(error.each(numbers)))
    for kind, over in (("A", "worst"), ("D", "mean")):
        both = Criterion(kind, (1.0, 1.0))
        other = RobustError(question.experiment, series, uncertain, question.known, both, 2, over)
        other.choose(numbers)
        way = 1e-3 * np.eye(4)[2]
        difference = (other(numbers + way) - other(numbers - way)) / 2e-3
        assert other.slope(numbers)[2] == pytest.approx(difference, rel=0.02)


def test_draws_are_of_what_is_uncertain():
    question = asked(uncertainty={DRAG: 0.3})
    found = draws(question.parameters, question.values, question.deviations, np.eye(2), 9)
    np.testing.assert_array_equal(found[0], question.values)
    assert np.all(found[:, 1] == question.values[1])
    assert np.all(found > 0)
    assert 0.15 < np.std(np.log(found[:, 0])) < 0.45


def test_what_is_known_badly_is_drawn_within_a_factor_of_four():
    question = asked(uncertainty={DRAG: 3.0, STIFFNESS: 0.1})
    found = draws(question.parameters, question.values, question.deviations, np.eye(2), 33)
    shares = found / question.values
    assert 3 < np.max(shares[:, 0]) <= 4
    assert 0.25 <= np.min(shares[:, 0]) < 0.4
    assert np.max(shares[:, 1]) < 1.3


def test_draws_that_cannot_be_simulated_are_left_out():
    """The draw with the current values must not be left out."""
    question = asked()
    series = CommandSeries.of(question.limits, 4)
    uncertain = draws(question.parameters, question.values, question.deviations, np.eye(2), 4)
    error = RobustError(question.experiment, series, uncertain, question.known, C, 2)
    numbers = series.base_step()
    nothing = np.zeros((4, 1, 1, 1))
    successful = np.asarray([False, True, False, True])
    told = Informed(nothing, np.zeros((4, 1, 1)), successful)
    error._seen = numbers.tobytes(), told
    error.leave_out_failing(numbers)
    np.testing.assert_array_equal(error.draws, uncertain[[0, 1, 3]])


def test_what_a_fit_does_not_tell_is_not_known():
    """Parameters that the fit held fixed, or that have no standard error, get a default error."""
    result = giajax.load_result(EARLIER / "result.json")
    estimate = dataclasses.replace(result.parameters[DRAG], standard_error=None)
    loose = dataclasses.replace(result, parameters={**result.parameters, DRAG: estimate})
    for source, error in ((result, result.parameters[DRAG].standard_error), (loose, None)):
        found = asked(source, wanted=[STIFFNESS], free=None)
        values = dict(zip(found.experiment.paths, found.values, strict=True))
        assert found.deviations[STIFFNESS] == pytest.approx(0.2 * values[STIFFNESS])
        assert found.deviations[DRAG] == pytest.approx(error or 0.2 * values[DRAG])


def test_a_result_and_its_definition_ask_the_same(tmp_path):
    """Free and held parameters, ties, the initial values and the wind are the same."""
    stored = json.loads((EARLIER / "result.json").read_text())
    ties = {"joints.yaw_stiffness": f"2 * {STIFFNESS}"}
    stored["config"]["ties"] = ties
    (tmp_path / "result.json").write_text(json.dumps(stored))
    text = (EARLIER / "run_fit.toml").read_text()
    tied = '[fit.ties]\n"joints.yaw_stiffness" = "2 * joints.pitch_stiffness"\n\n[figures'
    (tmp_path / "run_fit.toml").write_text(text.replace("[figures", tied))
    for name in ("run.csv", "run.toml"):
        (tmp_path / name).write_bytes((EARLIER / name).read_bytes())
    found = []
    for name in ("result.json", "run_fit.toml"):
        source, settings = source_of(tmp_path / name, None, {}, [], "tsit5", 1e-6)
        found.append(asked(source, **settings, wanted=[DRAG, STIFFNESS]))
    one, other = found
    assert (
        [tie.path for tie in one.experiment.ties]
        == [tie.path for tie in other.experiment.ties]
        == list(ties)
    )
    assert one.experiment.paths == other.experiment.paths
    assert one.experiment.own == other.experiment.own
    assert one.definition["wind"] == other.definition["wind"]
    for path in ("joints.damping", "air.added_mass_coefficient", "camera.origin[0]"):
        assert get(one.experiment.model, path) == get(other.experiment.model, path), path
    # A parameter that is free by default is held if the definition holds it.
    (tmp_path / "run_fit.toml").write_text(
        text.replace('free = ["air.drag_coefficient", "camera.origin[2]"]', "")
    )
    _, settings = source_of(tmp_path / "run_fit.toml", None, {}, [], "tsit5", 1e-6)
    assert DRAG in settings["free"]
    assert "joints.damping" not in settings["free"]


def test_priors_are_information():
    """This includes priors of the initial state of the run."""
    prior = giajax.Prior(1.2, deviation=0.06)
    known = asked(priors={DRAG: prior}).known
    np.testing.assert_allclose(known, np.diag([(1.2 / 0.06) ** 2, 0.0]))
    rate = {"initial.rate": giajax.Prior(0.0, deviation=0.1)}
    known = asked(definition={"initial": {"free": True}}, priors=rate).known
    np.testing.assert_allclose(known, np.diag([0.0, 0.0, 0.0, 0.0, 100.0, 100.0]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"priors": {"air.drag": {"value": 1.0, "deviation": 0.1}}}, "did you mean"),
        ({"priors": {"joints.damping": {"value": 1.0, "deviation": 0.1}}}, "but is not free"),
        ({"ties": {DRAG: f"0.4 * {STIFFNESS}"}}, f"'{DRAG}' is tied to other parameters: give the"),
    ],
)
def test_what_a_question_cannot_be(options, words):
    with pytest.raises(InputError, match=words):
        asked(**options)


def test_weights_may_be_one():
    question = asked(wanted={DRAG: 1.0, STIFFNESS: 1.0})
    assert question.weights("c") == tuple(question.values)
    with pytest.raises(InputError, match="criterion c needs one parameter"):
        asked(wanted=[DRAG, STIFFNESS]).weights("c")


def test_what_is_not_determined_has_no_ratio():
    question = asked()
    drive = base_step(question.limits, 4).drive()
    run = question.run_of(drive, "run")
    plan = {"run": run, "drive": drive, "markers": ("link02",), "channels": ("link02_z",)}
    told = {"times": run.times, "predicted": {"link02_z": np.zeros(len(run.times))}}
    known = Expected(**plan, **told, errors={DRAG: 0.1}, criterion=0.1)
    unknown = Expected(**plan, **told, errors={DRAG: np.inf}, criterion=None)
    common = {"limits": question.limits, "criterion": "c", "wanted": (DRAG,), "noise": {}}
    common |= {"parameters": {DRAG: (1.2, "")}, "before": {}, "spread": (0.5, 2.0), "draws": 2}
    common |= {"status": "converged", "evaluations": (), "seconds": 0.0}
    half = Design(**common, designed=known, base_step=unknown)
    assert half.ratio is None
    assert f"the base step cannot determine {DRAG}" in repr(half)
    assert design_rows(half) == [(DRAG, "1.2", "0.10", "not determined", "-", "-", "-")]
    later = dataclasses.replace(half, before={DRAG: 0.0312}, base_step=known)
    assert design_rows(later) == [(DRAG, "1.200", "0.10", "0.10", "1.0", "0.031", "-")]
    stored = json.loads(design_json(Design(**common, designed=unknown, base_step=unknown)))
    assert stored["ratio"] is stored["design"]["criterion"] is stored["draws"]["largest"] is None
    whole = Design(**common, designed=known, base_step=dataclasses.replace(known, criterion=0.2))
    assert whole.summary() == "0.500 times the error of the base step"


def test_a_free_first_state_is_a_nuisance():
    question = asked(definition={"initial": {"free": True}})
    assert question.experiment.own == (("initial.angle", 2), ("initial.rate", 2))
    assert question.known.shape == (6, 6)
    assert question.weights("c") == (1.2, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--parameter", "air.drag"], "did you mean 'air.drag_coefficient'?"),
        (["--parameter", DRAG, "--joints", "3"], "the arm has only joints 1 to 2"),
        (["--parameter", DRAG, "--joints", "1;2"], "give numbers"),
        (["--parameter", DRAG, "--max-angle", "0"], "the largest angle is 0"),
        (
            ["--parameter", DRAG, "--markers", "9"],
            "9 markers are requested: give a number from 1 to 2",
        ),
        (["--parameter", DRAG, "--knots", "1"], "a number of knots from 2 to"),
        (["--parameter", DRAG, "--criterion", "E"], "'E' is not a criterion"),
        (
            ["--parameter", DRAG, "--parameter", STIFFNESS, "--criterion", "c"],
            "criterion c needs one parameter",
        ),
        (["--parameter", DRAG, "--noise", "position_m=0"], "positive"),
        (["--parameter", DRAG, "--relative-uncertainty", "-1"], "the uncertainty of"),
        (["none.toml", "--parameter", DRAG], "none.toml"),
    ],
)
def test_one_sentence(tmp_path, capsys, options, words):
    typed = ["design", *options, "--links", "2", "--out", str(tmp_path / "o"), "--quiet"]
    assert main(typed) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def test_another_model_is_one_sentence():
    joint = giajax.build_model("joint", {"joint": {}}, {})
    with pytest.raises(InputError, match="give the model of an arm"):
        design_experiment(joint, [DRAG])
