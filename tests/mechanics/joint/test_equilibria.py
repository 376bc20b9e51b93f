"""Equilibrium angles of a joint for two pressures: the solver compared with a dense scan."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax.mechanics.joint import (
    BraidedMuscle,
    Correction,
    EmpiricalMuscle,
    Joint,
    JointPair,
    equilibria,
    joint_spring,
    net_torque,
    pair_command,
)

PLAIN = JointPair(Joint(correction=Correction(reading="none")))
PAIRS = {
    "plain": PLAIN,
    "corrected": JointPair(),
    "blended": JointPair(Joint(correction=Correction(blend=np.deg2rad(3)))),
    "printed": JointPair(Joint(correction=Correction(reading="printed"))),
    "empirical": JointPair(muscle=EmpiricalMuscle()),
}
LOAD = jnp.asarray(0.0)
torque = eqx.filter_jit(net_torque)


def scan(pair, pressures, load, count=40_001):
    """Return the net torque on a dense grid on each side of 0, from the formula alone."""
    sizes = np.deg2rad(np.linspace(0, 60, count))
    for ahead in (False, True):
        angle = jnp.asarray(sizes if ahead else -sizes[::-1])
        side = jnp.full(angle.shape, ahead)
        yield np.asarray(angle), np.asarray(torque(pair, pressures, load, angle, side))


def crossings(pair, pressures, load=LOAD):
    """Return intervals in which the torque changes its sign, and the sign of its slope there."""
    found = []
    ends = []
    for angle, values in scan(pair, pressures, load):
        at = np.flatnonzero(values[:-1] * values[1:] < 0)
        found += [(angle[i], angle[i + 1], np.sign(values[i + 1] - values[i])) for i in at]
        ends.append(values)
    if ends[0][-1] * ends[1][0] < -1e-20:
        found.append((0.0, 0.0, np.sign(ends[1][0] - ends[0][-1])))
    return sorted(found)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["corrected", "blended", "printed"])
def test_a_dense_scan_confirms_every_equilibrium(name):
    pair = PAIRS[name]
    random = np.random.default_rng(3)
    top = 45e3
    several = 0
    for case in range(20):
        pressures = jnp.asarray(random.uniform(0.3 * top, top, 2))
        if case >= 8:  # nearly equal pressures, which give several equilibria
            pressures = jnp.asarray(pressures[0] * (1 + random.uniform(-0.1, 0.1, 2)))
        load = jnp.asarray(random.choice([0.0, 0.0, random.normal(scale=0.1)]))
        found = equilibria(pair, pressures, load)
        expected = crossings(pair, pressures, load)
        assert len(found.every) == len(expected)
        several += len(expected) > 1
        for item, (low, high, sign) in zip(found.every, expected, strict=True):
            assert low - 1e-12 <= item.angle <= high + 1e-12
            assert item.stable == (sign < 0)
        both = scan(pair, pressures, load, 3)
        ends = [values[end] for (_, values), end in zip(both, (0, -1), strict=True)]
        assert found.at_lower_stop == (ends[0] < 0)
        assert found.at_upper_stop == (ends[1] > 0)
    assert several > 3


@pytest.mark.parametrize("name", ["corrected", "printed", "empirical"])
@pytest.mark.slow
def test_an_angle_gives_pressures_that_give_the_angle_back(name):
    """Within 1e-9 rad for stable angles; unstable ones are listed as unstable by the solver."""
    pair = PAIRS[name]
    stable = unstable = 0
    worst = 0.0
    for degrees in np.concatenate([np.arange(-60, 0, 2.5), np.arange(2.5, 60.1, 2.5), [-1, 1]]):
        angle = np.deg2rad(degrees)
        command = pair_command(pair, angle)
        if name == "printed" and abs(degrees) > 20:
            assert "push" in command.second_pressure.message() + command.first_pressure.message()
            continue
        assert bool(command.reached)
        found = equilibria(pair, command.pressures)
        nearest = min(found.every, key=lambda item: abs(item.angle - angle))
        a = jnp.asarray([angle])
        known = partial(net_torque, pair, command.pressures, LOAD, ahead=a > 0)
        slope = jax.jvp(known, (a,), (jnp.ones(1),))[1]
        assert nearest.stable == bool(slope[0] < 0)
        if nearest.stable:
            stable += 1
            worst = max(worst, abs(nearest.angle - angle))
            assert nearest.stiffness == pytest.approx(-float(slope[0]), rel=1e-6)
        else:
            unstable += 1
    assert worst < 1e-9
    assert stable >= (40 if name != "printed" else 10)
    assert unstable >= 2 or name == "empirical"


@pytest.mark.slow
def test_with_a_load_and_another_cocontraction():
    pair = PAIRS["corrected"]
    for degrees, load in ((30.0, 0.2), (-30.0, -0.2), (25.0, -0.1)):
        angle = np.deg2rad(degrees)
        command = pair_command(pair, angle, load=load, cocontraction=0.4)
        found = equilibria(pair, command.pressures, load)
        assert np.min(np.abs(found.angles - angle)) < 1e-9
        # Without the load, the equilibrium differs.
        assert np.min(np.abs(equilibria(pair, command.pressures).angles - angle)) > 0.01


def test_the_controller_shares_out_the_torque():
    command = pair_command(JointPair(), np.deg2rad(50.0), load=0.1)
    alpha, beta = 0.03 + 100 / 1600, -0.3 * 900 / 1600
    assert float(command.first.torque) == pytest.approx(0.3 + alpha + 0.1)
    assert float(command.second.torque) == pytest.approx(0.3 + beta)
    mirrored = pair_command(JointPair(), np.deg2rad(-50.0), load=-0.1)
    np.testing.assert_allclose(mirrored.pressures[::-1], command.pressures, rtol=1e-14)


@pytest.mark.slow
def test_the_pair_is_bistable_about_0():
    """The design's figures: a request of 20 deg without corrections, and the stiffness."""
    pressures = pair_command(PLAIN, np.deg2rad(20.0)).pressures
    found = equilibria(PLAIN, pressures).every
    np.testing.assert_allclose(
        np.rad2deg([item.angle for item in found]), [-16.5, -0.5, 20.0], atol=0.05
    )
    assert [item.stable for item in found] == [True, False, True]
    assert found[1].branches == ("outer, straight", "inner, wire slack")
    for pair in (PLAIN, JointPair()):
        for degrees in (10.0, 20.0, 30.0, 40.0, 50.0):
            command = pair_command(pair, np.deg2rad(degrees))
            (item,) = (
                e
                for e in equilibria(pair, command.pressures).every
                if abs(e.angle - np.deg2rad(degrees)) < 1e-9
            )
            assert 0.29 < item.muscle_stiffness < 0.71
    # Within the straight window, no requested angle is stable.
    for degrees in (-3.5, -1.0, 1.0, 3.5):
        command = pair_command(PLAIN, np.deg2rad(degrees))
        (item,) = (
            e
            for e in equilibria(PLAIN, command.pressures).every
            if abs(e.angle - np.deg2rad(degrees)) < 1e-9
        )
        assert item.stiffness < 0


@pytest.mark.slow
def test_0_itself():
    # Without corrections, 0 is an unstable equilibrium between two symmetric stable ones.
    found = equilibria(PLAIN, [26e3, 26e3]).every
    assert len(found) == 3
    assert found[1].angle == 0
    assert not found[1].stable
    assert found[0].angle == pytest.approx(-found[2].angle, abs=1e-12)
    # With corrections, the step of alpha(0) - beta(0) holds the joint like dry friction.
    found = equilibria(JointPair(), [26e3, 26e3]).every
    middle = found[len(found) // 2]
    assert middle.angle == 0
    assert middle.at_step
    assert middle.stable
    assert middle.stiffness == np.inf
    assert middle.muscle_stiffness < 0
    # At one end of the step, the other side determines the result.
    command = pair_command(JointPair(), 0.0)
    at_zero = [e for e in equilibria(JointPair(), command.pressures).every if e.angle == 0]
    assert [e.stable for e in at_zero] == [False]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("degrees", "offset", "falls"),
    [(20.0, 0.01, True), (-20.0, 0.01, True), (2.0, 0.01, True), (2.0, -0.01, False)],
)
def test_the_jumps_of_the_printed_beta_are_no_smooth_roots(degrees, offset, falls):
    pair = giajax.replace(PAIRS["printed"], {"joint.beta.offset": offset})
    pressures = jnp.asarray([30e3, 27e3])
    angle, ahead = jnp.deg2rad(jnp.asarray([degrees])), jnp.asarray([degrees > 0])
    below, above = (
        float(torque(pair, pressures, LOAD, angle + step, ahead)[0]) for step in (-1e-9, 1e-9)
    )
    assert (above < below - 0.01) == falls
    load = (below + above) / 2
    (item,) = (
        e
        for e in equilibria(pair, pressures, load).every
        if abs(e.angle - np.deg2rad(degrees)) < 1e-9
    )
    assert item.at_step
    assert item.stable == falls
    assert item.stiffness == (np.inf if falls else -np.inf)
    assert np.isfinite(item.muscle_stiffness)
    # The continuous reading has no jump at 0.
    other = JointPair()
    level = float(torque(other, pressures, LOAD, angle, ahead)[0])
    (item,) = (
        e
        for e in equilibria(other, pressures, level).every
        if abs(e.angle - np.deg2rad(degrees)) < 1e-9
    )
    assert not item.at_step
    assert np.isfinite(item.stiffness)


@pytest.mark.slow
def test_slack_muscles_leave_the_joint_to_the_load():
    idle = equilibria(PLAIN, [5e3, 5e3])
    assert idle.indifferent
    assert idle.every == ()
    found = equilibria(PLAIN, [0.0, 0.0], 0.1)
    assert found.every == ()
    assert found.at_lower_stop
    assert not found.at_upper_stop
    assert not found.indifferent


@pytest.mark.slow
def test_the_spring_and_its_derivatives():
    pair, angle = JointPair(), np.deg2rad(25.0)
    pressures = pair_command(pair, angle).pressures
    spring = joint_spring(pair, pressures, 0.9 * angle)
    assert float(spring.rest_angle) == pytest.approx(angle, abs=1e-12)

    def outputs(pressures, load, diameter):
        changed = giajax.replace(pair, {"muscle.diameter": diameter})
        spring = joint_spring(changed, pressures, angle, load)
        return jnp.stack([spring.rest_angle, spring.stiffness])

    point = (pressures, jnp.asarray(0.02), jnp.asarray(3.5e-3))
    for mode in (jax.jacfwd, jax.jacrev):
        by_pressure, by_load, by_diameter = mode(outputs, (0, 1, 2))(*point)
        for i in range(2):
            e = jnp.zeros(2).at[i].set(5.0)
            difference = outputs(pressures + e, *point[1:]) - outputs(pressures - e, *point[1:])
            np.testing.assert_allclose(by_pressure[:, i], difference / 10, rtol=1e-5)
        for index, slope, step in ((1, by_load, 1e-5), (2, by_diameter, 1e-8)):
            ahead, behind = (
                outputs(*(x + s * step * (i == index) for i, x in enumerate(point)))
                for s in (1, -1)
            )
            np.testing.assert_allclose(slope, (ahead - behind) / (2 * step), rtol=1e-5)
    # A load of 1 N m changes the angle by 1 / stiffness.
    assert float(by_load[0]) == pytest.approx(-1 / float(outputs(*point)[1]), rel=1e-9)


@pytest.mark.slow
def test_the_spring_feeds_a_joint_of_the_arm():
    """III.A: a spring with variable constant and initial length; one link, held by a pair."""
    pair, angle = JointPair(), np.deg2rad(30.0)
    spring = joint_spring(pair, pair_command(pair, angle).pressures, angle)
    stiff = {"joints.pitch_stiffness": spring.stiffness, "joints.damping": 0.2}
    arm = giajax.replace(giajax.takeichi_20m(1), stiff)
    step = giajax.joint_steps(1, {1: float(spring.rest_angle)})
    motion = giajax.simulate(arm, step, jnp.linspace(0.0, 20.0, 101))
    assert float(motion.angles[-1, 0]) == pytest.approx(angle, abs=1e-4)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: equilibria(JointPair(), [1e4]), "give two numbers"),
        (lambda: equilibria(JointPair(), [1e4, -1.0]), "not negative"),
        (lambda: equilibria(JointPair(), [1e4, 1e4], np.nan), "load is not finite"),
        (lambda: pair_command(JointPair(), 20.0), "at most 60 deg"),
        (lambda: pair_command(JointPair(), 0.1, load=np.inf), "not finite"),
        (lambda: joint_spring(PLAIN, [26e3, 26e3], 0.01), "no equilibrium near|not stable"),
        (lambda: joint_spring(PLAIN, [0.0, 0.0], 0.3, 0.1), "no equilibrium near"),
    ],
)
def test_bad_arguments_are_refused_with_a_sentence(call, sentence):
    with pytest.raises(giajax.InputError, match=sentence):
        call()


def test_what_a_muscle_cannot_do_is_said():
    weak = JointPair(muscle=BraidedMuscle(diameter=1e-3))
    command = pair_command(weak, np.deg2rad(60.0))
    assert not bool(command.reached)
    assert "pressure limit" in command.first_pressure.message()
    pushed = pair_command(JointPair(), np.deg2rad(30.0), load=-0.5)
    assert "push" in pushed.first_pressure.message()


@pytest.mark.slow
def test_two_near_roots_are_both_found():
    """With a load near the minimum of the torque, both roots lie in one interval."""
    pair = JointPair(Joint(correction=Correction(blend=np.deg2rad(2))))
    pressures = jnp.asarray([26e3, 26e3])
    angle = jnp.deg2rad(jnp.linspace(0.3, 1.0, 70_001))
    values = np.asarray(torque(pair, pressures, LOAD, angle, jnp.ones(angle.shape, bool)))
    lowest = int(np.argmin(values))
    assert 0 < lowest < len(values) - 1
    found = equilibria(pair, pressures, values[lowest] + 1e-10)
    near = [e for e in found.every if abs(e.angle - angle[lowest]) < np.deg2rad(0.1)]
    assert [e.stable for e in near] == [True, False]
    assert 0 < near[1].angle - near[0].angle < np.deg2rad(0.1) / 5
    assert len(equilibria(pair, pressures, values[lowest] - 1e-8).every) == len(found.every) - 2
