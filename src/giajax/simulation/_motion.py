"""The equation of motion as integrators see it, and the part of it that makes it stiff."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from ..mechanics.arm import (
    Arm,
    JointLaws,
    JointState,
    Pneumatics,
    Spring,
    Stiffness,
    bodies,
    contact_stiffness,
    forward_dynamics,
    joint_torque,
    lift,
    mass_matrix,
    touch,
)
from ..runtime.arrays import Array, Float, Scalar
from ._signal import LaggedSignal, Pressures, Signal


class Rates(NamedTuple):
    """Rates (1/s) of the fastest motions of an arm: of all, and of those that are not implicit."""

    all: Scalar
    explicit: Scalar


def fastest_rate(
    arm: Arm,
    angles: Float[Array, " joint"],
    command: Float[Array, " joint"] | None = None,
    *,
    springs: bool = True,
    mobility: Float[Array, "joint joint"] | None = None,
) -> Scalar:
    """Rate of the fastest motion of springs, dampers, gravity and lags at some angles (rad), 1/s.

    By default these angles are commanded (rad). Without `springs` (and dampers, and the lag of
    muscles) that of gravity alone. With the `mobility`, which is the inverse of the mass matrix, a
    bound of it that costs little.
    """
    # Lengths of steps are no part of what is differentiated.
    arm, angles, command = jax.lax.stop_gradient((arm, angles, command))
    if mobility is None:
        factor = jnp.linalg.cholesky(mass_matrix(arm, angles))

    def largest(strength: Array) -> Array:
        """Square root of the largest eigenvalue of M^-1 diag(strength)."""
        roots = jnp.sqrt(jnp.broadcast_to(strength, (arm.count,)))
        if mobility is not None:
            return jnp.sqrt(jnp.max(roots * (jnp.abs(mobility) @ roots)))
        root = jnp.diag(roots)
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
    laws = arm.joint_laws
    at = laws.at(angles, jnp.zeros_like(angles), angles if command is None else command)
    stiffest, (_, damping) = laws.stiffest(at), laws.slopes(at)
    if arm.pneumatics is not None:
        stiffest = stiffest + arm.pneumatics.stiffest(arm.count)
    # What runs away does so as fast as it would swing.
    rate = jnp.hypot(largest(jnp.abs(stiffest) + hanging), largest(jnp.abs(damping)) ** 2)
    if laws.rows:
        rate = jnp.hypot(rate, jnp.max(laws.state_slopes(at)[2]))
    if arm.pneumatics is None or arm.pneumatics.drive.lag is None:
        return rate
    return jnp.hypot(rate, 1 / arm.pneumatics.drive.lag)


class Inputs(eqx.Module):
    """What moves, and what moves it.

    Attributes:
        arm: the arm.
        command: angles over time that the drives pull towards, rad.
        wind: velocity of the air over time, m/s, of the whole arm or of link after link, or None
            for still air.
        torque: of the joints' drives over time, N m, or None.
        end: the last time before the end of the motion, s.
        pressure: supplied to muscles over time, or None where their controller does.
        begin: the time of a wind field at 0 of all these times, s; None for 0.
    """

    arm: Arm
    command: Signal | LaggedSignal
    wind: Signal | None
    torque: Signal | None
    end: Scalar
    pressure: Pressures | None = None
    begin: Scalar | None = None

    def parts(self, state: "State") -> "Parts":
        """What the rows of a state are."""
        memory = 2 + self.arm.joints.further_laws.rows
        muscles = memory + (0 if self.arm.pneumatics is None else self.arm.pneumatics.rows)
        return Parts(state[0], state[1], state[2:memory], state[memory:muscles], state[muscles:])

    def supplied(self, time: Any) -> Float[Array, "2 joint"] | None:
        """Pressures (Pa) that are supplied to muscles; None where joints have springs."""
        if self.arm.pneumatics is None:
            return None
        command = self.command(time)
        if self.pressure is None:
            return self.arm.pneumatics.commanded(command)
        return self.pressure.at(self.arm, time, command)

    def inside(self, time: Any, muscles: Array) -> Float[Array, "2 joint"] | None:
        """Pressures (Pa) in muscles of these states."""
        if self.arm.pneumatics is None or not self.arm.pneumatics.rows:
            return self.supplied(time)
        return self.arm.pneumatics.inside(muscles)

    def start(self, state: Float[Array, "2 joint"], time: Scalar) -> "State":
        """The state at the beginning: nothing is strained, and pressures have settled."""
        rows = [state, self.arm.joints.further_laws.unstrained(state[0])]
        if self.arm.pneumatics is not None:
            pressures = self.supplied(time)
            assert pressures is not None
            rows.append(self.arm.pneumatics.filled(pressures))
        if self.arm.contact is not None:
            rows.append(jnp.zeros((self.arm.contact.rows, self.arm.count), state.dtype))
        return jnp.concatenate(rows)


State = Float[Array, "row joint"]
"""Angles (rad) and rates (rad/s); where joints remember, the states of their laws; where
pressures lag, those of the muscles; where contacts have friction, the stretch of the skin."""


class Parts(NamedTuple):
    """The rows of a `State`."""

    angles: Float[Array, " joint"]
    rates: Float[Array, " joint"]
    memory: Float[Array, "memory joint"]
    muscles: Float[Array, "muscle joint"]
    skin: Float[Array, "skin joint"]


def motion(time: Any, state: State, inputs: Inputs) -> State:
    """Rates and accelerations of the joints, and how fast their other states change."""
    # A jump at the very end is no part of the motion, and would be bisected for nothing.
    time = jnp.minimum(time, inputs.end)
    angles, rates, memory, muscles, skin = inputs.parts(state)
    arm, wind, laws = inputs.arm, inputs.wind, inputs.arm.joints.further_laws
    command = inputs.command(time)
    air = None if wind is None else along_links(arm, wind(time))
    gust = None if wind is None else along_links(arm, wind.rate(time))
    pressures = inputs.inside(time, muscles)
    torque = joint_torque(arm, angles, rates, command, memory, pressures)
    if inputs.torque is not None:
        torque = torque + inputs.torque(time)
    met = None if arm.contact is None else touch(arm, angles, rates, skin if skin.size else None)
    if met is not None:
        torque = torque + met.torque
    clock = time if inputs.begin is None else inputs.begin + time
    moved = forward_dynamics(arm, angles, rates, torque, air, gust, clock)
    rows = [rates[None], moved[None], laws.rate(laws.at(angles, rates, command, memory))]
    if arm.pneumatics is not None and arm.pneumatics.rows:
        supplied = inputs.supplied(time)
        assert supplied is not None
        rows.append(arm.pneumatics.rate(supplied, muscles))
    if met is not None and skin.size:
        rows.append(met.slip)
    return jnp.concatenate(rows)


def along_links(arm: Arm, wind: Float[Array, " width"]) -> Array:
    """A wind as a signal has it, in a row for each link where it differs from link to link."""
    return wind if wind.size == 3 else wind.reshape(arm.count, 3)


class Springs(NamedTuple):
    """What of the joints is implicit in one state.

    Attributes:
        mass: mass matrix, kg m^2.
        stiffness: N m/rad.
        damping: N m s/rad.
        memory: of states of the joints' laws and pressures that lag, or None.
        contact: how torques of contact change with the angles and rates of all joints, or None.
    """

    mass: Float[Array, "joint joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
    memory: "Strain | None"
    contact: Stiffness | None


class Strain(NamedTuple):
    """How torques and further states depend on each other: of laws, and pressures that lag.

    Attributes:
        torque: of a unit of each state, against the motion, N m.
        filling: change of each state with the angle of its joint, 1/rad; 0 for a pressure.
        forgetting: rate at which each state falls back by itself, 1/s.
    """

    torque: Float[Array, "row joint"]
    filling: Float[Array, "row joint"]
    forgetting: Float[Array, "row joint"]


def springs(time: Any, state: State, inputs: Inputs) -> Springs:
    """Mass matrix, and the slopes of the torques of the joints alone, in one state."""
    angles, rates, memory, muscles, skin = inputs.parts(state)
    time = jnp.minimum(time, inputs.end)
    command = inputs.command(time)
    pressures = inputs.inside(time, muscles)
    arm, laws, pneumatics = inputs.arm, inputs.arm.joint_laws, inputs.arm.pneumatics
    at = laws.at(angles, rates, command, memory)
    stiffness, damping = laws.slopes(at)
    # What runs away is explicit: the matrix of a pair, or of a law, need not be positive definite.
    if arm.joints.laws:
        stiffness, damping = jnp.maximum(stiffness, 0), jnp.maximum(damping, 0)
    if pneumatics is not None and pressures is not None:
        along = jnp.ones_like(angles)
        pair = jax.jvp(lambda x: pneumatics.torque(x, pressures), (angles,), (along,))[1]
        stiffness = stiffness + jnp.maximum(-pair, 0)
    strains = [Strain(*laws.state_slopes(at))] if laws.rows else []
    if pneumatics is not None and pneumatics.rows:
        strains.append(_lagging(pneumatics, angles, muscles))
    strain = jax.tree.map(lambda *rows: jnp.concatenate(rows), *strains) if strains else None
    contact = None
    if arm.contact is not None:
        contact = contact_stiffness(arm, angles, rates, skin if skin.size else None)
    return Springs(mass_matrix(arm, angles), stiffness, damping, strain, contact)


def _lagging(pneumatics: Pneumatics, angles: Array, muscles: Array) -> Strain:
    """How the torques of muscles depend on pressures that lag, and these on themselves."""

    def of_one(row: Array) -> Array:
        at, along = pneumatics.inside(muscles), pneumatics.inside(row)
        return -jax.jvp(lambda p: pneumatics.torque(angles, p), (at,), (along,))[1]

    assert pneumatics.drive.lag is not None
    each = jnp.eye(2, dtype=angles.dtype)[:, :, None] * jnp.ones_like(muscles)[None]
    return Strain(
        torque=jnp.stack([of_one(row) for row in each]),
        filling=jnp.zeros_like(muscles),
        forgetting=jnp.full_like(muscles, 1.0) / pneumatics.drive.lag,
    )


def pull(time: Any, state: State, inputs: Inputs) -> Float[Array, " joint"]:
    """Torque of the joints and their drives in one state, of which the time moves the command."""
    time = jnp.minimum(time, inputs.end)
    # The state and the arm are those of the matrices that this goes with, and constants as they
    # are: a derivative by a stiffness has spring and command in one small term, the deflection.
    arm, state = jax.lax.stop_gradient((inputs.arm, state))
    angles, rates, memory, muscles, _ = inputs.parts(state)
    # Of the laws those that a command may move: the springs, and those of one's own.
    laws = JointLaws((Spring(arm.spring_stiffness), *arm.joints.laws.values()))
    own = memory[len(memory) - laws.rows :]
    torque = laws.torque(JointState(angles, rates, inputs.command(time), own))
    if arm.pneumatics is not None:
        pressures = dataclasses.replace(inputs, arm=arm).inside(time, muscles)
        assert pressures is not None
        torque = torque + arm.pneumatics.torque(angles, pressures)
    return torque if inputs.torque is None else torque + inputs.torque(time)
