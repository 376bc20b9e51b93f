"""Accelerations against MuJoCo, and against a second formulation in numpy."""

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from arms import general_arm, random_states
from giajax.arm import acceleration, takeichi_20m
from mujoco_chain import MujocoChain
from scipy_chain import ScipyChain


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
    """Random axes, per-link numbers, a turned base, gravity, wind, springs, dampers and drag."""
    arm = general_arm(20)
    compare(reference(arm), arm, random_states(20, 100))


@pytest.mark.parametrize("links", [1, 2])
def test_short_arms(links):
    arm = general_arm(links)
    compare(MujocoChain(arm), arm, random_states(links, 10))


def test_the_papers_arm():
    arm = takeichi_20m()
    compare(MujocoChain(arm), arm, random_states(20, 20))
