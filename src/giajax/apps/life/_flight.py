"""Energy and momentum of a flight: works and impulses, integrated in a repeated simulation."""

import dataclasses
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from ...mechanics.arm import (
    AbstractJointLaw,
    Arm,
    bodies,
    damping_power,
    drag_force,
    drag_power,
    hysteresis_power,
    joint_forces,
    kinetic_energy,
    lift,
    muscle_power,
    pose,
    potential_energy,
    touch,
    touched,
)
from ...runtime.arrays import Array, Float, Scalar
from ...runtime.programs import program
from ...runtime.text import InputError
from ...simulation import Inputs, Signal, motion

_MOST_STEPS = 10_000  # largest number of steps in an interval


class FlightWorks(NamedTuple):
    """Works on the motion of an arm, J; energy that is taken from the motion is negative.

    Attributes:
        drives: work of the commands, which wind up the springs of the joints.
        muscles: work of the pressures in the muscles.
        drag: work of the drag, which is positive if the wind drives the arm.
        damping: work of the dampers and the friction in the joints.
        hysteresis: work of the hysteresis and of further laws of the joints.
        contact: work of obstacles; energy still stored in flattened links counts as taken away.
    """

    drives: Scalar
    muscles: Scalar
    drag: Scalar
    damping: Scalar
    hysteresis: Scalar
    contact: Scalar


class Impulses(NamedTuple):
    """Impulses on an arm in the base frame, N s, from base, weight, lift, drag and obstacles."""

    base: Float[Array, "3"]
    weight: Float[Array, "3"]
    lift: Float[Array, "3"]
    drag: Float[Array, "3"]
    contact: Float[Array, "3"]


class Audit(NamedTuple):
    """Energy, momentum, works and impulses of a motion versus time.

    Attributes:
        angles: angles of the joints in the repeated simulation, rad.
        energy: kinetic energy and potential energy of springs, hysteresis, gravity and lift, J.
        momentum: momentum of the arm and its load, kg m/s.
        works: works since the beginning, J.
        impulses: impulses since the beginning, N s.
    """

    angles: Float[Array, "row joint"]
    energy: Float[Array, " row"]
    momentum: Float[Array, "row 3"]
    works: FlightWorks
    impulses: Impulses


def check_audited(arm: Arm) -> None:
    """Check that the balances include all effects of an arm.

    Raises:
        InputError: the arm has added mass, or a joint law with states that have no rate.
    """
    if arm.air.added_mass_coefficient is not None:
        raise InputError(
            "the arm has air.added_mass_coefficient, and in gusts the energy of the air that moves "
            "with the links cannot be balanced: remove the coefficient"
        )
    for law in arm.further_laws.laws:
        if law.rows and type(law).rate is AbstractJointLaw.rate:
            raise InputError(
                f"the arm has joints with {type(law).__name__}, whose state variables have no "
                "rate, so the energy of the motion cannot be balanced: use joints.memory"
            )


def _line(before: Array, after: Array, duration: Scalar) -> Signal:
    time = jnp.zeros((1,), before.dtype)
    slope = (after - before) / duration
    return Signal(time, before[None], slope[None], jnp.full_like(time, jnp.inf))


def _momentum(arm: Arm, angles: Array, rates: Array) -> Float[Array, "3"]:
    velocity = jax.jvp(lambda q: pose(arm, q).mass_centre, (angles,), (rates,))[1]
    momentum: Array = velocity @ bodies(arm).mass
    return momentum


def _powers(time: Any, state: Array, inputs: Inputs, slope: Array) -> tuple[Array, Any, Any]:
    """Return the time derivative of the state, the powers, W, and the forces, N."""
    assert inputs.wind is not None
    arm, command = inputs.arm, inputs.command(time)
    angles, rates, memory, skin = inputs.parts(state)
    moved = motion(time, state, inputs)
    air = inputs.wind(time).reshape(arm.count, 3)
    gust = inputs.wind.rate(time).reshape(arm.count, 3)
    clock = time if inputs.begin is None else inputs.begin + time
    strain = skin if skin.size else None

    def stored(command: Array) -> Scalar:
        return potential_energy(arm, angles, command, memory=memory)

    zero = jnp.zeros_like(rates[0])
    pressures = inputs.inside(time, memory)
    met, pushed = zero, jnp.zeros(3, rates.dtype)
    if arm.contact is not None:
        found = touch(arm, angles, rates, strain)
        met = found.torque @ rates
        pushed = jax.lax.cond(
            jnp.any(found.normal != 0),
            lambda: touched(arm, angles, rates, strain)[1].sum(axis=(0, 1)),
            lambda: jnp.zeros(3, rates.dtype),
        )
    works = FlightWorks(
        drives=jax.jvp(stored, (command,), (slope,))[1],
        muscles=zero if pressures is None else muscle_power(arm, angles, rates, pressures),
        drag=drag_power(arm, angles, rates, air, clock),
        damping=damping_power(arm, rates),
        hysteresis=hysteresis_power(arm, angles, rates, memory, command),
        contact=met,
    )
    upwards, borne = jnp.zeros(3, rates.dtype).at[2], lift(arm)
    # Computed without obstacles, this force is the sum of the forces of the base and the obstacles.
    alone = dataclasses.replace(arm, contact=None)
    held = joint_forces(alone, angles, rates, moved[1], air, gust, time=clock)[0]
    impulses = Impulses(
        base=held - pushed,
        weight=upwards.set(-arm.gravity * jnp.sum(bodies(arm).mass)),
        lift=upwards.set(zero if borne is None else jnp.sum(borne)),
        drag=drag_force(arm, angles, rates, air, clock).sum(axis=0),
        contact=pushed,
    )
    return moved, works, impulses


@program
def audit(
    arm: Arm,
    interval: Scalar,
    command: Float[Array, "row joint"],
    wind: Float[Array, "row width"],
    tolerance: Scalar,
) -> Audit:
    """Repeat a motion from rest, and integrate its works and impulses.

    The commands, rad, and the wind, m/s, are linear between rows. Works and impulses are additional
    states, and therefore as accurate as the motion. Unlike the simulation of the flight, the method
    is explicit, of order 5, and its steps end at each row. Skin that slides along an obstacle is
    released only at rows.
    """
    zero = jnp.zeros_like(interval)
    none = FlightWorks(*(zero,) * 6), Impulses(*(jnp.zeros(3, zero.dtype),) * 5)
    first = Inputs(arm, _line(command[0], command[0], interval), None, None, interval)
    state = first.start(jnp.zeros((2, arm.count), zero.dtype), zero)

    def rates(time: Any, y: Any, args: tuple[Inputs, Array]) -> Any:
        return _powers(time, y[0], *args)

    def seen(state: Array, inputs: Inputs, works: Any, impulses: Any) -> Audit:
        angles, rates, memory, _ = inputs.parts(state)
        at_end = inputs.command(interval)
        energy = kinetic_energy(arm, angles, rates)
        energy = energy + potential_energy(arm, angles, at_end, memory=memory)
        return Audit(angles, energy, _momentum(arm, angles, rates), works, impulses)

    def advance(y: Any, given: tuple[Array, ...]) -> tuple[Any, Audit]:
        begin, *ends = given
        before, after, blew, blows = ends
        inputs = Inputs(
            arm, _line(before, after, interval), _line(blew, blows, interval), None, interval,
            begin=begin,
        )  # fmt: skip
        solution = diffrax.diffeqsolve(
            diffrax.ODETerm(rates),
            diffrax.Tsit5(),
            t0=zero,
            t1=interval,
            dt0=interval / 4,
            y0=y,
            args=(inputs, (after - before) / interval),
            stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
            adjoint=diffrax.ForwardMode(),
            max_steps=_MOST_STEPS,
            throw=False,
        )
        state, works, impulses = jax.tree.map(lambda each: each[-1], solution.ys)
        ended = solution.result == diffrax.RESULTS.successful
        state = jnp.where(ended, state, jnp.nan)
        if arm.contact is not None and arm.contact.rows:
            parts = inputs.parts(state)
            normal = touch(arm, parts.angles, parts.rates, parts.skin).normal
            held = arm.contact.hold(parts.skin, normal)
            state = state.at[-arm.contact.rows :].set(held)
        return (state, works, impulses), seen(state, inputs, works, impulses)

    starts = interval * jnp.arange(len(command) - 1, dtype=interval.dtype)
    given = (starts, command[:-1], command[1:], wind[:-1], wind[1:])
    _, rows = jax.lax.scan(advance, (state, *none), given)
    begun = seen(state, first, *none)
    together: Audit = jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), begun, rows)
    return together
