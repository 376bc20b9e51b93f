"""A linear model with normal noise, whose repeated fits have closed-form distributions."""

import dataclasses
import itertools

import numpy as np
import pytest
from line import FREE, SIGMA, Line, columns

import giajax
from giajax import InputError
from giajax.noise import ChannelNoise
from giajax.studies import Bootstrap, _bootstrap

SIZE = 96


@pytest.fixture(scope="module")
def found(result, runs):
    return giajax.bootstrap(result, runs, size=SIZE, seed=3)


def exact_errors(runs):
    """Return the square roots of the diagonal of sigma^2 (X^T X)^-1."""
    rows = [
        columns(run.times)[name][~np.isnan(values)]
        for run in runs
        for name, values in run.observations.items()
    ]
    x = np.concatenate(rows)
    return SIGMA * np.sqrt(np.diag(np.linalg.inv(x.T @ x)))


def test_the_spread_is_that_of_the_linear_model(found, runs):
    assert (found.size, found.came_back, found.reasons, found.failures) == (SIZE, SIZE, {}, ())
    for path, error in zip(FREE, exact_errors(runs), strict=True):
        one = found.parameters[path]
        expected = 1 / np.sqrt(2 * (SIZE - 1))
        assert abs(one.spread / error - 1) < 3.5 * expected, path
        assert abs(one.ratio - one.spread / one.standard_error) < 1e-12
        assert one.ratio_error == pytest.approx(expected, rel=0.3)
        assert abs(one.bias) < 3.5 * one.bias_error
        low, high = one.coverage_interval
        assert low < 0.95 < high
        assert one.coverage == one.covered / one.asked
        values = np.asarray(one.values)
        assert one.percentile == pytest.approx(np.quantile(values, [0.025, 0.975]))
        assert one.basic == pytest.approx(2 * one.value - np.quantile(values, [0.975, 0.025]))


def test_what_is_known_before_is_drawn_anew(result, runs):
    """A prior with as much information as the data acts like another measurement."""
    path = FREE[0]
    estimate = result.parameters[path]
    error = estimate.standard_error
    prior = giajax.Prior(estimate.value + 3 * error, deviation=error)
    known = giajax.fit(
        Line(), runs, free=FREE, priors={path: prior}, noise_model="white", check=False
    )
    one = giajax.bootstrap(known, runs, size=SIZE).parameters[path]
    assert abs(one.ratio - 1) < 3.5 / np.sqrt(2 * (SIZE - 1))
    assert abs(one.bias) < 3.5 * one.bias_error
    with pytest.raises(InputError, match="a fit with priors cannot be repeated as a whole"):
        giajax.bootstrap(known, runs, whole=True)


def test_a_repetition_is_the_least_squares_of_its_data(result, runs, found):
    """The first repetition, solved in NumPy without the cells that were not measured."""
    optimum = giajax.studies.optimum_of(result, runs)
    recorded = _bootstrap.noisy(optimum, np.random.default_rng([3, 0]))
    x, y = [], []
    for run, again in zip(runs, recorded, strict=True):
        for name, values in run.observations.items():
            np.testing.assert_array_equal(np.isnan(again[name]), np.isnan(values))
            x.append(columns(run.times)[name][~np.isnan(values)])
            y.append(again[name][~np.isnan(values)])
    best = np.linalg.lstsq(np.concatenate(x), np.concatenate(y), rcond=None)[0]
    values = [found.parameters[path].values[0] for path in FREE]
    np.testing.assert_allclose(values, best, atol=0.02 * exact_errors(runs).min())


def test_numbers_do_not_depend_on_parts_and_go_on_in_a_folder(
    result, runs, found, tmp_path, monkeypatch
):
    monkeypatch.setattr(_bootstrap, "CHUNK", 3)
    done = []
    options = {"size": 5, "seed": 3, "folder": tmp_path}
    few = giajax.bootstrap(result, runs, progress=lambda *_: done.append(1), **options)
    for path in FREE:
        assert few.parameters[path].values == found.parameters[path].values[:5]
    assert len(done) == 2

    def fails(*_, **__):
        raise RuntimeError("nothing is done twice")

    # The key of a task contains the name of its function.
    fails.__module__, fails.__qualname__ = _bootstrap.__name__, "replicates"
    monkeypatch.setattr(_bootstrap, "replicates", fails)
    assert giajax.bootstrap(result, runs, **options) == few
    with pytest.raises(InputError, match=r"were completed: RuntimeError .*: nothing is done twice"):
        giajax.bootstrap(result, runs, **{**options, "seed": 4})
    assert giajax.bootstrap(result, runs, **{**options, "size": 6}).failures


def test_blocks_and_whole_fits_spread_as_much(result, runs):
    blocks = giajax.bootstrap(result, runs, size=24, method="block")
    assert blocks.block_lengths == {"line1": 4, "line2": 4}
    whole = giajax.bootstrap(result, runs, size=2, whole=True)
    assert not any("noise is fixed" in note for note in whole.notes)
    for path in FREE:
        assert 0.5 < blocks.parameters[path].ratio < 1.6
        assert blocks.parameters[path].coverage is None
        assert abs(whole.parameters[path].bias) < 4
        assert whole.parameters[path].asked == 2


def test_it_is_json(found):
    assert Bootstrap.of_json(found.to_json()) == found
    with pytest.raises(InputError, match=r"not a valid bootstrap\.json file of this version"):
        Bootstrap.of_json("{}")


@pytest.mark.quick
def test_blocks_are_rows_that_follow_each_other():
    """The residuals are row numbers, which shows that channels and neighbours stay together."""
    rows = np.arange(30.0)
    rest = np.stack([rows, rows + 100], axis=-1)
    source = _bootstrap.Residuals(("a", "b"), np.zeros((30, 2)), rest, 5)
    again = source.again(np.random.default_rng(0))
    np.testing.assert_array_equal(again["b"] - again["a"], 100)
    for block in again["a"].reshape(6, 5):
        np.testing.assert_array_equal(np.diff(block) % 30, 1)
    starts = [source.again(np.random.default_rng(seed))["a"][0] for seed in range(300)]
    assert set(starts) == set(rows)

    holes = rest.copy()
    holes[3:9, 1] = np.nan
    filled = _bootstrap.Residuals(("a", "b"), np.zeros((30, 2)), holes, 5).again(
        np.random.default_rng(1)
    )
    np.testing.assert_array_equal(np.isnan(filled["b"]), np.isnan(holes[:, 1]))


@pytest.mark.quick
def test_blocks_are_longer_where_residuals_remember():
    """The formula of Politis and White for an AR(1), with and without a noise model."""
    from line import recorded

    run = recorded(1)
    white = np.random.default_rng(0).normal(size=(40, 1))
    assert _bootstrap.block_length(run, white, [ChannelNoise(1.0)]) == 4
    step, rho = run.times[1], 0.8
    noise = ChannelNoise(0.0, 1.0, -step / np.log(rho))
    best = (6 * rho**2 / (1 - rho**2) ** 2 * 40) ** (1 / 3)
    assert _bootstrap.block_length(run, white, [noise]) == min(int(np.ceil(best)), 13)
    walk = np.cumsum(white, axis=0)
    assert _bootstrap.block_length(run, walk - walk.mean(), [ChannelNoise(1.0)]) == 13


@pytest.mark.quick
def test_what_few_repetitions_say():
    one = _bootstrap.repeated(1.0, 0.5, "m", [1.1], [0.2])
    assert (one.spread, one.bias, one.percentile, one.covered, one.asked) == (
        None,
        None,
        None,
        1,
        1,
    )
    none = _bootstrap.repeated(1.0, None, "m", [1.0, 2.0], [None, None])
    assert (none.ratio, none.coverage, none.asked) == (None, None, 0)
    assert none.spread == pytest.approx(np.sqrt(0.5))
    # From tables of Clopper and Pearson: 8 of 10, 10 of 10.
    assert _bootstrap.binomial_interval(8, 10) == pytest.approx((0.4439, 0.9748), abs=1e-4)
    assert _bootstrap.binomial_interval(10, 10) == pytest.approx((0.6915, 1.0), abs=1e-4)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"size": 1}, "the number of repetitions is 1: give at least 2"),
        ({"method": "jackknife"}, "unknown bootstrap method 'jackknife': use one of"),
        ({"seed": -1}, "the seed is -1: give 0 or"),
    ],
)
def test_what_cannot_be_repeated_is_refused(result, runs, options, sentence):
    with pytest.raises(InputError, match=sentence):
        giajax.bootstrap(result, runs, **options)


def test_a_fit_that_did_not_converge_is_not_repeated(result, runs):
    stopped = dataclasses.replace(result, status="not_converged")
    with pytest.raises(InputError, match="did not converge"):
        giajax.bootstrap(stopped, runs)


@pytest.mark.quick
def test_drawn_noise_has_the_covariance_of_its_model():
    """White and correlated noise, across a gap, and wider where robust weights are smaller."""
    from giajax.noise import drawn

    times = np.array([0.0, 0.1, 0.3, 2.0, 2.1])
    noises = [ChannelNoise(0.5, 1.0, 0.7), ChannelNoise(0.3)]
    weights = np.ones((5, 2))
    weights[2, 1] = 0.25
    random = np.random.default_rng(0)
    draws = np.stack([drawn(noises, times, weights, random) for _ in range(8_000)])
    apart = np.abs(times[:, None] - times)
    expected = np.exp(-apart / 0.7) + 0.25 * np.eye(5)
    np.testing.assert_allclose(np.cov(draws[:, :, 0].T), expected, atol=0.07)
    expected = 0.09 * np.diag([1, 1, 4, 1, 1])
    np.testing.assert_allclose(np.cov(draws[:, :, 1].T), expected, atol=0.02)
    for a, b in itertools.product(range(5), repeat=2):
        assert abs(np.mean(draws[:, a, 0] * draws[:, b, 1])) < 0.05
