"""What the air does to the links: wind, drag, added mass and lift."""

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
"""Of the air: one vector for the whole arm, or one for each link."""


class Flow(NamedTuple):
    """The air's velocity (m/s) and its rate (m/s^2): a column for the arm, or one for each link.

    With the time (s) of a wind field, or None without one. Where that is, it is beside all else,
    and `places` and `bodies` say how much faster (m/s) the air is at the places along the links
    and at the bodies that they carry than at the links' centres.
    """

    velocity: Float[Array, "3 places"]
    rate: Float[Array, "3 places"]
    time: Scalar | None = None
    places: Float[Array, "3 place link"] | None = None
    bodies: Float[Array, "3 body"] | None = None


class Load(NamedTuple):
    """Force on each link at its geometric centre, N, and couple, N m (None: no couple)."""

    force: Rows
    couple: Rows | None


def flow(arm: Arm, wind: Wind | None, rate: Wind | None = None, time: Any = 0.0) -> Flow:
    """The wind of a run; what is None is zero. The time, s, is that of a wind field."""

    def columns(vectors: Wind | None) -> Array:
        if vectors is None:
            return jnp.zeros((3, 1), arm.links.length.dtype)
        return vectors[:, None] if vectors.ndim == 1 else vectors.T

    if arm.air.wind_field is None:
        return Flow(columns(wind), columns(rate))
    return Flow(columns(wind), columns(rate), jnp.asarray(time, arm.links.length.dtype))


def with_field(arm: Arm, here: Pose, wind: Flow) -> Flow:
    """A wind with that of the arm's wind field, where the links are.

    Its rate is that of the air which is there, not that of the place: for added mass (Auton, Hunt
    and Prud'homme, J. Fluid Mech. 197 (1988) 241).
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
    """Velocity of each link's centre relative to the air, the arm's own wind included."""
    own = arm.air.wind
    return centre_velocity - (wind.velocity if own is None else wind.velocity + own[:, None])


def drag(arm: Arm, here: Pose, relative: Rows, omega: Rows, wind: Flow) -> Load:
    """Drag on each link, and on the bodies that it carries.

    F = -1/2 rho (C_D A) |V| V at each body, with V its velocity relative to the air: that of the
    link's centre, and what the link's turning adds. C_D A does not depend on the direction, as
    for a sphere, nor on the Reynolds number.

    Arguments:
        relative: velocity of the links' centres relative to the air, m/s.
        omega: angular velocity of the links, rad/s.
        wind: as of `with_field`.
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
    # Sums over the bodies of each link, of which it may carry several.
    carried = np.eye(arm.count, dtype=force.dtype)[carriers]
    couple = cross(lever, force) @ carried
    total = couple if load.couple is None else load.couple + couple
    return Load(load.force + force @ carried, total)


def _levers(arm: Arm, here: Pose) -> tuple[np.ndarray, Float[Array, "3 body"]]:
    """The links that carry bodies, from 0 on, and where these are from the links' centres, m."""
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
    """Gauss points on [-1, 1]; half the weights, which then sum to 1."""
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
    # The velocity across the link is linear along it.
    lean = scaled(links.length / 2, cross(omega, axis))
    stream = stream.at_places(places[None] * lean[:, None], wind.places)
    pieces = scaled(weights * links.length[None], law.force(stream))
    moment = (places[None] * pieces).sum(axis=1)
    return Load(pieces.sum(axis=1), cross(scaled(links.length / 2, axis), moment))


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
    arm: Arm, angles: PerJoint, rates: PerJoint, wind: Wind | None = None, time: Any = 0.0
) -> Float[Array, "link 3"]:
    """Drag force of the air on each link, N.

    With `drag = "centre"`: F_D = -1/2 rho C_D L d |V| V at the link's centre, with V the velocity
    of the centre relative to the air (paper, eq. 1). With `drag = "strip"`: the sum over the
    link of what acts across it, and the axial drag. Bodies with a drag of their own add theirs.

    Arguments:
        angles, rates: of the joints, rad and rad/s.
        wind: of the air in the base frame, m/s; still air by default.
        time: s, of a wind field.
    """
    return drag_in_motion(arm, angles, rates, wind, time)[0].force.T


def drag_in_motion(
    arm: Arm, angles: PerJoint, rates: PerJoint, wind: Wind | None, time: Any
) -> tuple[Load, Rows, Rows]:
    """Drag in one state of motion, with the velocities of the links' centres and turns."""
    here = pose(arm, angles)
    blown = with_field(arm, here, flow(arm, wind, time=time))
    omega = angular_velocities(here, rates)
    velocity = centre_velocities(arm, here, omega)
    relative = relative_velocity(arm, velocity, blown)
    return drag(arm, here, relative, omega, blown), velocity, omega


# Added mass: the air that a link must move out of its way (Kirchhoff).


class AddedMass(NamedTuple):
    """The fluid that a link moves: a rod that has inertia across the link alone, kg and kg m^2.

    A long cylinder with added-mass coefficient C_a moves C_a times the air that it displaces
    when it moves across itself, and none along itself (Lamb, Hydrodynamics, art. 42; Newman,
    Marine Hydrodynamics, sec. 4.15). Its kinetic energy is that of this rod, and Kirchhoff's
    equations follow from it (Lamb, ch. VI).
    """

    mass: Float[Array, " link"]
    inertia: Float[Array, " link"]


def added_mass(arm: Arm) -> AddedMass | None:
    """The rods of all links; None where added mass is left out."""
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
    """Force and couple of the fluid on each link, from the rate of its impulse.

    With the impulse P = m (w - (e.w) e) of the fluid at the link's centre, which moves with w
    through it, and the impulse couple L = J (omega - (e.omega) e), the force is -dP/dt and the
    couple about the centre -(w x P + dL/dt). A wind that changes in time also carries a pressure
    gradient, which pushes the displaced volume: rho V du/dt. The centres move with a velocity
    relative to the air, and an acceleration; the links' directions turn.
    """
    e = here.direction
    through = acceleration - wind.rate

    def rate_of_across(vector: Rows, rate: Rows) -> Rows:
        """d/dt of the part of a vector that is normal to the link."""
        along = dot(turning, vector) + dot(e, rate)
        return rate - scaled(along, e) - scaled(dot(e, vector), turning)

    impulse = scaled(rod.mass, across_link(e, relative))
    force = -scaled(rod.mass, rate_of_across(relative, through))
    force = force + scaled(arm.air.density * arm.links.volume, wind.rate)
    couple = scaled(rod.inertia, rate_of_across(omega, alpha)) + cross(relative, impulse)
    return force, -couple
