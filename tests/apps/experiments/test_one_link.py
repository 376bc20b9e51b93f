"""The 1-link experiment: the protocol, the simulated joint, and the effect of compensation."""

from types import SimpleNamespace

import numpy as np
import pytest

from giajax.apps import experiments
from giajax.apps.experiments import (
    SimulatedJoint,
    figure_12,
    history,
    one_link,
    other_history,
    paper_history,
)


@pytest.fixture(scope="module")
def study():
    return one_link()


def test_the_protocol_is_the_papers():
    plan = paper_history()
    assert set(np.abs(np.diff(plan.target))) == {1.0}
    turns = plan.target[1:-1][np.diff(plan.target)[1:] * np.diff(plan.target)[:-1] < 0]
    assert turns.tolist() == [60, -60, 60, -60]
    # The second repetition is measured: 0, 60, -60, 0.
    assert np.count_nonzero(plan.measured) == 241
    assert plan.target[plan.measured][[0, 60, 180, 240]].tolist() == [0, 60, -60, 0]
    held = np.diff(plan.times)
    np.testing.assert_array_equal(held, np.where(np.abs(plan.target[1:]) <= 30, 20.0, 5.0))


def test_the_other_history_is_another_one():
    plan = other_history()
    turns = plan.target[1:-1][np.diff(plan.target)[1:] * np.diff(plan.target)[:-1] < 0]
    assert len(turns) > 12
    assert np.max(np.abs(plan.target[plan.measured])) < 60


def test_the_joint_snaps_through_a_gap():
    joint = SimulatedJoint(pressure_noise=0.0)
    angles = joint.angles(paper_history().target)
    ahead, behind = joint.gap
    assert not np.any((angles > -0.97 * behind) & (angles < 0.97 * ahead))
    assert np.max(np.abs(np.diff(angles))) > 0.95 * (ahead + behind)
    # At rest, each branch is an increasing function of the drive.
    drive = np.linspace(-60, 60, 1001)
    settled = joint.rest_angles(drive)
    assert np.all(np.diff(settled) > 0)
    assert settled[[0, -1]] == pytest.approx([-60, 60], abs=2.5)
    # A drive below the snap-through limit does not change the branch.
    assert joint.rest_angles(np.asarray([5.0, -0.9 * joint.snap]))[1] > 0
    assert joint.rest_angles(np.asarray([-5.0, 0.9 * joint.snap]))[1] < 0


def test_its_hysteresis_does_not_depend_on_the_sampling():
    joint = SimulatedJoint(pressure_noise=0.0)
    coarse = history("coarse", (0, 40, -20, 30)).target
    fine = np.interp(np.arange(0, len(coarse) - 0.5, 0.5), np.arange(len(coarse)), coarse)
    np.testing.assert_allclose(joint.drive(fine)[::2], joint.drive(coarse), atol=2e-3)


def test_the_noise_is_that_of_two_markers():
    joint = SimulatedJoint(pressure_noise=0.0)
    still = np.full(4000, 50.0)
    error = joint.measured(still) - joint.angles(still)
    assert np.mean(error) == pytest.approx(joint.inclination, abs=0.02)
    expected = np.rad2deg(np.sqrt(2) * joint.marker_noise / joint.marker_distance)
    assert np.std(error) == pytest.approx(expected, rel=0.05)
    assert not np.array_equal(joint.measured(still), joint.measured(still, trial=1))
    np.testing.assert_array_equal(
        joint.measured(still), SimulatedJoint(pressure_noise=0).measured(still)
    )


def test_no_trial_is_made_with_a_fit_that_was_stopped(monkeypatch):
    stopped = SimpleNamespace(status="interrupted")
    monkeypatch.setattr(experiments, "_identify", lambda recording: stopped)
    with pytest.raises(KeyboardInterrupt):
        one_link()


@pytest.mark.slow
def test_without_compensation_it_is_as_far_off_as_the_prototype(study):
    none = study.trial("paper", "none")
    print(f"none: mean {none.mean:.2f}, largest {none.largest:.2f} deg")
    assert none.mean == pytest.approx(11, abs=1)
    assert none.largest == pytest.approx(30, abs=5)
    # The offset of the camera is removed, so the median error is 0.
    assert np.median(none.errors) == pytest.approx(0, abs=1e-9)
    assert study.offset == pytest.approx(SimulatedJoint().inclination, abs=0.5)


@pytest.mark.slow
def test_eq_12_halves_the_mean_and_leaves_the_largest(study):
    for name in ("paper", "other"):
        none, branches = study.trial(name, "none"), study.trial(name, "branches")
        print(f"{name}: mean {branches.mean:.2f} of {none.mean:.2f} deg")
        assert branches.mean < none.mean / 2
    paper = study.trial("paper", "branches").largest / study.trial("paper", "none").largest
    assert 0.85 < paper < 1.15


@pytest.mark.slow
def test_the_inverse_brings_the_mean_below_a_quarter(study):
    for name in ("paper", "other"):
        none, inverse = study.trial(name, "none"), study.trial(name, "inverse")
        print(f"{name}: mean {inverse.mean:.2f} of {none.mean:.2f} deg")
        assert inverse.mean < none.mean / 4
        assert inverse.mean < study.trial(name, "branches").mean


@pytest.mark.slow
def test_away_from_the_gap_the_inverse_is_near(study):
    trial = study.trial("other", "inverse")
    target = trial.history.target[trial.history.measured]
    away = np.abs(target) > 20
    assert np.mean(np.abs(trial.errors[away])) < 1.0


@pytest.mark.slow
def test_the_figure_shows_all_trials(study):
    figure = figure_12(study)
    assert len(figure.axes) == len(study.trials) == 6
    for axes, trial in zip(figure.axes, study.trials, strict=True):
        _, curve = axes.lines
        np.testing.assert_array_equal(curve.get_ydata(), trial.angles[trial.history.measured])
        assert f"{trial.mean:.1f}" in axes.texts[0].get_text()
