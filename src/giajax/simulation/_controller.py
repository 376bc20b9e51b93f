"""Step-size control that gives up on a motion that cannot go on."""

from collections.abc import Callable
from typing import Any

import diffrax
import jax.numpy as jnp
import optimistix as optx

from .._typing import Array, Scalar


def step_size_controller(
    rtol: Scalar, atol: Scalar, corners: Array
) -> diffrax.AbstractStepSizeController:
    """Proportional control to the tolerances, which neither steps over a corner nor hangs."""
    return diffrax.ClipStepSizeController(
        _GivesUp(diffrax.PIDController(rtol=rtol, atol=atol, norm=_norm)), jump_ts=corners
    )


def _norm(x: Any) -> Array:
    """Root mean square, infinite where it is NaN: such a step is rejected and tried smaller.

    diffrax would make the next step as long as NaN, and try that one up to the step limit.
    """
    norm = optx.rms_norm(x)
    return jnp.where(jnp.isnan(norm), jnp.inf, norm)


class _GivesUp(diffrax.AbstractAdaptiveStepSizeController):
    """Ends the integration at a rejected step that cannot be made smaller.

    `PIDController(dtmin=...)` would do it for accepted steps too, and those may be as short as
    the distance between two corners that differ by rounding.
    """

    rtol: Any
    atol: Any
    norm: Callable[[Any], Any]
    controller: diffrax.PIDController

    def __init__(self, controller: diffrax.PIDController) -> None:
        self.controller = controller
        # An implicit solver takes its own tolerances from here.
        self.rtol, self.atol, self.norm = controller.rtol, controller.atol, controller.norm

    def wrap(self, direction: Any) -> "_GivesUp":
        return _GivesUp(self.controller.wrap(direction))

    def init(self, *args: Any) -> tuple[Any, Any]:
        return self.controller.init(*args)

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
        shortest = 4 * jnp.finfo(jnp.result_type(t1)).eps * jnp.abs(t1)
        # Written so that it holds for a NaN, too.
        stuck = ~keep & ~(next_t1 - next_t0 > shortest)
        finite = jnp.all(jnp.isfinite(y_error))
        code = diffrax.RESULTS.where(
            finite, diffrax.RESULTS.dt_min_reached, diffrax.RESULTS.nonlinear_divergence
        )
        result = diffrax.RESULTS.where(stuck, code, result)
        return keep, next_t0, next_t1, jump, state, result
