"""Building arms: the paper's values, the defaults of `chain`, and invalid arguments."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from giajax.mechanics.arm import Arm, Joints, Links, preset, takeichi_20m
from giajax.runtime.text import InputError

PITCH, YAW = (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)


def test_the_preset_has_the_papers_numbers():
    arm = takeichi_20m()
    assert arm.count == 20
    assert_allclose(arm.links.length.sum(), 19.8)
    assert_allclose(arm.links.mass.sum(), 0.940)
    assert_allclose(arm.links.diameter, 0.300)
    assert_allclose(arm.links.centre_of_mass, 0.495)
    assert (float(arm.gravity), float(arm.air.density)) == (0.0, 1.204)
    assert arm.joints.axes == (PITCH, YAW) * 10
    assert_array_equal(arm.joints.stiffness, [3.0, 30.0] * 10)


def test_a_link_is_a_thin_tube_unless_told_otherwise():
    # I_axial = m r^2; I_transverse = m r^2 / 2 + m L^2 / 12.
    links = takeichi_20m(1, length=2.0, diameter=0.4, mass=0.3).links
    assert_allclose(links.inertia_axial, 0.3 * 0.2**2)
    assert_allclose(links.inertia_transverse, 0.3 * (0.2**2 / 2 + 2.0**2 / 12))
    assert_allclose(links.centre_of_mass, 1.0)


def test_presets_are_found_by_name():
    assert preset("takeichi_20m").count == 20
    assert preset("takeichi_20m", 3).count == 3
    with pytest.raises(InputError, match=r"no arm preset 'giraffe': use one of takeichi_20m"):
        preset("giraffe")


def test_the_stiffness_follows_the_kind_of_the_axis():
    axes = ["yaw", "pitch", [0, 0, -2], [0, 1, 1.01], [0, 1, 0.99], [1, 0, 0]]
    joints = takeichi_20m(6, joint_axes=axes).joints
    assert_array_equal(joints.is_yaw, [True, False, True, True, False, False])
    assert_array_equal(joints.stiffness, [30.0, 3.0, 30.0, 30.0, 3.0, 3.0])
    assert_allclose(np.linalg.norm(joints.axes, axis=1), 1.0, rtol=1e-15)


def test_numbers_may_be_given_for_all_links_or_for_each():
    arm = takeichi_20m(3, length=[1, 2, 3], mass=0.1, gravity=9.81, base_rotation=[0, 0.5, 0])
    assert_array_equal(arm.links.length, [1.0, 2.0, 3.0])
    assert_array_equal(arm.links.mass, [0.1] * 3)
    assert_array_equal(arm.links.centre_of_mass, [0.5, 1.0, 1.5])
    assert arm.links.length.dtype == jnp.float64
    assert not arm.gravity.weak_type


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"links": 0}, "an arm of 0 links cannot be built: give at least one link"),
        ({"mass": [0.1, 0.2]}, "mass has 2 values for 3 links: give one number, or 3"),
        ({"length": -1.0}, "length is out of bounds: give finite numbers greater than 0 m"),
        ({"mass": 0.0}, "mass is out of bounds: give finite numbers greater than 0 kg"),
        (
            {"diameter": np.nan},
            "diameter is out of bounds: give finite numbers greater than 0 m",
        ),
        (
            {"inertia_axial": 0.0},
            "inertia_axial is out of bounds: give finite numbers greater than 0 kg m^2",
        ),
        ({"joint_axes": "yaw_pitch"}, "joint_axes is 'yaw_pitch': give \"pitch_yaw\" or a list"),
        ({"joint_axes": ["pitch", "yaw"]}, "a list of 3 axes"),
        ({"joint_axes": ["pitch", "yaw", "roll"]}, "the joint axis 'roll' is unknown"),
        (
            {"joint_axes": ["yaw", "yaw", [0, 0, 0]]},
            "[0, 0, 0] is not a direction: give three",
        ),
        ({"joint_axes": ["yaw", "yaw", [0, 1]]}, "[0, 1] is not a direction: give three numbers"),
    ],
)
def test_what_cannot_be_built_is_refused(options, sentence):
    with pytest.raises(InputError) as refused:
        takeichi_20m(**{"links": 3} | options)
    assert sentence in str(refused.value)


def test_the_classes_check_what_they_are_given():
    arm = takeichi_20m(3)
    with pytest.raises(InputError, match="give each the shape"):
        Links(*[jnp.ones(3)] * 5, jnp.ones(2))
    with pytest.raises(InputError, match="a joint axis is not a unit vector"):
        Joints(axes=((0.0, 0.0, 2.0),))
    with pytest.raises(InputError, match="2 joint axes for 3 links"):
        Arm(arm.links, Joints(axes=(PITCH, YAW)), arm.air, jnp.zeros(3))
