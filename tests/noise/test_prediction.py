"""Held-out data of linear fits: compared with dense least squares, for right and wrong models."""

import numpy as np
import pytest
from scipy.stats import kstest

from giajax.fitting import PredictedChannel, PredictionTest
from giajax.noise import Cells, ChannelNoise, Reason, Series, Verdict

quick = pytest.mark.quick

SIGMA = 0.01
SAMPLES = 60
TIMES = np.linspace(0.0, 6.0, SAMPLES)
SLOW = ChannelNoise(0.6 * SIGMA, 0.8 * SIGMA, 0.7)
LATE = TIMES > 4


def covariance(noise):
    apart = np.abs(TIMES[:, None] - TIMES[None])
    slow = np.exp(-apart / noise.time_s) if noise.correlated else 0.0
    return noise.white**2 * np.eye(SAMPLES) + noise.correlated**2 * slow


def drawn(rng, *, noise=None, held=None, runs=2, channels=2, add=None):
    """Simulate recordings of a shared line and decay, with an offset and a slope of each run.

    The residuals belong to arbitrary parameter values, not to an optimum.

    Arguments:
        noise: stated noise; None for white noise that is not stated.
        held: the held-out cells, by run and channel.
        add: effects that the model omits, by run and channel.
    """
    factor = np.linalg.cholesky(covariance(noise or ChannelNoise(SIGMA)))
    shared = np.stack([np.exp(-TIMES), np.sin(TIMES), np.zeros(SAMPLES)], axis=1)
    own = np.stack([np.ones(SAMPLES), TIMES], axis=1)
    off, own_off = np.array([3.0, -2.0, 5.0]), rng.normal(size=(runs, 2))
    foretold = []
    for run in range(runs):
        for channel in range(channels):
            columns = shared * (1 + channel)
            residual = factor @ rng.normal(size=SAMPLES) + columns @ off + own @ own_off[run]
            if add is not None:
                residual = residual + add(run, channel)
            if noise is None:
                # Second differences are computed from the residuals at the optimum of the fit.
                residual = residual - columns @ off - own @ own_off[run]
            name = f"link{channel:02d}_z"
            series = Series(f"run{run}", name, residual, TIMES, noise, name, SIGMA, 0.0)
            cells = Cells(name, run, TIMES, np.ones(SAMPLES), residual, columns, own)
            mask = (held or {}).get((run, channel), np.zeros(SAMPLES, bool))
            foretold.append(PredictedChannel(series, cells, mask))
    return foretold


def held_run(run=1, channels=2):
    return {(run, channel): np.ones(SAMPLES, bool) for channel in range(channels)}


HELD = {
    "the end of each": {(run, channel): LATE for run in range(2) for channel in range(2)},
    "a run": held_run(),
    "a channel": {(run, 1): np.ones(SAMPLES, bool) for run in range(2)},
}


def least(foretold, rows, prior):
    """Return chi-square and rank of a fit of some cells, by one dense matrix."""
    blocks, rests = [], []
    for each, kept in zip(foretold, rows, strict=True):
        own = np.zeros((SAMPLES, 4))
        own[:, 2 * each.cells.run :][:, :2] = each.cells.own
        root = np.linalg.inv(np.linalg.cholesky(covariance(each.noise)[np.ix_(kept, kept)]))
        blocks.append(root @ np.concatenate([each.cells.shared, own], axis=1)[kept])
        rests.append(root @ each.cells.residual[kept])
    blocks.append(np.concatenate([prior[None, :-1], np.zeros((1, 4))], axis=1))
    rests.append(prior[-1:])
    matrix, rest = np.concatenate(blocks), np.concatenate(rests)
    step = np.linalg.lstsq(matrix, -rest, rcond=1e-9)[0]
    return float(np.sum((rest + matrix @ step) ** 2)), np.linalg.matrix_rank(matrix, tol=1e-6)


@pytest.mark.parametrize("held", HELD.values(), ids=HELD)
@pytest.mark.parametrize("noise", [ChannelNoise(SIGMA), SLOW, None], ids=["white", "slow", "none"])
@quick
def test_it_is_what_chi_square_rises_by_where_the_held_cells_are_fitted_too(held, noise):
    foretold = drawn(np.random.default_rng(0), noise=noise, held=held)
    prior = np.array([0.3 / SIGMA, 0.0, 0.0, 0.7])
    test = PredictionTest(foretold, np.outer(prior, prior), robust=False)
    everything = [np.ones(SAMPLES, bool) for _ in foretold]
    before, rank = least(foretold, [~each.held for each in foretold], prior)
    after, whole = least(foretold, everything, prior)
    found = test._of([i for i, each in enumerate(foretold) if np.any(each.held)])
    assert found.statistic == pytest.approx(after - before, rel=1e-6)
    assert found.degrees_of_freedom == sum(int(np.sum(each.held)) for each in foretold) - (
        whole - rank
    )
    # The same for one channel of a run.
    at = next(i for i, each in enumerate(foretold) if np.any(each.held))
    rows = [~each.held | (np.arange(len(foretold))[i] == at) for i, each in enumerate(foretold)]
    after, whole = least(foretold, rows, prior)
    found = test.of(foretold[at].cells.run, foretold[at].series.channel)
    assert found.statistic == pytest.approx(after - before, rel=1e-6)
    assert found.degrees_of_freedom == int(np.sum(foretold[at].held)) - (whole - rank)


@quick
def test_what_only_the_held_run_knows_takes_nothing():
    """Its own offset and slope use two degrees of freedom, however large they are."""
    rng = np.random.default_rng(1)
    foretold = drawn(rng, noise=ChannelNoise(SIGMA), held=held_run())
    test = PredictionTest(foretold, np.zeros((4, 4)), robust=False)
    assert test.reason() is None
    assert test._of([2, 3]).degrees_of_freedom == 2 * SAMPLES - 2
    (each,) = drawn(rng, noise=ChannelNoise(SIGMA), runs=1, channels=1)
    two = np.arange(SAMPLES) >= SAMPLES - 2
    own = np.where(two[:, None], each.cells.own, 0.0)
    each = PredictedChannel(each.series, Cells(**{**vars(each.cells), "own": own}), two)
    alone = PredictionTest([each], np.zeros((4, 4)), robust=False)
    assert alone.of(0, "link00_z").size is None
    assert alone.reason() is None


@pytest.mark.parametrize("held", HELD.values(), ids=HELD)
@pytest.mark.parametrize("noise", [ChannelNoise(SIGMA), SLOW, None], ids=["white", "slow", "none"])
def test_p_values_of_the_right_model_are_uniform(held, noise):
    """Kolmogorov-Smirnov test at 0.1 % for 200 draws; few of them indicate a wrong model."""
    rng = np.random.default_rng(2)
    values, accused = [], 0
    for _ in range(200):
        foretold = drawn(rng, noise=noise, held=held)
        test = PredictionTest(foretold, np.zeros((4, 4)), robust=False)
        at = [i for i, each in enumerate(foretold) if np.any(each.held)]
        values.append(test._of(at).p_value)
        accused += test.reason() is not None
    if noise is None:
        # The noise is estimated from held-out cells, too, which makes extremes rarer.
        assert np.mean(np.array(values) < 0.05) < 0.08
    else:
        assert kstest(values, "uniform").pvalue > 1e-3
    # The expected rate is one in 300; five of 200 have a probability below 1 in 500.
    assert accused < 5


def bend(run, channel):
    """An effect that the model omits: it starts late and affects one channel."""
    return 0.06 * np.clip(TIMES - 4, 0, None) ** 2 * (channel == 1)


@pytest.mark.parametrize("noise", [ChannelNoise(SIGMA), None], ids=["stated", "not stated"])
@quick
def test_what_the_model_lacks_is_found(noise):
    foretold = drawn(np.random.default_rng(3), noise=noise, held=HELD["the end of each"], add=bend)
    test = PredictionTest(foretold, np.zeros((4, 4)), robust=False)
    reason = test.reason()
    assert reason.code == "prediction"
    assert reason.channels == ("link01_z",)
    assert reason.size > 3
    assert reason.p_value < 1e-6
    assert f"{reason.size:.3g} times those expected from noise" in reason.sentence
    assert test.of(0, "link01_z").size == pytest.approx(reason.size, rel=0.5)
    assert test.of(0, "link00_z").size < 1.5


@quick
def test_outliers_are_left_out_and_a_prediction_that_fails_is_not():
    rng = np.random.default_rng(4)

    def reason(*, robust, spoil=0.0, add=None):
        foretold = drawn(rng, held=HELD["the end of each"], add=add)
        for each in foretold:
            each.series.residual[::12] += spoil
        return PredictionTest(foretold, np.zeros((4, 4)), robust=robust).reason()

    assert reason(robust=True, spoil=0.5) is None
    assert reason(robust=True, spoil=0.5, add=bend).code == "prediction"


@quick
def test_a_reason_more():
    reasons = [Reason(code, code, p, 2.0) for code, p in (("a", 1e-9), ("b", 1e-5), ("c", 1e-7))]
    one = Verdict("adequate").with_reason(reasons[0])
    assert (one.status, one.reasons) == ("inadequate", (reasons[0],))
    all_of_them = one.with_reason(reasons[1]).with_reason(reasons[2])
    assert [reason.code for reason in all_of_them.reasons] == ["a", "c", "b"]
    few = Verdict("not evaluated", (Reason("cells", "too few", 1.0, 1.0),))
    assert few.with_reason(reasons[1]).reasons == (reasons[1],)
