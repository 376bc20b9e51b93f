"""The gas of all bags over time."""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import optimistix

from .._program import program
from .._typing import Array, Bool, Float, Int, Scalar
from ..arm import bodies
from ._bags import BagState, PerBag, bag_state
from ._filling import Filling
from ._orifice import Hole, mass_flow
from ._supply import inflow

MOST_STEPS = 20_000


class State(NamedTuple):
    """What changes while bags are filled.

    Attributes:
        share: gas of each bag over that which fills it.
        supplied: gas that the supply has fed over that which fills all.
    """

    share: PerBag
    supplied: Scalar


class Course(NamedTuple):
    """Gas over time, at times that are evenly spaced.

    Attributes:
        times: s, from 0 to the end.
        share: gas of each bag over that which fills it.
        supplied: gas that the supply has fed over that which fills all.
        full: when each bag first has what fills it, s; NaN where it never has.
        lifts: when each link's lift first bears the link, s; NaN where it never does.
        lifts_all: when the lift of all first bears the arm, s.
        finished: whether all bags were filled.
        succeeded: whether the integration came to its end.
        steps: of the integration.
    """

    times: Float[Array, " time"]
    share: Float[Array, "time bag"]
    supplied: Float[Array, " time"]
    full: PerBag
    lifts: Float[Array, " link"]
    lifts_all: Scalar
    finished: Bool[Array, ""]
    succeeded: Bool[Array, ""]
    steps: Int[Array, ""]


def rates(time: Any, state: State, filling: Filling) -> State:
    """Rates of change, 1/s: what comes through one port of a bag less what leaves by the other."""
    gas, full = filling.gas, filling.full_mass
    pressure = bags_at(filling, state.share).pressure
    absolute = gas.ambient_pressure + pressure
    hole = Hole(*jax.tree.leaves(filling.ports))
    between = mass_flow(gas, hole, absolute[:-1], absolute[1:])
    total = jnp.sum(full)
    fed = inflow(gas, filling.supply, pressure[0], state.supplied * total)
    into = jnp.concatenate([fed[None], between])
    out = jnp.concatenate([between, jnp.zeros_like(fed)[None]])
    return State((into - out) / full, fed / total)


def bags_at(filling: Filling, share: PerBag) -> BagState:
    """Pressure and volume of the bags."""
    return bag_state(filling.gas, filling.skin, filling.stretch, share)


def net_lift_of_links(filling: Filling, share: PerBag) -> Float[Array, " link"]:
    """Mass that each link could still carry, kg: air displaced, less gas and all that it bears."""
    arm, here = filling.arm, filling.bag_of_link
    fullness = bags_at(filling, share).fullness[here]
    borne = bodies(arm).mass
    if arm.buoyancy is not None:
        # Its gas is that which is being filled in.
        borne = borne - arm.buoyancy.helium_density * arm.links.volume
    lift = arm.air.density * fullness - filling.gas.density * share[here]
    return lift * arm.links.volume - borne


@program
def course(filling: Filling, end: Scalar, tolerance: Scalar, *, times: int) -> Course:
    """Fill until every bag has what fills it, or until the end.

    Arguments:
        filling: what is filled.
        end: time at which to give up, s.
        tolerance: of the steps, relative to what fills a bag.
        times: how many to tell of.
    """
    start = State(jnp.zeros_like(filling.volume), jnp.zeros_like(end))

    exact = 100 * float(jnp.finfo(end.dtype).eps)

    def missing(t: Scalar, y: State, args: Filling, **_: object) -> Scalar:
        return jnp.min(y.share) - 1

    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(rates),
        # The pressures of bags that are tight settle within a second, the whole takes minutes.
        diffrax.Kvaerno5(),
        t0=jnp.zeros_like(end),
        t1=end,
        dt0=end * 1e-5,
        y0=start,
        args=filling,
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        saveat=diffrax.SaveAt(dense=True, t1=True),
        event=diffrax.Event(missing, optimistix.Newton(rtol=exact, atol=exact)),
        max_steps=MOST_STEPS,
        throw=False,
    )
    assert solution.ts is not None
    last = solution.ts[-1]
    finished = diffrax.is_event(solution.result)
    grid = jnp.linspace(0, last, times, dtype=last.dtype)
    known = jax.vmap(solution.evaluate)(grid)
    full, lifts, lifts_all = _crossings(filling, solution, grid, known)
    return Course(
        grid,
        known.share,
        known.supplied,
        # What the event stopped at is full then, up to rounding.
        jnp.where(finished & jnp.isnan(full), last, full),
        lifts,
        lifts_all,
        finished,
        diffrax.is_okay(solution.result),
        solution.stats["num_steps"],
    )


def _crossings(
    filling: Filling, solution: diffrax.Solution, grid: Array, known: State
) -> tuple[Array, Array, Array]:
    """When bags are full, links are borne, and the arm is: by bisection of the solution."""

    def all_of(share: PerBag) -> Array:
        lift = net_lift_of_links(filling, share)
        return jnp.concatenate([share - 1, lift, jnp.sum(lift)[None]])

    above = jax.vmap(all_of)(known.share) >= 0
    first = jnp.argmax(above, axis=0)
    low, high = grid[jnp.maximum(first - 1, 0)], grid[first]

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = ends
        middle = (low + high) / 2
        here = jax.vmap(lambda t: all_of(solution.evaluate(t).share))(middle)
        reached = jnp.diagonal(here) >= 0
        return jnp.where(reached, low, middle), jnp.where(reached, middle, high)

    _, high = jax.lax.fori_loop(0, 50, halve, (low, high))
    times = jnp.where(above.any(axis=0), high, jnp.nan)
    bags = filling.bags
    return times[:bags], times[bags:-1], times[-1]
