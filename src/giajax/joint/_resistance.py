"""What a joint itself resists to bending, whatever its muscles do: alpha and beta of both sides."""

from itertools import pairwise

import jax.numpy as jnp
import numpy as np

from .._typing import Array, Bool, Float
from ._correction import Correction

# Of the Gauss rule of two points, on an interval from 0 to 1; exact for a cubic.
_POINTS = (0.5 - np.sqrt(1 / 12), 0.5 + np.sqrt(1 / 12))


def resistance(
    correction: Correction, angle: Float[Array, "*shape"], ahead: Bool[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Torque with which the corrections of both muscles resist, towards 0, N m.

    Arguments:
        correction: of either side.
        angle: of the pair, rad.
        ahead: whether the first muscle is the inner one; what decides at 0.
    """
    return correction(angle, ahead) - correction(-angle, ~ahead)


def resistance_energy(
    correction: Correction, angle: Float[Array, "*shape"]
) -> Float[Array, "*shape"]:
    """Energy that bending stores against `resistance`, J; 0 in the straight joint.

    Between two kinks the resistance is a cubic of the angle, so that the sum over the pieces is
    exact.

    Arguments:
        correction: of either side, in the continuous reading or none.
        angle: of the pair, rad.
    """
    size = jnp.abs(angle)
    beta = correction.beta
    bends = [jnp.asarray(correction.blend), beta.width, beta.threshold, correction.alpha.threshold]
    kinks = jnp.sort(jnp.stack([jnp.asarray(x, size.dtype) for x in bends]))
    ends = [jnp.zeros_like(size), *(jnp.minimum(size, kink) for kink in kinks), size]
    energy = jnp.zeros_like(size)
    for start, end in pairwise(ends):
        width = end - start
        for point in _POINTS:
            at = start + point * width
            energy = energy + width / 2 * resistance(correction, at, jnp.ones(at.shape, bool))
    return energy
