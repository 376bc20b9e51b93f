"""Joint hysteresis: closed forms, energy, and the operators of `mechanics.hysteresis`."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.cli._values import with_settings
from giajax.mechanics.arm import (
    JointHysteresis,
    JointLaws,
    JointState,
    Memory,
    Stops,
    acceleration,
    hysteresis_power,
    inverse_dynamics,
    joint_torque,
    mass_matrix,
    potential_energy,
    takeichi_20m,
)
from giajax.mechanics.hysteresis import Stop
from giajax.models import arm_from_definition, arm_to_definition
from giajax.recordings import Definition
from giajax.schema.parameters import replace


def moment(angles, rates=None, states=None):
    still = jnp.zeros_like(angles)
    return JointState(angles, still if rates is None else rates, still, states)


def along(element, angles):
    """Return states and torques of one joint with sliding elements after each angle (rad)."""
    states = element.unstrained(jnp.asarray(angles[:1]))

    def move(states, angle):
        states = element.return_mapped(angle[None], states)
        return states, (states, -element.torque(moment(angle[None], states=states))[0])

    return jax.lax.scan(move, states, jnp.asarray(angles))[1]


def test_one_stop_dissipates_what_its_loop_encloses():
    strength, yield_angle, amplitude = 0.3, 0.25, 1.0
    element = Stops(strength=strength, yield_angle=yield_angle)
    quarter = np.linspace(0.0, amplitude, 401)
    loop = np.concatenate([quarter[::-1], -quarter[1:], -quarter[-2::-1], quarter[1:]])
    angles = np.concatenate([quarter, loop])
    torques = np.asarray(along(element, angles)[1])[len(quarter) :]
    # The torque is linear between these angles, because every corner is one of them.
    work = np.sum(np.diff(loop) * (torques[1:] + torques[:-1]) / 2)
    stiffness = strength / yield_angle
    assert work == pytest.approx(4 * strength * (amplitude - strength / stiffness), abs=1e-8)


def test_stops_in_parallel_are_the_operators_of_hysteresis():
    yields, strengths = np.asarray([0.05, 0.2, 0.6]), np.asarray([0.02, 0.1, 0.05])
    angles = np.cumsum(np.random.default_rng(3).normal(size=400)) * 0.1
    element = Stops(strength=strengths, yield_angle=yields)
    angles = np.concatenate([[0.0], angles])
    expected = sum(
        strength
        / width
        * np.asarray(Stop(thresholds=[width]).history(jnp.asarray(angles))[0])[:, 0]
        for strength, width in zip(strengths, yields, strict=True)
    )
    assert_allclose(along(element, angles)[1], expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize("start", [0.0, -0.4, 0.9])
def test_dahls_strain_in_one_direction_is_an_exponential(start):
    element = Memory(strength=0.2, yield_angle=0.03)
    count, way, one = 20_000, 0.08, jnp.ones(1)
    step = way / count

    def middle(_, z):
        half = z + step / 2 * element.rate(moment(one, one, z))
        return z + step * element.rate(moment(one, one, half))

    z = jax.lax.fori_loop(0, count, middle, jnp.full((1, 1), start))
    assert_allclose(z, 1 - (1 - start) * np.exp(-way / 0.03), rtol=0, atol=1e-8)


@pytest.mark.parametrize(("nu", "delta"), [(1.0, 0.0), (1.0, 0.5), (2.5, 0.3), (6.0, -0.7)])
def test_what_bouc_wen_takes_is_stored_or_lost_and_never_given(nu, delta):
    element = Memory(strength=0.2, yield_angle=0.03, nu=nu, delta=delta)
    random = np.random.default_rng(0)
    z, rates = jnp.asarray(random.uniform(-1, 1, (1, 50))), jnp.asarray(random.normal(size=50))
    at = moment(rates, rates, z)
    # By hand: the stored energy is S y z^2 / 2.
    lost = 0.2 * z[0] * (rates - 0.03 * element.rate(at)[0])
    assert_allclose(element.dissipation(at), lost, rtol=1e-13, atol=1e-16)
    assert np.all(lost >= -1e-16)
    # The state depends on the path, not on the time.
    quicker = at._replace(rates=3.0 * rates)
    assert_allclose(element.rate(quicker), 3.0 * element.rate(at), rtol=1e-13)


def test_what_stops_take_is_stored_or_lost_along_any_way():
    element = Stops(strength=[0.02, 0.1], yield_angle=[0.05, 0.3])
    angles = np.interp(np.linspace(0, 9, 4001), range(10), np.random.default_rng(1).normal(size=10))
    states, torques = along(element, angles)
    rows = jnp.asarray(angles)[:, None]
    energy = jax.vmap(lambda q, z: element.energy(moment(q, states=z)))(rows, states)[:, 0]
    moves = np.diff(angles)
    work = np.sum(moves * (torques[1:] + torques[:-1]) / 2)
    moments = jax.vmap(moment)(rows[1:], jnp.asarray(moves)[:, None], states[1:])
    lost = jax.vmap(element.dissipation)(moments)[:, 0]
    assert np.all(lost >= 0)
    # A step in which an element starts to slide counts as a sliding step.
    corners = 2 * 10 * 0.12 * np.max(np.abs(moves))
    assert work == pytest.approx(energy[-1] - energy[0] + np.sum(lost), abs=corners)
    assert np.sum(lost) > 20 * corners


def test_the_energy_of_an_arm_has_what_its_joints_store():
    parameters = {"joints.memory.strength": 0.2, "joints.stops.strength": [0.1, 0.3]}
    arm = takeichi_20m(3, parameters=parameters | {"joints.stops.yield_angle": [0.5, 0.7]})
    random = np.random.default_rng(2)
    angles, rates = (jnp.asarray(random.uniform(-0.3, 0.3, 3)) for _ in range(2))
    memory = jnp.asarray(random.uniform(-0.1, 0.1, (3, 3)))  # no elastic element slides
    laws = arm.joints.further_laws
    moved = (rates, laws.rate(laws.at(angles, rates, angles, memory)))

    def energy(angles, memory):
        return potential_energy(arm, angles, jnp.zeros(3), memory=memory)

    stored = jax.jvp(eqx.filter_jit(energy), (angles, memory), moved)[1]
    lost = -hysteresis_power(arm, angles, rates, memory)
    resting = jnp.zeros(3)
    taken = -joint_torque(arm, angles, resting, resting, memory) @ rates
    assert lost > 0
    assert stored + lost == pytest.approx(float(taken), rel=1e-12)


def test_a_derivative_is_finite_at_rest_and_at_a_reversal():
    parts = {"memory": Memory(strength=0.2, nu=1.5), "stops": Stops(strength=0.1)}

    def torque(strength, nu, rate):
        own = replace(JointHysteresis(**parts), {"memory.strength": strength, "memory.nu": nu})
        laws, still = JointLaws(own.laws), jnp.zeros(1)
        at = laws.at(still, rate, still)
        return laws.torque(at) + laws.rate(at)[0]

    for at in (0.0, 1e-300, -1.0):
        slopes = jax.jacfwd(torque, argnums=(0, 1, 2))(0.2, 1.5, jnp.full(1, at))
        assert all(np.all(np.isfinite(slope)) for slope in slopes)


def rows(**parts):
    return JointLaws(JointHysteresis(**parts).laws).rows


def test_joints_have_as_many_states_as_they_remember():
    assert rows() == 0
    assert rows(memory=Memory(strength=0.1)) == 1
    assert rows(memory=Memory(strength=0.1), stops=Stops(strength=[0.1, 0.2])) == 3


def test_stops_are_as_many_as_are_given():
    two = takeichi_20m(2, parameters={"joints.stops.strength": [0.1, 0.1]})
    definition = Definition.parse({"arm": arm_to_definition(two)}, "test")
    assert arm_from_definition(definition).joints.further_laws.rows == 2
    three = {"joints.stops.strength": [0.1, 0.2, 0.3], "joints.stops.yield_angle": [0.1, 0.2, 0.3]}
    assert replace(two, three).joints.further_laws.rows == 3
    assert (
        with_settings(two, {"joints.stops.strength": [0.1, 0.2, 0.3]}).joints.further_laws.rows == 3
    )
    with pytest.raises(InputError, match="give one strength and one yield angle"):
        replace(replace(two, three), {"joints.stops.strength": [0.1, 0.2]})
    with pytest.raises(InputError, match="give one strength and one yield angle"):
        takeichi_20m(2, parameters={"joints.stops.strength": []})


def test_how_added_mass_acts_is_in_the_definition_before_there_is_any():
    definition = {"arm": arm_to_definition(takeichi_20m(2, added_mass="inertia"))}
    again = arm_from_definition(Definition.parse(definition, "test"))
    assert again.air.added_mass == "inertia"


def test_stops_need_as_many_angles_as_strengths():
    with pytest.raises(InputError, match="give one strength and one yield angle"):
        Stops(strength=[0.1, 0.2, 0.3], yield_angle=[0.1, 0.2])
    with pytest.raises(InputError, match="give one strength and one yield angle"):
        takeichi_20m(2, parameters={"joints.stops.strength": [0.1, 0.2, 0.3],
                             "joints.stops.yield_angle": [0.1, 0.2]})  # fmt: skip


def test_without_velocity_products_added_mass_is_in_the_mass_matrix_alone():
    random = np.random.default_rng(5)
    plain = takeichi_20m(4, drag="strip")
    other = replace(
        takeichi_20m(4, drag="strip", added_mass="inertia"), {"air.added_mass_coefficient": 1}
    )
    angles, rates, turning = (jnp.asarray(random.normal(size=4)) for _ in range(3))
    matrix = eqx.filter_jit(mass_matrix)
    heavier = matrix(other, angles) - matrix(plain, angles)
    expected = eqx.filter_jit(inverse_dynamics)(plain, angles, rates, turning) + heavier @ turning
    inverse = eqx.filter_jit(inverse_dynamics)
    assert_allclose(inverse(other, angles, rates, turning), expected, rtol=1e-12)
    # The equation of motion and its derivatives have no additional terms.
    moved = eqx.filter_jit(acceleration)
    found = moved(other, angles, rates, angles)
    assert_allclose(inverse(other, angles, rates, found), -0.05 * rates, atol=1e-12)
    slope = eqx.filter_jit(jax.jacfwd(acceleration, argnums=2))(other, angles, rates, angles)
    step = 1e-6
    for joint in range(4):
        off = jnp.zeros(4).at[joint].set(step)
        ahead = moved(other, angles, rates + off, angles)
        behind = moved(other, angles, rates - off, angles)
        assert_allclose(slope[:, joint], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-5)


def test_yield_angles_without_strengths_are_no_stops():
    """They are for a fit that enables the strengths."""
    arm = takeichi_20m(2, parameters={"joints.stops.yield_angle": [0.1, 0.2]})
    laws, still = arm.joint_laws, jnp.zeros(2)
    assert laws.rows == 0
    at = laws.at(still + 0.3, still, still + 0.3)
    assert_allclose(laws.stiffest(at), [3.0, 30.0])
    assert_allclose(laws.torque(at), 0)
