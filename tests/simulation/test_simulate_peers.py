"""Trajectories compared with MuJoCo, and with scipy for a second formulation."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.simulation import joint_ramps, joint_steps, ramps, simulate
from peers.arms import driven_arm, general_arm
from peers.mujoco_chain import MujocoChain
from peers.scipy_chain import ScipyChain

TIMES = np.linspace(0.0, 25.0, 251)


@pytest.fixture(scope="module")
def driven():
    arm, command = driven_arm()
    return arm, command, simulate(arm, command, TIMES)


def test_the_driven_arm_moves_as_in_mujoco(driven):
    """Joints 1 and 2 of the 20 m arm for 25 s, at the default tolerance."""
    arm, command, motion = driven
    state = MujocoChain(arm, command).trajectory(TIMES, 0.005)
    tip = ScipyChain(arm).tip(state[:, 0])
    assert np.linalg.norm(tip[-1] - tip[0]) > 3
    assert_allclose(motion.tip, tip, rtol=0, atol=1e-5)
    assert_allclose(motion.angles, state[:, 0], rtol=0, atol=1e-5)
    # The rates include the fast yaw oscillations.
    assert_allclose(motion.rates, state[:, 1], rtol=0, atol=2e-4)


def test_the_default_tolerance_keeps_its_promise(driven):
    """Within 1e-4 m at the tip, as the documentation of `simulate` says."""
    arm, command, motion = driven
    tight = simulate(arm, command, TIMES, rtol=1e-10, atol=1e-10)
    assert np.linalg.norm(motion.tip - tight.tip, axis=1).max() < 1e-4


@pytest.mark.slow
def test_a_general_arm_in_a_changing_wind_moves_as_in_mujoco_and_scipy():
    """All features at once: axes, gravity, initial state, steps, and a wind given by rows."""
    arm = general_arm(5)
    times = np.linspace(0.0, 5.0, 51)
    command = joint_steps(5, {1: 0.5, 3: -0.4}, time=1.0)
    rows = np.linspace(0.0, 5.0, 11)
    wind = ramps(rows, np.stack([np.sin(rows), np.cos(2 * rows), 0.3 * rows], axis=1))
    random = np.random.default_rng(5)
    initial = tuple(random.uniform(-0.5, 0.5, (2, 5)))
    motion = simulate(arm, command, times, wind=wind, initial=initial, rtol=1e-9, atol=1e-9)
    by_scipy = ScipyChain(arm, command, wind).trajectory(times, initial=initial)
    by_mujoco = MujocoChain(arm, command, wind).trajectory(times, 0.001, initial=initial)
    for state in (by_scipy, by_mujoco):
        assert_allclose(motion.angles, state[:, 0], rtol=0, atol=1e-6)
        assert_allclose(motion.rates, state[:, 1], rtol=0, atol=1e-5)


def test_the_references_refuse_what_they_cannot_do():
    arm, _ = driven_arm(3)
    ramp = joint_ramps(3, {1: 0.5}, start=0.5)
    with pytest.raises(ValueError, match="the corners do not fall on steps"):
        MujocoChain(arm, ramp).trajectory(np.array([0.0, 2.1]), 0.3)
    with pytest.raises(ValueError, match="the times do not fall on steps"):
        MujocoChain(arm, ramp).trajectory(np.array([0.0, 2.1]), 0.1 / 3.5)
    with pytest.raises(FloatingPointError, match=r"unstable with a step of 0\.25 s"):
        MujocoChain(arm, ramp).trajectory(np.array([0.0, 25.0]), 0.25)
