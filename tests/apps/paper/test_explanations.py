"""Explanations of fig. 12 that can be distinguished, and what collapses under one muscle."""

import numpy as np
import pytest

from giajax.apps.paper import (
    EXPLANATIONS,
    Explained,
    Searched,
    at_pressure,
    collapse_pressure,
    collapse_radius,
    explained,
    explanations_figure,
    misfit,
)
from giajax.report import to_png

SEARCHED = Searched(np.array([0.02, 0.05]), np.array([0.034, 0.038, 0.042]), np.array([0.02]))
TRUTH = Explained("both", 0.05, 0.038, 0.02, np.empty(0))


@pytest.mark.quick
def test_what_collapses_under_one_muscle():
    """0.3 N m and 2 to 4 N: for a link of 150 mm its pressure, for a neck at 1 kPa its radius."""
    pressures = [collapse_pressure(0.15, 0.3, force) for force in (2.0, 4.0)]
    radii = [collapse_radius(1e3, 0.3, force) for force in (2.0, 4.0)]
    assert np.allclose(pressures, [56.6, 84.9], atol=0.05)
    assert np.allclose(radii, [0.0503, 0.0549], atol=5e-5)
    for radius, force in zip(radii, (2.0, 4.0), strict=True):
        assert collapse_pressure(radius, 0.3, force) == pytest.approx(1e3)


def test_explanations_are_told_apart():
    """A noisy loop of one explanation is identified with its parameters."""
    seen = at_pressure(TRUTH, 1e3).angles
    loop = seen + np.random.default_rng(0).normal(0, 2.0, seen.shape)
    found = explained(loop, SEARCHED)
    assert set(found) == set(EXPLANATIONS)
    liked = {name: np.std(loop - one.angles) for name, (_, one) in found.items()}
    assert liked["both"] < 2.3 < 5 < liked["the pair alone"]
    assert min(liked, key=liked.get) == "both"
    both = found["both"][1]
    assert (both.friction, both.radius) == (0.05, 0.038)
    assert to_png(explanations_figure(found, loop)).startswith(b"\x89PNG")


def test_a_neck_that_muscles_crush_explains_nothing():
    """p pi r^2 of 34 mm is 3.6 N, but the muscles press with 3.9 N during the motion."""
    crushed = at_pressure(Explained("both", 0.05, 0.034, 0.02, np.empty(0)), 1e3)
    assert -0.5 < crushed.stretching < 0
    found = explained(crushed.angles, SEARCHED)["both"]
    assert all(one.radius > 0.034 and one.stretching > 0 for one in found)


def test_gas_moves_a_neck_and_not_the_pair():
    """A proposed experiment: the same joint at three pressures."""
    pair = Explained("the pair alone", 0.05, None, None, np.empty(0))
    same = [at_pressure(pair, p).angles for p in (1000.0, 1500.0)]
    assert np.array_equal(*same)
    nearest = Explained("both", 0.04, 0.036, 0.02, np.empty(0))
    errors = [at_pressure(nearest, p).said["mean"] for p in (1000.0, 1500.0)]
    assert errors[0] - errors[1] > 2
    # The pair alone, with the values in the text, has an error that is too large for its mean.
    assert misfit(same[0]) > 20
