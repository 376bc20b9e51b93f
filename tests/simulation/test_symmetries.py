"""Invariances of a motion."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import get, replace
from giajax.simulation import joint_ramps, joint_steps, simulate

LINKS = 4
TIMES = np.linspace(0.0, 6.0, 31)
COMMAND = joint_ramps(LINKS, {1: 0.5, 2: 0.3}, start=0.5, duration=1.0)
TIGHT = {"rtol": 1e-9, "atol": 1e-9}


def move(arm, command=COMMAND, **options):
    return simulate(arm, command, TIMES, **TIGHT, **options)


@pytest.mark.slow
def test_a_pitch_command_moves_nothing_in_yaw():
    motion = move(takeichi_20m(LINKS), joint_ramps(LINKS, {1: 0.5}, start=0.5, duration=1.0))
    assert_allclose(motion.angles[:, 1::2], 0, atol=1e-12)
    assert_allclose(motion.tip[:, 1], 0, atol=1e-11)
    assert np.abs(motion.angles[:, 0::2]).max() > 0.4


def test_a_yaw_command_moves_nothing_in_pitch():
    motion = move(takeichi_20m(LINKS), joint_ramps(LINKS, {2: 0.5}, start=0.5, duration=1.0))
    assert_allclose(motion.angles[:, 0::2], 0, atol=1e-12)
    assert np.abs(motion.angles[:, 1::2]).max() > 0.4


def test_the_direction_of_the_base_is_nothing_without_gravity():
    turn = np.array([0.3, 1.4, -2.0])
    matrix = Rotation.from_rotvec(turn).as_matrix()
    wind = np.array([0.2, 0.1, 0.3])
    level = move(takeichi_20m(LINKS), wind=wind)
    turned = move(takeichi_20m(LINKS, base_rotation=turn), wind=matrix @ wind)
    assert_allclose(turned.angles, level.angles, atol=1e-7)
    assert_allclose(turned.tip, level.tip @ matrix.T, atol=1e-7)


def test_positions_know_drag_and_joints_only_per_unit_of_mass():
    arm = takeichi_20m(LINKS)
    scaled = replace(
        arm,
        {
            path: 1.9 * get(arm, path)
            for path in (
                "links.mass",
                "links.inertia_transverse",
                "links.inertia_axial",
                "air.drag_coefficient",
                "joints.pitch_stiffness",
                "joints.yaw_stiffness",
                "joints.damping",
            )
        },
    )
    wind = [0.1, 0.0, 0.2]
    plain = move(arm, wind=wind)
    assert_allclose(move(scaled, wind=wind).angles, plain.angles, atol=1e-9)
    thinner = replace(scaled, {"air.drag_coefficient": 1.2})
    assert np.abs(move(thinner, wind=wind).angles - plain.angles).max() > 1e-3


def test_left_and_right_are_mirror_images():
    arm = takeichi_20m(LINKS)
    left = move(arm, joint_ramps(LINKS, {1: 0.5, 2: 0.3}, start=0.5), wind=[0.0, 0.1, 0.0])
    right = move(arm, joint_ramps(LINKS, {1: 0.5, 2: -0.3}, start=0.5), wind=[0.0, -0.1, 0.0])
    assert_allclose(right.tip, np.asarray(left.tip) * [1.0, -1.0, 1.0], atol=1e-9)


def test_waiting_first_changes_nothing():
    """A step at 2 s gives the motion of a step at 0 s, two seconds later."""
    arm = takeichi_20m(LINKS)
    now = move(arm, joint_steps(LINKS, {1: 0.5}))
    later = move(arm, joint_steps(LINKS, {1: 0.5}, time=2.0))
    assert_allclose(later.angles[10:], now.angles[:-10], atol=1e-7)
    assert_array_equal(later.angles[:10], jnp.zeros((10, LINKS)))
