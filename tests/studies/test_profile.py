"""Profiles compared with closed forms and SciPy, and the limits at which they end."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq, lsq_linear
from scipy.stats import t as student

import giajax
from giajax import InputError, Run
from giajax.models.capabilities import Derived
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import parameter
from giajax.studies import ProfilePoint, interval_end, load_profiles, profile
from toy_model import Decay, Plain, run

TIMES = np.linspace(0.0, 4.0, 40)


class Cubic(Plain):
    """tip_z = offset + slope t + bend t^2, and derived quantities; linear in all parameters."""

    kind = "cubic"

    offset: Scalar = parameter(0.1, unit="m", doc="height", frozen=False)
    slope: Scalar = parameter(0.1, unit="m/s", doc="rate", frozen=False)
    bend: Scalar = parameter(0.1, unit="m/s^2", lower=0, doc="bend", frozen=False)

    def failure(self, inputs):
        return "never"

    def prepare(self, run):
        return jnp.asarray(run.times)

    def predict(self, inputs, channels):
        height = self.offset + self.slope * inputs + self.bend * inputs**2
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))

    def conditions(self, free, runs):
        return []

    def derived(self):
        return {"end": Derived(self.offset + 4 * self.slope, "m")}


class Timed(Decay):
    """The same decay, with its time constant."""

    kind = "timed"

    def derived(self):
        return {"time": Derived(1 / self.decay, "s")}


def recorded(bend, seed=0, state=True):
    height = 0.3 + 0.2 * TIMES + bend * TIMES**2
    noise = np.random.default_rng(seed).normal(scale=0.05, size=len(TIMES))
    return Run.from_arrays(
        TIMES,
        {"tip_z": height + noise},
        noise={"position": 0.05} if state else None,
        definition={"free_motion": True},
    )


def fitted(model, runs, **options):
    return giajax.fit(model, runs, noise_model="white", check=False, **options)


@pytest.fixture(scope="module")
def shallow():
    """Return a recording whose best bend is at its bound of zero, and the fit."""
    data = recorded(-0.02)
    result = fitted(Cubic(), data)
    assert result.parameters["bend"].value == 0
    return data, result


def test_of_a_linear_model_it_is_the_interval_of_the_standard_error():
    """By Student's t, because the noise is estimated; also for a derived quantity."""
    data = recorded(0.5, state=False)
    result = fitted(Cubic(), data)
    profiles = profile(result, data, ["offset", "slope", "bend", "end"])
    freedom = result.parameters["slope"].freedom
    assert 30 < freedom < 40
    for path, estimate in [*result.free.items(), ("end", result.derived["end"])]:
        found = profiles[path]
        width = student.ppf(0.975, freedom) * estimate.standard_error
        expected = estimate.value - width, estimate.value + width
        np.testing.assert_allclose(found.interval, expected, atol=1e-6 * width)
        np.testing.assert_allclose(found.linear, expected, atol=1e-6 * width)
        assert found.ended == ("level", "level")
        assert found.remarks == ()
        pulls = [(point.value - found.value) / found.standard_error for point in found.points]
        deviances = [point.deviance for point in found.points]
        np.testing.assert_allclose(deviances, np.square(pulls), atol=1e-4)
        assert max(deviances) < (found.reach + 0.6) ** 2


def test_of_one_parameter_it_is_where_the_chi_square_says():
    data = run(sigma=0.4, samples=30)
    held = {"amplitude": 2.0, "offset": 0.3}
    result = fitted(Decay(), data, free=["decay"], fix=held)
    found = profile(result, data)["decay"]
    recorded_z = data.observations["tip_z"]

    def beyond(decay):
        left = recorded_z - 2.0 * np.exp(-decay * data.times) - 0.3
        return np.sum((left / 0.4) ** 2) - best - student.ppf(0.975, np.inf) ** 2

    best = 0.0
    best = beyond(found.value) + student.ppf(0.975, np.inf) ** 2
    low, high = brentq(beyond, 0.05, found.value), brentq(beyond, found.value, 5.0)
    width = high - low
    np.testing.assert_allclose(found.interval, (low, high), atol=1e-4 * width)
    assert abs(found.linear[0] - low) > 0.02 * width


def test_a_derived_quantity_has_the_interval_of_what_it_follows_from():
    """A profile does not depend on the parametrisation, unlike a standard error."""
    data = run(sigma=0.4, samples=30, seed=1)
    result = fitted(Timed(), data)
    profiles = profile(result, data, ["decay", "time"])
    low, high = profiles["decay"].interval
    np.testing.assert_allclose(profiles["time"].interval, (1 / high, 1 / low), rtol=2e-3)
    assert abs(profiles["time"].linear[0] - 1 / high) > 0.1 / high


def test_at_a_bound_it_is_one_sided_and_others_are_told_of(shallow):
    """SciPy's bounded least squares gives the same deviance at every point."""
    data, result = shallow
    profiles = profile(result, data, ["offset", "bend"])
    bend = profiles["bend"]
    assert bend.ended == ("bound", "level")
    assert bend.interval[0] == 0
    assert bend.remarks[0] == "one-sided: its lower limit is its bound"
    columns = np.stack([np.ones(40), TIMES, TIMES**2], axis=1) / 0.05
    wanted = data.observations["tip_z"] / 0.05

    def cost(held, place):
        lower = np.array([-np.inf, -np.inf, 0.0])
        left = np.delete(columns, place, axis=1)
        box = np.delete(lower, place), np.full(2, np.inf)
        return 2 * lsq_linear(left, wanted - held * columns[:, place], box, tol=1e-14).cost

    best = 2 * lsq_linear(columns, wanted, ([-np.inf, -np.inf, 0], np.inf), tol=1e-14).cost
    for name, place in (("offset", 0), ("bend", 2)):
        for point in profiles[name].points:
            assert point.deviance == pytest.approx(cost(point.value, place) - best, abs=1e-3)
    # The upper limit is lower than the standard error suggests, because the data favour a negative
    # bend.
    assert bend.interval[1] < 0.8 * bend.linear[1]
    offset = profiles["offset"]
    away = [point.value for point in offset.points if not point.at_bounds]
    assert offset.remarks == (f"bend leaves its bound at {min(away):.5g}",) or offset.remarks == (
        f"bend leaves its bound at {max(away):.5g}",
    )


def test_another_that_meets_its_bound_is_told():
    data = recorded(0.01, seed=4)
    result = fitted(Cubic(), data)
    assert result.parameters["bend"].value > 0.005
    found = profile(result, data, ["slope"])["slope"]
    first = min(point.value for point in found.points if point.at_bounds == ("bend",))
    assert found.value < first < found.interval[1]
    assert found.remarks == (f"bend reaches its bound at {first:.5g}",)


def test_what_only_counts_together_has_no_end():
    data = run(seed=1)
    result = fitted(Decay(), data, free=["amplitude", "twin", "decay", "idle"])
    profiles = profile(result, data, ["twin", "idle"])
    assert profiles["twin"].ended[1] == "flat"
    assert profiles["twin"].interval[1] is None
    assert "the data give no upper limit" in profiles["twin"].remarks
    assert profiles["twin"].interval[0] < 0.1
    assert len(profiles["twin"].points) < 40
    assert profiles["idle"].remarks[0].endswith("no channel responds to this quantity")


def test_a_fit_that_was_not_at_its_optimum_is_told(shallow):
    """The result did not converge, or was edited by a user."""
    data = recorded(0.5)
    result = fitted(Cubic(), data)
    estimate = result.parameters["slope"]
    off = estimate.value + 0.3 * estimate.standard_error
    model = giajax.replace(result.model, {"slope": off})
    parameters = {**result.parameters, "slope": dataclasses.replace(estimate, value=off)}
    moved = dataclasses.replace(result, model=model, parameters=parameters)
    found = profile(moved, data, ["slope"])["slope"]
    assert found.lowest < -1
    assert "the fit was not at its optimum" in found.remarks[0]
    right = profile(result, data, ["slope"])["slope"].interval
    np.testing.assert_allclose(found.interval, right, atol=0.02 * estimate.standard_error)


def test_it_goes_on_where_it_was_stopped_and_is_read_again(shallow, tmp_path):
    data, result = shallow
    seen = []

    def stop(outcome, done, total):
        seen.append((done, total))
        if len(seen) == 3:
            raise KeyboardInterrupt

    first = profile(result, data, folder=tmp_path / "tasks", progress=stop)
    assert seen == [(1, 6), (2, 6), (3, 6)]
    assert first["offset"].complete
    assert first["slope"].ended[1] == "stopped"
    assert "the search for its upper limit was stopped" in first["slope"].remarks
    whole = profile(result, data, folder=tmp_path / "tasks", progress=lambda *at: seen.append(at))
    assert len(seen) == 6
    assert whole["offset"] == first["offset"]
    (tmp_path / "profiles.json").write_text(whole.to_json())
    assert load_profiles(tmp_path) == whole


def test_what_cannot_be_profiled_is_told_in_a_sentence(shallow):
    data, result = shallow
    with pytest.raises(InputError, match=r"'air\.drag' was neither free .* use one of"):
        profile(result, data, ["air.drag"])
    with pytest.raises(InputError, match="the level is 95"):
        profile(result, data, level=95)
    unfinished = dataclasses.replace(result, status="not_converged")
    with pytest.raises(InputError, match="the fit did not converge"):
        profile(unfinished, data)


@pytest.mark.quick
def test_an_end_is_the_first_crossing_above_the_lowest_point():
    values = np.linspace(-3.0, 3.0, 13)
    points = [ProfilePoint(float(v), float((v - 0.5) ** 2 - 0.25), ()) for v in values]
    assert interval_end(points, 1, 2.0) == pytest.approx(2.5, abs=1e-9)
    assert interval_end(points, -1, 2.0) == pytest.approx(-1.5, abs=1e-9)
    assert interval_end(points, 1, 2.6) is None
