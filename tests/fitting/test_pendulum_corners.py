"""A real pendulum with friction, the drag of the air and no damping, from far off."""

import pytest

from benchmarks.hard import MOST_ITERATIONS, from_every_side

# What leads through steps that are refused and parameters that touch their bounds: two that crawled
# once, and an easy one, whose optimum is to be theirs.
EASY = (1, 1, 1, 1)


@pytest.mark.long
@pytest.mark.parametrize(("loss", "far"), [("linear", (-1, 1, 1, -1)), ("huber", (1, -1, 1, 1))])
def test_two_corners_lead_to_one_optimum(loss, far):
    ends = from_every_side(120.0, [EASY, far], [loss])[loss]
    assert all(end["optimum"] for end in ends)
    assert all(end["iterations"] <= MOST_ITERATIONS for end in ends)
