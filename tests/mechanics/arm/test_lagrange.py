"""The equations of motion with all options enabled, derived again from the energies.

Lagrange: d/dt dL/dv - dL/dq = torque + generalised force of the drag, with L = T - V. Here, T
    follows
from the velocities of points and of thin rods of fluid, which are derivatives of their positions.
Rotations are Rodrigues' matrices. Only the values of the arm come from giajax, not its mechanics.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import (
    cylinder_drag_coefficient,
    forward_dynamics,
    inverse_dynamics,
    kinetic_energy,
    mass_matrix,
)
from giajax.schema.parameters import replace
from peers.arms import full_arm, random_states

LINKS = 3
STATES = random_states(LINKS, 4)
GUSTS = random_states(LINKS, 4, seed=9)["wind"]


@pytest.fixture(scope="module")
def arm():
    """Return an arm in which all values of links, joints and bodies differ."""
    arm = full_arm(LINKS)
    each = {
        "links.fullness": [0.9, 0.7, 0.8],
        "joints.armature": [0.003, 0.001, 0.002],
        "buoyancy.trim_mass": [0.01, 0.02, 0.03],
        "buoyancy.trim_position": [0.2, 0.5, 0.8],
        "buoyancy.trim_depth": [0.15, 0.05, 0.1],
        "buoyancy.imbalance": [0.005, -0.02, 0.01],
    }
    return replace(arm, {path: jnp.asarray(values) for path, values in each.items()})


@pytest.fixture(scope="module")
def numbers(arm):
    return jax.tree.map(np.asarray, arm)


def turned(axis, angle):
    """Return Rodrigues' rotation matrix about a unit axis."""
    x, y, z = axis
    skew = np.asarray([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + jnp.sin(angle) * skew + (1 - jnp.cos(angle)) * (skew @ skew)


def frames(arm, angles):
    """Return the matrix of each link (columns along, left, up) and the position of each joint."""
    size = np.linalg.norm(arm.base_rotation)
    frame, joint, found = turned(arm.base_rotation / size, size), jnp.zeros(3), []
    for link in range(LINKS):
        frame = frame @ turned(arm.joints.axes[link], angles[link])
        found.append((frame, joint))
        joint = joint + arm.links.length[link] * frame[:, 0]
    return found


def positions(arm, angles, places):
    """Return points, given by link and place in the link's frame, shape (point, 3)."""
    here = frames(arm, angles)
    return jnp.stack([here[i][1] + here[i][0] @ np.asarray(place) for i, *place in places])


def motion(arm, angles, rates, places):
    """Return positions and velocities of points."""
    return jax.jvp(lambda q: positions(arm, q, places), (angles,), (rates,))


def carried(arm):
    """Return all masses, with their link and place in the link's frame."""
    links, held, fixed = arm.links, arm.buoyancy, arm.point_masses
    found = []
    for i in range(LINKS):
        found.append((links.mass[i], (i, links.centre_of_mass[i], 0.0, 0.0)))
        helium = held.helium_density * links.volume[i]
        found.append((helium, (i, links.length[i] / 2, 0.0, 0.0)))
        found.append((held.trim_mass[i], (i, held.trim_position[i], 0.0, -held.trim_depth[i])))
    for body, link in enumerate(fixed.links):
        place = (link - 1, fixed.position[body], fixed.left[body], fixed.up[body])
        found.append((fixed.mass[body], place))
    masses, places = zip(*found, strict=True)
    return np.asarray(masses), places


def along(arm, node):
    """Return the place of each link that belongs to a Gauss node on [-1, 1]."""
    return [(i, arm.links.length[i] * (1 + node) / 2, 0.0, 0.0) for i in range(LINKS)]


def links_energy(arm, angles, rates):
    """Return the kinetic energy of the structure, of all that it carries, and of the drives."""
    links = arm.links
    masses, places = carried(arm)
    _, velocity = motion(arm, angles, rates, places)
    energy = (masses * (velocity**2).sum(axis=1)).sum() / 2
    here, moving = jax.jvp(lambda q: frames(arm, q), (angles,), (rates,))
    for i in range(LINKS):
        (frame, _), (turning, _) = here[i], moving[i]
        # For a round body, |de/dt| is the transverse angular velocity. The rate of its left
        # direction towards its up direction is the axial one. Helium does not take part in the
        # axial rotation.
        lean, spin = turning[:, 0] @ turning[:, 0], turning[:, 1] @ frame[:, 2]
        helium = arm.buoyancy.helium_density * links.volume[i]
        inertia = helium * (links.length[i] ** 2 / 12 + links.diameter[i] ** 2 / 16)
        inertia += links.inertia_transverse[i]
        energy += (inertia * lean + links.inertia_axial[i] * spin**2) / 2
    return energy + (arm.joints.armature * rates**2).sum() / 2


def across(arm, angles, vectors):
    """Split a vector of each link into the parts normal to the link and along it."""
    directions = jnp.stack([frame[:, 0] for frame, _ in frames(arm, angles)])
    size = (vectors * directions).sum(axis=1)
    return vectors - size[:, None] * directions, size, directions


def fluid_energy(arm, angles, rates, wind):
    """Return the kinetic energy of the air that moves transversely with each link.

    A Gauss rule with two points is exact, because the velocity is linear along the link.
    """
    mass = arm.air.added_mass_coefficient * arm.air.density * arm.links.volume
    energy = jnp.zeros(())
    for node in (-1 / np.sqrt(3), 1 / np.sqrt(3)):
        _, velocity = motion(arm, angles, rates, along(arm, node))
        through, *_ = across(arm, angles, velocity - wind[None])
        energy += (mass / 2 * (through**2).sum(axis=1)).sum() / 2
    return energy


def potential(arm, angles, gust):
    """Return the potential energy of weight, lift, and the pressure gradient of a changing wind."""
    masses, places = carried(arm)
    centre = positions(arm, angles, along(arm, 0.0))
    air = arm.air.density * arm.links.volume
    energy = arm.gravity * (masses * positions(arm, angles, places)[:, 2]).sum()
    energy -= ((air * arm.gravity + arm.buoyancy.imbalance) * centre[:, 2]).sum()
    return energy - (air * (centre @ gust)).sum()


def drag_torque(arm, angles, rates, wind):
    """Return the joint torques of the drag at three Gauss points per link and at the bodies."""
    total = jnp.zeros(LINKS)
    reference = cylinder_drag_coefficient(jnp.asarray(1e5))
    half_area = 0.5 * arm.air.density * arm.links.length * arm.links.diameter
    for node, weight in ((-np.sqrt(0.6), 5 / 18), (0.0, 8 / 18), (np.sqrt(0.6), 5 / 18)):
        places = along(arm, node)
        _, velocity = motion(arm, angles, rates, places)
        through, slip, directions = across(arm, angles, velocity - wind[None])
        speed = jnp.linalg.norm(through, axis=1)
        curve = cylinder_drag_coefficient(speed * arm.links.diameter / arm.air.viscosity)
        size = half_area * arm.air.drag_coefficient * curve / reference * speed
        force = -weight * size[:, None] * through
        if node == 0.0:
            skin = half_area * arm.air.axial_coefficient * abs(slip) * slip
            force -= skin[:, None] * directions
        _, pull_back = jax.vjp(lambda q, places=places: positions(arm, q, places), angles)
        total += pull_back(force)[0]
    fixed = arm.point_masses
    rows = (np.asarray(fixed.links) - 1, fixed.position, fixed.left, fixed.up)
    places = list(zip(*rows, strict=True))
    _, velocity = motion(arm, angles, rates, places)
    through = velocity - wind[None]
    size = 0.5 * arm.air.density * fixed.drag_area * jnp.linalg.norm(through, axis=1)
    _, pull_back = jax.vjp(lambda q: positions(arm, q, places), angles)
    return total - pull_back(size[:, None] * through)[0]


def lagranges_torque(arm, angles, rates, accelerations, wind, gust):
    """Return the joint torques at a time at which the wind is `wind` and its rate is `gust`."""

    def lagrangian(q, v, t):
        kinetic = links_energy(arm, q, v) + fluid_energy(arm, q, v, wind + arm.air.wind + gust * t)
        return kinetic - potential(arm, q, gust)

    momentum = jax.grad(lagrangian, argnums=1)
    now = jnp.zeros(())
    _, rate = jax.jvp(momentum, (angles, rates, now), (rates, accelerations, jnp.ones(())))
    force = jax.grad(lagrangian)(angles, rates, now)
    return rate - force - drag_torque(arm, angles, rates, wind + arm.air.wind)


@pytest.mark.slow
def test_the_torque_is_that_of_lagrange_with_every_option_on(arm, numbers):
    @jax.jit
    def both(*state):
        return lagranges_torque(numbers, *state), inverse_dynamics(arm, *state)

    rows = (STATES["angles"], STATES["rates"], STATES["command"], STATES["wind"], GUSTS)
    for state in zip(*rows, strict=True):
        expected, found = both(*state)
        assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.slow
def test_inverse_dynamics_undoes_forward_dynamics_with_every_option_on(arm):
    @jax.jit
    @jax.vmap
    def there_and_back(angles, rates, torques, wind, gust):
        accelerations = forward_dynamics(arm, angles, rates, torques, wind, gust)
        return inverse_dynamics(arm, angles, rates, accelerations, wind, gust)

    torques = STATES["command"]
    back = there_and_back(STATES["angles"], STATES["rates"], torques, STATES["wind"], GUSTS)
    assert_allclose(back, torques, rtol=1e-9, atol=1e-10)


def test_the_mass_matrix_is_the_hessian_of_the_energy_of_points_and_fluid(arm, numbers):
    calm = jnp.zeros(3)

    @jax.jit
    def both(angles, rates):
        def energy(v):
            return links_energy(numbers, angles, v) + fluid_energy(numbers, angles, v, calm)

        expected = jax.hessian(energy)(rates), energy(rates)
        return expected, (mass_matrix(arm, angles), kinetic_energy(arm, angles, rates))

    for angles, rates in zip(STATES["angles"], STATES["rates"], strict=True):
        (hessian, energy), (matrix, kinetic) = both(angles, rates)
        assert_allclose(matrix, hessian, rtol=0, atol=1e-13 * np.abs(hessian).max())
        assert_allclose(kinetic, energy, rtol=1e-13)
        assert np.linalg.eigvalsh(matrix).min() > 0
