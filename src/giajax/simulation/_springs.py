"""The part of the equation of motion that makes it stiff: springs, dampers and contacts."""

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from .._typing import Array, Float
from ..arm import Pneumatics, Stiffness, contact_stiffness, joint_torque, mass_matrix
from ._motion import Inputs, State


class Springs(NamedTuple):
    """What of the joints is implicit in one state.

    Attributes:
        mass: mass matrix, kg m^2.
        stiffness: N m/rad.
        damping: N m s/rad.
        memory: of hysteresis of the joints and pressures that lag, or None.
        contact: how torques of contact change with the angles and rates of all joints, or None.
    """

    mass: Float[Array, "joint joint"]
    stiffness: Float[Array, " joint"]
    damping: Float[Array, " joint"]
    memory: "Strain | None"
    contact: Stiffness | None


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
    angles, rates, memory, muscles, skin = inputs.parts(state)
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
    angles, rates, _, muscles, _ = inputs.parts(state)
    pressures = dataclasses.replace(inputs, arm=arm).inside(time, muscles)
    torque = joint_torque(arm, angles, rates, inputs.command(time), pressures=pressures)
    return torque if inputs.torque is None else torque + inputs.torque(time)
