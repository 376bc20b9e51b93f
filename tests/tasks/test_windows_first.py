"""A long swing of a pendulum with unknown frequency is fitted in windows, then as a whole."""

import numpy as np
import pytest

from giajax import FitTask, InputError, Run, model_for, predict, read_run
from giajax.cli import main
from giajax.fitting import load_result
from giajax.recordings import windows, write_run
from giajax.tasks import with_warm_start

TRUTH, NOISE_DEG = 0.6, 0.05
ARM = {"preset": "pendulum", "links": 1, "parameters": {"links.mass": 0.3}}


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Simulate forty seconds with about thirty periods, about a rest angle that is not straight."""
    path = tmp_path_factory.mktemp("swing") / "swing.csv"
    times = np.arange(1001) / 25
    parameters = ARM["parameters"] | {"links.centre_of_mass": TRUTH}
    released = {"arm": {**ARM, "parameters": parameters}, "initial": {"angle_deg": [20.0]}}
    plan = Run.from_arrays(times, {"joint01_angle": np.zeros_like(times)}, definition=released)
    noise = np.deg2rad(NOISE_DEG) * np.random.default_rng(1).normal(size=len(times))
    seen = predict(model_for([plan]), plan)["joint01_angle"] + noise
    about = {"initial": {"free": True, "first_row": True}, "noise": {"angle_deg": NOISE_DEG}}
    run = Run.from_arrays(times, {"joint01_angle": seen}, definition={"arm": ARM, **about})
    write_run(path, run.times, run.values, definition=run.definition, digits=9)
    return path


FREE, START = ["links.centre_of_mass"], {"links.centre_of_mass": 0.9}


@pytest.mark.long
def test_a_frequency_that_is_far_off_is_found(recording, tmp_path, capsys):
    # Without windows, the frequency is also found, starting with the first rows.
    task = FitTask.of(recording).on_top(free=FREE, start=START)
    assert task.run(check=False).reduced_chi_square == pytest.approx(1, abs=0.15)
    # The file gives the free parameters, the output shows the windows, and the repeated fit has
    # none.
    definition, out = tmp_path / "fit.toml", tmp_path / "out"
    definition.write_text(
        f'[fit]\ndata = ["{recording.as_posix()}"]\nfree = ["links.centre_of_mass"]\n'
        '[fit.start]\n"links.centre_of_mass" = 0.9\n'
    )
    quick = ["--no-figures", "--no-suspects"]
    words = ["fit", str(definition), "--windows-first", "3", *quick, "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr().err
    assert "first fit in 13 windows" in said
    assert "in windows: converged in" in said
    found = load_result(out)
    estimate = found.parameters["links.centre_of_mass[0]"]
    assert abs(estimate.value - TRUTH) < 3 * estimate.standard_error
    assert found.reduced_chi_square == pytest.approx(1, abs=0.15)
    # The result is that of the whole run, whose initial state was that of the first window.
    assert [run.name for run in found.runs] == ["swing"]
    assert found.task["begin"]["own"].keys() == {"swing"}
    assert main(["fit", "--again", str(out), *quick]) == 0
    again = capsys.readouterr()
    assert "windows" not in again.err
    assert "all numbers are identical, bit for bit" in again.out


@pytest.mark.slow
def test_a_gyroscope_alone_says_where_windows_begin(recording, tmp_path):
    """The rates contain no angles; each window starts near its rest, and its state is estimated."""
    run = read_run(recording)
    angle = run.values["joint01_angle"]
    rate = np.gradient(angle, run.times) + 0.002 * np.random.default_rng(2).normal(size=len(angle))
    swing = Run.from_arrays(
        run.times,
        {"joint01_rate": rate},
        definition={"arm": ARM, "initial": {"free": True, "first_row": True}},
    )
    path = write_run(tmp_path / "swing.csv", swing.times, swing.values, definition=swing.definition)
    task = FitTask.of(path).on_top(free=FREE, start=START, windows_first_s=3.0)
    found = with_warm_start(task).run(check=False)
    estimate = found.parameters["links.centre_of_mass[0]"]
    assert found.status == "converged"
    assert abs(estimate.value - TRUTH) < 0.005


def resting(**initial):
    about = {"arm": ARM, "initial": initial} if initial else {"free_motion": True}
    return Run.from_arrays(np.arange(9.0), {"joint01_rate": np.zeros(9)}, definition=about)


def test_what_one_sentence_advises_is_no_error_of_the_next():
    with pytest.raises(InputError, match="and also free = true if angles are not recorded"):
        windows(resting(), 4.0)
    with pytest.raises(InputError, match="let the fit estimate the initial state with free = true"):
        model_for([resting(first_row=True)]).prepare(resting(first_row=True))
    run = resting(first_row=True, free=True)
    assert len(windows(run, 4.0)) == 2
    model_for([run]).prepare(run)


@pytest.mark.quick
def test_either_windows_or_whole_runs():
    with pytest.raises(
        InputError, match="has window_s and windows_first_s, but the latter fits whole"
    ):
        FitTask.of("swing.csv").on_top(window_s=2.0, windows_first_s=3.0)
