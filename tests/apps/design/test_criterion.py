"""Design criteria, the selection of markers, and command limits, without an arm."""

import itertools
import math

import numpy as np
import pytest

from giajax import InputError
from giajax.apps.design import (
    CommandSeries,
    Criterion,
    Limits,
    Search,
    base_step,
    chosen_markers,
    covariance_of,
    starts_of,
)
from giajax.studies import expected_errors

pytestmark = pytest.mark.quick

RANDOM = np.random.default_rng(3)


def information(size=4, rows=30):
    jacobian = RANDOM.normal(size=(rows, size)) * [30.0, 10.0, 5.0, 40.0][:size]
    return jacobian.T @ jacobian


def test_c_of_one_parameter_is_its_standard_error():
    found = information()
    for index in range(4):
        value, _ = Criterion("c", tuple(np.eye(4)[index])).of_information(found)
        assert np.exp(value) == pytest.approx(expected_errors(found)[index], rel=1e-5)


def test_c_of_a_difference_has_the_covariance_in_it():
    found = information()
    inverse = np.linalg.inv(found)
    value, _ = Criterion("c", (1.0, -2.0, 0.0, 0.0)).of_information(found)
    variance = inverse[0, 0] + 4 * inverse[1, 1] - 4 * inverse[0, 1]
    assert np.exp(2 * value) == pytest.approx(variance, rel=1e-5)


def test_a_is_the_trace_of_the_covariance_and_not_of_its_inverse():
    """The trace is over the parameters of interest, others being free (Pyomo.DoE inverted it)."""
    found = information()
    value, _ = Criterion("A", (1.0, 0.0, 1.0, 0.0)).of_information(found)
    inverse = np.linalg.inv(found)
    assert np.exp(2 * value) == pytest.approx(inverse[0, 0] + inverse[2, 2], rel=1e-5)
    assert np.exp(2 * value) == pytest.approx(np.sum(expected_errors(found)[[0, 2]] ** 2), rel=1e-5)


def test_d_orders_experiments_alike_in_any_parameters():
    """A linear change of the parameters adds the same constant for every experiment."""
    one, other = information(3), information(3)
    turn = RANDOM.normal(size=(3, 3))
    criterion = Criterion("D", (1.0, 1.0, 1.0))
    plain = criterion.of_information(one)[0] - criterion.of_information(other)[0]
    turned = (
        criterion.of_information(turn.T @ one @ turn)[0]
        - criterion.of_information(turn.T @ other @ turn)[0]
    )
    assert turned == pytest.approx(plain, abs=1e-4)
    trace = Criterion("A", (1.0, 1.0, 1.0))
    before = trace.of_information(one)[0] - trace.of_information(other)[0]
    after = (
        trace.of_information(turn.T @ one @ turn)[0]
        - trace.of_information(turn.T @ other @ turn)[0]
    )
    assert abs(after - before) > 1e-3


@pytest.mark.parametrize(
    ("kind", "weights"), [("c", (0.5, -2.0, 0, 0)), ("A", (1, 1, 0, 0)), ("D", (1, 0, 1, 1))]
)
def test_slopes_are_those_of_differences(kind, weights):
    found = information()
    criterion = Criterion(kind, tuple(map(float, weights)))
    _, slope = criterion.of_information(found)
    way = RANDOM.normal(size=(4, 4))
    way = way + way.T
    ahead, behind = (criterion.of_information(found + s * 1e-3 * way)[0] for s in (1, -1))
    assert np.sum(slope * way) == pytest.approx((ahead - behind) / 2e-3, rel=1e-5)


def test_what_nothing_responds_to_weighs_nothing():
    found = information()
    found[3], found[:, 3] = 0.0, 0.0
    value, slope = Criterion("c", (1.0, 0, 0, 0)).of_information(found)
    assert np.exp(value) == pytest.approx(expected_errors(found)[0], rel=1e-5)
    assert np.all(np.isfinite(slope))
    assert covariance_of(found)[3, 3] == pytest.approx(1e4)


def test_what_the_data_do_not_tell_is_not_determined():
    """The data determine only the sum of two parameters, and a third one very poorly."""
    jacobian = np.asarray([[10.0, 10.0, 0.0], [0.0, 0.0, 1e-3]])
    found = jacobian.T @ jacobian
    assert Criterion("c", (2.0, 2.0, 0.0)).is_determined(found)
    for kind, weights in [
        ("c", (1.0, 0.0, 0.0)),
        ("c", (1.0, -1.0, 0.0)),
        ("c", (0.0, 0.0, 1.0)),
        ("A", (1.0, 1.0, 0.0)),
        ("D", (1.0, 0.0, 1.0)),
    ]:
        assert not Criterion(kind, weights).is_determined(found)
        assert Criterion(kind, weights).is_determined(found + np.eye(3))


def test_what_makes_no_criterion_is_one_sentence():
    with pytest.raises(InputError, match="'E' is not a criterion: use one of c, A, D"):
        Criterion("E", (1.0,))
    with pytest.raises(InputError, match="no parameter to estimate is given"):
        Criterion("A", (0.0, 0.0))


def errors(informations):
    return float(np.mean([np.trace(np.linalg.inv(one + 1e-3 * np.eye(2))) for one in informations]))


def bodies(count):
    rows = RANDOM.normal(size=(count, 2, 3, 2))
    return np.einsum("bdri,bdrj->bdij", rows, rows)


def test_few_markers_are_the_best_of_all_choices():
    each = bodies(7)
    best = min(
        itertools.combinations(range(7), 3), key=lambda some: errors(each[list(some)].sum(axis=0))
    )
    assert chosen_markers(errors, each, 3) == best
    with pytest.raises(InputError, match="8 markers are requested: give a number from 1 to 7"):
        chosen_markers(errors, each, 8)


def test_of_many_markers_no_exchange_helps():
    each = bodies(40)
    found = chosen_markers(errors, each, 4)
    now = errors(each[list(found)].sum(axis=0))
    for place, new in itertools.product(range(4), set(range(40)) - set(found)):
        some = [*found[:place], new, *found[place + 1 :]]
        assert errors(each[some].sum(axis=0)) >= now


LIMITS = Limits(joints=(1, 3), angle=0.5, rate=0.3, duration=12.0)


def test_no_series_leaves_the_limits():
    """This also holds for series far outside the limits, and after rounding by the optimiser."""
    series = CommandSeries.of(LIMITS, 7)
    wanted = [5 * RANDOM.normal(size=series.size), *starts_of(series, 9), np.ones(series.size)]
    for numbers in wanted:
        table = series.at(series.within(numbers)).table()
        assert np.all(np.abs(table) <= LIMITS.angle)
        rates = np.diff(table, axis=0) / np.diff(series.times)[:, None]
        assert np.all(np.abs(rates) <= LIMITS.rate)
    # The limits are reached, so the test is not trivial.
    assert np.max(np.abs(table)) == pytest.approx(LIMITS.angle)
    assert np.max(rates) == pytest.approx(LIMITS.rate, rel=0.3)
    inside = series.within(0.01 * np.ones(series.size))
    np.testing.assert_allclose(inside, 0.01)
    matrix = series.constraint()
    moved = matrix.A @ series.within(wanted[0])
    assert np.all((matrix.lb - 1e-12 <= moved) & (moved <= matrix.ub + 1e-12))


def test_the_base_step_is_that_of_the_paper():
    limits = Limits(angle=math.radians(30), rate=math.radians(30))
    drive = base_step(limits, 16).drive()
    rows = drive.at(np.asarray([0.0, 0.5, 1.0, 1.5, 25.0]))["joint01_command"]
    np.testing.assert_allclose(np.degrees(rows), [0, 0, 15, 30, 30], atol=1e-12)


def test_a_search_that_is_stopped_has_the_best_so_far():
    series = CommandSeries.of(LIMITS, 3)
    wanted = series.within(np.full(series.size, 0.4))
    told = []

    class Bowl:
        markers = (0,)

        def __call__(self, numbers):
            return float(np.sum((numbers - wanted) ** 2))

        def slope(self, numbers):
            return 2 * (numbers - wanted)

        def choose(self, numbers):
            """Do nothing, because there is only one body."""

    def stop(evaluation):
        told.append(evaluation)
        if len(told) == 6:
            raise KeyboardInterrupt

    search = Search(Bowl(), series, stop)
    search.follow(starts_of(series, 4), 1, 50)
    assert search.status == "interrupted"
    assert search.value == min(one.value for one in told) == Bowl()(search.best)
    whole = Search(Bowl(), series)
    whole.follow(starts_of(series, 4), 1, 50)
    assert whole.status == "converged"
    short = Search(Bowl(), series)
    short.follow(starts_of(series, 4), 1, 1)
    assert short.status == "iteration limit"
    np.testing.assert_allclose(whole.best, wanted, atol=0.02)

    def at_once(evaluation):
        raise KeyboardInterrupt

    class Nothing(Bowl):
        def __call__(self, numbers):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Search(Nothing(), series, at_once).follow(starts_of(series, 2), 1, 5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angle": 0.0}, "the largest angle is 0: give"),
        ({"angle": 1e300}, "deg: give at most 180 deg"),
        ({"rate": math.inf}, "the largest rate is inf: give"),
        ({"joints": ()}, "no joint is given"),
        ({"joints": (1, 1)}, "given twice"),
        ({"duration": 0.25}, "does not give a whole number"),
        ({"duration": 1e9}, "rows, but may have at most 100000: shorten"),
    ],
)
def test_limits_that_make_no_sense_are_one_sentence(change, words):
    with pytest.raises(InputError, match=words):
        Limits(**change)
