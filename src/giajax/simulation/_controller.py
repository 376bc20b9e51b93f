"""Step-size control: steps that derivatives survive, too, and an end to a motion that cannot go on.

Where such steps are needed, and why, stands in `_disturbances`.
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
_LEAST = 0.5  # of other explicit methods

_SHORT, _LATE = 0.05, 0.9  # turns before the one part of a step and after the other are left in it

# How far a step that is done again goes beyond the turn, so that the next one begins after it: the
# derivatives of its first stage would be those of before the turn otherwise.
_BEYOND = 1.04

# Part of the tolerance that a joint has to move by in a step for its turn to count.
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
    """Control to the tolerances that steps neither over a corner nor too far, and never hangs.

    Arguments:
        solver, rtol, atol: the integration method and the tolerances of its steps.
        corners: times that no step may cross, s; those that are infinite are none.
        bends: times of which a step that would cross some ends at the last, s.
        rates: of what a derivative may set swinging; None where the motion alone counts.
        turns: whether the equation of motion has a corner where a joint turns round.
        mobility: inverse of the mass matrix, 1/(kg m^2), where springs may become stiffer in the
            motion than they are by `rates`.
        inner: what controls the steps to the tolerances in place of `diffrax.PIDController`; its
            own are replaced.
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
    """Keeps steps stable, and ends at a rejected step that cannot be made smaller.

    Where the motion is infinite or NaN, diffrax rejects ever smaller steps up to the step limit.
    `PIDController(dtmin=...)` would end at accepted steps, too, and those may be as short as
    the distance between two corners that differ by rounding.
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
    """Of a step, times the rate of springs; infinite where they are implicit."""
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
        # An implicit solver takes its own tolerances from here.
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
        """`longest` and `slowness` of a step that begins here, s."""
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
            # Of a step that fails by itself, too, no more than what its error allows.
            crossed = (end < t1) & (keep | (end < next_t1)) & (end - t0 > _ulps(t1))
            keep = keep & ~crossed
            next_t0 = jnp.where(crossed, t0, next_t0)
            next_t1 = jnp.where(crossed, end, next_t1)
        # At rest nothing but the tolerance limits how long a step may be for the derivatives to be
        # as exact as the motion: an oscillation of size 1 would ask for about this.
        tolerance = jnp.maximum(self.rtol, self.atol)
        begin = y0 if self.mobility is None else jnp.where(keep, y1_candidate, y0)
        stable, slowness = self._limits(next_t0, begin, args)
        exact = 25 * tolerance ** (1 / error_order) * slowness
        resting = jnp.all(jnp.abs(y_error) <= 1e-5 * tolerance)  # but for rounding
        longest = jnp.where(resting, jnp.minimum(exact, stable), stable)
        next_t1 = jnp.minimum(next_t1, next_t0 + longest)
        # Steps from bend to bend have their bends at the same places however the last bits of the
        # motion fall: elsewhere each error, and with it each next step, would depend on those.
        bend = self.bends[last_before(self.bends, next_t1)]
        crossed = (bend < next_t1) & (bend > next_t0 + 0.01 * (next_t1 - next_t0))
        next_t1 = jnp.where(crossed, bend, next_t1)

        shortest = _ulps(t1)
        # Written so that it holds for a NaN, too.
        stuck = ~keep & ~(next_t1 - next_t0 > shortest)
        code = diffrax.RESULTS.where(
            jnp.all(jnp.isfinite(y_error)),
            diffrax.RESULTS.dt_min_reached,
            diffrax.RESULTS.nonlinear_divergence,
        )
        result = diffrax.RESULTS.where(stuck, code, result)
        return keep, next_t0, next_t1, jump, state, result


def _ulps(time: Any) -> Any:
    """What a step is longer than, s."""
    return 4 * jnp.finfo(jnp.result_type(time)).eps * jnp.abs(time)


def first_turn(
    step: Any, y0: Float[Array, "row joint"], y1: Float[Array, "row joint"], least: Any
) -> Scalar:
    """Part of a step (s) after which the first joint turns round; 1 if none does well within it.

    A joint that moves by less than `least` (rad) in the step is at rest.
    """
    # The time of a step's end is no part of what is differentiated.
    part = jax.lax.stop_gradient(turns(step, y0, y1))[0]
    moves = step * jnp.maximum(jnp.abs(y0[1]), jnp.abs(y1[1])) > least
    within = moves & (part > _SHORT) & (part < _LATE)
    return jnp.min(jnp.where(within, part, 1))
