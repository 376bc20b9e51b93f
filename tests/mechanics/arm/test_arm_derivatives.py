"""jvp and vjp of every public function of the arm, in motion and at rest, under jit and vmap."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax.mechanics.arm as mechanics
from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from peers.arms import full_arm, general_arm, random_states

LINKS = 3

# The arguments after the arm, by their names in `states`.
FUNCTIONS = {
    "link_centres": ("angles",),
    "tip_position": ("angles",),
    "link_velocities": ("angles", "rates"),
    "drag_force": ("angles", "rates", "wind"),
    "mass_matrix": ("angles",),
    "inverse_dynamics": ("angles", "rates", "torques", "wind", "gust"),
    "forward_dynamics": ("angles", "rates", "torques", "wind", "gust"),
    "joint_torque": ("angles", "rates", "command"),
    "acceleration": ("angles", "rates", "command", "wind", "gust", "torques"),
    "kinetic_energy": ("angles", "rates"),
    "potential_energy": ("angles", "command", "wind"),
    "drag_power": ("angles", "rates", "wind"),
    "damping_power": ("rates",),
}


def states():
    """Return two large motions, and a straight arm at rest in still air."""
    moving = random_states(LINKS, 2)
    moving["gust"] = random_states(LINKS, 2, seed=4)["wind"]
    moving["torques"] = random_states(LINKS, 2, seed=3)["command"]
    return {
        name: jnp.concatenate([value, jnp.zeros_like(value[:1])]) for name, value in moving.items()
    }


def test_no_public_function_is_left_out():
    functions = {
        name
        for name in dir(mechanics)
        if callable(getattr(mechanics, name)) and name[0].islower() and name[0] != "_"
    }
    builders = {
        "named_axes",
        "pose",
        "preset",
        "six_points",
        "structural_points",
        "trimmed",
        "with_wind",
        *mechanics.PRESETS,
    }
    without_state = {"cylinder_drag_coefficient", "net_lift", "bodies", "lift"}
    # Tested in test_contact, test_joint_memory and test_pneumatics.
    of_memory = {"hysteresis_power"}
    of_muscles = {"muscle_power"}
    of_contact = {"clearance", "contact_energy", "contact_stiffness", "touch", "touched"}
    # Parts of tested functions, which other packages and the tests of identities use.
    parts = {"carried_inertia", "eliminate_and_solve", "motion_and_momentum", "solve_eliminated"}
    parts |= {"flattening", "sum_from_tip", "check_drag_law", "check_joint_law", "check_wind"}
    parts |= {"solve_accelerations", "angular_velocities", "joint_forces"}  # in test_sensor_objects
    others = builders | without_state | of_memory | of_muscles | of_contact | parts
    assert functions - others == set(FUNCTIONS)


def cases():
    """Yield functions and arms; `acceleration` includes the parts that take longest to compile."""
    for name in FUNCTIONS:
        dynamics = name in ("forward_dynamics", "inverse_dynamics")
        yield pytest.param(name, general_arm, marks=[pytest.mark.slow] if dynamics else [])
        mark = pytest.mark.slow if name == "acceleration" else pytest.mark.long
        yield pytest.param(name, full_arm, marks=mark)


@pytest.mark.parametrize(("name", "build"), list(cases()))
def test_both_modes_agree_with_differences(name, build):
    """Compare along one random direction in all numbers of the arm, the state and the wind."""
    function = getattr(mechanics, name)
    arm = build(LINKS)
    known = states()
    state = tuple(known[argument] for argument in FUNCTIONS[name])
    random = np.random.default_rng(7)

    def like(x):
        return jnp.asarray(random.normal(size=x.shape)) * jnp.maximum(jnp.abs(x), 0.05)

    d_arm = jax.tree.map(like, arm)
    d_state = tuple(jnp.asarray(random.normal(size=part.shape)) for part in state)

    @jax.jit
    def values(arm, state):
        return jax.vmap(function, (None,) + (0,) * len(state))(arm, *state)

    def shifted(step):
        return jax.tree.map(lambda x, dx: x + step * dx, (arm, state), (d_arm, d_state))

    @jax.jit
    @jax.vmap
    def derivatives(state, d_state):
        out, push = jax.linearize(function, arm, *state)
        tangent = push(d_arm, *d_state)
        # The adjoint of a linear map satisfies <c, J d> = <J' c, d> for any c.
        cotangent = jnp.cos(jnp.arange(out.size, dtype=out.dtype)).reshape(out.shape)
        gradient = jax.linear_transpose(push, arm, *state)(cotangent)
        pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves((d_arm, *d_state)), strict=True)
        return tangent, jnp.vdot(cotangent, tangent), sum(jnp.vdot(g, d) for g, d in pairs)

    tangent, forward, reverse = derivatives(state, d_state)
    # |V| V has no third derivative at rest, so the error of a difference is of first order.
    step = 1e-7
    expected = (values(*shifted(step)) - values(*shifted(-step))) / (2 * step)
    scale = np.abs(expected).max()
    assert scale > 0
    assert_allclose(tangent, expected, rtol=1e-6, atol=2e-7 * scale)
    assert_allclose(reverse, forward, rtol=1e-10, atol=1e-12 * scale)


def test_drag_of_a_resting_arm_has_no_slope_but_that_of_moving_air_has():
    arm, still = takeichi_20m(LINKS), jnp.zeros(LINKS)

    @jax.jit
    def slope(wind):
        return jax.jacfwd(lambda rates: mechanics.drag_force(arm, still, rates, wind))(still)

    assert_allclose(slope(jnp.zeros(3)), np.zeros((LINKS, 3, LINKS)), atol=0)
    # In a wind U, dF/dV is -K U across the wind and -2 K U along it.
    force = 0.5 * 1.204 * 1.2 * 0.99 * 0.3
    across = slope(jnp.array([0.2, 0.0, 0.0]))[0, 2, 0]
    along = slope(jnp.array([0.0, 0.0, 0.2]))[0, 2, 0]
    assert_allclose([across, along], [-force * 0.2 * 0.495, -2 * force * 0.2 * 0.495], rtol=1e-12)


@pytest.mark.slow
def test_acceleration_from_rest_is_that_of_the_springs():
    """At rest, d(acceleration)/d(command) = M^-1 K, and only gravity would accelerate the arm."""
    arm, still = takeichi_20m(LINKS), jnp.zeros(LINKS)

    @jax.jit
    def slopes(arm, command):
        return jax.jacrev(mechanics.acceleration, argnums=(0, 3))(arm, still, still, command)

    by_arm, by_command = slopes(arm, still)
    matrix = mechanics.mass_matrix(arm, still)
    expected = np.linalg.inv(matrix) * np.asarray(arm.joints.stiffness)
    assert_allclose(by_command, expected, rtol=1e-10)
    for path, leaf in jax.tree.leaves_with_path(by_arm):
        falls = jax.tree_util.keystr(path) == ".gravity"
        assert np.any(leaf != 0) == falls, path
        assert np.all(np.isfinite(leaf)), path


def test_batches_of_arms_are_batches_of_derivatives():
    arm, state = general_arm(LINKS), {name: value[0] for name, value in states().items()}
    coefficients = jnp.array([0.0, 0.5, 1.5])

    def first(coefficient, wind):
        changed = replace(arm, {"air.drag_coefficient": coefficient})
        arguments = (state[name] for name in ("angles", "rates", "command"))
        return mechanics.acceleration(changed, *arguments, wind)[0]

    both = eqx.filter_jit(jax.vmap(jax.value_and_grad(first), (0, None)))
    values, slopes = both(coefficients, state["wind"])
    # The acceleration is linear in the drag coefficient.
    assert_allclose(np.diff(values) / np.diff(coefficients), slopes[1:], rtol=1e-10)
    assert_allclose(slopes, slopes[0], rtol=1e-10)
