"""Points that fill a cube evenly."""

import inspect

import numpy as np

from ._typing import Float


def sobol_points(count: int, dimensions: int, seed: int) -> Float[np.ndarray, "point dimension"]:
    """Points of a scrambled Sobol sequence in the unit cube, none of them on its faces.

    More of them have the same first ones.

    Arguments:
        count: of points.
        dimensions: of the cube.
        seed: of the scrambling.
    """
    # Takes a second to import.
    from scipy.stats import qmc

    # The seed was called otherwise before SciPy 1.15.
    name = "rng" if "rng" in inspect.signature(qmc.Sobol.__init__).parameters else "seed"
    sobol = qmc.Sobol(dimensions, **{name: seed})
    points = sobol.random_base2(max(count - 1, 1).bit_length())[:count]
    edge = np.finfo(float).eps
    return np.asarray(np.clip(points, edge, 1 - edge))
