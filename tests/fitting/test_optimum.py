"""The optimum of a fit, evaluated and refitted, compared with separate fits."""

import dataclasses

import numpy as np
import pytest

import giajax
from giajax import InputError
from giajax.studies import optimum_of
from toy_model import Decay, run

FREE = ["amplitude", "decay", "offset"]


@pytest.fixture(scope="module")
def runs():
    first, second = run(seed=1), run(seed=2)
    return [dataclasses.replace(first, name="first"), dataclasses.replace(second, name="second")]


@pytest.fixture(scope="module")
def result(runs):
    return giajax.fit(Decay(), runs, free=FREE, noise_model="white")


@pytest.fixture(scope="module")
def optimum(result, runs):
    return optimum_of(result, runs)


def errors_of(result):
    return [result.parameters[path].standard_error for path in FREE]


def values_of(result):
    return np.asarray([result.parameters[path].value for path in FREE])


def test_it_is_where_the_fit_ended(result, runs, optimum):
    assert optimum.labels == tuple(FREE)
    np.testing.assert_allclose(optimum.values, values_of(result), rtol=1e-14)
    np.testing.assert_allclose(optimum.cost, result.cost, rtol=1e-12)
    known = optimum.statistics.standard_errors
    np.testing.assert_allclose([known[i] for i in range(3)], errors_of(result), rtol=1e-9)
    for mine, theirs in zip(optimum.predictions, result.predictions, strict=True):
        np.testing.assert_allclose(mine["tip_z"], theirs["tip_z"], rtol=1e-12)


def test_from_elsewhere_it_comes_back(result, optimum):
    errors = np.asarray(errors_of(result))
    again = optimum.refit(start=optimum.values + 5 * errors * [1, -1, 1])
    assert again.converged
    np.testing.assert_allclose(again.values, optimum.values, atol=0.02 * errors.min())


def test_what_is_held_stays_and_the_others_follow(result, runs, optimum):
    value = result.parameters["decay"].value + 3 * result.parameters["decay"].standard_error
    held = optimum.refit(held={"decay": value})
    others = giajax.fit(
        Decay(), runs, free=["amplitude", "offset"], fix={"decay": value}, noise_model="white"
    )
    assert held.values[1] == value
    # Both are as close to their optimum as the stopping criterion of a fit requires.
    for path, place in (("amplitude", 0), ("offset", 2)):
        estimate = others.parameters[path]
        assert abs(held.values[place] - estimate.value) < 0.02 * estimate.standard_error
    assert held.cost > optimum.cost


def test_a_run_left_out_is_not_there(runs, result, optimum):
    left = [run.observations for run in runs]
    left[1] = {"tip_z": np.full_like(left[1]["tip_z"], np.nan)}
    without = optimum.refit(recorded=left)
    alone = giajax.fit(Decay(), runs[0], free=FREE, noise_model="white")
    assert without.converged
    assert np.all(np.abs(without.values - values_of(alone)) < 0.02 * np.asarray(errors_of(alone)))
    assert np.any(np.abs(without.values - optimum.values) > 0.1 * np.asarray(errors_of(result)))


def test_at_other_values_the_jacobian_is_that_of_the_residual(optimum):
    there = optimum.values * [1.02, 0.97, 1.1]
    jacobian = optimum.at(there).jacobian
    for place in range(3):
        step = np.zeros(3)
        step[place] = 1e-6
        ahead, behind = optimum.at(there + step), optimum.at(there - step)
        slope = (ahead.residual - behind.residual) / 2e-6
        np.testing.assert_allclose(jacobian.times(step * 1e6), slope, rtol=1e-6, atol=1e-5)


def test_what_cannot_be_is_refused(optimum):
    with pytest.raises(InputError, match="'idle' was not free in this fit"):
        optimum.refit(held={"idle": 1.0})
    with pytest.raises(
        InputError, match="decay cannot be fixed at 10, which is outside its bounds"
    ):
        optimum.refit(held={"decay": 10.0})


def test_where_the_model_fails_a_refit_says_so(optimum):
    failed = optimum.refit(held={"decay": 8.5})
    assert (failed.converged, failed.reason) == (False, "wall")


def test_correlated_noise_is_that_of_the_fit(runs):
    """Correlated noise and robust weights of cells are recovered from the records."""
    rng = np.random.default_rng(3)
    slow = np.zeros(60)
    for i in range(1, 60):
        slow[i] = 0.9 * slow[i - 1] + 0.005 * rng.normal()
    values = {"tip_z": runs[0].observations["tip_z"] + slow}
    values["tip_z"][20] += 0.4
    drifting = giajax.Run.from_arrays(
        runs[0].times, values, name="drifting", definition={"free_motion": True}
    )
    result = giajax.fit(Decay(), drifting, free=FREE, loss="huber")
    assert result.runs[0].channels["tip_z"].correlated > 0
    again = optimum_of(result, [drifting])
    assert again.cost == pytest.approx(result.cost, rel=0.02)
    back = again.refit(start=again.values * 1.05)
    assert np.all(np.abs(back.values - values_of(result)) < 0.1 * np.asarray(errors_of(result)))
