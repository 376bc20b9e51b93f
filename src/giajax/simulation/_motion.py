"""The equation of motion as integrators see it, and the part of it that makes it stiff."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..arm import Arm, acceleration, joint_torque, mass_matrix
from ._signal import Signal


class Inputs(eqx.Module):
    """What moves, and what moves it.

    Attributes:
        arm: the arm.
        command: commanded angles over time, rad.
        wind: velocity of the air over time, m/s, or None for still air.
        torque: of the joints' drives over time, N m, or None.
        end: the last time before the end of the motion, s.
    """

    arm: Arm
    command: Signal
    wind: Signal | None
    torque: Signal | None
    end: Scalar


State = Float[Array, "row joint"]
"""Angles (rad), rates (rad/s) and, where joints remember, the states of their hysteresis."""


def motion(time: Any, state: State, inputs: Inputs) -> State:
    """Rates and accelerations of the joints, and how fast the states of their hysteresis change."""
    # A jump at the very end is no part of the motion, and would be bisected for nothing.
    time = jnp.minimum(time, inputs.end)
    angles, rates, memory = state[0], state[1], state[2:]
    arm, wind = inputs.arm, inputs.wind
    command = inputs.command(time)
    air = None if wind is None else wind(time)
    gust = None if wind is None else wind.rate(time)
    drive = None if inputs.torque is None else inputs.torque(time)
    moved = acceleration(arm, angles, rates, command, air, gust, drive, memory)
    return jnp.concatenate([rates[None], moved[None], arm.joints.hysteresis.rate(rates, memory)])


class Springs(NamedTuple):
    """What of the joints is implicit in one state.

    Attributes:
        mass: mass matrix, kg m^2.
        stiffness: N m/rad.
        damping: N m s/rad.
        memory: of the joints' hysteresis, or None.
    """

    mass: Float[Array, "joint joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
    memory: "Strain | None"


class Strain(NamedTuple):
    """How torque and states of the joints' hysteresis depend on each other.

    Attributes:
        torque: of a unit of each state, against the motion, N m.
        filling: change of each state with the angle of its joint, 1/rad.
        forgetting: rate at which each state falls back by itself while its joint moves, 1/s.
    """

    torque: Float[Array, "row joint"]
    filling: Float[Array, "row joint"]
    forgetting: Float[Array, "row joint"]


def springs(time: Any, state: State, inputs: Inputs) -> Springs:
    """Mass matrix, and the slopes of the torques of the joints alone, in one state."""
    angles, rates, memory = state[0], state[1], state[2:]
    command = inputs.command(jnp.minimum(time, inputs.end))
    arm, hysteresis = inputs.arm, inputs.arm.joints.hysteresis

    # The torque of a joint depends on its own angle and rate only, so that one derivative along
    # all angles at once is the diagonal, whatever the law of the spring or the damper.
    def slope(of: Any, at: Array) -> Array:
        return -jax.jvp(of, (at,), (jnp.ones_like(at),))[1]

    stiffness = slope(lambda x: joint_torque(arm, x, rates, command), angles)
    damping = slope(lambda x: joint_torque(arm, angles, x, command), rates)
    strain = None
    if hysteresis.rows:
        stiffness = stiffness + hysteresis.tangent(angles, rates, memory)
        strain = Strain(
            torque=hysteresis.pull(memory),
            filling=-slope(lambda x: hysteresis.rate(x, memory), rates),
            forgetting=slope(lambda x: hysteresis.rate(rates, x), memory),
        )
    return Springs(mass_matrix(arm, angles), stiffness, damping, strain)


def pull(time: Any, state: State, inputs: Inputs) -> Float[Array, " joint"]:
    """Torque of the joints and their drives in one state, of which the time moves the command."""
    time = jnp.minimum(time, inputs.end)
    # The state and the arm are those of the matrices that this goes with, and constants as they
    # are: a derivative by a stiffness has spring and command in one small term, the deflection.
    arm, (angles, rates) = jax.lax.stop_gradient((inputs.arm, state[:2]))
    torque = joint_torque(arm, angles, rates, inputs.command(time))
    return torque if inputs.torque is None else torque + inputs.torque(time)
