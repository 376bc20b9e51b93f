"""Messages of a fit that goes wrong, and messages that it must not print."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from giajax.fitting import fit
from giajax.report import summary
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import parameter
from toy_model import TRUTH, Decay, run


class Signed(Decay):
    """A decay whose height may be negative, or zero initially."""

    height: Scalar = parameter(0.0, unit="m", doc="added to the amplitude", frozen=False)

    def predict(self, inputs, channels):
        values = self.height * jnp.exp(-self.decay * inputs) + self.offset
        return dict.fromkeys(channels, values), self.decay < 8


def changed(change, **about):
    """Return the recording with some cells changed."""
    recorded = run(**about)
    values = np.array(recorded.values["tip_z"])
    change(values)
    return dataclasses.replace(recorded, values={"tip_z": values})


def test_what_does_not_respond_at_the_start_is_asked_again_where_the_fit_ends():
    """Without a height, the decay has no effect; with one, it has."""
    result = fit(Signed(), run(), free=["height", "decay", "offset"],
                 start={"decay": 1.5}, noise_model="white")  # fmt: skip
    assert result.parameters["height"].value == pytest.approx(TRUTH["amplitude"], abs=0.05)
    assert result.status == "converged"
    decay = result.parameters["decay"]
    assert abs(decay.value - TRUTH["decay"]) < 4 * decay.standard_error
    assert not result.findings


def glitches(values):
    values[[7, 23, 41]] += [5.0, -4.0, 6.0]


def test_outliers_are_named_with_their_rows_and_what_tames_them():
    result = fit(Decay(), changed(glitches))
    (finding,) = [each for each in result.findings if each.code == "outliers"]
    assert "tip_z in sample 7, 23, 41" in finding.sentence
    assert "--loss student_t" in finding.advice
    tamed = fit(Decay(), changed(glitches), loss="student_t")
    assert "outliers" not in {each.code for each in tamed.findings}
    assert tamed.parameters["decay"].value == pytest.approx(TRUTH["decay"], abs=0.02)


def test_what_a_model_misses_in_a_part_of_the_motion_is_no_outlier():
    def late(values):
        values[54:] += 0.5

    assert "outliers" not in {each.code for each in fit(Decay(), changed(late)).findings}


def test_a_model_that_does_not_describe_the_data_is_not_helped_by_iterations_or_priors():
    def another(values):
        values[:] = 3 * np.sin(3 * np.linspace(0, 4, len(values)))

    free = ["amplitude", "decay", "offset", "idle"]
    result = fit(Decay(), changed(another, sigma=0.01), free=free, max_iterations=30)
    said = summary(result)
    assert "allow more iterations" not in said
    assert "give it a prior" not in said
    assert "giajax check" in said


def test_a_fit_that_is_on_its_way_may_have_more_iterations():
    result = fit(Decay(), run(), start={"decay": 6.0, "amplitude": 0.1}, max_iterations=2)
    assert result.reason == "iterations"
    assert "allow more iterations" in result.message


def test_a_fit_without_an_optimum_says_nothing_of_bounds():
    """The best offset is negative, and the fit ends before it gets there."""
    bounds = {"offset": (0.35, 5.0)}
    whole = fit(Decay(), run(), bounds=bounds, start={"offset": 0.4})
    assert "at_a_bound" in {each.code for each in whole.findings}
    for most in range(1, whole.iterations):
        part = fit(Decay(), run(), bounds=bounds, start={"offset": 0.4}, max_iterations=most)
        if part.status == "not_converged":
            assert not {"at_a_bound", "curved"} & {each.code for each in part.findings}
            assert "the best value is the bound" not in summary(part)
