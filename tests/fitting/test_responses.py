"""Responses of predictions to parameters are the same, for few and for many directions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.fitting import Direction, responses
from small_pendulum import TRUTH, Pendulum, swing

PATHS = list(TRUTH)


@pytest.mark.parametrize("count", [15, 18, 19])
@pytest.mark.parametrize("several", [False, True])
def test_many_directions_give_the_columns_of_few(count, several):
    """Many directions of one run are split over two cores, and states of runs are not changed."""
    runs = swing(seconds=9.0)[: 2 if several else 1]
    few = [Direction(path, np.asarray(1.0)) for path in PATHS]
    # Directions of one path with different step sizes serve as different paths.
    sizes = 1.0 + np.arange(count)
    many = [Direction(PATHS[i % 4], np.asarray(size)) for i, size in enumerate(sizes)]
    for given, expected in zip(
        responses(Pendulum(), runs, many), responses(Pendulum(), runs, few), strict=True
    ):
        assert given.columns.shape[-1] == count
        columns = expected.columns[..., np.arange(count) % 4] * sizes
        assert_allclose(given.columns, columns, rtol=1e-9, atol=1e-12)
        assert_allclose(given.predicted, expected.predicted, rtol=0, atol=1e-13)
        assert given.own.shape[-1] == 2
        assert_allclose(given.own, expected.own, rtol=1e-9, atol=1e-12)
