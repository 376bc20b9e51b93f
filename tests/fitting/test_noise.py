"""Fits with correlated noise, and the statements of their results."""

import dataclasses
import json

import numpy as np
import pytest

from giajax import InputError
from giajax.fitting import Estimate, Noise, NoiseFit, RunFit, fit
from giajax.noise import Verdict
from giajax.recordings import Definition, Run
from giajax.report import summary
from giajax.runtime.records import from_plain
from toy_model import TRUTH, Decay, height, run

START = {"amplitude": 1.0, "decay": 1.2, "offset": 0.1}
TIMES = np.linspace(0.0, 20.0, 400)


def recording(
    seed=2, *, noise=None, white=0.03, correlated=0.04, time_s=0.5, add=0.0, times=TIMES, name="run"
):
    """Simulate the true model with white noise and AR(1) noise."""
    rng = np.random.default_rng(seed)
    memory = rng.normal(size=len(times))
    decay = np.exp(-np.diff(times) / time_s)
    for i in range(1, len(times)):
        memory[i] = decay[i - 1] * memory[i - 1] + np.sqrt(1 - decay[i - 1] ** 2) * memory[i]
    values = height(times) + white * rng.normal(size=len(times)) + correlated * memory + add
    return Run.from_arrays(
        times,
        {"tip_z": values},
        name=name,
        noise=noise,
        definition={"free_motion": True},
    )


@pytest.fixture(scope="module")
def correlated():
    return fit(Decay(), recording(), start=START)


def test_the_memory_is_measured_and_allowed_for(correlated):
    (channel,) = correlated.runs[0].channels.values()
    assert channel.correlated == pytest.approx(0.04, rel=0.3)
    assert 0.1 < channel.correlation_time_s < 1.5
    assert channel.innovation < channel.noise
    white = fit(Decay(), recording(), start=START, noise_model="white")
    for path, true in TRUTH.items():
        estimate = correlated.parameters[path]
        assert abs(estimate.value - true) < 3.5 * estimate.standard_error
        assert estimate.standard_error > 1.5 * white.parameters[path].standard_error
        low, high = estimate.interval
        assert high - low > 2 * 1.96 * estimate.standard_error
        assert estimate.freedom > 3
        assert correlated.noise.widening[path] > 1.5
    assert not white.noise.widening
    assert "correlated over" in summary(correlated)


def test_a_memory_that_nobody_stated_is_no_adequate_model(correlated):
    """Correlation may be noise or missing physics, so the verdict distrusts the noise model."""
    assert correlated.status == "converged"
    assert correlated.verdict.status == "inadequate"
    assert "correlation" in {reason.code for reason in correlated.verdict.reasons}
    assert correlated.headline.startswith("INADEQUATE MODEL: the residuals are correlated")
    assert "conditional on a model" in correlated.headline


def test_a_memory_that_is_stated_is_adequate():
    run = recording(noise={"position": 0.05})
    section = {"position_m": 0.05, "position_correlated_m": 0.04, "position_correlation_s": 0.5}
    known = dataclasses.replace(
        run, definition=run.definition.merged_with(type(run.definition).parse({"noise": section}))
    )
    result = fit(Decay(), known, start=START)
    assert result.verdict.status == "adequate"
    (channel,) = result.runs[0].channels.values()
    assert (channel.noise, channel.correlated) == pytest.approx((0.05, 0.04))
    assert result.parameters["decay"].freedom is None


@pytest.mark.parametrize(
    ("section", "sentence"),
    [
        ({"position_correlated_m": 0.04}, "add the other"),
        ({"position_correlated_m": 0.1, "position_correlation_s": 1.0}, "at least as large"),
    ],
)
@pytest.mark.quick
def test_half_a_statement_is_refused(section, sentence):
    with pytest.raises(InputError, match=sentence):
        Run.from_arrays(
            [0.0, 1.0, 2.0],
            {"tip_z": [0.0, 1.0, 2.0]},
            definition={"noise": {"position_m": 0.05, **section}},
        )


@pytest.mark.quick
def test_runs_that_state_another_memory_do_not_share_it():
    def known(time_s):
        plain = recording(noise={"position": 0.05})
        section = {"position_m": 0.05, "position_correlated_m": 0.04}
        section["position_correlation_s"] = time_s
        changed = type(plain.definition).parse({"noise": section})
        return dataclasses.replace(plain, definition=plain.definition.merged_with(changed))

    noise = Noise.of([known(0.1), known(10.0)], "correlated", per_run=False)
    assert [each["tip_z"].time_s for each in noise.values] == [0.1, 10.0]
    assert sorted(each.time_s for each in noise.by_key().values()) == [0.1, 10.0]
    white = Noise.of([known(0.1)], "white", per_run=False)
    assert white.values[0]["tip_z"].is_white
    assert white.values[0]["tip_z"].deviation == pytest.approx(0.05)


def test_an_unknown_noise_model_is_refused():
    with pytest.raises(InputError, match='must be "correlated" or "white"'):
        fit(Decay(), run(), noise_model="pink")


def test_outliers_among_correlated_noise_do_not_smear():
    spoiled = np.zeros(len(TIMES))
    spoiled[::20] = 1.0
    result = fit(Decay(), recording(add=spoiled), start=START, loss="huber")
    (channel,) = result.runs[0].channels.values()
    assert channel.noise == pytest.approx(0.05, rel=0.3)
    assert result.reduced_chi_square == pytest.approx(1.0, abs=0.4)
    clean = fit(Decay(), recording(), start=START)
    for path, true in TRUTH.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - true) < 3.5 * estimate.standard_error
        # An outlier has about the effect of a missing cell, whatever its size is.
        assert estimate.standard_error < 2 * clean.parameters[path].standard_error


def test_noise_is_one_in_all_runs_or_one_in_each():
    """The third run deviates; with its own noise it would get almost no weight."""
    runs = [run(seed=seed, state_noise=False) for seed in range(2)]
    odd = run(seed=2, state_noise=False)
    values = odd.observations["tip_z"] + 0.3 * np.sin(5 * odd.times)
    odd = dataclasses.replace(odd, values={"tip_z": values})
    together = fit(Decay(), [*runs, odd], start=START)
    noises = [fitted.channels["tip_z"].noise for fitted in together.runs]
    assert noises[0] == noises[1] == noises[2]
    assert together.verdict.status == "inadequate"
    assert "run2" in " ".join(reason.sentence for reason in together.verdict.reasons)
    alone = fit(Decay(), [*runs, odd], start=START, noise_per_run=True)
    noises = [fitted.channels["tip_z"].noise for fitted in alone.runs]
    assert noises[2] > 10 * noises[0]


def test_a_record_of_few_correlation_times_is_a_finding():
    short = recording(white=0.001, time_s=8.0)
    codes = {finding.code for finding in fit(Decay(), short, start=START).findings}
    assert "short_record" in codes
    words = {"position_m": 0.041, "position_correlated_m": 0.04, "position_correlation_s": 8.0}
    known = dataclasses.replace(short, definition=Definition.parse({"noise": words}))
    (found,) = fit(Decay(), known, start=START).runs
    assert found.channels["tip_z"].correlation_time_s == 8.0
    codes = {finding.code for finding in fit(Decay(), known, start=START).findings}
    assert "short_record" not in codes


def test_a_trend_over_the_whole_record_makes_no_error_smaller():
    """Noise that is stated far too large can only be interpreted as constant over the record."""
    long = np.linspace(0.0, 200.0, 4000)  # much longer than the decay
    cautious = recording(white=0.03, correlated=0.0, noise={"position": 0.6}, times=long)
    result = fit(Decay(), cautious, start=START)
    assert result.noise.trends == ["tip_z"]
    assert min(result.noise.widening.values()) >= 1 - 1e-9
    assert (result.verdict.status, result.verdict.reasons[0].code) == ("doubtful", "too_small")
    assert "the standard errors are not reduced" in summary(result)
    white = fit(Decay(), cautious, start=START, noise_model="white")
    for path in TRUTH:
        errors = [each.parameters[path].standard_error for each in (result, white)]
        assert errors[0] >= 0.95 * errors[1]


def test_it_is_stored(correlated):
    record = json.loads(correlated.to_json())
    assert from_plain(Verdict, record["verdict"]) == correlated.verdict
    assert NoiseFit(**record["noise"]) == correlated.noise
    assert from_plain(Estimate, record["parameters"]["decay"]) == correlated.parameters["decay"]
    assert from_plain(RunFit, record["runs"][0]) == correlated.runs[0]
