"""Masses and buoyancy of the links: trim, helium, point masses, and the presets that use them."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax.mechanics.arm
from giajax.mechanics.arm import (
    PointMasses,
    net_lift,
    pendulum,
    takeichi_20m,
    takeichi_20m_full,
    trimmed,
)
from giajax.runtime.text import InputError
from giajax.schema.parameters import replace
from peers.arms import full_arm, random_states

acceleration = eqx.filter_jit(giajax.mechanics.arm.acceleration)
inverse_dynamics = eqx.filter_jit(giajax.mechanics.arm.inverse_dynamics)
mass_matrix = eqx.filter_jit(giajax.mechanics.arm.mass_matrix)
accelerations_by_angles = eqx.filter_jit(jax.jacfwd(giajax.mechanics.arm.acceleration, argnums=1))

# Mass of the air that a link of the paper's arm displaces, kg.
DISPLACED = 1.204 * np.pi / 4 * 0.3**2 * 0.99


@pytest.mark.parametrize("structure", [0.02, 0.047, 0.06])
def test_a_trimmed_link_moves_with_the_mass_of_the_air_it_displaces(structure):
    """At the end of a long massless lever, M / R^2 is the effective mass for any structure."""
    lever = 1e6
    arm = takeichi_20m(
        2,
        length=[lever, 0.99],
        diameter=[2e-7, 0.3],
        mass=[1e-9, structure],
        joint_axes=["yaw", "yaw"],
        gravity=9.81,
        buoyancy=True,
        parameters={"buoyancy.trim_depth": 0.15},
    )
    floating = trimmed(arm)
    mass = mass_matrix(floating, jnp.array([0.0, np.pi / 2]))[0, 0] / lever**2
    assert_allclose(mass, DISPLACED, rtol=2e-6)
    assert_allclose(net_lift(floating), 0, atol=1e-15)
    weight = DISPLACED * (1 - 0.1664 / 1.204) - structure
    assert_allclose(floating.buoyancy.trim_mass[1], weight, rtol=1e-4)


def test_a_link_lifts_what_the_paper_says():
    """0.0843 kg of air, compared with 0.0116 kg of helium and 0.047 kg of structure."""
    arm = takeichi_20m(gravity=9.81, buoyancy=True)
    assert_allclose(net_lift(arm), DISPLACED - 0.011645 - 0.047, rtol=1e-4)
    assert_allclose(inverse_dynamics(arm, *[jnp.zeros(20)] * 3)[1::2], 0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("build", [takeichi_20m, full_arm], ids=["the paper's", "uneven"])
def test_a_trimmed_arm_stays_wherever_it_is_put(build):
    """Weight and lift balance about every point of a level link, in any pose."""
    held = takeichi_20m(1, buoyancy=True).buoyancy
    arm = dataclasses.replace(build(4), point_masses=None, buoyancy=held)
    share, along = jnp.array([0.3, 0.4, 0.5, 0.2]), jnp.array([0.45, 0.6, 0.5, 0.5])
    changes = {
        "gravity": 9.81,
        "links.mass": share * arm.air.density * arm.links.volume,
        "links.centre_of_mass": along * arm.links.length,
        "joints.pitch_stiffness": 0.0,
        "joints.yaw_stiffness": 0.0,
    }
    arm = replace(arm, changes)
    floating = trimmed(arm, level=True)
    calm = None if arm.air.wind is None else -arm.air.wind
    angles = random_states(4, 1)["angles"][0]
    still = jnp.zeros(4)
    found = acceleration(floating, angles, still, still, calm)
    falls = acceleration(arm, angles, still, still, calm)
    assert np.abs(falls).max() > 0.1
    assert_allclose(found, 0, atol=1e-11 * np.abs(falls).max())
    # If it is not level, it floats but rotates.
    off = trimmed(arm)
    assert_allclose(net_lift(off), 0, atol=1e-15)
    assert np.abs(acceleration(off, angles, still, still, calm)).max() > 1e-3


@pytest.mark.slow
def test_the_full_arm_floats_at_rest_when_it_is_straight():
    arm, still = takeichi_20m_full(), jnp.zeros(20)
    assert_allclose(acceleration(arm, still, still, still), 0, atol=1e-11)
    assert_allclose(net_lift(arm), 0, atol=1e-15)
    # The camera belongs to the load of its link, so the trim weight is nearer to the base.
    lighter = arm.buoyancy.trim_mass[-2] - arm.buoyancy.trim_mass[-1]
    assert_allclose(lighter, 0.003, rtol=1e-9)
    assert 0.4 < float(arm.buoyancy.trim_position[-1]) < 0.495
    # Weights below the axis pull a raised arm back; for a single link with 0.038 N m/rad.
    raised = inverse_dynamics(arm, still.at[18].set(1e-6), still, still)
    depth, weights = 0.15, arm.buoyancy.trim_mass
    assert_allclose(raised[18] / 1e-6, 9.80665 * depth * weights[18:].sum(), rtol=1e-4)


def test_weights_below_the_axis_are_a_stiffness():
    """m g h for a floating link with weight m at depth h: 0.15 m give 0.038 N m/rad."""
    arm = takeichi_20m(1, gravity=9.81, trim=True, parameters={"buoyancy.trim_depth": 0.15})
    angle = 0.3
    torque = inverse_dynamics(arm, jnp.array([angle]), jnp.zeros(1), jnp.zeros(1))
    stiffness = float(arm.buoyancy.trim_mass[0]) * 9.81 * 0.15
    assert_allclose(torque, [stiffness * np.sin(angle)], rtol=1e-10)
    assert stiffness == pytest.approx(0.038, rel=0.02)


def test_lift_that_is_left_over_raises_the_arm():
    parameters = {"buoyancy.imbalance": 0.02}
    arm = takeichi_20m(2, gravity=9.81, trim=True, joint_axes=["pitch"] * 2, parameters=parameters)
    torque = inverse_dynamics(arm, *[jnp.zeros(2)] * 3)
    assert_allclose(torque, [-0.02 * (0.495 + 1.485), -0.02 * 0.495], rtol=1e-9)


def test_a_point_mass_is_what_the_link_would_be_with_it():
    """Centre of mass and inertia (parallel axes) of the combined link, checked about three axes."""
    place, size = np.array([0.9, 0.1, -0.2]), 0.05
    fixed = PointMasses((1,), *(jnp.asarray(x) for x in (size, *place)))
    for axis in np.eye(3):
        plain = takeichi_20m(1, joint_axes=[axis.tolist()])
        arm = dataclasses.replace(plain, point_masses=fixed)
        lever = np.cross(axis, place)
        added = mass_matrix(arm, jnp.zeros(1)) - mass_matrix(plain, jnp.zeros(1))
        assert_allclose(added, [[size * lever @ lever]], rtol=1e-12)


def test_two_bodies_on_one_link_are_one_in_their_middle():
    def arm(links, mass, position, up):
        fixed = PointMasses(links, jnp.asarray(mass), jnp.asarray(position), None, jnp.asarray(up))
        return takeichi_20m(3, gravity=9.81, point_masses=fixed)

    two = arm((2, 2), [0.1, 0.1], [0.3, 0.3], [0.2, 0.2])
    one = arm((2,), [0.2], [0.3], [0.2])
    rows = [random_states(3, 1)[name][0] for name in ("angles", "rates", "command")]
    assert_allclose(acceleration(two, *rows), acceleration(one, *rows), rtol=1e-10)


def test_a_pendulum_hangs_down_and_swings_as_a_rod():
    """A thin rod: w^2 = m g (L/2) / (m L^2 / 3 + m r^2 / 2) = 3 g / (2 L) for r = 0."""
    g = 9.80665
    slope = accelerations_by_angles(pendulum(), *[jnp.zeros(1)] * 3)
    assert_allclose(-slope, [[3 * g / 2 / (1 + 1.5 * 0.01**2)]], rtol=1e-12)
    assert_allclose(
        giajax.mechanics.arm.tip_position(pendulum(2), jnp.zeros(2)), [0, 0, -2], atol=1e-15
    )


def test_a_double_pendulum_swings_in_its_two_modes():
    """Two equal thin rods: w^2 = 3 (1 -+ 2 / sqrt 7) g / L.

    With absolute angles: M = m L^2 [[4/3, 1/2], [1/2, 1/3]], K = m g L [[3/2, 0], [0, 1/2]];
    det(K - w^2 M) = 0 is 7 x^2 - 42 x + 27 = 0 for x = w^2 L / g: x = 3 -+ 6 / sqrt 7.
    """
    arm = pendulum(2, diameter=1e-6)
    slope = accelerations_by_angles(arm, *[jnp.zeros(2)] * 3)
    squares = np.sort(np.linalg.eigvals(-slope).real) / 9.80665
    assert_allclose(squares, [3 - 6 / np.sqrt(7), 3 + 6 / np.sqrt(7)], rtol=1e-10)


def camera(link, **places):
    return PointMasses((link,), jnp.full(1, 0.003), **{"position": jnp.full(1, 0.9)} | places)


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (lambda: takeichi_20m(3, drag="middle"), "drag is 'middle': use one of centre, strip"),
        (
            lambda: takeichi_20m(3, drag_curve="sphere"),
            "drag_curve is 'sphere': use one of constant, cy",
        ),
        (lambda: takeichi_20m(3, strip_points=0), "strip_points is 0: give at least 1"),
        (
            lambda: takeichi_20m(3, parameters={"air.axial_coefficient": 0.1}),
            "no axial coefficient: use drag = 'strip'",
        ),
        (
            lambda: takeichi_20m(point_masses=camera(99)),
            "a point mass is on link 99 of an arm with only 20 links: correct the number",
        ),
        (lambda: camera(0), "a point mass has no link, or a link number below 1: number links"),
        (
            lambda: PointMasses((), 0.1, 0.2),
            "a point mass has no link, or a link number below 1: number links",
        ),
        (lambda: camera(1, up=jnp.zeros(2)), "have 1 links and a up of shape (2,)"),
        (
            lambda: takeichi_20m(3, mass=[0.04, 0.1, 0.05], trim=True),
            "link 2 is 0.0274 kg too heavy to float, so no trim weight can balance it",
        ),
        (
            lambda: takeichi_20m(2, mass=0.07, trim=True, centre_of_mass=0.2),
            "link 1 would float level only with a trim weight at 8.41 m along its axis, which is "
            "outside the link of 0.99 m",
        ),
        (
            lambda: trimmed(takeichi_20m(2)),
            "this arm has no buoyancy: build it with buoyancy=True",
        ),
        (
            lambda: net_lift(takeichi_20m(2)),
            "this arm has no buoyancy: build it with buoyancy=True",
        ),
        (
            lambda: takeichi_20m(3, parameters={"buoyancy.trim_mass": 0.1}),
            "there is no parameter 'buoyancy.trim_mass'",
        ),
        (
            lambda: takeichi_20m(3, parameters={"joints.friction": [0.1, 0.2]}),
            "'joints.friction' has 2 values: give one finite number, or 3 numbers",
        ),
        (
            lambda: takeichi_20m(3, parameters={"air.wind": [0.1, np.nan, 0.0]}),
            "'air.wind' has 3 values: give one finite number, or 3 numbers",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(build, sentence):
    with pytest.raises(InputError) as refused:
        build()
    assert sentence in str(refused.value)
