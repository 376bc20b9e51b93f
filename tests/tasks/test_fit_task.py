"""A fit as data: the precedence of settings, and equality with a fit by hand."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import FitTask, InputError, fit, load_result, model_for, read_run
from giajax.fitting import prediction_errors
from giajax.recordings import Definition
from giajax.tasks import _preparation
from small_loops import write_task

# Any finished fit can be used where none is run.
FINISHED = Path(__file__).parents[1] / "fitting" / "earlier"


@pytest.fixture
def path(tmp_path):
    return write_task(tmp_path)


def test_a_task_is_made_without_jax(path):
    code = (
        "import sys, giajax; "
        f"task = giajax.FitTask.load({str(path)!r}).on_top(free=['elastic'], starts=3); "
        "giajax.FitTask.of('a.csv').on_top(tolerance=1e-8); "
        "sys.exit(str({'jax', 'equinox', 'matplotlib'} & set(sys.modules) or '') or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)


def test_files_are_beside_the_definition_and_results_are_not(path):
    task = FitTask.load(path)
    assert task.data == (path.parent / "loops.csv",)
    assert task.validation == (path.parent / "other.csv",)
    assert str(task.out) == "giajax-out/loops_fit"
    assert str(FitTask.of(["there/a.csv"]).out) == "giajax-out/a"
    assert FitTask.of("a.csv") == FitTask.of([Path("a.csv")])
    assert str(task.on_top(out="here").out) == "here"
    assert str(task.on_top(data=["a.csv"]).data[0]) == "a.csv"
    assert task.on_top(validation="b.csv").validation == (Path("b.csv"),)


def test_the_last_word_on_a_parameter_counts(path):
    before = FitTask.load(path)
    task = before.on_top(fix={"weights[0]": 0.7}, start={"offset": 0.05, "elastic": 0.4})
    settings = task.definition.fit
    assert settings.free == ["elastic"]
    assert settings.start == {"offset": 0.05, "elastic": 0.4}
    assert settings.fix == {"weights[0]": 0.7}
    # Settings that are not mentioned are kept, and the previous task is unchanged.
    assert settings.loss == "soft_l1"
    assert before.definition.fit.fix == {"offset": 0.1}
    assert before.definition == Definition.load(path)
    freed = task.on_top(free=["weights[0]", "offset"]).definition.fit
    assert (freed.free, freed.fix) == (["weights[0]", "offset"], {})


@pytest.mark.parametrize(
    ("settings", "part"),
    [
        ({"loss": "cauchy"}, "the arguments: fit.loss"),
        ({"tolerance": -1.0}, "fit.tolerance"),
        ({"max_iterations": 0}, "fit.max_iterations"),
        ({"starts": 0}, "fit.starts"),
    ],
)
def test_a_wrong_setting_is_one_sentence(path, settings, part):
    with pytest.raises(InputError, match=part):
        FitTask.load(path).on_top(**settings)


def test_an_array_starts_and_is_held_element_by_element(path):
    path.write_text(
        path.read_text()
        .replace("[0.2]", "[0.2, 0.4]")
        .replace('"weights[0]" = 0.3', "weights = [0.3, 0.1]")
        .replace('["elastic", "weights[0]"]', '["elastic", "weights"]')
    )
    task = FitTask.load(path)
    setup = task.prepare().setup
    assert_allclose(setup.model.operator.weights, [0.3, 0.1])
    assert setup.config["start"] == {"weights": [0.3, 0.1]}
    held = task.on_top(fix={"weights": [0.5, 0.25]}).prepare().setup
    assert_allclose(held.model.operator.weights, [0.5, 0.25])
    assert [parameter.path for parameter in held.parameters] == ["elastic"]
    # A single value applies to all elements, and so does a list with one value.
    alike = task.on_top(start={"weights": [0.2]}).prepare().setup
    assert_allclose(alike.model.operator.weights, [0.2, 0.2])
    assert alike.config["start"] == {"weights": 0.2}
    with pytest.raises(InputError, match=r"weights is set to 3 values, but has 2 elements: give"):
        task.on_top(start={"weights": [0.1, 0.2, 0.3]}).prepare()


def test_no_data_is_one_sentence():
    with pytest.raises(InputError, match="no data: give"):
        FitTask(Definition()).run()


def test_it_is_the_fit_by_hand_with_its_validation(path):
    told = []
    result = FitTask.load(path).run(told.append)
    definition = Definition.load(path)
    run, other = (
        read_run(path.parent / name, definition=definition) for name in ("loops.csv", "other.csv")
    )
    by_hand = fit(
        model_for([run]),
        run,
        free=["elastic", "weights[0]"],
        start={"weights[0]": 0.3},
        fix={"offset": 0.1},
        loss="soft_l1",
    )
    assert result.status == "converged"
    assert [iteration.number for iteration in told] == list(range(result.iterations + 1))
    for name, truth in (("elastic", 0.5), ("weights[0]", 0.8)):
        estimate = result.parameters[name]
        assert abs(estimate.value - truth) < 3.5 * estimate.standard_error
        assert estimate.value == pytest.approx(by_hand.parameters[name].value, rel=1e-12)
    assert result.config == by_hand.config
    assert result.validation == (prediction_errors(result.model, other),)
    (channel,) = result.validation[0].channels.values()
    assert channel.rmse == pytest.approx(0.005, rel=0.4)
    assert channel.largest > channel.rmse


def test_settings_reach_the_fit(path):
    task = FitTask.load(path)
    announced = []
    several = task.on_top(starts=2, seed=3, spread=0.5, loss="huber", max_iterations=1).run(
        announce=lambda number, start: announced.append((number, start)), check=False
    )
    assert [number for number, _ in announced] == [1, 2]
    assert announced[0][1]["weights[0]"] == 0.3
    assert [start.start for start in several.starts] == [start for _, start in announced]
    assert several.status == "not_converged"
    for key, value in {"starts": 2, "seed": 3, "spread": 0.5, "max_iterations": 1}.items():
        assert several.config[key] == value
    assert several.config["loss"] == "huber"


def test_an_interruption_of_the_validation_keeps_the_fit(path, monkeypatch):
    finished = load_result(FINISHED)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(_preparation, "solve", lambda *_, **__: finished)
    monkeypatch.setattr(_preparation, "prediction_errors", interrupt)
    result = FitTask.load(path).run()
    assert result.status == "interrupted"
    assert result.message == f"{finished.message}; interrupted before the validation was complete"
    assert result.parameters == finished.parameters
    assert result.validation == ()


def test_a_solver_is_refused_where_there_is_none(path):
    for settings in ({"solver": "tsit5"}, {"tolerance": 1e-8}):
        with pytest.raises(InputError, match="hysteresis model has neither a solver nor a tol"):
            FitTask.load(path).on_top(**settings).prepare()


ARM = """
[arm]
links = 2
[initial]
first_row = true
free = true
[fit]
data = ["swing.csv"]
window_s = 1.0
solver = "dopri8"
tolerance = 1e-5
channels = ["joint01_angle"]
"""


def test_the_definition_of_an_arm_says_solver_and_windows(tmp_path):
    times = np.linspace(0, 3, 61)
    rows = [f"{t:.4g},{np.cos(t):.6g},{np.sin(t):.6g}" for t in times]
    head = "time_s,joint01_angle_rad,joint02_angle_rad"
    (tmp_path / "swing.csv").write_text("\n".join([head, *rows]) + "\n")
    (tmp_path / "swing_fit.toml").write_text(ARM)
    task = FitTask.load(tmp_path / "swing_fit.toml")
    ready = task.prepare()
    assert len(ready.runs) == 3
    assert all(list(run.observations) == ["joint01_angle"] for run in ready.runs)
    assert (ready.setup.model.solver, float(ready.setup.model.tolerance)) == ("dopri8", 1e-5)
    again = task.on_top(solver="heun", tolerance=1e-4).prepare().setup
    assert (again.config["solver"], again.config["tolerance"]) == ("heun", 1e-4)
    assert again.config["definition"]["simulation"]["solver"] == "heun"
    # Setting one of the two keeps the other.
    assert task.on_top(solver="heun").prepare().setup.config["tolerance"] == 1e-5
    with pytest.raises(InputError, match="there is no solver 'euler'"):
        task.on_top(solver="euler").prepare()
    assert_allclose(ready.runs[1].times[0], 1.0)
