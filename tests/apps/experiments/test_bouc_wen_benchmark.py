"""The Bouc-Wen benchmark: identifiable parameters are found, and a sweep is predicted."""

import dataclasses

import numpy as np
import pytest

from giajax import fit, model_for, predict
from giajax.apps.experiments import NOISE, bouc_wen_benchmark, decibels, multisine

# Initial guesses that are 30 % too large or too small.
START = {
    "mass": 1.3,
    "damping": 0.7,
    "stiffness": 0.7,
    "alpha": 1.3,
    "beta": 1.3,
    "gamma": 1.3,
    "delta": 0.7,
}


@pytest.fixture(scope="module")
def benchmark():
    return bouc_wen_benchmark()


@pytest.fixture(scope="module")
def result(benchmark):
    start = {path: factor * benchmark.truth[path] for path, factor in START.items()}
    free = [*START, "offset"]
    return fit(model_for([benchmark.multisine]), benchmark.multisine, free=free, start=start)


def test_the_force_is_as_stated():
    force = multisine(np.random.default_rng(3))
    assert np.sqrt(np.mean(force**2)) == pytest.approx(50)
    spectrum, frequencies = np.abs(np.fft.rfft(force)), np.fft.rfftfreq(8192, 1 / 750)
    inside = (frequencies >= 5) & (frequencies <= 150)
    np.testing.assert_allclose(spectrum[inside], spectrum[inside][0], rtol=1e-9)
    assert np.max(spectrum[~inside]) < 1e-9 * np.max(spectrum)


@pytest.mark.long
def test_it_converges_to_the_noise(result):
    assert result.status == "converged", result.message
    assert result.reduced_chi_square == pytest.approx(1, abs=4 * np.sqrt(2 / 8192))
    assert result.gradient_check.relative_difference < 1e-2
    assert result.tolerance_effect.largest_in_standard_errors < 0.2


@pytest.mark.long
def test_it_flags_the_collinear_parameters_by_itself(result):
    for path, others in (
        ("beta", "gamma, delta"),
        ("gamma", "beta, delta"),
        ("delta", "beta, gamma"),
    ):
        assert result.parameters[path].standard_error is None
        assert result.parameters[path].remark == (
            f"not determined individually: only a combination with {others} is"
        )
    assert not {"beta", "gamma", "delta"} & set(result.correlation.parameters)


@pytest.mark.long
def test_what_is_determined_is_within_two_and_a_half_standard_errors(result, benchmark):
    estimates = {**result.parameters, **result.derived}
    for name in ("mass", "damping", "stiffness", "alpha", "beta*gamma", "beta*delta"):
        estimate, truth = estimates[name], benchmark.truth[name]
        away = (estimate.value - truth) / estimate.standard_error
        print(f"{name}: {estimate.value:.6g} +- {estimate.standard_error:.2g}, {away:+.2f} errors")
        assert abs(away) < 2.5
        assert estimate.standard_error < 0.01 * abs(truth)


@pytest.mark.long
def test_it_predicts_a_sweep_that_it_did_not_see(result, benchmark):
    run = benchmark.sweep
    error = predicted_sweep(result, run) - run.values["output"]
    rms = float(np.sqrt(np.mean(error**2)))
    print(f"sweep: {1e3 * rms:.3g} mm RMS, {decibels(rms):.1f} dB; noise {decibels(NOISE):.1f} dB")
    assert rms < NOISE
    assert np.std(run.values["output"]) > 50 * NOISE


def predicted_sweep(result, run):
    """Predict the sweep, which is not a period of a band-limited signal."""
    return predict(dataclasses.replace(result.model, interpolation="linear"), run)["output"]
