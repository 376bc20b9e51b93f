"""A ball on a string: a point mass with its own drag.

With all other options enabled, `test_lagrange.py` derives its torque again, `test_conservation.py`
checks its power, and `test_option_derivatives.py` checks its derivatives.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from giajax import ArmModel, Definition, InputError, fit, model_for, replace
from giajax.apps.synthetic import synthesise
from giajax.mechanics import arm as mechanics
from giajax.mechanics.arm import PointMasses, forward_dynamics, pendulum
from giajax.models import arm_from_definition, arm_to_definition
from giajax.simulation import constant, simulate

drag_power = eqx.filter_jit(mechanics.drag_power)
inverse_dynamics = eqx.filter_jit(mechanics.inverse_dynamics)

GRAVITY, LENGTH, MASS, AREA, DENSITY = 9.80665, 1.3, 0.05, 0.004, 1.204
THREAD = 1e-6  # kg; the string has almost no mass, and no drag
TIMES = np.linspace(0.0, 6.0, 61)
SECTION = {
    "preset": "pendulum",
    "link_length_m": LENGTH,
    "link_mass_kg": THREAD,
    "point_masses": [{"link": 1, "mass_kg": MASS, "position_m": LENGTH, "drag_area_m2": AREA}],
}


@pytest.fixture(scope="module")
def ball():
    return arm_from_definition(Definition.parse({"arm": SECTION}))


def swing(wind, start):
    """Return the angle over time of a ball on a massless string in a plane, by Newton's law.

    The ball is at L (sin a, -cos a) and moves with L a' t, t = (cos a, sin a). Its drag is
    -1/2 rho C_D A |v - u| (v - u). Along t: M L a'' = -M g sin a + drag . t.
    """
    along, up = wind

    def rates(_, state):
        angle, rate = state
        tangent = np.array([np.cos(angle), np.sin(angle)])
        through = LENGTH * rate * tangent - np.array([along, up])
        drag = -0.5 * DENSITY * AREA * np.hypot(*through) * through
        return [rate, -GRAVITY / LENGTH * np.sin(angle) + drag @ tangent / (MASS * LENGTH)]

    options = {"rtol": 1e-11, "atol": 1e-11, "method": "DOP853"}
    return solve_ivp(rates, (0.0, TIMES[-1]), [start, 0.0], t_eval=TIMES, **options).y[0]


@pytest.mark.parametrize("wind", [(0.0, 0.0), (2.0, 0.5)], ids=["still", "wind"])
def test_a_ball_swings_as_newton_says(ball, wind):
    """The preset hangs along -z, and its angle increases towards x."""
    found = simulate(
        ball,
        constant([0.0]),
        TIMES,
        wind=constant([wind[0], 0.0, wind[1]]),
        initial=([1.2], [0.0]),
        rtol=1e-9,
        atol=1e-9,
    )
    expected = swing(wind, 1.2)
    assert_allclose(found.angles[:, 0], expected, rtol=0, atol=2e-5)
    assert_allclose(found.tip[:, 0], LENGTH * np.sin(expected), rtol=0, atol=3e-5)
    # The air must have an effect: without it, the amplitude would not decrease.
    assert np.abs(expected[-20:]).max() < 0.9


def test_its_power_is_that_of_its_drag(ball):
    """-1/2 rho C_D A v^3 in still air, and in a wind the power of its force on the moving ball."""
    speed = 0.7 * LENGTH
    power = drag_power(ball, jnp.array([0.4]), jnp.array([0.7]))
    assert_allclose(power, -0.5 * DENSITY * AREA * speed**3, rtol=1e-12)


def test_several_bodies_on_a_link_and_one_beside_its_axis():
    """The torque that holds the arm at rest in a wind follows from the levers."""
    bodies = PointMasses(
        links=(2, 1, 2),
        mass=jnp.full(3, 0.01),
        position=jnp.array([0.5, 1.0, 0.8]),
        left=jnp.zeros(3),
        up=jnp.array([0.0, 0.3, 0.0]),
        drag_area=jnp.array([0.002, 0.003, 0.004]),
    )
    arm = pendulum(2, gravity=0.0, base_rotation=(0.0, 0.0, 0.0), point_masses=bodies)
    wind = jnp.array([0.0, 0.0, 3.0])
    still = jnp.zeros(2)
    # The links lie along x, and a pitch joint turns z down, so an upward force requires a torque.
    force = 0.5 * DENSITY * np.array([0.002, 0.003, 0.004]) * 3.0**2
    about_second = force[0] * 0.5 + force[2] * 0.8
    about_first = force[0] * 1.5 + force[1] * 1.0 + force[2] * 1.8
    found = np.abs(inverse_dynamics(arm, still, still, still, wind))
    assert_allclose(found, [about_first, about_second], rtol=1e-12)
    # A wind along the links exerts a torque only through the body above the axis.
    found = np.abs(inverse_dynamics(arm, still, still, still, wind[::-1]))
    assert_allclose(found, [force[1] * 0.3, 0.0], rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_its_derivatives_are_those_of_differences(ball):
    def acceleration(area, position, angle, rate):
        numbers = {"point_masses.drag_area": area, "point_masses.position": position}
        arm = replace(ball, numbers)
        return forward_dynamics(arm, angle[None], rate[None], jnp.zeros(1))[0]

    values = jax.jit(jax.vmap(acceleration))
    forwards, backwards = (
        jax.jit(mode(acceleration, range(4))) for mode in (jax.jacfwd, jax.jacrev)
    )
    for rate in (0.7, 0.0):
        at = np.array([AREA, 1.1, 0.4, rate])
        found, reverse = (np.array(mode(*jnp.asarray(at))) for mode in (forwards, backwards))
        assert_allclose(reverse, found, rtol=1e-10, atol=1e-14)
        # At rest, |v| v of a difference is of second order, so the difference must be small.
        steps = np.diag([1e-5, 1e-5, 1e-5, 1e-5 if rate else 1e-7])
        forth, back = (values(*(at[:, None] + sign * steps)) for sign in (1, -1))
        expected = np.asarray(forth - back) / (2 * np.diag(steps))
        assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
    # At rest, neither the area nor the rate has a first-order effect.
    assert found[0] == found[3] == 0


@pytest.mark.slow
def test_a_fit_finds_it(ball):
    definition = {"arm": {**SECTION}, "initial": {"angle_deg": 60.0}, "free_motion": True}
    run = synthesise(
        ArmModel(ball),
        TIMES[:31],
        {},
        ["joint01_angle"],
        noise={"angle": 0.005},
        definition=definition,
    )
    model = model_for([run])
    assert_allclose(model.arm.point_masses.drag_area, [AREA])
    result = fit(model, run, free=["point_masses.drag_area[0]"],
                 start={"point_masses.drag_area[0]": 0.001}, check=False)  # fmt: skip
    (estimate,) = result.free.values()
    assert result.status == "converged"
    assert estimate.unit == "m^2"
    assert estimate.standard_error < 0.03 * AREA
    assert abs(estimate.value - AREA) < 3.5 * estimate.standard_error
    assert any("point_masses.drag_area: valid for air.density" in c for c in result.conditions)


def test_a_file_says_it_or_leaves_it_out(ball):
    section = arm_to_definition(ball)
    assert section["point_masses"][0]["drag_area_m2"] == AREA
    again = arm_from_definition(Definition.parse({"arm": section}))
    assert_allclose(again.point_masses.drag_area, ball.point_masses.drag_area)
    without = {**SECTION["point_masses"][0], "drag_area_m2": 0.0}
    bare = arm_from_definition(Definition.parse({"arm": {**SECTION, "point_masses": [without]}}))
    assert bare.point_masses.drag_area is None
    assert "drag_area_m2" not in arm_to_definition(bare)["point_masses"][0]
    with pytest.raises(InputError, match="zero or a positive number"):
        Definition.parse({"arm": {"point_masses": [{**without, "drag_area_m2": -1.0}]}})
