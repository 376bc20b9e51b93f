"""How stiff muscles make a joint at most: what steps of the integration must resolve."""

import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Scalar
from ..joint import LARGEST_ANGLE, JointPair, muscle_torques, resistance

# Angles at which the steepest slope is looked for.
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 121)


def stiffest_pair(pair: JointPair) -> Scalar:
    """Bound of the stiffness of a pair at any pressures within its range, N m/rad.

    One pressure may be high where the other is low, so that what each muscle adds counts by itself.

    Arguments:
        pair: the joint and its muscles.
    """
    angles = jnp.asarray(_ANGLES)
    ahead, pressures = angles >= 0, jnp.full(2, 1.0) * pair.muscle.limit

    def torques(angle: Array) -> tuple[Array, Array]:
        own = resistance(pair.joint.correction, angle, ahead)
        return muscle_torques(pair, pressures, angle, ahead), own

    (first, second), own = jax.jvp(torques, (angles,), (jnp.ones_like(angles),))[1]
    return jnp.max(jnp.maximum(-first, 0) + jnp.maximum(second, 0) + own)
