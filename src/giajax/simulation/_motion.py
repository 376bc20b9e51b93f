"""The equation of motion as integrators see it, and the part of it that makes it stiff."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..arm import Arm, Pneumatics, acceleration, joint_torque, mass_matrix
from ._pressures import Pressures
from ._signal import Signal


class Inputs(eqx.Module):
    """What moves, and what moves it.

    Attributes:
        arm: the arm.
        command: commanded angles over time, rad.
        wind: velocity of the air over time, m/s, of the whole arm or of link after link, or None
            for still air.
        torque: of the joints' drives over time, N m, or None.
        end: the last time before the end of the motion, s.
        pressure: supplied to muscles over time, or None where their controller does.
    """

    arm: Arm
    command: Signal
    wind: Signal | None
    torque: Signal | None
    end: Scalar
    pressure: Pressures | None = None

    def parts(self, state: "State") -> tuple[Array, Array, Array, Array]:
        """Angles, rates, states of hysteresis and states of muscles."""
        last = 2 + self.arm.joints.hysteresis.rows
        return state[0], state[1], state[2:last], state[last:]

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
        rows = [state, self.arm.joints.hysteresis.unstrained(state[0])]
        if self.arm.pneumatics is not None:
            pressures = self.supplied(time)
            assert pressures is not None
            rows.append(self.arm.pneumatics.filled(pressures))
        return jnp.concatenate(rows)


State = Float[Array, "row joint"]
"""Angles (rad), rates (rad/s) and, where joints remember, the states of their hysteresis; where
pressures lag, those of the muscles."""


def motion(time: Any, state: State, inputs: Inputs) -> State:
    """Rates and accelerations of the joints, and how fast their other states change."""
    # A jump at the very end is no part of the motion, and would be bisected for nothing.
    time = jnp.minimum(time, inputs.end)
    angles, rates, memory, muscles = inputs.parts(state)
    arm, wind = inputs.arm, inputs.wind
    command = inputs.command(time)
    air = None if wind is None else along_links(arm, wind(time))
    gust = None if wind is None else along_links(arm, wind.rate(time))
    drive = None if inputs.torque is None else inputs.torque(time)
    pressures = inputs.inside(time, muscles)
    moved = acceleration(arm, angles, rates, command, air, gust, drive, memory, pressures)
    rows = [rates[None], moved[None], arm.joints.hysteresis.rate(rates, memory)]
    if arm.pneumatics is not None and arm.pneumatics.rows:
        supplied = inputs.supplied(time)
        assert supplied is not None
        rows.append(arm.pneumatics.rate(supplied, muscles))
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
        memory: of hysteresis of the joints and pressures that lag, or None.
    """

    mass: Float[Array, "joint joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
    memory: "Strain | None"


class Strain(NamedTuple):
    """How torques and further states depend on each other: hysteresis, and pressures that lag.

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
    angles, rates, memory, muscles = inputs.parts(state)
    time = jnp.minimum(time, inputs.end)
    command = inputs.command(time)
    pressures = inputs.inside(time, muscles)
    arm, hysteresis, pneumatics = inputs.arm, inputs.arm.joints.hysteresis, inputs.arm.pneumatics

    # The torque of a joint depends on its own angle and rate only, so that one derivative along
    # all angles at once is the diagonal, whatever the law of the spring or the damper.
    def slope(of: Any, at: Array) -> Array:
        return -jax.jvp(of, (at,), (jnp.ones_like(at),))[1]

    def torque(angles: Array, rates: Array) -> Array:
        return joint_torque(arm, angles, rates, command, pressures=pressures)

    stiffness = slope(lambda x: torque(x, rates), angles)
    damping = slope(lambda x: torque(angles, x), rates)
    if pneumatics is not None:
        # A pair that runs away is explicit: its matrix need not be positive definite.
        stiffness = jnp.maximum(stiffness, 0)
    strains = []
    if hysteresis.rows:
        stiffness = stiffness + hysteresis.tangent(angles, rates, memory)
        strains.append(
            Strain(
                torque=hysteresis.pull(memory),
                filling=-slope(lambda x: hysteresis.rate(x, memory), rates),
                forgetting=slope(lambda x: hysteresis.rate(rates, x), memory),
            )
        )
    if pneumatics is not None and pneumatics.rows:
        strains.append(_lagging(pneumatics, angles, muscles))
    strain = jax.tree.map(lambda *rows: jnp.concatenate(rows), *strains) if strains else None
    return Springs(mass_matrix(arm, angles), stiffness, damping, strain)


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
    angles, rates, _, muscles = inputs.parts(state)
    pressures = dataclasses.replace(inputs, arm=arm).inside(time, muscles)
    torque = joint_torque(arm, angles, rates, inputs.command(time), pressures=pressures)
    return torque if inputs.torque is None else torque + inputs.torque(time)
