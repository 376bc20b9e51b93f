"""Positions and velocities of the links."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import giajax.mechanics.arm
from giajax.mechanics.arm import takeichi_20m
from peers.arms import general_arm, random_states
from peers.scipy_chain import ScipyChain

link_centres = eqx.filter_jit(giajax.mechanics.arm.link_centres)
link_velocities = eqx.filter_jit(giajax.mechanics.arm.link_velocities)
tip_position = eqx.filter_jit(giajax.mechanics.arm.tip_position)


def test_the_straight_arm_lies_along_x():
    arm = takeichi_20m(3, length=[1.0, 2.0, 3.0])
    expected = [[0.5, 0, 0], [2.0, 0, 0], [4.5, 0, 0]]
    assert_allclose(link_centres(arm, jnp.zeros(3)), expected)
    assert_allclose(tip_position(arm, jnp.zeros(3)), [6.0, 0, 0])


def test_a_positive_pitch_raises_and_a_positive_yaw_turns_to_the_left():
    arm = takeichi_20m(2, length=2.0)
    pitch, yaw = jnp.array([0.3, 0.0]), jnp.array([0.0, 0.3])
    assert_allclose(
        tip_position(arm, pitch), [4 * np.cos(0.3), 0, 4 * np.sin(0.3)], rtol=1e-15, atol=1e-15
    )
    assert_allclose(
        link_centres(arm, yaw), [[1, 0, 0], [2 + np.cos(0.3), np.sin(0.3), 0]], atol=1e-15
    )


def test_angles_of_a_planar_chain_add_up():
    arm = takeichi_20m(5, length=[0.5, 1.0, 1.5, 2.0, 2.5], joint_axes=["pitch"] * 5)
    angles = jnp.array([0.3, -0.7, 1.1, 0.2, -2.0])
    slope, length = np.cumsum(angles), np.asarray(arm.links.length)
    ends = np.cumsum(length * np.array([np.cos(slope), np.sin(slope)]), axis=1)
    centres = ends - length * np.array([np.cos(slope), np.sin(slope)]) / 2
    assert_allclose(tip_position(arm, angles), [ends[0, -1], 0, ends[1, -1]], atol=1e-14)
    found = link_centres(arm, angles)
    assert_allclose(found[:, [0, 2]], centres.T, atol=1e-14)
    assert_allclose(found[:, 1], 0, atol=1e-15)


def test_the_positions_are_those_of_rotation_matrices():
    arm, angles = general_arm(12), random_states(12, 1)["angles"][0]
    reference = ScipyChain(arm)
    along = reference.orientations(np.asarray(angles))[:, :, 0] * reference.length[:, None]
    centres = np.cumsum(along, axis=0) - along / 2
    assert_allclose(link_centres(arm, angles), centres, atol=1e-13)
    assert_allclose(tip_position(arm, angles), along.sum(axis=0), atol=1e-13)


def test_the_base_turns_the_whole_arm():
    vector = np.array([0.4, -1.2, 2.0])
    state = random_states(4, 1)
    angles, rates = state["angles"][0], state["rates"][0]
    turn = Rotation.from_rotvec(vector).as_matrix()
    level, turned = takeichi_20m(4), takeichi_20m(4, base_rotation=vector)
    for quantity in (link_centres, lambda arm, angles: link_velocities(arm, angles, rates)):
        assert_allclose(quantity(turned, angles), quantity(level, angles) @ turn.T, atol=1e-13)


@pytest.mark.parametrize("links", [1, 7])
def test_velocities_are_the_derivative_of_positions(links):
    arm, state = general_arm(links), random_states(links, 1)
    angles, rates = state["angles"][0], state["rates"][0]
    _, expected = jax.jvp(lambda q: link_centres(arm, q), (angles,), (rates,))
    assert_allclose(link_velocities(arm, angles, rates), expected, rtol=1e-12, atol=1e-13)
    step = 1e-5
    forth, back = (link_centres(arm, angles + sign * step * rates) for sign in (1, -1))
    assert_allclose(expected, (forth - back) / (2 * step), atol=1e-8)


def test_links_keep_their_length():
    arm = takeichi_20m(6)
    angles = random_states(6, 1)["angles"][0]
    joints = [np.zeros(3)]
    for centre in np.asarray(link_centres(arm, angles)):
        assert_allclose(np.linalg.norm(centre - joints[-1]), 0.495, rtol=1e-13)
        joints.append(2 * centre - joints[-1])
    assert_allclose(tip_position(arm, angles), joints[-1], atol=1e-13)
