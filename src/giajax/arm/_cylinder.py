"""How the drag coefficient of a smooth circular cylinder in cross flow depends on Re.

log10 C_D is a line in log10 Re and three smooth steps: the end of creeping flow, the growth of the
wake, and the drag crisis. The coefficients are a least-squares fit to 247 digitised points (Re 0.1
to 8.5e6) that scatter by 0.037 about it; `data/recorded/cylinder_cd` holds them and the fit.
"""

import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ._atmosphere import Air

_LINE = (3.75991, -0.90015)
_HEIGHT = np.asarray([-0.27163, 2.87305, 0.48415])
_PLACE = np.asarray([5.56961, 3.91454, 6.32711])
_WIDTH = np.asarray([0.04694, 2.98417, 0.46406])

# The curve goes on level outside; the points end at 0.1 and 8.5e6.
_LOWEST, _HIGHEST = 0.01, 1e7

# The Reynolds number at which `air.drag_coefficient` is meant.
_REFERENCE = 1e5


def cylinder_drag_coefficient(reynolds: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """C_D of a smooth circular cylinder in cross flow, referred to length times diameter.

    Arguments:
        reynolds: |V| d / nu, not negative.

    Returns:
        C_D, of the shape of the argument.
    """
    return jnp.exp(np.log(10) * _log10(reynolds))


def _log10(reynolds: Array) -> Array:
    # Smooth at Re = 0, where an arm at rest is differentiated.
    square = jnp.minimum(reynolds * reynolds + _LOWEST**2, _HIGHEST**2)
    x = jnp.log(square) / (2 * np.log(10))
    value = _LINE[0] + _LINE[1] * x
    for height, place, width in zip(_HEIGHT, _PLACE, _WIDTH, strict=True):
        value = value + float(height) * jnp.tanh((x - float(place)) / float(width))
    return value


def drag_factor(
    air: Air, speed: Float[Array, "*shape"], diameter: Float[Array, "*shape"]
) -> Float[Array, "*shape"] | float:
    """C_D at a speed (m/s) over `air.drag_coefficient`."""
    if air.drag_curve == "constant":
        return 1.0
    x = np.log10(_REFERENCE)
    reference = _LINE[0] + _LINE[1] * x + np.sum(_HEIGHT * np.tanh((x - _PLACE) / _WIDTH))
    reynolds = speed * diameter / air.viscosity
    return jnp.exp(np.log(10) * (_log10(reynolds) - float(reference)))
