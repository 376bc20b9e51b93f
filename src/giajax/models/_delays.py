"""The motion of an arm as clocks that are late or early show it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from .._typing import Array, Bool, Float, Scalar
from ..simulation import Trajectory

Times = Float[Array, " sample"]


class Seen(NamedTuple):
    """Joint angles (rad) and rates (rad/s) at the samples of one clock."""

    angles: Float[Array, "sample joint"]
    rates: Float[Array, "sample joint"]


def seen_with_delays(
    motion: Callable[[Times, Scalar], Trajectory],
    times: Times,
    delays: Sequence[Scalar | None],
) -> tuple[list[Seen], Bool[Array, ""]]:
    """States at the samples less each delay, from one simulation.

    The integrator's own interpolation gives them, at no more error than it has anyway, and with
    the derivative by the delay. Where a delay reaches back before the run, the arm has the rates
    of its first sample (it rests, if it starts at rest); where it reaches beyond the end, the run
    goes on with its last command.

    Arguments:
        motion: the motion at increasing times, from the first sample until some time.
        times: of the samples, s.
        delays: of each clock, s; None for a clock that is right.

    Returns:
        What each clock shows, and whether the simulation succeeded.
    """
    first = times[0]
    clocks = [times if delay is None else times - delay for delay in delays]
    within = [jnp.where(moments < first, first, moments) for moments in clocks]
    together = jnp.concatenate(within)
    order = jnp.argsort(jax.lax.stop_gradient(together))
    # Where the simulation ends changes nothing before it.
    end = jax.lax.stop_gradient(jnp.max(jnp.append(together, times[-1])))
    moved = motion(together[order], end)
    place = jnp.argsort(order).reshape(len(delays), len(times))
    seen = []
    for row, moments, inside in zip(place, clocks, within, strict=True):
        angles, rates = moved.angles[row], moved.rates[row]
        seen.append(Seen(angles + (moments - inside)[:, None] * rates, rates))
    return seen, moved.successful
