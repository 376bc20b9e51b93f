"""A simulation takes the requested kind of steps, whether it is differentiated or not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from giajax.mechanics.arm import takeichi_20m, takeichi_20m_full
from giajax.models import ArmModel
from giajax.schema.parameters import declared, replace
from giajax.simulation import constant, is_disturbance, joint_ramps, simulate

LINKS = 3
TIMES = np.linspace(0.0, 3.0, 16)
# In a planar motion, the stiff yaw springs are at rest, and only a derivative excites them.
ARM = replace(takeichi_20m(LINKS), {"joints.yaw_stiffness": 3e3})
COMMAND = joint_ramps(LINKS, {1: 0.5}, start=0.5)
STILL = jnp.zeros(3)
CHOICES = pytest.mark.parametrize("steps_for", ["motion", "derivatives"])
SOLVERS = pytest.mark.parametrize("solver", ["tsit5", "springs5"])


def motion(coefficient, wind, **options):
    """Return angles and rates in one array, and the numbers of steps."""
    arm = replace(ARM, {"air.drag_coefficient": coefficient})
    moved = simulate(arm, COMMAND, TIMES, wind=wind, throw=False, **options)
    return jnp.stack([moved.angles, moved.rates]).ravel(), moved.steps


@pytest.mark.slow
@CHOICES
@SOLVERS
def test_the_value_beside_a_derivative_is_the_value(solver, steps_for):
    def by_drag(coefficient):
        return motion(coefficient, STILL, solver=solver, steps_for=steps_for)

    coefficient = jnp.asarray(1.2)
    value, steps = by_drag(coefficient)
    beside, slope, taken = jax.jvp(by_drag, (coefficient,), (jnp.ones(()),), has_aux=True)
    assert_array_equal(taken, steps)
    # Two programs with the same steps differ in rounding, which the steps amplify.
    assert_allclose(beside, value, rtol=0, atol=1e-11)
    assert np.abs(slope).max() > 0.01


@pytest.mark.slow
@SOLVERS
def test_the_value_beside_a_derivative_by_the_wind_is_the_value(solver):
    def by_wind(wind):
        return motion(1.2, wind, solver=solver, steps_for="derivatives")

    value, steps = by_wind(STILL)
    beside, slope, taken = jax.jvp(by_wind, (STILL,), (jnp.ones(3),), has_aux=True)
    assert_array_equal(taken, steps)
    # Two programs with the same steps differ in rounding, which the steps amplify.
    assert_allclose(beside, value, rtol=0, atol=1e-11)
    assert np.abs(slope).max() > 0.01


@pytest.mark.slow
@SOLVERS
def test_steps_for_derivatives_keep_derivatives_across_a_planar_motion_stable(solver):
    """The derivative is with respect to a cross-wind, which is zero in the motion itself."""
    options = {"solver": solver, "rtol": 1e-12, "atol": 1e-12, "steps_for": "derivatives"}
    across = jnp.asarray([0.0, 1.0, 0.0])
    value = jax.jit(lambda wind: motion(1.2, wind, **options)[0])
    _, slope = jax.jvp(value, (STILL,), (across,))
    step = 2e-5  # tiny, because |V| V has its kink at rest
    difference = (value(step * across) - value(-step * across)) / (2 * step)
    largest = np.abs(difference).max()
    assert largest > 1e-4
    assert_allclose(slope, difference, rtol=0, atol=0.02 * largest)


@pytest.mark.slow
def test_steps_for_derivatives_are_the_shorter_ones_of_an_explicit_method():
    _, plain = motion(1.2, STILL, solver="tsit5")
    _, careful = motion(1.2, STILL, solver="tsit5", steps_for="derivatives")
    assert careful[0] > 2 * plain[0]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("derivatives", ["forward", "reverse"])
@pytest.mark.parametrize("part", ["command", "wind", "torque", "initial", "gravity"])
def test_a_disturbance_needs_steps_for_derivatives(part, derivatives, compiled):
    def last(x):
        inputs = {
            "command": COMMAND,
            "wind": constant(STILL),
            "torque": constant(np.zeros(LINKS)),
            "initial": (jnp.zeros(LINKS), jnp.zeros(LINKS)),
        }
        arm = ARM
        if part == "gravity":
            arm = replace(ARM, {"gravity": x})
        else:
            inputs[part] = jax.tree.map(lambda leaf: leaf + x, inputs[part])
        moved = simulate(arm, times=TIMES, derivatives=derivatives, throw=False, **inputs)
        return moved.rates[-1, 0]

    derivative = (jax.jacfwd if derivatives == "forward" else jax.grad)(last)
    with pytest.raises(
        TypeError, match=r"with respect to a disturbance .*: call simulate with steps_for="
    ):
        (jax.jit(derivative) if compiled else derivative)(0.1)


@pytest.mark.long
def test_reverse_mode_by_what_moves_already_takes_steps_for_the_motion():
    def first(coefficient):
        return motion(coefficient, STILL, derivatives="reverse")[0][-LINKS]

    value, slope = jax.value_and_grad(first)(1.2)
    assert_allclose(value, first(1.2), rtol=0, atol=1e-11)
    difference = (first(1.201) - first(1.199)) / 2e-3
    assert_allclose(slope, difference, rtol=1e-3)


def test_a_model_takes_the_steps_that_its_free_parameters_need():
    arm = takeichi_20m_full(2)
    model = ArmModel(arm)
    assert model.for_derivatives(["air.drag_coefficient", "links.mass[0]"]) == model
    for path in ("base_rotation", "air.wind[1]", "buoyancy.trim_mass", "initial.angle"):
        assert model.for_derivatives(["joints.damping", path]).steps_for == "derivatives"
    heads = {path.partition(".")[0] for path in declared(arm) if is_disturbance(path)}
    assert heads == {"base_rotation", "gravity", "buoyancy", "point_masses"}
    assert not is_disturbance("gravity_of_nothing")
