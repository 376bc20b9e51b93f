"""The restricted likelihood: compared with its textbook form, and the resulting estimates."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.noise import (
    Cells,
    ChannelNoise,
    Restricted,
    Stated,
    estimate,
    grams,
    outlier_weights,
    small_sample,
)


def memory(times, time_s, rng):
    """Return an Ornstein-Uhlenbeck process with unit variance."""
    decay = np.exp(-np.diff(times) / time_s)
    values = rng.normal(size=len(times))
    for i in range(1, len(times)):
        values[i] = decay[i - 1] * values[i - 1] + np.sqrt(1 - decay[i - 1] ** 2) * values[i]
    return values


def smooth(times):
    """Return four columns like those of a fit of a slow motion."""
    u = times / times[-1]
    return np.stack([np.exp(-3 * u), np.sin(3 * u), u, np.cos(7 * u)], axis=1)


def of_run(times, values, columns, *, own=None, run=0, key="x"):
    start = np.linalg.lstsq(columns, values, rcond=None)[0]
    return Cells(
        key=key,
        run=run,
        times=times,
        weights=np.ones(len(values)),
        residual=values - columns @ start,
        shared=columns,
        own=np.zeros((len(values), 0)) if own is None else own,
    )


@pytest.mark.quick
def test_differences_of_it_are_those_of_the_textbook():
    """Two runs with one column each, and two channels with different noise."""
    rng = np.random.default_rng(0)
    times = np.sort(rng.uniform(0, 9, 25))
    shared = smooth(times)[:, :2]
    cells = [
        of_run(
            times,
            rng.normal(size=25),
            shared * (1 + run + i),
            own=rng.normal(size=(25, 1)),
            run=run,
            key=key,
        )
        for run in range(2)
        for i, key in enumerate(("x", "y"))
    ]
    noise = {"x": ChannelNoise(0.8, 0.5, 1.0), "y": ChannelNoise(1.2)}
    problem = Restricted.of(cells, noise)

    def textbook(of_x):
        parts, columns, residual = [], [], []
        for each in cells:
            now = of_x if each.key == "x" else noise["y"]
            v = now.white**2 * np.eye(25)
            if not now.is_white:
                v += now.correlated**2 * np.exp(-np.abs(times[:, None] - times) / now.time_s)
            parts.append(v)
            own = np.zeros((25, 2))
            own[:, each.run] = each.own[:, 0]
            columns.append(np.concatenate([each.shared, own], axis=1))
            residual.append(each.residual)
        x, e = np.concatenate(columns), np.concatenate(residual)
        inverse = np.zeros((100, 100))
        for i, v in enumerate(parts):
            inverse[25 * i : 25 * i + 25, 25 * i : 25 * i + 25] = np.linalg.inv(v)
        gram = x.T @ inverse @ x
        left = inverse - inverse @ x @ np.linalg.solve(gram, x.T @ inverse)
        logs = sum(np.linalg.slogdet(v)[1] for v in parts)
        return logs + np.linalg.slogdet(gram)[1] + e @ left @ e

    other = ChannelNoise(0.3, 1.0, 4.0)
    ours = problem.value("x", other) - problem.value("x", noise["x"])
    assert ours == pytest.approx(textbook(other) - textbook(noise["x"]), rel=1e-8)
    assert problem.with_noise("x", other).value("y", noise["y"]) == pytest.approx(
        problem.value("x", other)
    )


@pytest.mark.quick
@pytest.mark.parametrize("own", [False, True])
def test_with_priors_it_is_the_likelihood_of_parameters_that_are_drawn(own):
    """The third column equals the first, so a prior of one partly determines their sum."""
    rng = np.random.default_rng(4)
    times = np.sort(rng.uniform(0, 9, 30))
    columns = smooth(times)[:, [0, 1, 0]]
    mine = rng.normal(size=(30, 1))
    cells = of_run(times, rng.normal(size=30), columns, own=mine if own else None)
    deviations, off = np.array([0.3, 20.0, 0.1]), np.array([1.5, 0.2, -0.7])
    rows = np.column_stack([np.diag(1 / deviations), off])
    noise, other = ChannelNoise(0.8, 0.5, 1.0), ChannelNoise(0.3, 1.0, 4.0)
    problem = Restricted.of([cells], {"x": noise}, rows.T @ rows)

    def textbook(now):
        v = now.white**2 * np.eye(30) + columns @ np.diag(deviations**2) @ columns.T
        v += now.correlated**2 * np.exp(-np.abs(times[:, None] - times) / now.time_s)
        left = inverse = np.linalg.inv(v)
        value = np.linalg.slogdet(v)[1]
        if own:
            gram = mine.T @ inverse @ mine
            left = inverse - inverse @ mine @ np.linalg.solve(gram, mine.T @ inverse)
            value += np.linalg.slogdet(gram)[1]
        rest = cells.residual - columns @ (off * deviations)
        return value + rest @ left @ rest

    ours = problem.value("x", other) - problem.value("x", noise)
    assert ours == pytest.approx(textbook(other) - textbook(noise), rel=1e-8)


@pytest.mark.quick
def test_white_and_correlated_parts_are_told_apart():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.02, 0.08, 3000))
    values = 0.03 * rng.normal(size=3000) + 0.04 * memory(times, 0.7, rng)
    cells = of_run(times, values, smooth(times))
    problem = Restricted.of([cells], {"x": ChannelNoise(0.1)})
    (noise,) = estimate(problem, {"x": Stated()}, correlated=True).noise.values()
    assert noise.white == pytest.approx(0.03, rel=0.06)
    assert noise.correlated == pytest.approx(0.04, rel=0.15)
    assert noise.time_s == pytest.approx(0.7, rel=0.4)
    (white,) = estimate(problem, {"x": Stated()}, correlated=False).noise.values()
    assert white.is_white
    assert white.deviation == pytest.approx(0.05, rel=0.1)


@pytest.mark.quick
def test_stated_noise_is_kept_where_the_residuals_allow_it():
    rng = np.random.default_rng(2)
    times = np.arange(250) * 0.1
    values = 0.05 * memory(times, 1.0, rng)
    problem = Restricted.of([of_run(times, values, smooth(times))], {"x": ChannelNoise(0.05)})
    kept = estimate(problem, {"x": Stated(0.05)}, correlated=True).noise["x"]
    assert kept.deviation == pytest.approx(0.05)
    assert not kept.is_white
    left = estimate(problem, {"x": Stated(0.01)}, correlated=True).noise["x"]
    assert left.deviation > 0.03
    known = Stated(0.05, correlated=0.03, time_s=2.0)
    assert estimate(problem, {"x": known}, correlated=True).noise["x"] == known.noise


@pytest.mark.quick
def test_of_white_noise_the_degrees_of_freedom_are_those_of_students_t():
    rng = np.random.default_rng(4)
    times = np.arange(15) * 1.0
    columns = smooth(times)[:, :2]
    cells = of_run(times, rng.normal(size=15), columns)
    problem = Restricted.of([cells], {"x": ChannelNoise(1.0)})
    problem = estimate(problem, {"x": Stated()}, correlated=False)
    size = problem.noise["x"].deviation
    assert size**2 == pytest.approx(np.sum(cells.residual**2) / 13, rel=1e-4)
    covariance = size**2 * np.linalg.inv(columns.T @ columns)
    spread = small_sample(problem, [cells], covariance, {"x": Stated()})
    assert_allclose(spread.degrees_of_freedom, 13, rtol=0.01)
    assert_allclose(spread.covariance, covariance, rtol=0.01)


@pytest.mark.quick
def test_an_outlier_is_no_memory():
    rng = np.random.default_rng(5)
    times = np.arange(200) * 0.1
    noise = ChannelNoise(0.03, 0.04, 1.0)
    values = 0.03 * rng.normal(size=200) + 0.04 * memory(times, 1.0, rng)
    values[[50, 120]] += 1.0
    weights = outlier_weights(of_run(times, values, smooth(times)), noise)
    assert np.all(weights[[50, 120]] < 0.1)
    assert np.all(weights[[49, 51, 119, 121]] > 0.3)
    assert np.mean(weights == 1.0) > 0.6


def test_channels_are_passed_over_together_as_one_by_one():
    """At the same times and at different times; one channel has no cells left."""
    rng = np.random.default_rng(5)
    times = np.linspace(0.0, 10.0, 60)
    whole = [of_run(times, rng.normal(size=60), smooth(times)) for _ in range(3)]
    those = [*whole, whole[0].where(times < 5), whole[1].where(times < 0)]
    noise = ChannelNoise(0.6, 0.8, 1.5)
    for each, (gram, determinant) in zip(those, grams(those, noise), strict=True):
        alone, of_one = each.gram(noise)
        assert_allclose(gram, alone, rtol=1e-12, atol=1e-12)
        assert determinant == pytest.approx(of_one)


def test_far_guesses_of_the_size_lead_to_the_same():
    rng = np.random.default_rng(6)
    times = np.linspace(0.0, 10.0, 200)
    cells = of_run(times, 0.01 * rng.normal(size=200), smooth(times))
    for guess in (1.0, 1e-4):
        problem = Restricted.of([cells], {"x": ChannelNoise(guess)})
        found = estimate(problem, {"x": Stated()}, correlated=True).noise["x"]
        assert found.is_white
        assert found.deviation == pytest.approx(0.01, rel=0.1)


def test_a_chance_hit_among_many_channels_is_no_memory():
    """One channel in twenty looks correlated by chance; among sixty, usually none should."""
    times, rng = np.linspace(0, 10, 60), np.random.default_rng(3)
    names = [f"c{number}" for number in range(60)]
    cells = [of_run(times, rng.normal(size=60), smooth(times), key=name) for name in names]
    alone = sum(
        not estimate(
            Restricted.of([each], {each.key: ChannelNoise(1.0)}), {each.key: Stated()},
            correlated=True,
        ).noise[each.key].is_white
        for each in cells
    )  # fmt: skip
    assert alone > 0
    problem = Restricted.of(cells, dict.fromkeys(names, ChannelNoise(1.0)))
    found = estimate(problem, dict.fromkeys(names, Stated()), correlated=True)
    assert sum(not each.is_white for each in found.noise.values()) == 0
