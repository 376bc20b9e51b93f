"""How fast an arm may move, of itself, in one configuration: what explicit steps must resolve."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..arm import Arm, bodies, lift, mass_matrix


class Rates(NamedTuple):
    """Rates of the fastest motions that an arm is capable of (`fastest_rate`), 1/s.

    Attributes:
        all: of all motions.
        explicit: of those that the method does not take implicitly.
    """

    all: Scalar
    explicit: Scalar


def fastest_rate(arm: Arm, angles: Float[Array, " joint"], *, springs: bool = True) -> Scalar:
    """Rate of the fastest motion of springs, dampers, gravity and lags in one configuration, 1/s.

    Without `springs`, that of gravity alone.

    Arguments:
        arm: the arm.
        angles: of its joints, rad, shape (joint,).
        springs: whether the springs and dampers of the joints count, and the lag of muscles.
    """
    # Lengths of steps are no part of what is differentiated.
    arm, angles = jax.lax.stop_gradient((arm, angles))
    factor = jnp.linalg.cholesky(mass_matrix(arm, angles))

    def largest(strength: Array) -> Array:
        """Square root of the largest eigenvalue of M^-1 diag(strength)."""
        root = jnp.diag(jnp.sqrt(jnp.broadcast_to(strength, (arm.count,))))
        return jnp.linalg.norm(jax.scipy.linalg.solve_triangular(factor, root, lower=True), 2)

    # Gravity swings what hangs, too: a bound of its stiffness, from weights times their distances.
    ends = jnp.cumsum(arm.links.length)
    reach = jnp.triu(ends[None, :] - (ends - arm.links.length)[:, None])
    weights = arm.gravity * bodies(arm).mass
    upwards = lift(arm)
    weights = jnp.abs(weights if upwards is None else weights - upwards)
    hanging = reach @ weights
    if not springs:
        return largest(hanging)
    oscillation = largest(arm.stiffest_spring + hanging)
    rate = jnp.hypot(oscillation, largest(arm.joints.stiffest_damping) ** 2)
    if arm.pneumatics is None or arm.pneumatics.drive.lag is None:
        return rate
    return jnp.hypot(rate, 1 / arm.pneumatics.drive.lag)
