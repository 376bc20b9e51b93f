"""Verdicts on residuals with a known origin."""

import dataclasses
from collections import Counter

import numpy as np
import pytest

from giajax.noise import ChannelNoise, Reason, Series, Verdict, judge, white_deviation

SIGMA = 0.01


def residuals(rng, *, samples=250, channels=3, runs=1, stated=True, memory=False, add=None):
    """Return series of white noise, or of stated correlated noise, after a fit of four columns."""
    times = np.arange(samples) * 0.1
    u = times / times[-1]
    columns = np.stack([np.exp(-3 * u), np.sin(3 * u), u, np.ones(samples)], axis=1)
    noise = ChannelNoise(SIGMA, SIGMA, 1.0) if memory else ChannelNoise(SIGMA)
    series = []
    for run in range(runs):
        for channel in range(channels):
            values = SIGMA * rng.normal(size=samples)
            if memory:
                decay = np.exp(-0.1)
                slow = rng.normal(size=samples)
                for i in range(1, samples):
                    slow[i] = decay * slow[i - 1] + np.sqrt(1 - decay**2) * slow[i]
                values = values + SIGMA * slow
            if add is not None:
                values = values + add(times, run, channel)
            values = values - columns @ np.linalg.lstsq(columns, values, rcond=None)[0]
            adopted = float(np.sqrt(np.sum(values**2) / (samples - 4)))
            series.append(
                Series(
                    run=f"run{run}",
                    channel=f"link{channel:02d}_z",
                    residual=values,
                    times=times,
                    stated=noise if stated else None,
                    key=f"link{channel:02d}_z",
                    adopted=noise.deviation if stated else adopted,
                    lost=4.0,
                )
            )
    return series


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [
        {"channels": 9},
        {"channels": 9, "stated": False},
        {"samples": 60, "channels": 1, "stated": False},
        {"samples": 100, "runs": 4, "stated": False},
        {"memory": True},
    ],
    ids=["stated", "not stated", "short", "runs", "with a memory"],
)
def test_noise_alone_is_seldom_accused(case):
    """At most 2 % of 300; the probability of 14 or more is below 1 %."""
    rng = np.random.default_rng(0)
    wrong = [judge(residuals(rng, **case), robust=False) for _ in range(300)]
    codes = Counter(reason.code for verdict in wrong for reason in verdict.reasons)
    assert sum(verdict.status != "adequate" for verdict in wrong) < 14, codes


@pytest.mark.parametrize("factor", [1.3, 2.5, 5.0, 25.0])
def test_noise_that_is_stated_far_too_large_is_no_proof_of_a_model(factor):
    rng = np.random.default_rng(1)
    stated = ChannelNoise(factor * SIGMA)
    series = [dataclasses.replace(each, stated=stated) for each in residuals(rng)]
    found = judge(series, robust=False)
    if factor < 3:  # data sheets are as cautious as this
        assert found.status == "adequate"
        return
    (reason,) = found.reasons
    assert (found.status, reason.code) == ("doubtful", "too_small")
    assert reason.size == pytest.approx(factor, rel=0.2)
    assert "times the residuals in link01_z, so the stated noise or the unit" in reason.sentence
    one = [*residuals(rng)[1:], series[0]]
    assert [reason.channels for reason in judge(one, robust=False).reasons] == [("link00_z",)]


def wave(times, run, channel):
    """Missing physics: slow, in one channel, as large as the noise."""
    return SIGMA * np.sqrt(2) * np.sin(2 * np.pi * times / 6) * (channel == 0)


@pytest.mark.parametrize("stated", [True, False])
@pytest.mark.parametrize(
    ("code", "add"),
    [
        ("correlation", wave),
        ("runs", lambda times, run, channel: 2 * wave(times, run, channel) * (run == 1)),
    ],
)
@pytest.mark.quick
def test_missing_physics_is_seen(stated, code, add):
    rng = np.random.default_rng(1)
    for _ in range(20):
        verdict = judge(residuals(rng, runs=2, stated=stated, add=add), robust=False)
        assert verdict.status == "inadequate"
        assert code in {reason.code for reason in verdict.reasons}
        assert any("link00_z" in reason.channels for reason in verdict.reasons)


@pytest.mark.quick
def test_noise_that_the_residuals_adopt_does_not_hide_a_wrong_model():
    """The estimated deviation makes chi-square 1, but second differences detect the wrong model."""
    (found,) = [
        reason
        for reason in judge(
            residuals(np.random.default_rng(2), stated=False, add=wave), robust=False
        ).reasons
        if reason.code == "differences"
    ]
    assert found.size == pytest.approx(np.sqrt(2), rel=0.15)
    assert "link00_z" in found.sentence


@pytest.mark.quick
def test_more_white_noise_than_stated_is_a_reason():
    rng = np.random.default_rng(3)
    verdict = judge(
        residuals(rng, samples=1004, add=lambda *_: 0.5 * SIGMA * rng.normal(size=1004)),
        robust=False,
    )
    assert [reason.code for reason in verdict.reasons] == ["noise"]
    assert verdict.reasons[0].size == pytest.approx(np.sqrt(1.25), rel=0.05)


@pytest.mark.quick
def test_significance_without_size_is_no_reason():
    """A noise excess of 5 % in 40,000 cells is significant, but unimportant."""
    rng = np.random.default_rng(4)
    verdict = judge(
        residuals(
            rng, samples=40_000, channels=1, add=lambda *_: 0.3 * SIGMA * rng.normal(size=40_000)
        ),
        robust=False,
    )
    assert verdict.status == "adequate"


@pytest.mark.quick
def test_a_drift_is_a_reason():
    series = residuals(np.random.default_rng(5), channels=1)
    (each,) = series
    drifting = each.where(np.ones(len(each), bool))
    drifting.residual[:] += 0.04 * (each.times / each.times[-1] - 0.5)
    codes = {reason.code for reason in judge([drifting], robust=False).reasons}
    assert "drift" in codes


@pytest.mark.quick
def test_outliers_of_a_robust_fit_are_no_reason():
    rng = np.random.default_rng(6)

    def spoiled():
        series = residuals(rng)
        for each in series:
            each.residual[::20] += 0.5
        return series

    assert judge(spoiled(), robust=True).status == "adequate"
    assert judge(spoiled(), robust=False).status == "inadequate"


@pytest.mark.quick
def test_noise_that_a_few_cells_make_is_a_doubt_where_they_count_in_full():
    """Five glitches in a channel cause a doubt; heavy-tailed or stated noise does not."""

    def glitches(times, run, channel):
        return 2.0 * (np.arange(len(times)) % 50 == 25) * (channel == 1)

    series = residuals(np.random.default_rng(4), stated=False, add=glitches)
    verdict = judge(series, robust=False)
    assert verdict.status == "doubtful"
    assert [reason.code for reason in verdict.reasons] == ["outliers"]
    assert verdict.reasons[0].channels == ("link01_z",)
    robust = judge(series, robust=True)
    assert "outliers" not in [reason.code for reason in robust.reasons]
    rng = np.random.default_rng(5)
    tails = residuals(rng, stated=False, add=lambda t, *_: 3 * SIGMA * rng.standard_t(3, len(t)))
    assert judge(tails, robust=False).status == "adequate"


def test_white_noise_is_that_of_the_fit_unless_it_is_surely_more():
    rng = np.random.default_rng(6)
    plain = [SIGMA * rng.normal(size=250) for _ in range(100)]
    adopted = [float(np.std(rest)) for rest in plain]
    pairs = list(zip(plain, adopted, strict=True))
    seen = [white_deviation(rest, None, size, in_time=True) for rest, size in pairs]
    assert sum(a != b for a, b in zip(seen, adopted, strict=True)) <= 2
    slow = plain[0] + 0.05 * np.sin(np.linspace(0, 6, 250))
    slow[::50] += 3.0
    slow[7] = np.nan
    taken = float(np.nanstd(slow))
    assert white_deviation(slow, None, taken, in_time=True) == pytest.approx(SIGMA, rel=0.2)
    assert white_deviation(slow, None, taken, in_time=False) == taken
    assert white_deviation(slow, 0.02, taken, in_time=True) == 0.02


def test_noise_that_was_resampled_is_not_that_of_a_few_cells():
    """Two of three cells are interpolated linearly, and no cell is a glitch."""
    rng = np.random.default_rng(8)
    recorded = SIGMA * rng.normal(size=401)
    rest = np.interp(np.arange(1201) / 3, np.arange(401), recorded) + 1e-9 * rng.normal(size=1201)
    assert 0.15 * SIGMA < white_deviation(rest, None, float(np.std(rest)), in_time=True) < SIGMA
    often = SIGMA * rng.normal(size=1000) + 50 * SIGMA * (rng.uniform(size=1000) < 0.05)
    seen = white_deviation(often, None, float(np.std(often)), in_time=True)
    assert seen == pytest.approx(SIGMA, rel=0.3)
    gappy = np.full(4000, np.nan)
    gappy[::3] = SIGMA * rng.normal(size=1334) + 5 * SIGMA * np.sin(np.linspace(0, 6, 1334))
    taken = float(np.nanstd(gappy))
    assert white_deviation(gappy, None, taken, in_time=True) == pytest.approx(SIGMA, rel=0.1)


def test_too_few_cells_are_not_judged():
    (each, *_) = residuals(np.random.default_rng(7))
    few = each.where(np.arange(len(each)) < 12)
    assert judge([few], robust=False).status == "not evaluated"


@pytest.mark.quick
def test_runs_may_differ_in_length_and_in_noise():
    """A long run with much noise and a short one with little, each with its own noise."""
    rng = np.random.default_rng(8)
    wrong = 0
    for _ in range(30):
        series = [
            Series(f"run{i}", "x", size * rng.normal(size=count), None, None, f"x{i}", size, 1.0)
            for i, (count, size) in enumerate([(1000, 10.0), (40, 1.0)])
        ]
        wrong += judge(series, robust=False).status == "inadequate"
    assert wrong <= 3


@pytest.mark.quick
def test_residuals_of_exactly_nothing_are_judged():
    times = np.arange(40.0)
    series = [Series(f"run{i}", "x", np.zeros(40), times, None, "x", 1.0, 1.0) for i in range(2)]
    assert judge(series, robust=False).status == "adequate"


@pytest.mark.quick
def test_a_doubt_makes_an_adequate_model_doubtful_and_no_other_better():
    doubt, other = Reason("suspect", "a delay", 1e-9, 4.0), Reason("end", "no optimum", 1.0, 1.0)
    doubtful = Verdict("adequate").doubted(other).doubted(doubt)
    assert (doubtful.status, doubtful.reasons) == ("doubtful", (doubt, other))
    assert doubtful.without("suspect") == Verdict("doubtful", (other,))
    assert doubtful.without("suspect").without("end") == Verdict("adequate")
    wrong = Verdict.inadequate([Reason("noise", "too large", 1e-12, 2.0)])
    assert wrong.doubted(doubt).status == "inadequate"
    assert wrong.doubted(doubt).without("suspect") == wrong
    assert doubtful.with_reason(wrong.reasons[0]).status == "inadequate"
