"""Gas of an arm of balloons during feeding, rest, venting and rolling up."""

import dataclasses
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import optimistix

from ...mechanics.inflation import (
    BagState,
    Filling,
    Hole,
    PerBag,
    bag_energy,
    bag_state,
    mass_flow,
)
from ...mechanics.unrolling import Unrolling, open_volume
from ...runtime.arrays import Array, Bool, Float, Scalar, larger, smaller
from ...runtime.programs import program

_MOST_STEPS = 50_000
_CLOSE = 1e-9  # tolerance of the time of an event

_ALIKE = 0.01  # difference of equal pressures, relative to the largest pressure

LEFT_OPEN = 0.01
"""Smallest fraction of a link's volume that stays open and keeps gas in the roll."""


class GasWorks(NamedTuple):
    """Works on gas and skin, J; losses are negative.

    Attributes:
        supply: available work of the gas that is fed at the pressure of the first bag.
        ports: loss in the ports between the bags.
        valve: loss in the valve through which gas is let out.
        hand: work of the hand that rolls the arm up.
    """

    supply: Scalar
    ports: Scalar
    valve: Scalar
    hand: Scalar


class GasState(NamedTuple):
    """State of the gas in all bags.

    Attributes:
        share: mass of the gas in each bag divided by the mass that fills it.
        skin: work of the pressure on the skin of each bag, J per m^3 of the tight bag.
        fed: mass of gas that was fed, kg.
        let_out: mass of gas that was let out, kg.
        works: works on gas and skin, J.
    """

    share: PerBag
    skin: PerBag
    fed: Scalar
    let_out: Scalar
    works: GasWorks


class Handling(NamedTuple):
    """Handling of the gas in a phase, as numbers, so that all phases share one compiled program.

    Attributes:
        feeds: 1 if the supply is open, else 0.
        settles: 1 if the phase ends when all pressures are equal within 1 %, else 0.
        opens: 1 if the first bag is open to the room, through a port like the others, else 0.
        rolls: speed at which the arm is rolled up from its tip, m/s.
        force: value of p pi r^2 that all links must reach for the end of the phase, N; a negative
            value is ignored.
        pressure: pressure that no link may exceed for the end of the phase, Pa; a negative value is
            ignored.
        duration: largest duration of the phase, s.
    """

    feeds: Scalar
    settles: Scalar
    opens: Scalar
    rolls: Scalar
    force: Scalar
    pressure: Scalar
    duration: Scalar


class GasCourse(NamedTuple):
    """Gas versus time, at evenly spaced times from 0 until the end of a phase.

    Attributes:
        times: times since the beginning of the phase, s.
        share: mass of the gas in each bag relative to a full bag, shape (time, bag).
        pressure: gauge pressure of each link relative to the room, Pa, shape (time, link).
        fullness: volume of each link divided by that of its tube, shape (time, link).
        lift: additional mass that the buoyancy of all links could carry, kg, shape (time,).
        stored: energy of gas and skin at the beginning and at the end, J.
        mass: mass of the gas, computed from pressures and volumes, at the beginning and at the
            end, kg.
        end: last state.
        reached: whether the phase reached its goal.
        succeeded: whether the integration succeeded.
    """

    times: Float[Array, " time"]
    share: Float[Array, "time bag"]
    pressure: Float[Array, "time link"]
    fullness: Float[Array, "time link"]
    lift: Float[Array, " time"]
    stored: Float[Array, "2"]
    mass: Float[Array, "2"]
    end: GasState
    reached: Bool[Array, ""]
    succeeded: Bool[Array, ""]


def _open_part(unrolling: Unrolling, rolls: Scalar, time: Scalar) -> PerBag:
    """Return the fraction of each bag that is not rolled up."""
    filling = unrolling.filling
    volume = open_volume(unrolling, unrolling.length - rolls * time)
    bags = jnp.zeros_like(filling.volume).at[filling.bag_of_link].add(volume)
    return larger(bags / filling.volume, LEFT_OPEN)


def _bags(filling: Filling, share: PerBag, part: PerBag) -> BagState:
    """Return the pressure and fullness of the open part of each bag."""
    return bag_state(filling.gas, filling.skin, filling.stretch, share / part)


def gas_rates(time: Any, state: GasState, args: tuple[Unrolling, Handling]) -> GasState:
    """Return the time derivatives of the state of the gas, including the powers."""
    unrolling, handling = args
    filling = unrolling.filling
    gas, ports = filling.gas, filling.ports
    part, closing = jax.jvp(
        lambda t: _open_part(unrolling, handling.rolls, t), (time,), (jnp.ones_like(time),)
    )
    bags = _bags(filling, state.share, part)
    room = gas.ambient_pressure
    supplied, between = filling.flows(bags.pressure, state.fed)
    fed = handling.feeds * supplied
    first = Hole(
        jnp.ravel(ports.diameter)[0], jnp.ravel(ports.length)[0], ports.discharge_coefficient
    )
    let_out = handling.opens * mass_flow(gas, first, room + bags.pressure[0], room)
    into = jnp.concatenate([(fed - let_out)[None], between])
    out = jnp.concatenate([between, jnp.zeros_like(fed)[None]])
    # Available work of a kilogram of gas that expands to the pressure of the room.
    worth = gas.specific_energy * jnp.log1p(bags.pressure / room)
    changing = (into - out) / filling.full_mass
    stretching = jax.jvp(
        lambda inside: _bags(filling, inside, jnp.ones_like(part)).fullness,
        (state.share / part,),
        ((changing - state.share / part * closing) / part,),
    )[1]
    pressed = bags.pressure * bags.fullness - state.skin
    works = GasWorks(
        supply=worth[0] * fed,
        ports=-jnp.sum((worth[:-1] - worth[1:]) * between),
        valve=-worth[0] * let_out,
        hand=-jnp.sum(pressed * filling.volume * closing),
    )
    return GasState(changing, bags.pressure * stretching, fed, let_out, works)


def _links_of(filling: Filling, state: BagState) -> tuple[Array, Array]:
    here = filling.bag_of_link
    return state.pressure[here], state.fullness[here]


@program
def gas_course(
    unrolling: Unrolling, handling: Handling, begin: GasState, tolerance: Scalar, times: int
) -> GasCourse:
    """Simulate the gas from a state until the goal is reached, or until the largest duration."""
    filling = unrolling.filling
    area = jnp.pi / 4 * filling.arm.links.diameter**2

    def beyond(t: Scalar, y: GasState, args: Any, **_: object) -> Scalar:
        part = _open_part(unrolling, handling.rolls, t)
        pressure = _links_of(filling, _bags(filling, y.share, part))[0]
        full = jnp.min(y.share) - 1
        holds = jnp.min(pressure * area) / larger(handling.force, 1) - 1
        filled: Array = jnp.where(handling.force < 0, full, smaller(full, holds))
        emptied = handling.pressure - jnp.max(pressure)
        never = -jnp.ones_like(filled)
        left = jnp.where(handling.pressure < 0, never, emptied)
        alike = jnp.min(pressure) - (1 - _ALIKE) * jnp.max(pressure)
        left = jnp.where(handling.settles > 0, alike, left)
        reached: Array = jnp.where(handling.feeds > 0, filled, left)
        return reached

    zero = jnp.zeros_like(begin.fed)
    # A goal that is already reached at the beginning does not cause an event.
    already = beyond(zero, begin, None) >= 0
    until = jnp.where(already, 1e-9 * handling.duration, handling.duration)
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(gas_rates),
        # An implicit method is needed as in `fill`: pressures of tight bags settle within a second.
        diffrax.Kvaerno5(),
        t0=zero,
        t1=until,
        dt0=handling.duration * 1e-6,
        y0=begin,
        args=(unrolling, handling),
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        saveat=diffrax.SaveAt(dense=True, t1=True),
        event=diffrax.Event(beyond, optimistix.Newton(rtol=_CLOSE, atol=_CLOSE)),
        adjoint=diffrax.ForwardMode(),
        max_steps=_MOST_STEPS,
        throw=False,
    )
    assert solution.ts is not None
    last = solution.ts[-1]
    grid = jnp.linspace(0, last, times, dtype=last.dtype)
    end: GasState = jax.tree.map(lambda each: each[-1], solution.ys)

    def at(t: Array, share: PerBag) -> tuple[Array, Array, Array]:
        part = _open_part(unrolling, handling.rolls, t)
        state = _bags(filling, share, part)
        pressure, fullness = _links_of(filling, state)
        displaced = filling.arm.air.density * state.fullness * part - filling.gas.density * share
        lift = jnp.sum(displaced * filling.volume) - jnp.sum(filling.borne_mass)
        return pressure, fullness * part[filling.bag_of_link], lift

    def held(t: Array, share: PerBag) -> tuple[Array, Array]:
        """Return the energy of gas and skin, J, and the mass of the gas, kg."""
        part = _open_part(unrolling, handling.rolls, t)
        energy = bag_energy(filling.gas, filling.skin, filling.stretch, share / part)
        state = _bags(filling, share, part)
        pressed = 1 + state.pressure / filling.gas.ambient_pressure
        tight = part * filling.volume
        mass = jnp.sum(filling.gas.density * pressed * state.fullness * tight)
        return jnp.sum((energy.gas + energy.skin) * tight), mass

    share = jax.vmap(solution.evaluate)(grid).share
    pressure, fullness, lift = jax.vmap(at)(grid, share)
    ends = jnp.stack([begin.share, end.share])
    stored, mass = jax.vmap(held)(jnp.stack([zero, last]), ends)
    return GasCourse(
        grid,
        share,
        pressure,
        fullness,
        lift,
        stored,
        mass,
        end,
        diffrax.is_event(solution.result) | already,
        diffrax.is_okay(solution.result),
    )


def as_one_bag(unrolling: Unrolling) -> Unrolling:
    """Return the arm as one bag without ports between its links, as in a gas-driven `unroll`."""
    filling = unrolling.filling
    ports = jax.tree.map(lambda each: jnp.ravel(each)[0], filling.ports)
    shared = (tuple(range(1, filling.arm.count + 1)),) if filling.arm.count > 1 else ()
    return dataclasses.replace(
        unrolling, filling=dataclasses.replace(filling, ports=ports, shared=shared)
    )


@program
def gas_at(filling: Filling, share: Array) -> GasState:
    """Return the state of bags that were fed a share of the gas that fills them; works are 0."""
    zero = jnp.zeros((), share.dtype)
    skin = bag_energy(filling.gas, filling.skin, filling.stretch, share).skin
    fed = jnp.sum(share * filling.full_mass)
    return GasState(share, skin, fed, zero, GasWorks(zero, zero, zero, zero))
