"""Contact of links with obstacles: closed forms, energy, power and derivatives."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics import arm as mechanics
from giajax.mechanics.arm import Contact, Pairs, flattening, mass_matrix, pose, takeichi_20m
from giajax.mechanics.obstacles import Box, Plane, WallWithOpening, nearest, solids
from giajax.schema.parameters import replace

touch, touched = jax.jit(mechanics.touch), jax.jit(mechanics.touched)
contact_energy = jax.jit(mechanics.contact_energy)
contact_stiffness = jax.jit(mechanics.contact_stiffness)

# With so few links, all pairs of links and boxes are evaluated together, by one program.
LINKS = 2
SCENE = (
    Box(centre=[1.4, 0.1, -0.5], size=[0.4, 0.6, 0.9], rotation=[0.2, 0.1, 0.5]),
    WallWithOpening(centre=[2.4, 0.0, 0.0], opening=[0.5, 0.5], rotation=[0.0, 0.1, 0.1]),
    Plane(centre=[0.0, 0.0, -0.55], normal=[0.1, 0.1, 1.0]),
)


def arm_among(obstacles=SCENE, links=LINKS, pressure=1000.0, **about):
    contact = Contact(obstacles=obstacles, **about)
    return takeichi_20m(links, contact=contact, parameters={"links.pressure": pressure})


@eqx.filter_jit
def depths(arm, angles):
    """Return the indentation of the links, m, for rows of angles."""
    pairs = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices((arm.count, 10))))
    return jax.vmap(lambda q: flattening(arm, arm.contact, pose(arm, q), pairs))(angles)


@functools.cache
def pressed_states(count, links=LINKS):
    """Return angles in which links touch obstacles, but not deeper than a link is thick."""
    random = np.random.default_rng(3)
    angles = jnp.asarray(random.normal(size=(2000, links)) * 0.25)
    depth = jnp.max(depths(arm_among(links=links), angles), axis=1)
    found = angles[(depth > 2e-3) & (depth < 0.08)]
    assert len(found) >= count
    rates = jnp.asarray(random.normal(size=(count, links)))
    strain = jnp.asarray(random.normal(size=(count, 3, links)) * 1e-3)
    return found[:count], rates, strain


# One program for each function and its derivative along a direction, shared by the tests. The rows
# are processed in a loop, because a batch would have to be traced, too.
@jax.jit
def touch_along(arm, state, direction):
    """Return the contact for rows of angles, rates and stretch, and the change of its torque."""

    def one(state, direction):
        met, change = jax.jvp(lambda *x: touch(arm, *x), state, direction)
        return met, change.torque

    return jax.lax.map(lambda row: one(*row), (state, direction))


@jax.jit
def energy_along(arm, angles, direction):
    """Return the energy for rows of angles, and its change."""

    def one(row):
        q, v = row
        return jax.jvp(lambda q: contact_energy(arm, q), (q,), (v,))

    return jax.lax.map(one, (angles, direction))


@pytest.mark.parametrize("factor", [np.pi, 4 * np.pi / 3])
def test_a_link_between_two_plates_is_the_closed_form(factor):
    """(pi / 2) p L delta for plates whose distance decreases by delta; pi p L w for each wall."""
    w, pressure = 0.02, 800.0
    walls = (
        Plane(centre=[0.0, 0.0, -0.15 + w], name="below"),
        Plane(centre=[0.0, 0.0, 0.15 - w], normal=[0.0, 0.0, -1.0], name="above"),
    )
    arm = arm_among(walls, links=1, pressure=pressure, shape_factor=factor)
    flat, force = touched(arm, jnp.zeros(1), jnp.zeros(1))
    expected = factor * pressure * 0.99 * w
    assert_allclose(force[0], [[0, 0, expected], [0, 0, -expected]], rtol=1e-12, atol=1e-12)
    assert_allclose(flat, [[w, w]], rtol=1e-12)
    if factor == np.pi:
        assert_allclose(expected, np.pi / 2 * pressure * 0.99 * (2 * w), rtol=1e-15)
    assert_allclose(contact_energy(arm, jnp.zeros(1)), 2 * expected * w / 2, rtol=1e-12)
    # The forces from above and below are equal, so the torque is zero.
    assert_allclose(touch(arm, jnp.zeros(1), jnp.zeros(1)).torque, 0, atol=1e-12)


def test_a_flattened_tube_has_the_force_of_its_flat_width():
    """The force of an oval of the same circumference is p times its flat width.

    A single wall deforms the section to first order like a membrane under its own uniform weight.
    The radial displacements u satisfy u + u'' = (F / p) (delta - cos(theta) / pi). Its terms cos(n
    theta), n >= 2, are 1 / (pi (1 - n^2)).
    """
    radius, pressure, delta = 0.15, 1000.0, 0.01
    flat = (2 * np.pi * radius - np.pi * (2 * radius - delta)) / 2
    assert_allclose(pressure * flat, np.pi / 2 * pressure * delta, rtol=1e-12)
    n = np.arange(2, 400_000, dtype=float)
    one_wall = np.sum(1 / (np.pi * (n * n - 1)))
    assert_allclose(1 / one_wall, 4 * np.pi / 3, rtol=1e-5)
    two_walls = np.sum(2 / (np.pi * (n[::2] ** 2 - 1)))
    assert_allclose(1 / two_walls, np.pi, rtol=1e-5)


def test_force_is_the_derivative_of_the_energy_and_has_its_own():
    arm = arm_among(damping=0.4, friction=0.3)
    angles, rates, strain = pressed_states(40)
    here, still = (angles, rates, strain), jnp.zeros_like(rates)
    step = 1e-6
    resting = touch_along(arm, (angles, still, jnp.zeros_like(strain)), here)[0].torque
    rows = [step * np.tile(row, (len(angles), 1)) for row in np.eye(LINKS)]
    slopes = [
        (energy_along(arm, angles + row, row)[0] - energy_along(arm, angles - row, row)[0])
        / (2 * step)
        for row in rows
    ]
    scale = np.abs(resting).max(axis=1, keepdims=True)
    assert_allclose(-np.stack(slopes, axis=1) / scale, resting / scale, atol=1e-5)
    # One direction in angles, rates and stretch, in both modes.
    random = np.random.default_rng(5)
    d = [jnp.asarray(random.normal(size=x.shape)) for x in here]
    d[2] = d[2] * 1e-3
    _, forward = touch_along(arm, here, tuple(d))
    ahead, back = (
        touch_along(
            arm, tuple(x + sign * step * dx for x, dx in zip(here, d, strict=True)), tuple(d)
        )[0].torque
        for sign in (1, -1)
    )
    numbers = (ahead - back) / (2 * step)
    size = np.abs(numbers).max(axis=1, keepdims=True)
    assert_allclose(forward / size, numbers / size, atol=1e-4)

    weights = jnp.cos(jnp.arange(LINKS))

    def pulled(x):
        torque, pull = jax.vjp(lambda *x: touch(arm, *x).torque, *x)
        return torque, pull(weights)

    torque, by = jax.jit(lambda here: jax.lax.map(pulled, here))(here)
    assert_allclose(torque, touch_along(arm, here, here)[0].torque, rtol=1e-10, atol=1e-12)
    reverse = sum(np.sum(a * b, axis=tuple(range(1, a.ndim))) for a, b in zip(by, d, strict=True))
    assert_allclose(np.asarray(forward) @ weights, reverse, rtol=1e-8)


@pytest.mark.slow
def test_derivatives_by_pressure_and_by_where_the_wall_stands():
    """Also with respect to the angles, for so many links that only near pairs are evaluated."""
    links = 3
    arm = arm_among(pressure=1000.0, links=links)
    angles, way, _ = pressed_states(8, links)

    def of(pressure, height, q):
        up = jnp.array([0.0, 0.0, 1.0]) * height
        scene = tuple(dataclasses.replace(each, centre=each.centre + up) for each in SCENE)
        contact = dataclasses.replace(arm.contact, obstacles=scene)
        moved = replace(dataclasses.replace(arm, contact=contact), {"links.pressure": pressure})
        return jnp.sum(touch(moved, q, jnp.zeros(links)).torque * jnp.arange(1.0, 1 + links))

    @jax.jit
    def total(*at):
        def one(row):
            q, v = row

            def bent(pressure, height, bend):
                return of(pressure, height, q + bend * v)

            return jax.value_and_grad(bent, (0, 1, 2))(*at)

        return jax.tree.map(jnp.sum, jax.lax.map(one, (angles, way)))

    at = (jnp.asarray(1000.0), jnp.asarray(0.0), jnp.asarray(0.0))
    value, slopes = total(*at)
    assert_allclose(slopes[0], value / 1000, rtol=1e-10)
    step = 1e-6
    for index in (1, 2):
        ahead, back = (
            total(*(x + sign * step * (i == index) for i, x in enumerate(at)))[0]
            for sign in (1, -1)
        )
        assert ahead != back
        assert_allclose(slopes[index], (ahead - back) / (2 * step), rtol=1e-4)


def test_contact_never_creates_energy():
    """In every state, the sum of delivered power and rate of stored energy is not positive."""
    arm = arm_among(damping=2.0, friction=0.4)
    angles, rates, strain = pressed_states(40)

    state = (angles, rates * 3, strain)
    met, _ = touch_along(arm, state, state)
    # Power of the torques, and rate of the energy stored by flattening and by sticking skin.
    power = np.sum(met.torque * state[1], axis=1)
    stored = energy_along(arm, angles, state[1])[1]
    held = jax.jit(jax.vmap(arm.contact.hold))(strain, met.normal)
    stretched = float(arm.contact.friction_stiffness) * np.sum(held * met.slip, axis=(1, 2))
    total, size = power + np.asarray(stored) + stretched, np.abs(power)
    assert np.all(total < 1e-10 * size + 1e-12)
    assert np.median(-total / size) > 0.01


def test_the_stiffness_is_what_presses_and_never_negative():
    arm = arm_among((Plane(centre=[0.0, 0.0, -0.14]),), damping=0.5, friction=0.5)
    angles = jnp.asarray([0.001, -0.001])
    still, slack = jnp.zeros(LINKS), jnp.zeros((3, LINKS))
    stiff = contact_stiffness(arm, angles, still, slack)
    by = jax.jit(jax.jacfwd(lambda q, v: touch(arm, q, v, slack), (0, 1)))(angles, still)
    by_angles, by_rates = (-each for each in by.torque)
    # The rotation of the normals is neglected, which is the force divided by the length.
    assert_allclose(stiff.angles, by_angles, atol=0.02 * np.abs(by_angles).max())
    assert_allclose(stiff.rates, by_rates, atol=1e-10)
    assert np.linalg.eigvalsh(stiff.angles).min() > -1e-9
    assert_allclose(stiff.sticking, by.slip[1], atol=1e-12)
    stretch = jnp.asarray(np.random.default_rng(0).normal(size=(3, LINKS)) * 1e-4)
    pulls, rest = (touch(arm, angles, still, each).torque for each in (stretch, slack))
    by_skin = -stiff.skin * jnp.einsum("ilj,il->j", stiff.sticking, stretch)
    assert_allclose(pulls - rest, by_skin, atol=1e-10)


def test_the_period_of_a_link_on_its_cushion():
    """3.1 kN/m and 257 rad/s for a link of 47 g at 1 kPa, on which a wall presses uniformly."""
    arm = arm_among((Plane(centre=[0.0, 0.0, -0.14]),), links=1)
    rate = np.sqrt(np.pi * 1000 * 0.99 / float(arm.links.mass[0]))
    assert_allclose(rate, 257, rtol=2e-3)
    stiff = contact_stiffness(arm, jnp.zeros(1), jnp.zeros(1)).angles
    # About the joint, the stiffness is pi p L^3 / 3.
    assert_allclose(stiff, [[np.pi * 1000 * 0.99**3 / 3]], rtol=1e-10)
    assert mass_matrix(arm, jnp.zeros(1)) > 0


def test_boxes_side_by_side_press_as_one_wall():
    """A link that slides along a wall of eight boxes is not affected by the seams."""
    wall = WallWithOpening(
        centre=[0.5, 0.0, -1.2],
        opening=[0.3, 0.3],
        margins=[1.0] * 4,
        rotation=[0.0, np.pi / 2, 0.0],
    )
    solid = Box(size=[2.3, 2.3, 0.2])

    def arm(obstacle):
        moved = dataclasses.replace(obstacle, centre=jnp.asarray([1.0, 0.8, -0.24]))
        return takeichi_20m(2, joint_axes=["yaw", "pitch"], contact=Contact(obstacles=(moved,)))

    # The link crosses the seams at x = 0.85 and 1.15 m, in the last case also that at y = 0.65 m.
    # The opening between them is out of reach.
    for angle in (-0.15, 0.0, 0.1, 0.3, 0.36):
        angles = jnp.asarray([angle, 0.012])
        whole, parts = (touch(arm(each), angles, jnp.zeros(2)) for each in (solid, wall))
        assert np.min(whole.normal) > 1
        assert_allclose(parts.normal, whole.normal, rtol=1e-9)
        assert_allclose(parts.torque, whole.torque, rtol=1e-9, atol=1e-9)
    # Over the opening, there is no contact.
    angles = jnp.asarray([0.67, 0.0])
    whole, parts = (touch(arm(each), angles, jnp.zeros(2)) for each in (solid, wall))
    assert np.sum(parts.normal) < 0.95 * np.sum(whole.normal)


def test_flattening_is_that_of_the_deepest_place_of_the_axis():
    """This includes an axis inside a box; compared with a fine search along the links."""
    arm = arm_among(links=3)
    angles = jnp.asarray(np.random.default_rng(9).normal(size=(120, 3)) * 0.5)
    boxes, radius = solids(SCENE), float(arm.links.diameter[0]) / 2

    def searched(q):
        here = pose(arm, q)
        along = jnp.linspace(0, 0.99, 4001)
        x = here.joint[:, :, None] + here.direction[:, :, None] * along[None, None]
        beside = x[:, :, None] - boxes.centre[:, None, :, None]
        local = jnp.sum(boxes.frame[:, :, None, :, None] * beside[:, None], axis=0)
        shared = jnp.asarray(boxes.shared, float)[:, :, None, :, None]
        half = boxes.half[:, None, :, None]
        seen = nearest(local, half, shared)
        # The part beyond a shared face belongs to the other box.
        other = (shared[1] > 0) & (local > half) | (shared[0] > 0) & (local < -half)
        depth = jnp.where(jnp.any(other, axis=0), 0, radius - seen.distance)
        return jnp.maximum(jnp.max(depth, axis=-1), 0).ravel()

    found = depths(arm, angles)
    expected = jax.jit(jax.vmap(searched))(angles)
    assert np.sum(expected > radius) > 30
    assert_allclose(found, expected, atol=3e-4)


def test_a_plane_ends_nowhere_that_an_arm_reaches():
    """The result does not depend on the position of its reference point, even if it is far away."""
    for centre in ([0.0, 0.0, -0.14], [5000.0, -3000.0, -0.14]):
        arm = arm_among((Plane(centre=centre),))
        flat = touched(arm, jnp.zeros(LINKS), jnp.zeros(LINKS))[0]
        assert_allclose(flat[:, 0], 0.01, rtol=1e-10)


def test_far_away_nothing_is_pressed():
    arm = arm_among((Plane(centre=[0.0, 0.0, -5.0]),), friction=0.3)
    met = touch(arm, jnp.zeros(LINKS), jnp.ones(LINKS), jnp.ones((3, LINKS)))
    assert not np.any(met.torque)
    assert not np.any(met.slip)


def test_many_links_at_once_are_all_seen():
    """There are more pairs than the number that is evaluated together if few are near."""
    ground = (Plane(centre=[0.0, 0.0, -0.14]), Box(centre=[6.0, 0.29, 0.0], size=[14.0, 0.3, 0.3]))
    arm = arm_among(ground, links=15)
    flat, force = touched(arm, jnp.zeros(15), jnp.zeros(15))
    assert_allclose(flat[:, 0], 0.01, rtol=1e-10)
    assert_allclose(flat[:12, 1], 0.01, rtol=1e-10)
    seen = touch(arm, jnp.zeros(15), jnp.zeros(15)).normal
    # At the end of the box, forces on one link have several directions.
    alike = np.delete(np.arange(15), 13)
    assert_allclose(seen[alike], jnp.linalg.norm(force, axis=2).sum(axis=1)[alike], rtol=1e-9)


def test_clearance_is_the_distance_of_the_skin_and_has_its_slope():
    """For a plane, the clearance is the height; for a box, the distance of its nearest corner."""
    height, radius = 0.8, 0.15
    things = (Plane([0.0, 0.0, -height]), Box([4.0, 1.0, 0.0], [2.0, 1.0, 1.0]))
    around = dataclasses.replace(takeichi_20m(2), contact=Contact(things))
    gaps = np.asarray(mechanics.clearance(around, jnp.zeros(2)))
    length = float(jnp.sum(around.links.length))
    np.testing.assert_allclose(gaps[:, 0], height - radius, atol=1e-12)
    assert gaps[1, 1] == pytest.approx(math.hypot(3.0 - length, 0.5) - radius)
    # A positive angle bends the arm up, away from the plane, by the height of its lower end.
    bent = jnp.asarray([-0.1, 0.0])
    low = height - length / 2 * math.sin(0.1) - radius
    assert float(mechanics.clearance(around, bent)[0, 0]) == pytest.approx(low)
    slope = jax.jacfwd(lambda each: mechanics.clearance(around, each)[0, 0])(bent)
    assert slope[0] == pytest.approx(length / 2 * math.cos(0.1))
    with pytest.raises(InputError, match="has no obstacles, so it has no clearance"):
        mechanics.clearance(takeichi_20m(2), jnp.zeros(2))


def test_clearance_of_a_wall_is_that_of_points_along_the_links():
    """Links pass the opening at all angles; compared with points at intervals of 2 mm."""
    wall = WallWithOpening([2.0, 0.0, 0.3], [1.0, 1.2], [0.5, 0.6, 0.7, 0.8], 0.2, [0.1, 0.3, 0.2])
    around = dataclasses.replace(takeichi_20m(6), contact=Contact((wall,)))
    angles = np.random.default_rng(1).uniform(-0.8, 0.8, (40, 6))
    found = np.asarray(jax.vmap(lambda each: mechanics.clearance(around, each))(angles))
    boxes = solids((wall,))
    frame, half = np.moveaxis(np.asarray(boxes.frame), 2, 0), np.asarray(boxes.half).T
    share = np.linspace(0.0, 1.0, 500)
    for row, gaps in zip(angles, found, strict=True):
        here = pose(around, jnp.asarray(row))
        along = np.asarray(around.links.length)[:, None] * share
        joint, direction = np.asarray(here.joint).T, np.asarray(here.direction).T
        points = joint[:, None] + along[:, :, None] * direction[:, None]
        for k, centre in enumerate(np.asarray(boxes.centre).T):
            out = np.abs((points - centre) @ frame[k]) - half[k]
            far = np.linalg.norm(np.maximum(out, 0), axis=2).min(axis=1)
            apart = far > 1e-3
            assert_allclose(gaps[apart, k], far[apart] - 0.15, atol=1e-3)
            assert np.all(gaps[~apart, k] < -0.14)


@pytest.mark.parametrize("beside", [0.0, 0.2])
def test_clearance_within_a_wall_is_to_its_faces_and_not_to_those_of_its_boxes(beside):
    """Half of the thickness plus the radius, for links in the wall near the seam of two boxes."""
    centre = [1.0, 0.0, -0.5 - beside]
    wall = WallWithOpening(centre, [1.0, 1.0], [1.5] * 4, 1.0, [0.0, 0.0, np.pi / 2])
    around = dataclasses.replace(takeichi_20m(2), contact=Contact((wall,)))
    gaps = np.asarray(mechanics.clearance(around, jnp.zeros(2)))
    assert_allclose(gaps.min(axis=1), -0.5 - 0.15, atol=1e-6)


def test_contact_needs_something_to_touch():
    with pytest.raises(InputError, match="without an obstacle: give at least one"):
        Contact(obstacles=())
    with pytest.raises(InputError, match="two obstacles are called 'box': give each its own"):
        Contact(obstacles=(Box(), Box()))
    with pytest.raises(InputError, match="friction_stiffness is 0: make it positive"):
        Contact(obstacles=(Box(),), friction=0.3, friction_stiffness=0.0)
