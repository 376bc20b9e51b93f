"""The equation of motion as integrators see it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..arm import Arm, forward_dynamics, joint_torque, touch
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

    def parts(self, state: "State") -> "Parts":
        """What the rows of a state are."""
        memory = 2 + self.arm.joints.hysteresis.rows
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
        rows = [state, self.arm.joints.hysteresis.unstrained(state[0])]
        if self.arm.pneumatics is not None:
            pressures = self.supplied(time)
            assert pressures is not None
            rows.append(self.arm.pneumatics.filled(pressures))
        if self.arm.contact is not None:
            rows.append(jnp.zeros((self.arm.contact.rows, self.arm.count), state.dtype))
        return jnp.concatenate(rows)


State = Float[Array, "row joint"]
"""Angles (rad) and rates (rad/s); where joints remember, the states of their hysteresis; where
pressures lag, those of the muscles; where contacts have friction, the stretch of the skin."""


class Parts(NamedTuple):
    """The rows of a state.

    Attributes:
        angles: rad.
        rates: rad/s.
        memory: states of hysteresis.
        muscles: states of muscles.
        skin: stretch of the skin of the links, m.
    """

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
    arm, wind = inputs.arm, inputs.wind
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
    moved = forward_dynamics(arm, angles, rates, torque, air, gust)
    rows = [rates[None], moved[None], arm.joints.hysteresis.rate(rates, memory)]
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
