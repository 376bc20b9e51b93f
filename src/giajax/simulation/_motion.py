"""The equation of motion as integrators see it, and the part of it that makes it stiff."""

from typing import Any

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


def motion(time: Any, state: Float[Array, "2 joint"], inputs: Inputs) -> Float[Array, "2 joint"]:
    """Rates and accelerations of the joints."""
    # A jump at the very end is no part of the motion, and would be bisected for nothing.
    time = jnp.minimum(time, inputs.end)
    angles, rates = state
    arm, wind = inputs.arm, inputs.wind
    command = inputs.command(time)
    air = None if wind is None else wind(time)
    gust = None if wind is None else wind.rate(time)
    drive = None if inputs.torque is None else inputs.torque(time)
    return jnp.stack([rates, acceleration(arm, angles, rates, command, air, gust, drive)])


def springs(
    time: Any, state: Float[Array, "2 joint"], inputs: Inputs
) -> tuple[Float[Array, "joint joint"], Float[Array, " joint"], Float[Array, " joint"]]:
    """Mass matrix, stiffness and damping of the joints alone in one state."""
    angles, rates = state
    command = inputs.command(jnp.minimum(time, inputs.end))

    # The torque of a joint depends on its own angle and rate only, so that one derivative along
    # all angles at once is the diagonal, whatever the law of the spring or the damper.
    def slope(torque: Any, at: Array) -> Array:
        return -jax.jvp(torque, (at,), (jnp.ones_like(at),))[1]

    stiffness = slope(lambda x: joint_torque(inputs.arm, x, rates, command), angles)
    damping = slope(lambda x: joint_torque(inputs.arm, angles, x, command), rates)
    return mass_matrix(inputs.arm, angles), stiffness, damping
