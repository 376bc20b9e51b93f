"""What the air does to the links: wind, drag at their centres or along them, and lift."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, safe_norm, scaled
from .._typing import Array, Float
from ._arm import Arm
from ._bodies import lift
from ._body_drag import body_drag
from ._cylinder import drag_factor
from ._kinematics import Pose, Rows, angular_velocities, centre_velocities, pose

Wind = Float[Array, "3"] | Float[Array, "link 3"]
"""Of the air: one vector for the whole arm, or one for each link."""


class Flow(NamedTuple):
    """The wind at one time: the velocity of the air (m/s) and its rate of change (m/s^2).

    One column for the whole arm, or one for each link.
    """

    velocity: Float[Array, "3 places"]
    rate: Float[Array, "3 places"]


class Load(NamedTuple):
    """Force on each link at its geometric centre, N, and couple, N m (None: no couple)."""

    force: Rows
    couple: Rows | None


def flow(arm: Arm, wind: Wind | None, rate: Wind | None = None) -> Flow:
    """The wind of a run; what is None is zero."""

    def columns(vectors: Wind | None) -> Array:
        if vectors is None:
            return jnp.zeros((3, 1), arm.links.length.dtype)
        return vectors[:, None] if vectors.ndim == 1 else vectors.T

    return Flow(columns(wind), columns(rate))


def relative_velocity(arm: Arm, centre_velocity: Rows, wind: Flow) -> Rows:
    """Velocity of each link's centre relative to the air, the arm's own wind included."""
    own = arm.air.wind
    return centre_velocity - (wind.velocity if own is None else wind.velocity + own[:, None])


def drag(arm: Arm, here: Pose, relative: Rows, omega: Rows) -> Load:
    """Drag on each link, and on the bodies that it carries.

    Arguments:
        arm: the arm.
        here: its pose.
        relative: velocity of the links' centres relative to the air.
        omega: angular velocity of the links.
    """
    load, carried = (
        _drag_of_links(arm, here, relative, omega),
        body_drag(arm, here, relative, omega),
    )
    if carried is None:
        return load
    force, couple = carried
    return Load(load.force + force, couple if load.couple is None else load.couple + couple)


def _drag_of_links(arm: Arm, here: Pose, relative: Rows, omega: Rows) -> Load:
    air, links = arm.air, arm.links
    half_rho_area = 0.5 * air.density * links.length * links.diameter
    if air.drag == "centre":
        speed = safe_norm(relative)
        factor = half_rho_area * air.drag_coefficient * drag_factor(air, speed, links.diameter)
        return Load(-scaled(factor * speed, relative), None)
    along = dot(here.direction, relative)
    across = across_link(here.direction, relative)
    # Gauss points on [-1, 1]; half the weights, which then sum to 1.
    gauss, weight = np.polynomial.legendre.leggauss(air.strip_points)
    places, weights = (jnp.asarray(x, relative.dtype) for x in (gauss, weight / 2))
    # The velocity across the link is linear along it.
    lean = scaled(links.length / 2, cross(omega, here.direction))
    local = across[:, None] + places[None, :, None] * lean[:, None]
    speed = safe_norm(local)
    curve = drag_factor(air, speed, jnp.broadcast_to(links.diameter, speed.shape))
    factor = (half_rho_area * air.drag_coefficient)[None] * curve
    pieces = -scaled(weights[:, None] * factor * speed, local)
    force = pieces.sum(axis=1)
    if air.axial_coefficient is not None:
        skin = half_rho_area * air.axial_coefficient * jnp.abs(along) * along
        force = force - scaled(skin, here.direction)
    moment = (places[None, :, None] * pieces).sum(axis=1)
    return Load(force, cross(scaled(links.length / 2, here.direction), moment))


def lift_force(arm: Arm) -> Rows | None:
    """Buoyancy of the links at their centres, N; None where it is left out."""
    upwards = lift(arm)
    if upwards is None:
        return None
    return jnp.zeros((3, arm.count), upwards.dtype).at[2].set(upwards)


def across_link(direction: Rows, vector: Rows) -> Rows:
    """The part of a vector that is normal to each link."""
    return vector - scaled(dot(direction, vector), direction)


def drag_force(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    wind: Wind | None = None,
) -> Float[Array, "link 3"]:
    """Drag force of the air on each link, N.

    With `drag = "centre"`: F_D = -1/2 rho C_D L d |V| V at the link's centre, with V the velocity
    of the centre relative to the air (paper, eq. 1). With `drag = "strip"`: the sum over the
    link of what acts across it, and the axial drag. Bodies with a drag of their own add theirs.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        wind: velocity of the air in the base frame, m/s, one for the arm or one for each link;
            still air by default.

    Returns:
        Force in the base frame, N, shape (link, 3).
    """
    return drag_in_motion(arm, angles, rates, wind).load.force.T


class Dragged(NamedTuple):
    """Drag on each link, and how the links move through the air."""

    load: Load
    velocity: Rows
    omega: Rows


def drag_in_motion(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    wind: Wind | None,
) -> Dragged:
    """Drag in one state of motion, with the velocities of the links' centres and turns."""
    here = pose(arm, angles)
    omega = angular_velocities(here, rates)
    velocity = centre_velocities(arm, here, omega)
    relative = relative_velocity(arm, velocity, flow(arm, wind))
    return Dragged(drag(arm, here, relative, omega), velocity, omega)
