"""Accelerations against MuJoCo, and against a second formulation in NumPy."""

import dataclasses

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import acceleration, takeichi_20m
from peers.arms import full_arm, general_arm, random_states
from peers.mujoco_chain import MujocoChain
from peers.scipy_chain import ScipyChain


@eqx.filter_jit
def accelerations(arm, states):
    order = ("angles", "rates", "command", "wind")
    return jax.vmap(acceleration, (None, 0, 0, 0, 0))(arm, *(states[name] for name in order))


def compare(reference, arm, states):
    found = accelerations(arm, states)
    given = {name: np.asarray(value) for name, value in states.items()}
    for row in range(len(found)):
        expected = reference.acceleration(**{name: value[row] for name, value in given.items()})
        assert_allclose(found[row], expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("reference", [MujocoChain, ScipyChain])
def test_a_hundred_states_of_a_general_arm(reference):
    """Random axes, per-link values, a rotated base, gravity, wind, springs, dampers and drag."""
    arm = general_arm(20)
    compare(reference(arm), arm, random_states(20, 100))


def without_what_mujoco_lacks(arm):
    air = {"added_mass_coefficient": None, "drag_curve": "constant"}
    bodies = dataclasses.replace(arm.point_masses, drag_area=None)
    air = dataclasses.replace(arm.air, **air)
    return dataclasses.replace(arm, air=air, point_masses=bodies)


@pytest.mark.slow
@pytest.mark.parametrize("links", [2, 8])
def test_everything_that_mujoco_can_do_at_once(links):
    """Armature, helium, trim weights and off-axis point masses are MuJoCo's own bodies. Lift,
    imbalance, a constant wind, friction, cross-flow and axial drag are forces in NumPy."""
    arm = without_what_mujoco_lacks(full_arm(links))
    compare(MujocoChain(arm), arm, random_states(links, 20))


def test_what_mujoco_lacks_is_refused():
    arm = full_arm(2)
    with pytest.raises(ValueError, match="neither added mass nor this drag curve"):
        MujocoChain(arm)


@pytest.mark.parametrize("links", [1, 2])
def test_short_arms(links):
    arm = general_arm(links)
    compare(MujocoChain(arm), arm, random_states(links, 10))


def test_the_papers_arm():
    arm = takeichi_20m()
    compare(MujocoChain(arm), arm, random_states(20, 20))
