"""Mechanical identities that hold for any arm, with references independent of the code."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import giajax.mechanics.arm
from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import get, replace, switched_on
from peers.arms import general_arm, random_states
from peers.scipy_chain import ScipyChain

# Compiled as a whole, because compiling the operations of a function one by one takes a second.
acceleration = eqx.filter_jit(giajax.mechanics.arm.acceleration)
damping_power = eqx.filter_jit(giajax.mechanics.arm.damping_power)
drag_force = eqx.filter_jit(giajax.mechanics.arm.drag_force)
drag_power = eqx.filter_jit(giajax.mechanics.arm.drag_power)
forward_dynamics = eqx.filter_jit(giajax.mechanics.arm.forward_dynamics)
inverse_dynamics = eqx.filter_jit(giajax.mechanics.arm.inverse_dynamics)
joint_torque = eqx.filter_jit(giajax.mechanics.arm.joint_torque)
kinetic_energy = eqx.filter_jit(giajax.mechanics.arm.kinetic_energy)
link_centres = eqx.filter_jit(giajax.mechanics.arm.link_centres)
link_velocities = eqx.filter_jit(giajax.mechanics.arm.link_velocities)
mass_matrix = eqx.filter_jit(giajax.mechanics.arm.mass_matrix)
potential_energy = eqx.filter_jit(giajax.mechanics.arm.potential_energy)
tip_position = eqx.filter_jit(giajax.mechanics.arm.tip_position)

LINKS = 6
STATES = random_states(LINKS, 10)
ANGLES, RATES, WIND = (STATES[name] for name in ("angles", "rates", "wind"))
ACCELERATIONS = STATES["command"]


@pytest.fixture(scope="module")
def arm():
    return general_arm(LINKS)


@pytest.fixture(scope="module")
def ideal(arm):
    """Return the same arm without air and gravity, with inertia alone."""
    return replace(arm, {"air.drag_coefficient": 0.0, "gravity": 0.0})


def energy_of_links(arm, angles, rates):
    """Return the kinetic energy link by link, as in a textbook."""
    orientations = ScipyChain(arm).orientations(np.asarray(angles))
    links = jax.tree.map(np.asarray, arm.links)
    omega, joint_velocity, energy = np.zeros(3), np.zeros(3), 0.0
    for link, turn in enumerate(orientations):
        omega = omega + rates[link] * (turn @ np.asarray(arm.joints.axes[link]))
        velocity = joint_velocity + np.cross(omega, links.centre_of_mass[link] * turn[:, 0])
        in_link = turn.T @ omega
        across, along = links.inertia_transverse[link], links.inertia_axial[link]
        energy += links.mass[link] * velocity @ velocity / 2
        energy += (along * in_link[0] ** 2 + across * (in_link[1] ** 2 + in_link[2] ** 2)) / 2
        joint_velocity = joint_velocity + np.cross(omega, links.length[link] * turn[:, 0])
    return energy


def test_the_mass_matrix_is_symmetric_and_positive_definite(arm):
    for matrix in jax.vmap(mass_matrix, in_axes=(None, 0))(arm, ANGLES):
        assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0


def test_the_mass_matrix_is_the_hessian_of_the_links_energy(arm):
    angles = ANGLES[0]
    unit = np.eye(LINKS)
    # Polarisation of the quadratic form: T(a + b) - T(a) - T(b) = a' M b.
    alone = [energy_of_links(arm, angles, e) for e in unit]
    expected = [
        [
            energy_of_links(arm, angles, unit[i] + unit[j]) - alone[i] - alone[j]
            for j in range(LINKS)
        ]
        for i in range(LINKS)
    ]
    matrix = mass_matrix(arm, angles)
    assert_allclose(matrix, expected, rtol=1e-11, atol=1e-13)


def test_one_link_turns_with_its_inertia_about_the_joint():
    # Parallel axes: I + m c^2 about a transverse axis, I_axial about the link's own axis.
    links = {"mass": 0.2, "length": 1.5, "centre_of_mass": 0.4}
    inertias = {"inertia_transverse": 0.03, "inertia_axial": 0.01}
    for axes, expected in ([["pitch"]], 0.03 + 0.2 * 0.16), ([[[1, 0, 0]]], 0.01):
        arm = takeichi_20m(1, **links, **inertias, joint_axes=axes[0])
        assert_allclose(mass_matrix(arm, jnp.array([0.7])), [[expected]], rtol=1e-14)


def test_the_rate_of_the_mass_matrix_is_the_coriolis_matrix_and_its_transpose(ideal):
    """d/dt M - (C + C') = 0 with Christoffel's C = 1/2 dh/dv; h = C v is quadratic in v."""

    def coriolis_force(angles, rates):
        return inverse_dynamics(ideal, angles, rates, jnp.zeros(LINKS))

    @jax.jit
    def difference(angles, rates):
        coriolis = jax.jacfwd(coriolis_force, argnums=1)(angles, rates) / 2
        _, rate = jax.jvp(lambda q: mass_matrix(ideal, q), (angles,), (rates,))
        return rate, coriolis, coriolis_force(angles, rates)

    for angles, rates in zip(ANGLES, RATES, strict=True):
        rate, coriolis, force = difference(angles, rates)
        assert_allclose(coriolis @ rates, force, rtol=1e-10, atol=1e-12)
        assert_allclose(rate, coriolis + coriolis.T, rtol=1e-10, atol=1e-12)


def test_inverse_dynamics_undoes_forward_dynamics(arm):
    @jax.jit
    @jax.vmap
    def there_and_back(angles, rates, torques, wind):
        accelerations = forward_dynamics(arm, angles, rates, torques, wind)
        return inverse_dynamics(arm, angles, rates, accelerations, wind)

    torques = ACCELERATIONS
    assert_allclose(there_and_back(ANGLES, RATES, torques, WIND), torques, rtol=1e-9, atol=1e-10)


def test_accelerations_enter_the_torque_through_the_mass_matrix(arm):
    angles, rates, accelerations, wind = ANGLES[0], RATES[0], ACCELERATIONS[0], WIND[0]
    moving = inverse_dynamics(arm, angles, rates, accelerations, wind)
    coasting = inverse_dynamics(arm, angles, rates, jnp.zeros(LINKS), wind)
    expected = mass_matrix(arm, angles) @ accelerations
    assert_allclose(moving - coasting, expected, rtol=1e-11, atol=1e-12)


@pytest.mark.slow
def test_still_air_is_a_wind_of_zero(arm):
    angles, rates, torques = ANGLES[0], RATES[0], ACCELERATIONS[0]
    calm = jnp.zeros(3)
    for function in (inverse_dynamics, forward_dynamics, acceleration):
        assert_array_equal(
            function(arm, angles, rates, torques), function(arm, angles, rates, torques, calm)
        )
    assert_array_equal(drag_force(arm, angles, rates), drag_force(arm, angles, rates, calm))
    assert_array_equal(drag_power(arm, angles, rates), drag_power(arm, angles, rates, calm))


def test_the_torque_that_holds_an_arm_is_the_slope_of_its_weight(arm):
    still = jnp.zeros(LINKS)
    for angles in ANGLES[:3]:
        held = inverse_dynamics(arm, angles, still, still)
        slope = jax.grad(potential_energy, argnums=1)(arm, angles, angles)
        assert_allclose(held, slope, rtol=1e-12, atol=1e-13)


def test_a_straight_arm_hangs_its_weight_on_its_levers():
    arm = takeichi_20m(4, mass=[0.1, 0.2, 0.3, 0.4], length=2.0, centre_of_mass=0.5, gravity=9.81)
    still = jnp.zeros(4)
    held = inverse_dynamics(arm, still, still, still)
    # Centres of mass at 0.5, 2.5, 4.5, 6.5 m; joints 1 and 3 are pitch joints, 2 and 4 bear no
    # weight.
    first = 9.81 * (0.1 * 0.5 + 0.2 * 2.5 + 0.3 * 4.5 + 0.4 * 6.5)
    third = 9.81 * (0.3 * 0.5 + 0.4 * 2.5)
    assert_allclose(held, [first, 0, third, 0], rtol=1e-14, atol=1e-14)


def test_springs_pull_to_the_command_and_dampers_against_the_rate():
    arm = replace(takeichi_20m(3), {"joints.damping": 0.5})
    torque = joint_torque(
        arm, jnp.array([0.1, 0.2, 0.3]), jnp.array([1.0, -2.0, 0.0]), jnp.array([0.5, 0.2, -0.1])
    )
    assert_allclose(torque, [3 * 0.4 - 0.5, 30 * 0.0 + 1.0, 3 * -0.4], rtol=1e-14)


def test_every_joint_may_have_its_own_damping(arm):
    each = jnp.linspace(0.01, 0.06, LINKS)
    own = replace_damping(arm, each)
    angles, rates = ANGLES[0], RATES[0]
    still = joint_torque(own, angles, jnp.zeros(LINKS), angles)
    assert_array_equal(still, np.zeros(LINKS))
    assert_allclose(joint_torque(own, angles, rates, angles), -each * rates, rtol=1e-14)
    assert_allclose(damping_power(own, rates), -(each * rates**2).sum(), rtol=1e-14)
    found = acceleration(own, angles, rates, jnp.zeros(LINKS))
    expected = ScipyChain(own).acceleration(*map(np.asarray, (angles, rates)), np.zeros(LINKS))
    assert_allclose(found, expected, rtol=1e-10)


def replace_damping(arm, damping):
    return eqx.tree_at(lambda arm: arm.joints.damping, arm, damping)


def test_drag_is_equation_1(arm):
    for angles, rates, wind in zip(ANGLES[:3], RATES[:3], WIND[:3], strict=True):
        velocity = np.asarray(link_velocities(arm, angles, rates)) - np.asarray(wind)
        area = np.asarray(arm.links.length) * np.asarray(arm.links.diameter)
        speed = np.linalg.norm(velocity, axis=1)
        expected = -0.5 * 1.1 * 0.9 * (area * speed)[:, None] * velocity
        assert_allclose(drag_force(arm, angles, rates, wind), expected, rtol=1e-12)


def test_the_wind_blows_a_resting_arm_along():
    arm = takeichi_20m(2)
    still = jnp.zeros(2)
    force = drag_force(arm, still, still, jnp.array([0.0, 0.0, 0.2]))
    # 1/2 1.204 1.2 0.99 0.3 0.2^2
    assert_allclose(force, [[0, 0, 0.0085820]] * 2, rtol=1e-4)
    rising = acceleration(arm, still, still, still, jnp.array([0.0, 0.0, 0.2]))
    assert float(rising[0]) > 0


def test_an_arm_carried_along_by_the_wind_feels_none_of_it():
    # One link about a vertical axis, whose centre moves with the wind for an instant.
    arm = takeichi_20m(1, joint_axes=["yaw"])
    angles, rates = jnp.zeros(1), jnp.ones(1)
    with_it = link_velocities(arm, angles, rates)[0]
    assert_allclose(drag_force(arm, angles, rates, with_it), np.zeros((1, 3)), atol=0)


def test_drag_does_its_virtual_work(arm):
    airless = replace(arm, {"air.drag_coefficient": 0.0})
    for angles, rates, wind in zip(ANGLES[:3], RATES[:3], WIND[:3], strict=True):
        accelerations = ACCELERATIONS[0]
        against = inverse_dynamics(arm, angles, rates, accelerations, wind)
        without = inverse_dynamics(airless, angles, rates, accelerations, wind)
        force = drag_force(arm, angles, rates, wind)
        _, pull_back = jax.vjp(lambda q: link_centres(arm, q), angles)
        assert_allclose(without - against, pull_back(force)[0], rtol=1e-10, atol=1e-12)


def test_powers_are_force_times_velocity(arm):
    for angles, rates, wind in zip(ANGLES[:3], RATES[:3], WIND[:3], strict=True):
        force = drag_force(arm, angles, rates, wind)
        expected = (force * link_velocities(arm, angles, rates)).sum()
        assert_allclose(drag_power(arm, angles, rates, wind), expected, rtol=1e-12)
        assert float(drag_power(arm, angles, rates)) < 0
        assert_allclose(damping_power(arm, rates), -0.04 * (rates**2).sum(), rtol=1e-13)


def test_energies_are_those_of_links_springs_and_weights(arm):
    reference = ScipyChain(arm)
    for angles, rates, command in zip(ANGLES[:3], RATES[:3], STATES["command"][:3], strict=True):
        kinetic = energy_of_links(arm, angles, rates)
        assert_allclose(kinetic_energy(arm, angles, rates), kinetic, rtol=1e-12)
        along = reference.orientations(np.asarray(angles))[:, :, 0]
        span = reference.length[:, None] * along
        height = np.cumsum(span, axis=0) - span + reference.mass_centre[:, None] * along
        weight = 1.7 * (reference.mass * height[:, 2]).sum()
        springs = (reference.stiffness * (angles - command) ** 2).sum() / 2
        found = potential_energy(arm, angles, command)
        assert_allclose(found, weight + springs, rtol=1e-12)


def test_a_pitch_command_moves_nothing_in_yaw():
    arm = takeichi_20m(8)
    pitch = np.arange(8) % 2 == 0
    planar = {name: jnp.where(pitch, value[0, :8], 0) for name, value in plane_states().items()}
    found = acceleration(arm, planar["angles"], planar["rates"], planar["command"])
    assert_allclose(found[~pitch], 0, atol=1e-12 * np.abs(found).max())
    assert np.all(np.abs(found[pitch]) > 1e-3)


def plane_states():
    states = random_states(8, 1)
    return {name: states[name] for name in ("angles", "rates", "command")}


def test_the_direction_of_the_base_is_nothing_without_gravity_and_wind():
    states = random_states(8, 1)
    state = (states["angles"][0], states["rates"][0], states["command"][0])
    arm = takeichi_20m(8)
    turned = takeichi_20m(8, base_rotation=[0.3, 1.4, -2.0])
    assert_allclose(acceleration(turned, *state), acceleration(arm, *state), rtol=1e-10)


def test_mass_inertia_drag_and_joints_scale_together():
    states = random_states(8, 1)
    state = (states["angles"][0], states["rates"][0], states["command"][0], states["wind"][0])
    arm = takeichi_20m(8)
    paths = [
        "links.mass",
        "links.inertia_transverse",
        "links.inertia_axial",
        "air.drag_coefficient",
        "joints.pitch_stiffness",
        "joints.yaw_stiffness",
        "joints.damping",
    ]
    heavier = replace(arm, {path: 1.7 * get(arm, path) for path in paths})
    assert_allclose(acceleration(heavier, *state), acceleration(arm, *state), rtol=1e-10)
    # If one of them is omitted, the result differs.
    lighter_drag = replace(heavier, {"air.drag_coefficient": 1.2})
    assert not np.allclose(acceleration(lighter_drag, *state), acceleration(arm, *state), rtol=1e-3)


def test_a_change_of_numbers_compiles_nothing_again():
    traced = []

    @jax.jit
    def program(arm, angles):
        traced.append(arm)
        return tip_position(arm, angles).sum() + acceleration(arm, angles, angles, angles).sum()

    arm, angles = takeichi_20m(3), jnp.zeros(3)
    program(arm, angles)
    program(replace(arm, {"air.drag_coefficient": 1.0}), angles)
    program(replace(arm, {"air.drag_coefficient": jnp.asarray(1.0)}), angles)
    program(replace(arm, {"links.mass[1]": np.float32(0.1), "gravity": 1}), angles)
    program(takeichi_20m(3, mass=1, gravity=3), angles)
    assert len(traced) == 1


def test_the_bound_on_damping_follows_from_the_law():
    """By hand: friction has its largest slope at rest, 0.3 / 0.1 N m s/rad, plus the damping."""
    values = {"joints.damping": [1.0, 2.0], "joints.friction": 0.3, "joints.friction_rate": 0.1}
    laws = replace(switched_on(takeichi_20m(2), list(values)), values).joint_laws
    still, small = jnp.zeros(2), jnp.full(2, 1e-7)
    steepest = laws.slopes(laws.at(still, still, still))[1]
    assert_allclose(steepest, [4.0, 5.0], rtol=1e-14)
    torque = laws.torque(laws.at(still, small, still))
    assert_allclose(-torque / small, steepest, rtol=1e-9)
