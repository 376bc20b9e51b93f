"""The score test: compared with refits of linear problems, and its false-positive rate."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from giajax.noise import beyond_mixture
from giajax.studies._score import (
    Table,
    alike,
    drop_beyond,
    projected,
    scatter,
    score,
)

pytestmark = pytest.mark.quick
FREE = (-np.inf, np.inf)


def smooth(samples=200):
    t = np.linspace(0, 1, samples)
    return np.stack([np.ones_like(t), t, np.sin(5 * t), np.exp(-4 * t)], axis=-1)


def table(residual, fitted, asked, own=None, timed=True):
    count = len(residual)
    own = np.zeros((count, 0)) if own is None else own
    return Table(
        residual=residual[:, None],
        measured=np.ones((count, 1), bool),
        fitted=fitted[:, None],
        own=own[:, None],
        asked=asked[:, None],
        timed=timed,
    )


def squares(y, columns):
    return float(np.sum((y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]) ** 2))


def test_drop_and_estimate_are_those_of_a_refit():
    columns = smooth()
    y = columns @ [1.0, 2.0, 0.5, 0.3] + np.random.default_rng(1).normal(size=200)
    fitted, asked = columns[:, :2], columns[:, 2:]
    rest = projected([table(-y, fitted, asked)])
    one = score(rest, [0], [-np.inf], [np.inf])
    with_it = np.linalg.lstsq(columns[:, :3], y, rcond=None)[0]
    assert one.step[0] == pytest.approx(with_it[2], rel=1e-9)
    assert one.drop == pytest.approx(squares(y, fitted) - squares(y, columns[:, :3]), rel=1e-9)
    both = score(rest, [0, 1], [-np.inf] * 2, [np.inf] * 2)
    assert both.drop == pytest.approx(squares(y, fitted) - squares(y, columns), rel=1e-9)


def test_what_is_free_in_one_run_alone_is_taken_out_of_that_run():
    columns, noise = smooth(), np.random.default_rng(2).normal(size=(2, 200))
    own = np.ones((200, 1))
    asked = columns[:, 2:3]
    rest = projected([table(row, columns[:, 1:2], asked, own) for row in noise])
    # As one matrix, with a column of ones for each run.
    ones = np.kron(np.eye(2), own)
    whole = np.concatenate([np.tile(columns[:, 1:2], (2, 1)), ones], axis=1)
    y = noise.ravel()
    drop = squares(y, whole) - squares(y, np.column_stack([whole, np.tile(asked, (2, 1))]))
    assert score(rest, [0], [-np.inf], [np.inf]).drop == pytest.approx(drop, rel=1e-9)
    assert rest.parameters == 3


def test_at_a_bound_only_what_leads_inwards_counts():
    columns = smooth()
    for sign in (1, -1):
        y = sign * columns[:, 2] * 0.8 + np.random.default_rng(3).normal(size=200)
        rest = projected([table(-y, columns[:, :2], columns[:, 2:3])])
        one = score(rest, [0], [0.0], [np.inf])
        if sign > 0:
            both = score(rest, [0], [-np.inf], [np.inf])
            assert one.p_value == pytest.approx(both.p_value / 2)
            assert one.step[0] > 0
        else:
            assert (one.step[0], one.drop, one.p_value) == (0, 0, 1)


def test_a_step_ends_at_its_bound_and_is_worth_less():
    columns = smooth()
    y = columns[:, 2] * 20 + np.random.default_rng(4).normal(size=200)
    rest = projected([table(-y, columns[:, :2], columns[:, 2:3])])
    free, bounded = score(rest, [0], [-np.inf], [np.inf]), score(rest, [0], [-1.0], [1.0])
    assert bounded.step[0] == 1
    # The quadratic function of the step, evaluated at a part of the step.
    part = 1 / free.step[0]
    assert bounded.drop == pytest.approx(free.drop * (2 * part - part**2), rel=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
@pytest.mark.parametrize("tests", [1, 2])
def test_noise_alone_is_significant_as_often_as_it_says(rho, tests):
    """White and correlated noise that is not stated: 5 % significant, within 4 deviations."""
    columns, samples = smooth(600), 600
    random = np.random.default_rng(5)
    count = 0
    for _ in range(400):
        noise = np.zeros(samples)
        steps = random.normal(size=samples) * np.sqrt(1 - rho**2)
        noise[0] = random.normal()
        for i in range(1, samples):
            noise[i] = rho * noise[i - 1] + steps[i]
        rest = projected([table(noise, columns[:, :2], columns[:, 2:])])
        found = score(rest, list(range(tests)), [-np.inf] * tests, [np.inf] * tests)
        count += found.p_value < 0.05
    # A lower rate is acceptable, but not a rate that is higher by more than this.
    assert 0.01 < count / 400 < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 400)


def test_gaps_and_runs_without_time():
    """Unmeasured cells are ignored, and without time, cells have no neighbours."""
    columns = smooth()
    noise = np.random.default_rng(6).normal(size=200)
    full = table(noise, columns[:, :2], columns[:, 2:3])
    measured = full.measured.copy()
    measured[50:90] = False
    gappy = Table(
        np.where(measured, full.residual, 0), measured,
        full.fitted, full.own, full.asked, timed=True,
    )  # fmt: skip
    rest = projected([gappy])
    kept = measured[:, 0]
    y = noise[kept]
    drop = squares(y, columns[kept, :2]) - squares(y, columns[kept, :3])
    assert score(rest, [0], [-np.inf], [np.inf]).drop == pytest.approx(drop, rel=1e-9)
    smoothly = np.cumsum(noise)
    timed, static = (
        score(
            projected([table(smoothly, columns[:, :2], columns[:, 2:3], timed=timed)]),
            [0], [-np.inf], [np.inf],
        )
        for timed in (True, False)
    )  # fmt: skip
    assert timed.drop == static.drop
    assert timed.error[0] > 2 * static.error[0]


def test_columns_that_the_fit_cannot_tell_apart_are_alike():
    columns = smooth()
    asked = np.stack([columns[:, 2], columns[:, 2] + columns[:, 1], columns[:, 3]], axis=-1)
    rest = projected([table(np.ones(200), columns[:, :2], asked)])
    assert alike(rest, [0], [1]) == pytest.approx(1, abs=1e-9)
    assert alike(rest, [0], [2]) < 0.99


def with_priors(y, columns, known):
    """Return the weighted sum of squares of a fit in which each prior is a further row."""
    rows = np.concatenate([columns, np.pad(known[:, 1:], ((0, 0), (0, columns.shape[1] - 2)))])
    return squares(np.append(y, -known[:, 0]), rows)


def test_a_prior_is_one_more_row_and_keeps_a_parameter_from_imitating():
    columns, random = smooth(), np.random.default_rng(7)
    y = columns @ [0.1, 0.2, 0.3, 0.0] + random.normal(size=200)
    known = np.array([[0.5, 20.0, 0.0]])
    rest = projected([table(-y, columns[:, :2], columns[:, 2:3])], known)
    one = score(rest, [0], [-np.inf], [np.inf])
    drop = with_priors(y, columns[:, :2], known) - with_priors(y, columns[:, :3], known)
    assert one.drop == pytest.approx(drop, rel=1e-9)
    assert (rest.values, rest.parameters, list(rest.known)) == (200, 2, [200])
    # The trace of the hat matrix: a parameter with a prior costs less than a degree of freedom.
    gram = columns[:, :2].T @ columns[:, :2]
    trace = np.trace(np.linalg.solve(gram + np.diag([400.0, 0.0]), gram))
    assert rest.lost == pytest.approx(trace, rel=1e-9)
    assert 1 < rest.lost < 1.2
    # The same with a parameter that only one run has.
    own = dataclasses.replace(
        table(-y, columns[:, 1:2], columns[:, 2:3], own=columns[:, :1]), known=known[:, :2]
    )
    alone = projected([own])
    assert score(alone, [0], [-np.inf], [np.inf]).drop == pytest.approx(drop, rel=1e-9)
    assert alone.lost == pytest.approx(trace, rel=1e-9)
    assert (alone.values, alone.parameters) == (200, 2)


def test_with_priors_noise_alone_is_significant_as_often_as_it_says():
    """The true values are drawn from the priors: 5 % of 500 significant, within 4 deviations."""
    columns, random = smooth(60), np.random.default_rng(8)
    count = 0
    for _ in range(500):
        truth = random.normal(size=2) / [1.0, 3.0]
        y = columns[:, :2] @ truth + random.normal(size=60)
        known = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 3.0]])
        rest = projected([table(-y, columns[:, :2], columns[:, 2:3])], known)
        count += score(rest, [0], [-np.inf], [np.inf]).p_value < 0.05
    assert abs(count / 500 - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 500)


def test_what_a_column_takes_beyond_others_is_that_of_refits():
    columns = smooth()
    y = columns @ [1.0, 2.0, 0.5, 0.3] + np.random.default_rng(3).normal(size=200)
    rest = projected([table(-y, columns[:, :2], columns[:, 2:])])
    expected = squares(y, columns[:, :3]) - squares(y, columns)
    assert drop_beyond(rest, [1], [0]) == pytest.approx(expected, rel=1e-9)
    assert drop_beyond(rest, [0, 1], []) == pytest.approx(
        squares(y, columns[:, :2]) - squares(y, columns), rel=1e-9
    )


@pytest.mark.parametrize("weights", [[1.0], [2.0] * 5, [3, 1, 0.2, 0.01], np.geomspace(1, 1e-6, 9)])
def test_a_mixture_of_chi_squares(weights):
    weights = np.asarray(weights, dtype=float)
    drawn = np.random.default_rng(4).standard_normal((200_000, len(weights))) ** 2 @ weights
    for chance in (0.5, 0.1, 0.01, 0.001):
        value = float(np.quantile(drawn, 1 - chance))
        assert beyond_mixture(weights, value) == pytest.approx(chance, rel=0.2)
    if np.ptp(weights) == 0:
        far = 60 * weights.sum()
        assert np.log(beyond_mixture(weights, far)) == pytest.approx(
            np.log(chi2.sf(far / weights[0], len(weights))), rel=0.01
        )
    assert beyond_mixture(np.zeros(3), 1.0) == 1.0


def test_how_far_amounts_scatter_is_found_and_noise_is_not():
    """300 draws: without scatter, 5 % are significant; with scatter, its deviation is estimated."""
    random, columns = np.random.default_rng(7), smooth()
    asked = np.stack([np.sin(k * np.linspace(0, 3, 200)) for k in range(1, 9)], axis=-1)
    named, found = 0, []
    for _ in range(300):
        noise = random.normal(size=200)
        rest = projected([table(noise, columns[:, :2], asked)])
        named += scatter(rest, range(8)).p_value < 0.05
        moved = noise - asked @ random.normal(0, 0.5, size=8)
        there = scatter(projected([table(moved, columns[:, :2], asked)]), range(8))
        found.append((there.step[0], there.p_value))
    assert named / 300 < 0.05 + 4 * np.sqrt(0.05 * 0.95 / 300)
    deviations, chances = np.transpose(found)
    assert np.sqrt(np.mean(deviations**2)) == pytest.approx(0.5, rel=0.1)
    assert np.median(chances) < 1e-6
