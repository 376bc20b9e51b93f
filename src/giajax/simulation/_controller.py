"""Step-size control: steps that derivatives survive, too, and an end to a motion that cannot go on.

Where such steps are needed, and why, stands in `_disturbances`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..arm import Arm, bodies, lift, mass_matrix
from ._linearly_implicit import LinearlyImplicit

# Length of a step, times the rate of the motion, that a method is stable with: where its stability
# function reaches 1 for an oscillation with 1 % of critical damping.
_STABLE: dict[type[diffrax.AbstractSolver], float] = {
    diffrax.Tsit5: 2.0,
    diffrax.Dopri5: 2.0,
    diffrax.Dopri8: 4.4,
    diffrax.Bosh3: 1.7,
    diffrax.Heun: 0.5,
    LinearlyImplicit: 2.0,
}


class Rates(NamedTuple):
    """Rates of the fastest motions that an arm is capable of (`fastest_rate`), 1/s.

    Attributes:
        all: of all motions.
        explicit: of those that the method does not take implicitly.
    """

    all: Scalar
    explicit: Scalar


def step_size_controller(
    solver: diffrax.AbstractSolver,
    rtol: Scalar,
    atol: Scalar,
    corners: Array,
    rates: Rates | None = None,
) -> diffrax.AbstractStepSizeController:
    """Control to the tolerances that steps neither over a corner nor too far, and never hangs.

    Arguments:
        solver: the integration method.
        rtol, atol: tolerances of a step.
        corners: times that no step may cross, s.
        rates: of what a derivative may set swinging; None where the motion alone counts.

    Returns:
        The controller.
    """
    slowness = stable = jnp.full((), jnp.inf)
    if rates is not None:
        slowness = 1 / rates.all
        stable = _STABLE.get(type(solver), jnp.inf) / rates.explicit
    controller = diffrax.PIDController(rtol=rtol, atol=atol)
    return diffrax.ClipStepSizeController(
        _Careful(controller, stable, slowness),
        jump_ts=corners,
    )


def fastest_rate(arm: Arm, angles: Float[Array, " joint"], *, springs: bool = True) -> Scalar:
    """Rate of the fastest motion of springs, dampers and gravity in one configuration, 1/s.

    Without `springs`, that of gravity alone.

    Arguments:
        arm: the arm.
        angles: of its joints, rad, shape (joint,).
        springs: whether the springs and dampers of the joints count.
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
    oscillation = largest(arm.joints.stiffness + hanging)
    return jnp.hypot(oscillation, largest(arm.joints.stiffest_damping) ** 2)


class _Careful(diffrax.AbstractAdaptiveStepSizeController):
    """Keeps steps stable, and ends at a rejected step that cannot be made smaller.

    Where the motion is infinite or NaN, diffrax rejects ever smaller steps up to the step limit.
    `PIDController(dtmin=...)` would end at accepted steps, too, and those may be as short as
    the distance between two corners that differ by rounding.
    """

    rtol: Any
    atol: Any
    norm: Callable[[Any], Any]
    controller: diffrax.PIDController
    longest: Array
    slowness: Array

    def __init__(self, controller: diffrax.PIDController, longest: Array, slowness: Array) -> None:
        self.controller = controller
        # An implicit solver takes its own tolerances from here.
        self.rtol, self.atol, self.norm = controller.rtol, controller.atol, controller.norm
        self.longest = longest
        self.slowness = slowness

    def wrap(self, direction: Any) -> "_Careful":
        return _Careful(self.controller.wrap(direction), self.longest, self.slowness)

    def init(self, terms: Any, t0: Any, *args: Any) -> tuple[Any, Any]:
        t1, state = self.controller.init(terms, t0, *args)
        return jnp.minimum(t1, t0 + self.longest), state

    def adapt_step_size(
        self,
        t0: Any,
        t1: Any,
        y0: Any,
        y1_candidate: Any,
        args: Any,
        y_error: Any,
        error_order: Any,
        controller_state: Any,
    ) -> tuple[Any, ...]:
        keep, next_t0, next_t1, jump, state, result = self.controller.adapt_step_size(
            t0, t1, y0, y1_candidate, args, y_error, error_order, controller_state
        )
        # At rest nothing but the tolerance limits how long a step may be for the derivatives to be
        # as exact as the motion: an oscillation of size 1 would ask for about this.
        tolerance = jnp.maximum(self.rtol, self.atol)
        exact = 25 * tolerance ** (1 / error_order) * self.slowness
        resting = jnp.all(jnp.abs(y_error) <= 1e-6 * tolerance)  # but for rounding
        longest = jnp.where(resting, jnp.minimum(exact, self.longest), self.longest)
        next_t1 = jnp.minimum(next_t1, next_t0 + longest)

        shortest = 4 * jnp.finfo(jnp.result_type(t1)).eps * jnp.abs(t1)
        # Written so that it holds for a NaN, too.
        stuck = ~keep & ~(next_t1 - next_t0 > shortest)
        code = diffrax.RESULTS.where(
            jnp.all(jnp.isfinite(y_error)),
            diffrax.RESULTS.dt_min_reached,
            diffrax.RESULTS.nonlinear_divergence,
        )
        result = diffrax.RESULTS.where(stuck, code, result)
        return keep, next_t0, next_t1, jump, state, result
