"""Step-size control for accurate derivatives, which also stops a motion that cannot continue.

The comments in `_simulate` explain when and why derivatives require such steps.
"""

from collections.abc import Callable
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp

from ..runtime.arrays import Array, Float, Scalar
from ._linearly_implicit import LinearlyImplicit
from ._motion import Inputs, Rates, State, fastest_rate, turns
from ._signal import last_before
from ._solvers import with_tolerances

# Largest stable product of step size and rate of the motion: the stability function reaches 1 for
# an oscillation with 1 % of critical damping.
_STABLE: dict[type[diffrax.AbstractSolver], float] = {
    diffrax.Tsit5: 2.0,
    diffrax.Dopri5: 2.0,
    diffrax.Dopri8: 4.4,
    diffrax.Bosh3: 1.7,
    diffrax.Heun: 0.5,
    LinearlyImplicit: 2.0,
}
_LEAST = 0.5  # for other explicit methods

# Turns before the first and after the second of these fractions of a step are not treated.
_SHORT, _LATE = 0.05, 0.9

# Factor by which a repeated step extends beyond the turn, so that the next step begins after it.
# Otherwise the derivatives of the first stage of the next step would be those before the turn.
_BEYOND = 1.04

# Minimum movement of a joint in a step, as a fraction of the tolerance, for which its turn is
# treated.
_LEAST_MOVE = 0.01


def step_size_controller(
    solver: diffrax.AbstractSolver,
    rtol: Scalar,
    atol: Scalar,
    corners: Float[Array, " knot"],
    bends: Float[Array, " knot"],
    rates: Rates | None = None,
    *,
    turns: bool = False,
    mobility: Float[Array, "joint joint"] | None = None,
    inner: diffrax.AbstractAdaptiveStepSizeController | None = None,
) -> diffrax.AbstractStepSizeController:
    """Return an error controller with a step limit for stability that crosses no corner.

    Arguments:
        solver, rtol, atol: integration method, and relative and absolute tolerance of a step.
        corners: times that no step may cross, s; infinite entries are ignored.
        bends: times at which steps end if possible, s: a step that would cross some of them ends at
            the last of these.
        rates: rates of the motions that a derivative may excite; None if only the accuracy of the
            motion matters.
        turns: whether the equation of motion has a corner where a joint reverses its direction.
        mobility: inverse of the mass matrix, 1/(kg m^2), if springs may become stiffer during the
            motion than `rates` assumes.
        inner: adaptive controller that replaces `diffrax.PIDController`; its tolerances are
            replaced.
    """
    slowness = stable = jnp.full((), jnp.inf)
    length = jnp.inf
    if rates is not None:
        slowness = 1 / rates.all
        implicit = isinstance(solver, diffrax.AbstractImplicitSolver)
        length = _STABLE.get(type(solver), jnp.inf if implicit else _LEAST)
        stable = length / rates.explicit
        if isinstance(solver, LinearlyImplicit):
            length = jnp.inf
    controller = (
        diffrax.PIDController(rtol, atol) if inner is None else with_tolerances(inner, rtol, atol)
    )
    return diffrax.ClipStepSizeController(
        _Careful(controller, stable, slowness, jnp.sort(bends), turns, length, mobility),
        jump_ts=corners,
    )


class _Careful(diffrax.AbstractAdaptiveStepSizeController):
    """Controller that keeps steps stable, and stops at a rejected step that cannot be reduced.

    If the motion becomes infinite or NaN, diffrax rejects ever smaller steps up to the step limit.
    `PIDController(dtmin=...)` would also stop at accepted steps, which may be as short as the
    distance between two corners that differ by rounding.
    """

    rtol: Any
    atol: Any
    norm: Callable[[Any], Any]
    controller: diffrax.AbstractAdaptiveStepSizeController
    longest: Array
    slowness: Array
    bends: Array
    turns: bool = eqx.field(static=True)
    length: float = eqx.field(static=True)
    """Product of step size and rate of the springs; infinite if the springs are implicit."""
    mobility: Array | None

    def __init__(
        self,
        controller: diffrax.AbstractAdaptiveStepSizeController,
        longest: Array,
        slowness: Array,
        bends: Float[Array, " knot"],
        turns: bool,
        length: float,
        mobility: Array | None,
    ) -> None:
        self.controller = controller
        # An implicit solver takes its tolerances from here.
        self.rtol, self.atol, self.norm = controller.rtol, controller.atol, controller.norm
        self.longest, self.slowness, self.bends, self.turns = longest, slowness, bends, turns
        self.length, self.mobility = length, mobility

    def wrap(self, direction: Any) -> "_Careful":
        inner: Any = self.controller.wrap(direction)
        return _Careful(
            inner, self.longest, self.slowness, self.bends, self.turns, self.length, self.mobility
        )

    def init(
        self, terms: Any, t0: Any, t1: Any, y0: Any, dt0: Any, args: Any, *rest: Any
    ) -> tuple[Any, Any]:
        t1, state = self.controller.init(terms, t0, t1, y0, dt0, args, *rest)
        return jnp.minimum(t1, t0 + self._limits(t0, y0, args)[0]), state

    def _limits(self, time: Any, state: State, inputs: Inputs) -> tuple[Array, Array]:
        """Return `longest` and `slowness` of a step that starts here, s."""
        if self.mobility is None:
            return self.longest, self.slowness
        time = jnp.minimum(time, inputs.end)
        command = inputs.command(time)
        supplied = inputs.supplied(time, command)
        mobility = self.mobility
        rate = fastest_rate(inputs.arm, state[0], command, pressures=supplied, mobility=mobility)
        slowness = jnp.minimum(self.slowness, 1 / rate)
        return jnp.minimum(self.longest, self.length * slowness), slowness

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
        if self.turns:
            least = _LEAST_MOVE * jnp.maximum(self.rtol, self.atol)
            end = t0 + _BEYOND * first_turn(t1 - t0, y0, y1_candidate, least) * (t1 - t0)
            # If the step is rejected by its error as well, the new step is no longer than its error
            # allows.
            crossed = (end < t1) & (keep | (end < next_t1)) & (end - t0 > _ulps(t1))
            keep = keep & ~crossed
            next_t0 = jnp.where(crossed, t0, next_t0)
            next_t1 = jnp.where(crossed, end, next_t1)
        # At rest, only this limit keeps the derivatives as accurate as the motion. It is about the
        # step size for an oscillation of amplitude 1.
        tolerance = jnp.maximum(self.rtol, self.atol)
        begin = y0 if self.mobility is None else jnp.where(keep, y1_candidate, y0)
        stable, slowness = self._limits(next_t0, begin, args)
        exact = 25 * tolerance ** (1 / error_order) * slowness
        resting = jnp.all(jnp.abs(y_error) <= 1e-5 * tolerance)  # except for rounding
        longest = jnp.where(resting, jnp.minimum(exact, stable), stable)
        next_t1 = jnp.minimum(next_t1, next_t0 + longest)
        # If steps end at bends, their ends do not depend on rounding errors of the motion.
        # Otherwise each error, and with it each next step, would depend on them.
        bend = self.bends[last_before(self.bends, next_t1)]
        crossed = (bend < next_t1) & (bend > next_t0 + 0.01 * (next_t1 - next_t0))
        next_t1 = jnp.where(crossed, bend, next_t1)

        shortest = _ulps(t1)
        # Written such that it is also true for NaN.
        stuck = ~keep & ~(next_t1 - next_t0 > shortest)
        code = diffrax.RESULTS.where(
            jnp.all(jnp.isfinite(y_error)),
            diffrax.RESULTS.dt_min_reached,
            diffrax.RESULTS.nonlinear_divergence,
        )
        result = diffrax.RESULTS.where(stuck, code, result)
        return keep, next_t0, next_t1, jump, state, result


def _ulps(time: Any) -> Any:
    """Return the minimum length of a step, s."""
    return 4 * jnp.finfo(jnp.result_type(time)).eps * jnp.abs(time)


def first_turn(
    step: Any, y0: Float[Array, "row joint"], y1: Float[Array, "row joint"], least: Any
) -> Scalar:
    """Return the fraction of a step (s) after which the first joint reverses its direction.

    The fraction is 1 if no joint reverses well within the step. A joint that moves by less than
    `least` (rad) in the step is considered at rest.
    """
    # The end of a step is not differentiated.
    part = jax.lax.stop_gradient(turns(step, y0, y1))[0]
    moves = step * jnp.maximum(jnp.abs(y0[1]), jnp.abs(y1[1])) > least
    within = moves & (part > _SHORT) & (part < _LATE)
    return jnp.min(jnp.where(within, part, 1))
