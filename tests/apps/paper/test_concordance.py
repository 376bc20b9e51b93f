"""The measure of table 3, compared with a second implementation."""

import math
from fractions import Fraction

import numpy as np
import pytest

from giajax import InputError
from giajax.apps.paper import compared, concordance, relative_error

pytestmark = pytest.mark.quick

TIMES = [number / 10 for number in range(251)]


def by_hand(model, experiment):
    """1 - |Xm - Xe| / |Xe| from 10 to 25 s, sample by sample with exact fractions."""
    terms = []
    for tenth, (ours, theirs) in enumerate(zip(model, experiment, strict=True)):
        if not 100 <= tenth <= 250 or math.isnan(theirs) or theirs == 0:
            continue
        ours, theirs = Fraction(ours), Fraction(theirs)
        terms.append(1 - abs((ours - theirs) / theirs))
    return float(sum(terms) / len(terms)), len(terms)


@pytest.fixture
def curves():
    random = np.random.default_rng(3)
    experiment = np.sin(np.asarray(TIMES) / 3) + 0.02 * random.standard_normal(251)
    model = np.sin(np.asarray(TIMES) / 3.2)
    experiment[[120, 180]] = np.nan
    experiment[[50, 200]] = 0.0
    return model, experiment


def test_it_is_what_the_paper_defines(curves):
    model, experiment = curves
    rows = compared(np.asarray(TIMES))
    expected, count = by_hand(model, experiment)
    assert count == 151 - 3
    assert concordance(model[rows], experiment[rows]) == pytest.approx(expected, rel=1e-12)
    # The measure has no lower bound.
    assert concordance(-100 * model[rows], experiment[rows]) < -50


def test_simple_cases():
    ones = np.ones(5)
    assert concordance(ones, ones) == 1
    assert concordance(0 * ones, ones) == 0
    assert concordance(1.25 * ones, ones) == pytest.approx(0.75)
    assert concordance(3 * ones, -ones) == pytest.approx(-3)
    assert relative_error(ones, ones) == 0
    assert relative_error(0 * ones, 7 * ones) == 1
    assert relative_error(np.array([1.0, 1.0]), np.array([1.0, -1.0])) == pytest.approx(
        math.sqrt(2)
    )


def test_the_error_that_does_not_blow_up(curves):
    model, experiment = curves
    above = below = 0.0
    for ours, theirs in zip(model, experiment, strict=True):
        if not math.isnan(theirs):
            above += (ours - theirs) ** 2
            below += theirs**2
    assert relative_error(model, experiment) == pytest.approx(math.sqrt(above / below), rel=1e-12)


def test_every_tenth_of_a_second_is_compared():
    rows = compared(np.asarray(TIMES))
    assert len(rows) == 151
    assert np.allclose(np.asarray(TIMES)[rows], np.linspace(10, 25, 151))
    # Rows between the samples, such as corners of a command, are ignored.
    more = np.sort([*TIMES, 12.03])
    assert 12.03 not in more[compared(more)]
    with pytest.raises(InputError, match="no sample at"):
        compared(np.linspace(0, 25, 126))
