"""Muscles in joints of an arm: the statics of a joint, with finite values and derivatives."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics import arm as mechanics, joint as statics
from giajax.mechanics.arm import (
    JointLaws,
    Pneumatics,
    potential_energy,
    takeichi_20m,
)
from giajax.mechanics.joint import (
    Correction,
    EmpiricalMuscle,
    Joint,
    JointPair,
    Piston,
    branch_angles,
    muscle_path,
    muscle_torques,
    pair_command,
)

joint_torque = eqx.filter_jit(mechanics.joint_torque)
net_torque = eqx.filter_jit(statics.net_torque)
acceleration = eqx.filter_jit(mechanics.acceleration)
muscle_power = eqx.filter_jit(mechanics.muscle_power)
commanded = eqx.filter_jit(Pneumatics.commanded)


def held_at(drive, angles, pressures):
    """Return the torques of joints held at these angles with these muscle pressures."""
    still = jnp.zeros_like(angles)
    return JointLaws((drive,)).at(angles, still, still, None, pressures)


LINKS = 4
PAIR = Pneumatics((1,)).pair


@pytest.mark.parametrize(
    ("muscles", "joints"), [("pitch", [0, 2]), ("all", [0, 1, 2, 3]), ([1, 2, 4], [0, 1, 3])]
)
def test_the_torque_is_that_of_the_joint_at_rest(muscles, joints):
    arm = takeichi_20m(LINKS, muscles=muscles)
    random = np.random.default_rng(1)
    angles = jnp.asarray(random.uniform(-1, 1, LINKS))
    pressures = jnp.asarray(random.uniform(2e4, 4e4, (2, LINKS)))
    command, still = jnp.asarray(random.uniform(-1, 1, LINKS)), jnp.zeros(LINKS)
    expected = np.asarray(arm.joints.yaw_stiffness) * (command - angles)
    for joint in joints:
        at = angles[joint]
        own = net_torque(PAIR, pressures[:, joint], jnp.zeros(()), at, at >= 0)
        expected = expected.at[joint].set(own)
    found = joint_torque(arm, angles, still, command, pressures=pressures)
    assert_allclose(found[np.asarray(joints)], expected[np.asarray(joints)], rtol=1e-12)
    sprung = [j for j in range(LINKS) if j not in joints]
    stiffness = np.asarray(arm.joints.stiffness)
    assert_allclose(
        found[np.asarray(sprung, int)], (stiffness * (command - angles))[np.asarray(sprung, int)]
    )


def test_the_controller_of_an_arm_is_that_of_a_joint():
    drive = takeichi_20m(LINKS, muscles="pitch").pneumatics
    command = jnp.deg2rad(jnp.asarray([30.0, 5.0, -2.0, 0.0]))
    found = commanded(drive, command)
    of_a_joint = eqx.filter_jit(lambda angle: pair_command(PAIR, angle).pressures)
    for joint in (0, 2):
        assert_allclose(found[:, joint], of_a_joint(command[joint]), rtol=1e-13)
    assert_allclose(found[:, np.asarray([1, 3])], 0)
    # The passive stiffness of a joint is compensated, too.
    stiff = takeichi_20m(LINKS, muscles="pitch", parameters={"drive.passive_stiffness": 0.2})
    torque = joint_torque(stiff, command, jnp.zeros(LINKS), command)
    assert_allclose(torque, 0, atol=1e-14)
    assert not np.allclose(commanded(stiff.pneumatics, command), found)


def test_beyond_its_range_a_joint_is_finite_and_comes_back():
    drive = Pneumatics((1,))
    held = [[a, b] for a in (0.0, 1e4, 5e4, 3e5) for b in (0.0, 1e4, 5e4, 3e5)]
    beyond = jnp.deg2rad(jnp.asarray([60.0, 61.0, 90.0, 140.0, 300.0]))

    def torque(angle, pressures):
        return drive.torque(held_at(drive, angle[None], pressures[:, None]))[0]

    both = jax.jit(jax.vmap(jax.vmap(jax.value_and_grad(torque), (0, None)), (None, 0)))
    for side in (1, -1):
        values, slopes = both(side * beyond, jnp.asarray(held))
        assert np.all(np.isfinite(values))
        assert np.all(np.diff(side * values, axis=1) < 0)
        assert np.all(slopes[:, 1:] < 0)
        assert np.all(np.isfinite(slopes))


def special_states():
    """Return angles (rad) and pressures (Pa) at the limits of regimes."""
    taut, wrapped = branch_angles(PAIR.joint.geometry)
    correction = PAIR.joint.correction
    kinks = [0.0, taut, wrapped, correction.blend, float(correction.beta.width)]
    kinks += [float(correction.alpha.threshold), np.deg2rad(60.0), 2.0, -2.0]
    for angle in [*kinks, *(-np.asarray(kinks))]:
        for first, second in ((0.0, 0.0), (1e4, 1e4), (3e4, 2e4), (3e5, 0.0)):
            yield angle, first, second


@functools.cache
def flat_drive(stiffness):
    """Return the parameters of a joint with this passive stiffness, and their structure."""
    stiff = {"drive.passive_stiffness": stiffness}
    flat, unflatten = ravel_pytree(takeichi_20m(1, muscles="all", parameters=stiff).pneumatics)
    return np.asarray(flat), unflatten


def values(unflatten):
    """Return torque, controller and energy of one joint, for parameters, angle and pressures."""

    def of(flat, row):
        own = unflatten(flat)
        held = own.commanded(jnp.clip(row[:1], -1, 1))[:, 0] / 1e5
        at = held_at(own, row[:1], row[1:, None])
        return jnp.stack([own.torque(at)[0], *held, own.energy(at)[0]])

    return of


ORDINARY = [(0.3, 3e4, 2.5e4), (-0.03, 2.7e4, 2.6e4), (1.2, 5e4, 1.5e4)]


@functools.cache
def slopes(mode, stiffness):
    """Return derivatives by parameters, angle and pressures, in ordinary and in special states."""
    flat, _ = flat_drive(stiffness)
    rows = np.asarray([*ORDINARY, *special_states()])
    return [np.asarray(each) for each in slopes_by(mode)(flat, rows)]


@functools.cache
def slopes_by(mode):
    one = mode(values(flat_drive(0.1)[1]), (0, 1))
    return jax.jit(lambda flat, rows: jax.lax.map(lambda row: one(flat, row), rows))


@pytest.mark.parametrize("mode", [jax.jacfwd, pytest.param(jax.jacrev, marks=pytest.mark.slow)])
def test_derivatives_are_finite_wherever_something_begins(mode):
    for stiffness in (0.0, 0.1):
        assert all(np.all(np.isfinite(each)) for each in slopes(mode, stiffness))


def test_derivatives_are_those_that_differences_show():
    flat, unflatten = flat_drive(0.1)
    rows = np.asarray(ORDINARY)
    steps = 1e-6 * np.maximum(np.abs(flat), 1e-3)
    off = np.diag(steps)
    each = jax.jit(jax.vmap(values(unflatten), (None, 0)))
    either = np.stack([each(row, rows) for row in np.concatenate([flat + off, flat - off])], axis=1)
    ahead, back = np.split(either, 2, axis=1)
    found = (ahead - back) / (2 * steps[None, :, None])
    scale = np.max(np.abs(found), axis=(0, 1), keepdims=True)
    computed = np.swapaxes(slopes(jax.jacfwd, 0.1)[0][: len(rows)], 1, 2)
    assert_allclose(computed, found, rtol=2e-5, atol=1e-8 * scale.max())


@eqx.filter_jit
def stored_along(arm, angles, rates, command):
    """Return the rate of the stored energy."""
    return jax.jvp(lambda q: potential_energy(arm, q, command), (angles,), (rates,))[1]


def test_what_muscles_do_is_stored_or_resisted():
    """Power of the torque = power of the pressures - rate of the stored energy."""
    pull = jax.jit(lambda *at: muscle_torques(PAIR, *at, at[1] >= 0))
    arm = takeichi_20m(LINKS, muscles="pitch", parameters={"drive.passive_stiffness": 0.15})
    random = np.random.default_rng(4)
    for spread in (0.01, 0.5, 1.5):
        angles, rates = (jnp.asarray(random.uniform(-spread, spread, LINKS)) for _ in range(2))
        pressures = jnp.asarray(random.uniform(0, 5e4, (2, LINKS)))
        command = angles.at[np.asarray([0, 2])].set(0)  # no spring is strained

        torque = joint_torque(arm, angles, jnp.zeros(LINKS), command, pressures=pressures)
        power = muscle_power(arm, angles, rates, pressures)
        first, second = pull(pressures, jnp.clip(angles, -np.pi / 3, np.pi / 3))
        assert_allclose(power, np.sum(((first - second) * rates)[::2]), rtol=1e-10, atol=1e-14)
        change = stored_along(arm, angles, rates, command)
        assert float(torque @ rates) == pytest.approx(float(power - change), rel=1e-10, abs=1e-12)


def test_an_ideal_braid_does_the_work_of_its_gas():
    """F dL = -p dV for k = eta = 1 without a dead band (Chou and Hannaford)."""
    ideal = {"muscle.end_correction": 1.0, "muscle.dead_band": 0.0}
    arm = takeichi_20m(1, muscles="all", parameters=ideal)
    drive, pressures = arm.pneumatics, jnp.asarray([[4e4], [2e4]])
    muscle, length = drive.muscle, drive.joint.geometry.muscle_length

    def volume(side):
        """Volume of a cylinder of inextensible threads, whose radius follows from its length."""

        def of(angles):
            left = muscle_path(drive.joint.geometry, side * angles).length / length
            thread = 1 / jnp.cos(muscle.braid_angle)
            radius = (
                muscle.diameter / 2 * jnp.sqrt(thread**2 - left**2) / jnp.tan(muscle.braid_angle)
            )
            return (jnp.pi * radius**2 * left * length)[0]

        return jax.jit(lambda at, along: jax.jvp(of, (at,), (along,))[1])

    along = [volume(side) for side in (1.0, -1.0)]
    for at in (0.4, -0.02, -0.9):
        angles, rates = jnp.asarray([at]), jnp.asarray([0.7])
        gas = sum(
            float(pressure) * grows(angles, rates)
            for pressure, grows in zip(pressures[:, 0], along, strict=True)
        )
        assert float(muscle_power(arm, angles, rates, pressures)) == pytest.approx(float(gas))


def test_another_law_drives_an_arm():
    pair = JointPair(Joint(correction=Correction(reading="none")), EmpiricalMuscle())
    arm = takeichi_20m(2, muscles="pitch", pair=pair)
    command = jnp.deg2rad(jnp.asarray([25.0, 0.0]))
    still = jnp.zeros(2)
    assert_allclose(acceleration(arm, command, still, command), 0, atol=1e-11)
    braided = commanded(takeichi_20m(2, muscles="pitch").pneumatics, command)
    assert not np.allclose(commanded(arm.pneumatics, command), braided)


def test_at_60_degrees_the_slope_is_that_of_the_range():
    drive = Pneumatics((1,))

    def pressures(angle):
        return drive.commanded(angle[None])[:, 0]

    slope = jax.jit(jax.jacfwd(pressures))
    for side in (1, -1):
        at, inside = (slope(jnp.asarray(side * np.deg2rad(a))) for a in (60.0, 60 - 1e-6))
        assert_allclose(at, inside, rtol=1e-5)


def test_a_bound_of_the_stiffness_holds_for_any_pressures():
    arm = takeichi_20m(2, muscles="pitch", parameters={"joints.yaw_stiffness": 7.0})
    drive = arm.pneumatics
    angles = np.deg2rad(np.linspace(-59.5, 59.5, 120))
    held = np.asarray([[a, b] for a in (0, 1e5, 3e5) for b in (0, 1e5, 3e5)])

    def slope(angle, pressures):
        angles, both = jnp.stack([angle, 0 * angle]), jnp.stack([pressures] * 2, 1)
        return drive.slopes(held_at(drive, angles, both))[0][0]

    found = jax.jit(jax.vmap(jax.vmap(slope, (0, None)), (None, 0)))(angles, held)
    bound = drive.stiffest(held_at(drive, jnp.zeros(2), jnp.zeros((2, 2))))
    assert np.max(found) <= bound[0] < 1.2 * np.max(found)
    # The stop is stiffer but not included, and springs are independent of the muscles.
    assert bound[0] < float(drive.drive.stop_stiffness)
    assert bound[1] == 0


def test_a_spring_that_no_joint_has_is_0_whoever_states_it():
    stated = takeichi_20m(1, muscles="pitch", parameters={"joints.pitch_stiffness": 3.0})
    assert float(stated.joints.pitch_stiffness) == 0


def test_bad_muscles_are_refused():
    for wrong in ([1.9], 3, "yaw", [True]):
        with pytest.raises(InputError, match='use "pitch", "all" or a list'):
            takeichi_20m(2, muscles=wrong)
    with pytest.raises(InputError, match="which pushes"):
        takeichi_20m(2, muscles="all", pair=JointPair(PAIR.joint, Piston()))
    with pytest.raises(InputError, match="joint 3 has muscles, but the arm has only 2 joints"):
        takeichi_20m(2, muscles=[1, 3])
    with pytest.raises(InputError, match="give joint numbers of at least 1 in increasing order"):
        takeichi_20m(2, muscles=[2, 1])
    with pytest.raises(InputError, match="no joint has muscles"):
        takeichi_20m(2, pair=JointPair())
    with pytest.raises(InputError, match="jump at 0"):
        takeichi_20m(2, muscles="all", pair=JointPair())
    printed = JointPair(Joint(correction=Correction(reading="printed", blend=0.1)))
    with pytest.raises(InputError, match="printed in the paper"):
        takeichi_20m(2, muscles="all", pair=printed)
