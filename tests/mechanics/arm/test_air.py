"""Strip drag, C_D by Reynolds number, added mass and unsteady wind, against closed forms."""

import dataclasses
import functools
import runpy
from itertools import pairwise
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import giajax.mechanics.arm
from giajax.mechanics.arm import _drag as _cylinder, takeichi_20m
from giajax.schema.parameters import replace
from peers.arms import full_arm, random_states

acceleration = eqx.filter_jit(giajax.mechanics.arm.acceleration)
cylinder_drag_coefficient = jax.jit(giajax.mechanics.arm.cylinder_drag_coefficient)
drag_force = eqx.filter_jit(giajax.mechanics.arm.drag_force)
drag_power = eqx.filter_jit(giajax.mechanics.arm.drag_power)
inverse_dynamics = eqx.filter_jit(giajax.mechanics.arm.inverse_dynamics)
kinetic_energy = eqx.filter_jit(giajax.mechanics.arm.kinetic_energy)
mass_matrix = eqx.filter_jit(giajax.mechanics.arm.mass_matrix)

DENSITY, LENGTH, DIAMETER = 1.204, 0.99, 0.3
DISPLACED = DENSITY * np.pi / 4 * DIAMETER**2 * LENGTH
STILL = jnp.zeros(1)

POINTS = Path(__file__).parents[3] / "data" / "recorded" / "cylinder_cd"


def one_link(*, axes=("yaw",), **options):
    parameters = options.pop("parameters", {})
    return takeichi_20m(len(axes), joint_axes=list(axes), parameters=parameters, **options)


def test_drag_along_a_link_that_turns_about_its_end():
    """dF = 1/2 rho C_D d (w s)^2 ds: force rho C_D d w^2 L^3 / 6, torque rho C_D d w^2 L^4 / 8.

    Two points are exact here. One point gives the drag of the centre, L^4 / 16.
    """
    rates = jnp.array([-2.0])
    strength = DENSITY * 1.2 * DIAMETER * 2.0**2
    for count, share in (1, 1 / 16), (2, 1 / 8), (7, 1 / 8):
        arm = one_link(drag="strip", strip_points=count)
        torque = inverse_dynamics(arm, STILL, rates, STILL)
        assert_allclose(torque, [-strength * LENGTH**4 * share], rtol=1e-12)
        force = drag_force(arm, STILL, rates)
        expected = strength * LENGTH**3 * (1 / 8 if count == 1 else 1 / 6)
        assert_allclose(force, [[0, expected, 0]], rtol=1e-12, atol=1e-15)


def test_the_wind_across_and_along_a_link():
    wind = jnp.array([3.0, 0.0, 4.0])
    parameters = {"air.axial_coefficient": 0.05}
    arm = one_link(drag="strip", parameters=parameters)
    half_area = 0.5 * DENSITY * LENGTH * DIAMETER
    force = drag_force(arm, STILL, STILL, wind)
    assert_allclose(force, [[half_area * 0.05 * 9, 0, half_area * 1.2 * 16]], rtol=1e-12)
    # Without an axial coefficient, there is no force along the link; eq. (1) acts along the wind.
    smooth = drag_force(one_link(drag="strip"), STILL, STILL, wind)
    assert_allclose(smooth, [[0, 0, half_area * 1.2 * 16]], rtol=1e-12, atol=1e-15)
    by_eq_1 = drag_force(one_link(), STILL, STILL, wind)
    assert_allclose(by_eq_1, half_area * 1.2 * 5 * wind[None], rtol=1e-12)


@pytest.mark.slow
def test_drag_along_the_link_converges_with_the_number_of_points():
    """Power of the drag on a flailing arm, whose relative air speed changes sign along the links.

    There, |V| V has a kink, which limits the order of a Gauss rule.
    """
    states = random_states(3, 6)
    general = full_arm(3)

    def power(count):
        air = dataclasses.replace(general.air, drag_curve="constant", strip_points=count)
        arm = dataclasses.replace(general, air=air)
        rows = (states[name] for name in ("angles", "rates", "wind"))
        return eqx.filter_jit(jax.vmap(giajax.mechanics.arm.drag_power, (None, 0, 0, 0)))(
            arm, *rows
        )

    exact = power(100)
    errors = [np.abs(power(count) / exact - 1).max() for count in (1, 2, 3, 6, 12)]
    assert all(after < before / 2 for before, after in pairwise(errors))
    assert errors[0] > 0.03
    assert errors[2] < 0.01
    assert errors[4] < 3e-4


def points():
    x, y = np.loadtxt(POINTS / "points.csv", delimiter=",", skiprows=1).T
    return 10**x, y


def test_the_drag_curve_follows_the_points():
    reynolds, logarithm = points()
    found = np.log10(cylinder_drag_coefficient(jnp.asarray(reynolds)))
    assert np.sqrt(np.mean((found - logarithm) ** 2)) < 0.037
    # A cylinder of this size in a step of 30 deg has Re 60 .. 9000 and C_D of about 1.
    middle = cylinder_drag_coefficient(jnp.geomspace(300.0, 9000.0, 20))
    assert np.all((middle > 0.85) & (middle < 1.15))


def test_the_coefficients_of_the_curve_are_the_fit_to_the_points():
    fitted, residuals = runpy.run_path(str(POINTS / "fit_curve.py"))["fitted"]()
    transitions = [_cylinder._HEIGHT, _cylinder._PLACE, _cylinder._WIDTH]
    stated = np.concatenate([_cylinder._LINE, *transitions])
    assert_allclose(stated, fitted, rtol=0, atol=1e-5)
    assert np.sqrt(np.mean(residuals**2)) < 0.037


def test_the_drag_curve_falls_rises_and_falls_as_it_should():
    """Creeping flow, the minimum below 1e4, the plateau at 1e5, the drag crisis, the recovery."""

    def ordered(low, high):
        return np.diff(cylinder_drag_coefficient(jnp.geomspace(low, high, 400)))

    assert np.all(ordered(0.01, 1e3) < 0)
    assert np.all(ordered(5e3, 5e4) > 0)
    assert np.all(ordered(2.5e5, 4.5e5) < 0)
    assert np.all(ordered(8e5, 4e6) > 0)
    crisis = cylinder_drag_coefficient(jnp.array([2e5, 6e5]))
    assert crisis[0] > 3 * crisis[1]


def test_slopes_of_the_drag_curve_are_those_of_its_differences():
    """First and second derivatives, from creeping flow to beyond the crisis."""
    reynolds = jnp.geomspace(1e-3, 9.9e6, 300)
    apart = 1e-5 * reynolds
    for function in (cylinder_drag_coefficient, jax.vmap(jax.grad(cylinder_drag_coefficient))):
        differences = (function(reynolds + apart) - function(reynolds - apart)) / (2 * apart)
        slopes = jax.vmap(jax.grad(lambda x, of=function: of(x[None])[0]))(reynolds)
        scale = np.abs(function(reynolds) / reynolds)
        assert_allclose(slopes / scale, differences / scale, rtol=0, atol=1e-6)
        every = jax.vmap(jax.jacfwd(lambda x, of=function: of(x[None])[0]))(reynolds)
        assert_allclose(every, slopes, rtol=1e-12)


def test_the_drag_curve_has_finite_slopes_everywhere():
    reynolds = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-6, 1e12, 100)])
    slopes = jax.jit(jax.vmap(jax.grad(cylinder_drag_coefficient)))(reynolds)
    assert np.all(np.isfinite(slopes))
    assert slopes[0] == 0
    # The curve is constant outside its points.
    for near, far in (0.0, 1e-4), (1e7, 1e12):
        assert_allclose(*cylinder_drag_coefficient(jnp.array([near, far])), rtol=1e-4)


@pytest.mark.parametrize("drag", ["centre", "strip"])
def test_the_drag_coefficient_is_that_at_a_reynolds_number_of_1e5(drag):
    speed = 1e5 * 1.516e-5 / DIAMETER
    for reynolds in 1e3, 1e5:
        wind = jnp.array([0.0, 0.0, speed * reynolds / 1e5])
        plain = drag_force(one_link(drag=drag), STILL, STILL, wind)
        curved = drag_force(one_link(drag=drag, drag_curve="cylinder"), STILL, STILL, wind)
        pair = cylinder_drag_coefficient(jnp.array([reynolds, 1e5]))
        assert_allclose(curved, plain * pair[0] / pair[1], rtol=1e-12, atol=1e-15)


def test_the_power_of_drag_is_the_loss_of_every_piece():
    """-1/2 rho C_D d int |V|^3 ds for a link that turns about its end: rho C_D d w^3 L^4 / 8."""
    arm = one_link(drag="strip")
    expected = -DENSITY * 1.2 * DIAMETER * 2.0**3 * LENGTH**4 / 8
    assert_allclose(drag_power(arm, STILL, jnp.array([2.0])), expected, rtol=1e-12)


@pytest.mark.parametrize("coefficient", [0.5, 1.0])
def test_the_air_that_turns_with_a_link(coefficient):
    """1/2 int C_a rho A (w s)^2 ds = 1/2 (C_a rho V L^2 / 3) w^2 about an end, 0 about its axis."""
    rates = jnp.array([1.5])
    added = {"air.added_mass_coefficient": coefficient}
    for axis, inertia in ("yaw", coefficient * DISPLACED * LENGTH**2 / 3), ([1, 0, 0], 0.0):
        plain, full = one_link(axes=[axis]), one_link(axes=[axis], parameters=added)
        found = kinetic_energy(full, STILL, rates) - kinetic_energy(plain, STILL, rates)
        assert_allclose(found, inertia * 1.5**2 / 2, rtol=1e-12, atol=1e-15)


def test_a_link_is_heavier_across_itself_than_along():
    """At the end of a lever much longer than the link, M / R^2 is the effective mass."""
    lever = 1e6
    for axis, angle, share in ("yaw", np.pi / 2, 0.0), ([1, 0, 0], 0.0, 1.0):
        arm = takeichi_20m(
            2,
            length=[lever, LENGTH],
            diameter=[1e-12, DIAMETER],
            mass=[1e-15, 0.047],
            joint_axes=["yaw", axis],
            parameters={"air.added_mass_coefficient": 0.8},
        )
        mass = mass_matrix(arm, jnp.array([0.0, angle]))[0, 0] / lever**2
        assert_allclose(mass, 0.047 + share * 0.8 * DISPLACED, rtol=1e-5)


def test_gravity_does_not_weigh_the_air_that_moves_along():
    still = jnp.zeros(4)
    arm = takeichi_20m(4, gravity=9.81)
    heavier = replace(arm, {"air.added_mass_coefficient": 1.0})
    assert_array_equal(
        inverse_dynamics(arm, still, still, still), inverse_dynamics(heavier, still, still, still)
    )


def test_a_growing_wind_pushes_a_held_link():
    """rho V (1 + C_a) du/dt across the link, rho V du/dt along it (due to the pressure alone)."""
    gust, coefficient = 2.0, 0.7
    arm = takeichi_20m(
        2, joint_axes=["yaw", "yaw"], parameters={"air.added_mass_coefficient": coefficient}
    )
    still, calm = jnp.zeros(2), jnp.zeros(3)
    rate = jnp.array([0.0, gust, 0.0])
    across, along = DISPLACED * (1 + coefficient) * gust, DISPLACED * gust
    held = inverse_dynamics(arm, still, still, still, calm, rate)
    levers = np.array([LENGTH / 2 + 3 * LENGTH / 2, LENGTH / 2])
    assert_allclose(held, -across * levers, rtol=1e-12)
    # The second link is parallel to the wind, at the end of the first.
    bent = inverse_dynamics(arm, jnp.array([0.0, np.pi / 2]), still, still, calm, rate)
    assert_allclose(bent, [-(across * LENGTH / 2 + along * LENGTH), 0], rtol=1e-12, atol=1e-15)


def test_a_wind_of_each_link_acts_on_each():
    """At rest, the drag and the force of a changing wind depend only on the wind at the link."""
    arm = takeichi_20m(3, drag="strip", parameters={"air.added_mass_coefficient": 0.7})
    random = np.random.default_rng(2)
    winds, growing = random.normal(size=(2, 3, 3))
    still = jnp.zeros(3)
    forces = drag_force(arm, still, still, jnp.asarray(winds))
    for link, wind in enumerate(winds):
        alone = drag_force(arm, still, still, jnp.asarray(wind))
        assert_allclose(forces[link], alone[link], rtol=1e-12)
        assert np.abs(alone[(link + 1) % 3] - forces[(link + 1) % 3]).max() > 1e-3
    # The loads of a wind along a chain are the sum of the loads of the winds at single links.
    state = (still, still, still)
    torque = inverse_dynamics(arm, *state, jnp.asarray(winds), jnp.asarray(growing))
    parts = 0.0
    for link in range(3):
        one, its = np.zeros((2, 3, 3))
        one[link], its[link] = winds[link], growing[link]
        parts += inverse_dynamics(arm, *state, jnp.asarray(one), jnp.asarray(its))
    assert_allclose(torque, parts, rtol=1e-10)
    # The derivative with respect to the wind at a link uses the custom derivative of the dynamics.
    forward = functools.partial(acceleration, arm, still, still, still)
    aside = jnp.zeros((3, 3)).at[1, 2].set(1e-6)
    ahead, behind = (forward(jnp.asarray(winds) + sign * aside) for sign in (1, -1))
    slope = jax.jvp(forward, (jnp.asarray(winds),), (aside,))[1]
    assert np.abs(slope).max() > 1e-8
    assert_allclose(slope, (ahead - behind) / 2, atol=1e-5 * np.abs(slope).max())
    same = jnp.asarray(np.tile(winds[0], (3, 1)))
    assert_allclose(
        inverse_dynamics(arm, *state, same, same),
        inverse_dynamics(arm, *state, same[0], same[0]),
        rtol=1e-12,
    )


def test_the_couple_of_munk_turns_a_link_across_the_wind():
    """A slender body in a steady stream without drag: no force, but m_a U^2 sin(2 a) / 2."""
    arm = one_link(parameters={"air.added_mass_coefficient": 0.8, "air.drag_coefficient": 0.0})
    for angle in np.linspace(-1.5, 1.5, 7):
        wind = 3.0 * jnp.array([np.cos(angle), np.sin(angle), 0.0])
        torque = inverse_dynamics(arm, STILL, STILL, STILL, wind)
        munk = 0.8 * DISPLACED * 3.0**2 * np.sin(2 * angle) / 2
        assert_allclose(torque, [munk], rtol=1e-12, atol=1e-15)


def test_the_arms_own_wind_is_added_to_that_of_the_run():
    arm = full_arm(3)
    state = {name: value[0] for name, value in random_states(3, 1).items()}
    angles, rates, command, wind = (state[n] for n in ("angles", "rates", "command", "wind"))
    calm = replace(arm, {"air.wind": [0.0, 0.0, 0.0]})
    found = inverse_dynamics(arm, angles, rates, command, wind)
    expected = inverse_dynamics(calm, angles, rates, command, wind + arm.air.wind)
    assert_allclose(found, expected, rtol=1e-11)
    found, expected = (
        drag_force(arm, angles, rates, wind),
        drag_force(calm, angles, rates, wind + arm.air.wind),
    )
    assert_allclose(found, expected, rtol=1e-11)


def test_an_option_at_nothing_is_an_option_left_out():
    """With a value of zero, every option gives the same result as the arm without it."""
    zeros = {
        "joints.friction": 0.0,
        "joints.armature": 0.0,
        "air.wind": [0.0, 0.0, 0.0],
        "air.added_mass_coefficient": 0.0,
    }
    state = {name: value[0] for name, value in random_states(4, 1).items()}
    rows = [state[name] for name in ("angles", "rates", "command", "wind")]
    plain, switched = takeichi_20m(4), takeichi_20m(4, parameters=zeros)
    accelerate = eqx.filter_jit(giajax.mechanics.arm.acceleration)
    assert_allclose(accelerate(switched, *rows), accelerate(plain, *rows), rtol=1e-10)
