"""Filling an arm, and what comes of it."""

import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
import optimistix

from ...mechanics.arm import STANDARD_GRAVITY, bodies
from ...mechanics.inflation import (
    STRENGTHS,
    BagState,
    Filling,
    Hole,
    PerBag,
    bag_state,
    inflow,
    mass_flow,
    stiff_share,
)
from ...runtime.arrays import Array, Bool, Float, Int, Scalar
from ...runtime.limits import FILLING_S
from ...runtime.programs import program
from ...runtime.text import InputError
from ...schema import GAS, PORTS, SKIN, SUPPLY
from ...schema.parameters import check_within_bounds, declared, get, replace

MOST_STEPS = 20_000


class State(NamedTuple):
    """What changes: gas of each bag, and all that the supply has fed, over what fills them."""

    share: PerBag
    supplied: Scalar


class Course(NamedTuple):
    """Gas over time, at evenly spaced times (s) from 0 to the end, as `Filled` has it.

    Shares and what was supplied are over what fills a bag, or all. Times of what never came: NaN.
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
    """Fill until every bag has what fills it, or until the end (s); told of at so many times.

    The tolerance of the steps is relative to what fills a bag.
    """
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
        y0=State(jnp.zeros_like(filling.volume), jnp.zeros_like(end)),
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


Numbers = npt.NDArray[np.float64]

LIMIT = 6 * 3600.0
"""When `fill` gives up, s."""

_TIMES = 401
_TOLERANCE = 1e-8


@dataclasses.dataclass(frozen=True)
class Filled:
    """An arm that was filled, over time.

    Links of one bag have the same fullness, pressure and times.

    Attributes:
        times: s, from 0 until all is full, shape (time,).
        fullness: volume of each link over that of its tube, shape (time, link).
        pressure: of each link above that of the room, Pa, shape (time, link).
        gas: mass in each link, kg, shape (time, link).
        supplied: mass that the supply has fed, kg, shape (time,).
        flow: of the supply, as volume at the pressure of the room, m^3/s, shape (time,).
        net_lift: what each link could carry beside itself, kg, shape (time, link).
        folding_moment: p pi r^3 of each link, at which it folds, N m, shape (time, link).
        stiffness: bending stiffness of each link, N m^2, shape (time, link); assumed: that of
            Comer and Levy's tube under the moment of its own weight at its end.
        full: when each link has the gas that fills it, s; NaN where it never has, shape (link,).
        lift_off: when each link's lift bears the link, s; NaN where it never does, shape (link,).
        arm_lift_off: when the lift of all links bears the mass of all, s.
        finished: whether all links were filled within the limit.
    """

    filling: Filling
    times: Numbers
    fullness: Numbers
    pressure: Numbers
    gas: Numbers
    supplied: Numbers
    flow: Numbers
    net_lift: Numbers
    folding_moment: Numbers
    stiffness: Numbers
    full: Numbers
    lift_off: Numbers
    arm_lift_off: float
    finished: bool

    @property
    def duration(self) -> float:
        """How long filling took, s; NaN where it was not finished."""
        return float(np.max(self.full))

    @property
    def imbalance(self) -> float:
        """Largest difference of what was fed and what is in the links, over what fills them."""
        off = np.max(np.abs(self.supplied - self.gas.sum(axis=1)))
        return float(off) / float(np.sum(np.asarray(self.filling.full_mass)))


def fill(filling: Filling | None = None, *, limit: float = LIMIT) -> Filled:
    """Fill an arm of balloons with helium, until every link is full (fig. 15).

    Arguments:
        filling: arm, gas, ports and supply; those of the paper by default.
        limit: when to give up, s.

    Raises:
        InputError: a number that is out of its bounds, or steps that do not come to an end.

    Example:
        >>> import giajax
        >>> filled = giajax.fill()
        >>> round(filled.duration / 60, 1), round(filled.arm_lift_off / 60, 1)
        (23.2, 14.9)
    """
    made = Filling() if filling is None else filling
    if not 0 < limit < np.inf:
        raise InputError(f"the limit is {limit:g} s: give a positive number of seconds")
    check_filling(made)
    found = tried(made, limit, _TOLERANCE)
    if not bool(found.succeeded):
        raise InputError(
            f"the filling cannot be followed beyond {float(found.times[-1]):.3g} s, after "
            f"{int(found.steps)} steps: give narrower holes, or a larger skin_slack"
        )
    here, links = made.bag_of_link, made.arm.links
    pressure, fullness, flow, lift = map(np.asarray, _states(made, found))
    radius, mass = np.asarray(links.diameter) / 2, np.asarray(links.mass)
    fold = np.pi * radius**3 * pressure[:, here]
    own = mass * STANDARD_GRAVITY * np.asarray(links.length) / 2
    with np.errstate(divide="ignore"):
        load = own / fold
    without_wrinkles = float(made.skin.stiffness) * np.pi * radius**3
    return Filled(
        filling=made,
        times=np.asarray(found.times),
        fullness=fullness[:, here],
        pressure=pressure[:, here],
        gas=np.asarray(found.share)[:, here] * np.asarray(made.gas.density * links.volume),
        supplied=np.asarray(found.supplied) * float(jnp.sum(made.full_mass)),
        flow=flow,
        net_lift=lift,
        folding_moment=fold,
        stiffness=without_wrinkles * stiff_share(load),
        full=np.asarray(found.full)[here],
        lift_off=np.asarray(found.lifts),
        arm_lift_off=float(found.lifts_all),
        finished=bool(found.finished),
    )


def tried(filling: Filling, limit: float, tolerance: float) -> Course:
    """The gas over time, as far as its steps came."""
    if jnp.result_type(float) == jnp.float32:
        tolerance = max(tolerance, 1e-4)
    numbers = (jnp.asarray(number, jnp.result_type(float)) for number in (limit, tolerance))
    return course(filling, *numbers, times=_TIMES)


def check_filling(filling: Filling) -> None:
    """Refuse numbers that are out of bounds."""
    own = {declaration.path for group in (GAS, SKIN, PORTS, SUPPLY) for declaration in group}
    for path, parameter in declared(filling).items():
        if path in own or path.startswith("links.") or path == "air.density":
            for value in np.ravel(np.asarray(parameter.value(filling))).tolist():
                # A bound of 0 is a port without a hole.
                closed = path in own and value <= parameter.declaration.lower
                check_within_bounds(parameter, value, free=closed)


@program
def _states(filling: Filling, found: Course) -> tuple[Array, Array, Array, Array]:
    """Pressure and fullness of bags, flow of the supply and net lift of links, by time."""
    total = jnp.sum(filling.full_mass)

    def at(share: Array, supplied: Scalar) -> tuple[Array, Array, Array, Array]:
        bags = bags_at(filling, share)
        fed = inflow(filling.gas, filling.supply, bags.pressure[0], supplied * total)
        lift = net_lift_of_links(filling, share)
        return bags.pressure, bags.fullness, fed / filling.gas.density, lift

    return jax.vmap(at)(found.share, found.supplied)


PAPER_DURATION = 23 * 60.0
"""How long filling took, s (IV.B)."""

DIAMETERS = (0.004, 0.005, 0.006, 0.007, 0.008, 0.01, 0.012, 0.015, 0.02)
"""Diameters of the ports of a curve, m."""

_TRIES = 40
# A supply that is a hundred times as strong will not do either.
_FAR = math.log(1e2)
_CLOSE = 1e-6


@dataclasses.dataclass(frozen=True)
class FillingCurve:
    """Pairs of port and supply with which filling takes a given time (s).

    Attributes:
        diameters: of all ports, m, shape (pair,).
        strengths: what the supply must have, SI: the parameter `path`; NaN where no supply will do.
        path: of the supply's parameter: flow, pressure of the regulator, nozzle of the bottle.
        flows: of the supply when it begins, as volume at the pressure of the room, m^3/s.
        pressures: the largest of the first bag above that of the room, Pa.
    """

    duration: float
    diameters: Numbers
    strengths: Numbers
    path: str
    flows: Numbers
    pressures: Numbers


def filling_curve(
    filling: Filling | None = None,
    *,
    duration: float = PAPER_DURATION,
    diameters: Sequence[float] = DIAMETERS,
) -> FillingCurve:
    """The supply for each diameter (m) of the ports with which filling takes a given time (s).

    Arguments:
        filling: arm, gas, ports and supply; all ports are given the same diameter.

    Raises:
        InputError: a number that is out of its bounds, or an arm without ports.
    """
    made = Filling() if filling is None else filling
    if made.bags < 2:
        raise InputError("all links share one bag, which has no ports: leave the curve out")
    if not 0 < duration <= FILLING_S:
        raise InputError(
            f"the duration is {duration:g} s: give a positive number, at most {FILLING_S:g} s"
        )
    if not len(diameters):
        raise InputError("there are no diameters: give at least one")
    path = STRENGTHS[made.supply.kind]
    guess = math.log(float(get(made, path)))
    columns = []
    # From the widest, which needs what ports of no resistance need.
    for diameter in sorted(diameters, reverse=True):
        narrowed = replace(made, {PORTS.diameter.path: float(diameter)})
        check_filling(narrowed)
        strength = _strength(narrowed, path, duration, guess)
        if strength is None:
            columns.append((diameter, np.nan, np.nan, np.nan))
            continue
        guess = math.log(strength)
        found = fill(replace(narrowed, {path: strength}), limit=2 * duration)
        columns.append((diameter, strength, found.flow[0], found.pressure[:, 0].max()))
    pairs = np.asarray(columns[::-1]).T
    return FillingCurve(duration, pairs[0], pairs[1], path, pairs[2], pairs[3])


def _strength(filling: Filling, path: str, duration: float, guess: float) -> float | None:
    """The strength of the supply with which filling takes this long; None where there is none.

    By the secant in logarithms, kept between what is too little and what is too much.
    """
    low, high, start = -math.inf, math.inf, guess
    here, before = guess, None
    for _ in range(_TRIES):
        course = tried(replace(filling, {path: math.exp(here)}), 4 * duration, 1e-7)
        if not bool(course.succeeded):
            return None
        finished = bool(course.finished)
        late = math.log(float(course.times[-1]) / duration)
        if finished and abs(late) < _CLOSE:
            return math.exp(here)
        low, high = (max(low, here), high) if late > 0 else (low, min(high, here))
        # What a meter feeds takes a time that is inverse to it.
        slope = -1.0
        if before is not None and finished and before[0] != here:
            slope = min((late - before[1]) / (here - before[0]), -0.05)
        before = (here, late) if finished else None
        new = here - min(max(late / slope, -1.5), 1.5)
        here = new if low < new < high else (low + high) / 2
        if abs(here - start) > _FAR or high - low < 1e-12:
            return None
    return None
