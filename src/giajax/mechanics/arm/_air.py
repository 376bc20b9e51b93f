"""Aerodynamic loads on the links: wind, drag, added mass and lift."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Float, Scalar, cross, dot, safe_norm, scaled
from ._arm import Arm, lift
from ._drag import Stream
from ._joint_laws import PerJoint
from ._kinematics import Pose, Rows, angular_velocities, centre_velocities, pose

Wind = Float[Array, "3"] | Float[Array, "link 3"]
"""Velocity of the air: one vector for the whole arm, or one for each link."""


class Flow(NamedTuple):
    """Velocity of the air.

    A wind field is added to the other winds.

    Attributes:
        velocity: velocity, m/s; one column for the whole arm, or one for each link.
        rate: rate of change of the velocity, m/s^2; one column for the whole arm, or one for each
            link.
        time: time at which a wind field is evaluated, s; None without a wind field.
        places: velocity at the points along the links minus that at the link centres, m/s.
        bodies: velocity at the bodies carried by the links minus that at the link centres, m/s.
    """

    velocity: Float[Array, "3 places"]
    rate: Float[Array, "3 places"]
    time: Scalar | None = None
    places: Float[Array, "3 place link"] | None = None
    bodies: Float[Array, "3 body"] | None = None


class Load(NamedTuple):
    """Load on each link.

    Attributes:
        force: force at the geometric centre of the link, N.
        couple: couple, N m; None for no couple.
    """

    force: Rows
    couple: Rows | None


def flow(arm: Arm, wind: Wind | None, rate: Wind | None = None, time: Any = 0.0) -> Flow:
    """Return the wind of a run.

    Arguments:
        arm: the arm.
        wind: velocity of the air, m/s; None for still air.
        rate: rate of change of the velocity, m/s^2; None for a steady wind.
        time: time at which a wind field is evaluated, s.
    """

    def columns(vectors: Wind | None) -> Array:
        if vectors is None:
            return jnp.zeros((3, 1), arm.links.length.dtype)
        return vectors[:, None] if vectors.ndim == 1 else vectors.T

    if arm.air.wind_field is None:
        return Flow(columns(wind), columns(rate))
    return Flow(columns(wind), columns(rate), jnp.asarray(time, arm.links.length.dtype))


def with_field(arm: Arm, here: Pose, wind: Flow) -> Flow:
    """Add the wind field of the arm, evaluated at the links, to a wind.

    The rate for the added mass is the derivative following the motion of the air, not that at a
    fixed position (Auton, Hunt and Prud'homme, J. Fluid Mech. 197 (1988) 241).
    """
    field, time = arm.air.wind_field, wind.time
    if field is None or time is None:
        return wind
    at = [here.centre]
    if arm.air.drag_law.points:
        places, _ = _gauss(arm.air.drag_law.points, here.centre.dtype)
        along = places[None] * scaled(arm.links.length / 2, here.direction)[:, None]
        at.append((here.centre[:, None] + along).reshape(3, -1))
    carried = None if arm.point_masses is None else arm.point_masses.drag_area
    if carried is not None:
        carriers, lever = _levers(arm, here)
        at.append(here.centre[:, carriers] + lever)
    found = field(jnp.concatenate(at, axis=1).T, time).T
    centre, places_too, bodies = found[:, : arm.count], None, None
    if arm.air.drag_law.points:
        end = arm.count * (1 + arm.air.drag_law.points)
        places_too = found[:, arm.count : end].reshape(3, -1, arm.count) - centre[:, None]
    if carried is not None:
        bodies = found[:, -len(carriers) :] - centre[:, carriers]
    own = Flow(centre + wind.velocity, wind.rate, time, places_too, bodies)
    if arm.air.added_mass_coefficient is None:
        return own
    carried_along = relative_velocity(arm, jnp.zeros_like(centre), own)
    given = (here.centre.T, time), (-carried_along.T, jnp.ones_like(time))
    return own._replace(rate=wind.rate + jax.jvp(field, *given)[1].T)


def relative_velocity(arm: Arm, centre_velocity: Rows, wind: Flow) -> Rows:
    """Return the velocity of each link centre relative to the air, including `air.wind`."""
    own = arm.air.wind
    return centre_velocity - (wind.velocity if own is None else wind.velocity + own[:, None])


def drag(arm: Arm, here: Pose, relative: Rows, omega: Rows, wind: Flow) -> Load:
    """Return the drag on each link and on the bodies that it carries.

    The force on a body is F = -1/2 rho (C_D A) |V| V. Its velocity V relative to the air includes
    the rotation of the link. C_D A does not depend on the direction, as for a sphere, nor on the
    Reynolds number.

    Arguments:
        arm: the arm.
        here: configuration of the arm.
        relative: velocity of the link centres relative to the air, m/s.
        omega: angular velocity of the links, rad/s.
        wind: the result of `with_field`.
    """
    load, bodies = _drag_of_links(arm, here, relative, omega, wind), arm.point_masses
    if bodies is None or bodies.drag_area is None:
        return load
    carriers, lever = _levers(arm, here)
    velocity = relative[:, carriers] + cross(omega[:, carriers], lever)
    if wind.bodies is not None:
        velocity = velocity - wind.bodies
    area = jnp.broadcast_to(bodies.drag_area, carriers.shape)
    size = 0.5 * arm.air.density * area * safe_norm(velocity)
    force = -scaled(size, velocity)
    # The loads are summed for each link, because a link may carry several bodies.
    carried = np.eye(arm.count, dtype=force.dtype)[carriers]
    couple = cross(lever, force) @ carried
    total = couple if load.couple is None else load.couple + couple
    return Load(load.force + force @ carried, total)


def _levers(arm: Arm, here: Pose) -> tuple[np.ndarray, Float[Array, "3 body"]]:
    """Return the indices of links that carry bodies, and vectors from link centres to bodies, m."""
    bodies = arm.point_masses
    assert bodies is not None
    carriers = np.asarray(bodies.links) - 1

    def each(value: Array) -> Array:
        return jnp.broadcast_to(value, carriers.shape)

    along = each(bodies.position) - arm.links.length[carriers] / 2
    lever = scaled(along, here.direction[:, carriers])
    if bodies.left is not None:
        assert here.left is not None
        lever = lever + scaled(each(bodies.left), here.left[:, carriers])
    if bodies.up is not None:
        lever = lever + scaled(each(bodies.up), here.up[:, carriers])
    return carriers, lever


def _gauss(points: int, dtype: Any) -> tuple[Array, Array]:
    """Return the Gauss points on [-1, 1], and weights that are normalised to a sum of 1."""
    gauss, weight = np.polynomial.legendre.leggauss(points)
    places, weights = (jnp.asarray(x, dtype)[:, None] for x in (gauss, weight / 2))
    return places, weights


def _drag_of_links(arm: Arm, here: Pose, relative: Rows, omega: Rows, wind: Flow) -> Load:
    air, links, axis = arm.air, arm.links, here.direction
    law = air.drag_law
    along = dot(axis, relative)
    stream = Stream(
        velocity=relative,
        across=relative - scaled(along, axis),
        along=along,
        axis=axis,
        diameter=links.diameter,
        fullness=links.fullness,
        density=air.density,
        viscosity=air.viscosity,
    )
    if law.points == 0:
        return Load(scaled(links.length, law.force(stream)), None)
    places, weights = _gauss(law.points, relative.dtype)
    # The velocity across a link varies linearly along the link.
    lean = scaled(links.length / 2, cross(omega, axis))
    stream = stream.at_places(places[None] * lean[:, None], wind.places)
    pieces = scaled(weights * links.length[None], law.force(stream))
    moment = (places[None] * pieces).sum(axis=1)
    return Load(pieces.sum(axis=1), cross(scaled(links.length / 2, axis), moment))


def lift_force(arm: Arm) -> Rows | None:
    """Return the buoyancy of the links at their centres, N; None if buoyancy is disabled."""
    upwards = lift(arm)
    if upwards is None:
        return None
    return jnp.zeros((3, arm.count), upwards.dtype).at[2].set(upwards)


def across_link(direction: Rows, vector: Rows) -> Rows:
    """Return the component of a vector normal to each link."""
    return vector - scaled(dot(direction, vector), direction)


def drag_force(
    arm: Arm, angles: PerJoint, rates: PerJoint, wind: Wind | None = None, time: Any = 0.0
) -> Float[Array, "link 3"]:
    """Return the drag force of the air on each link, N.

    With `drag = "centre"`, the force is F_D = -1/2 rho C_D L d |V| V at the centre of the link,
    where V is the velocity of the centre relative to the air (paper, eq. 1). With `drag = "strip"`,
    it is the integral of the cross-flow drag along the link plus the axial drag. The drag of the
    bodies that a link carries is included.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        wind: velocity of the air in the base frame, m/s; still air by default.
        time: time at which a wind field is evaluated, s.
    """
    return drag_in_motion(arm, angles, rates, wind, time)[0].force.T


def drag_in_motion(
    arm: Arm, angles: PerJoint, rates: PerJoint, wind: Wind | None, time: Any
) -> tuple[Load, Rows, Rows]:
    """Return drag, velocities of the link centres and angular velocities in one state."""
    here = pose(arm, angles)
    blown = with_field(arm, here, flow(arm, wind, time=time))
    omega = angular_velocities(here, rates)
    velocity = centre_velocities(arm, here, omega)
    relative = relative_velocity(arm, velocity, blown)
    return drag(arm, here, relative, omega, blown), velocity, omega


# Added mass: the air that a link accelerates in transverse motion (Kirchhoff).


class AddedMass(NamedTuple):
    """Added mass of the links, modelled as rods that have transverse inertia only.

    A long cylinder with the added-mass coefficient C_a accelerates C_a times the displaced air in
    transverse motion, and none in axial motion (Lamb, Hydrodynamics, art. 42; Newman, Marine
    Hydrodynamics, sec. 4.15). The kinetic energy of the air is that of this rod. Kirchhoff's
    equations follow from it (Lamb, ch. VI).

    Attributes:
        mass: mass of each rod, kg.
        inertia: transverse moment of inertia of each rod about its centre, kg m^2.
    """

    mass: Float[Array, " link"]
    inertia: Float[Array, " link"]


def added_mass(arm: Arm) -> AddedMass | None:
    """Return the added mass of all links; None if added mass is disabled."""
    if arm.air.added_mass_coefficient is None:
        return None
    mass = arm.air.added_mass_coefficient * arm.air.density * arm.links.volume
    return AddedMass(mass, mass * arm.links.length**2 / 12)


def added_mass_load(
    arm: Arm,
    rod: AddedMass,
    here: Pose,
    relative: Rows,
    turning: Rows,
    omega: Rows,
    alpha: Rows,
    acceleration: Rows,
    wind: Flow,
) -> tuple[Rows, Rows]:
    """Return force and couple of the accelerated air on each link, from the rate of its impulse.

    Let w be the velocity of the link centre relative to the air and e the direction of the link.
    The impulse of the air is P = m (w - (e.w) e), and its angular impulse is
    L = J (omega - (e.omega) e). The force is -dP/dt, and the couple about the centre is
    -(w x P + dL/dt). A wind u that changes with time has a pressure gradient, which exerts the
    additional force rho V du/dt on the displaced volume V.

    Arguments:
        arm: the arm.
        rod: added mass of the links.
        here: configuration of the arm.
        relative: velocity of the link centres relative to the air, m/s.
        turning: rate of change of the link directions, 1/s.
        omega: angular velocity of the links, rad/s.
        alpha: angular acceleration of the links, rad/s^2.
        acceleration: acceleration of the link centres, m/s^2.
        wind: the result of `with_field`.
    """
    e = here.direction
    through = acceleration - wind.rate

    def rate_of_across(vector: Rows, rate: Rows) -> Rows:
        """Return the rate of change of the component of a vector normal to the link."""
        along = dot(turning, vector) + dot(e, rate)
        return rate - scaled(along, e) - scaled(dot(e, vector), turning)

    impulse = scaled(rod.mass, across_link(e, relative))
    force = -scaled(rod.mass, rate_of_across(relative, through))
    force = force + scaled(arm.air.density * arm.links.volume, wind.rate)
    couple = scaled(rod.inertia, rate_of_across(omega, alpha)) + cross(relative, impulse)
    return force, -couple
