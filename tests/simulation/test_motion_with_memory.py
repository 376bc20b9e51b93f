"""Arms with joint hysteresis: compared with fixed steps, and after a command that returns."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics.arm import acceleration, takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import (
    Signal,
    joint_ramps,
    logged,
    simulate,
    solver as solver_named,
    with_return_mapping,
)

LINKS = 2
END = 2.0
BOUC_WEN = {"joints.memory.strength": 0.3, "joints.memory.yield_angle": 0.02}
SHARP = BOUC_WEN | {"joints.memory.nu": 2.0, "joints.memory.delta": 0.4}
STOPS = {"joints.stops.strength": [0.1, 0.2], "joints.stops.yield_angle": [0.01, 0.05]}
LAWS = {"dahl": BOUC_WEN, "bouc-wen": SHARP, "stops": STOPS, "both": BOUC_WEN | STOPS}


def arm_with(parameters, links=LINKS):
    # The fast command causes reversals in each joint, at rest and in motion.
    own = {"joints.pitch_stiffness": 3.0, "joints.yaw_stiffness": 5.0, "joints.damping": 0.02}
    return takeichi_20m(links, parameters=own | {"air.added_mass_coefficient": 1.0} | parameters)


def to_and_fro(links=LINKS):
    """Return a command that goes to an angle and returns to 0."""
    times = np.asarray([0.0, 0.1, 0.3, 0.9, 1.0, 100.0])
    values = np.zeros((6, links))
    values[2:4, :2] = 0.5, -0.3
    return logged(times, values, "linear")


@eqx.filter_jit
def by_fixed_steps(arm, command, count):
    """Return angles (rad) at the ends of equal steps of classical Runge-Kutta, and at midpoints."""
    step, laws = END / count, arm.joints.further_laws

    def slope(time, state):
        angles, rates, memory = state[0], state[1], state[2:]
        moved = acceleration(arm, angles, rates, command(time), memory=memory)
        at = laws.at(angles, rates, command(time), memory)
        return jnp.concatenate([rates[None], moved[None], laws.rate(at)])

    def one(state, index):
        time = index.astype(float) * step
        first = slope(time, state)
        second = slope(time + step / 2, state + step / 2 * first)
        third = slope(time + step / 2, state + step / 2 * second)
        fourth = slope(time + step, state + step * third)
        state = state + step / 6 * (first + 2 * second + 2 * third + fourth)
        memory = laws.return_mapped(state[0], state[2:])
        return jnp.concatenate([state[:2], memory]), state[0]

    rest = jnp.zeros(arm.count)
    start = jnp.concatenate([jnp.zeros((2, arm.count)), laws.unstrained(rest)])
    return jax.lax.scan(one, start, jnp.arange(count))[1]


@functools.cache
def referred_to(law):
    return np.asarray(by_fixed_steps(arm_with(LAWS[law]), to_and_fro(), 40_000)[1999::2000])


@pytest.mark.parametrize("solver", ["springs5", pytest.param("tsit5", marks=pytest.mark.slow)])
@pytest.mark.parametrize("law", LAWS)
def test_a_motion_is_that_of_fixed_steps(law, solver):
    arm, command = arm_with(LAWS[law]), to_and_fro()
    times = np.linspace(0, END, 21)
    motion = simulate(arm, command, times, solver=solver, rtol=1e-8, atol=1e-8)
    assert_allclose(motion.angles[1:], referred_to(law), rtol=0, atol=1e-6)
    if law == "stops":
        strain = np.abs(motion.angles[:, None] - motion.memory)
        assert np.all(strain <= np.asarray([0.01, 0.05])[None, :, None] + 1e-12)


def test_joints_do_not_come_back():
    arm = arm_with(BOUC_WEN | {"joints.damping": 1.5})
    times = np.linspace(0, 12.0, 25)
    motion = simulate(arm, to_and_fro(), times)
    at_rest = motion.angles[-1]
    assert_allclose(motion.rates[-1], 0, atol=2e-3)
    # Friction balances the remaining torque of the spring.
    held = np.asarray([3.0, 5.0]) * np.abs(np.asarray(at_rest))
    assert np.all(held <= 0.3)
    free = simulate(arm_with({"joints.damping": 1.5}), to_and_fro(), times)
    assert abs(at_rest[0]) > 10 * abs(free.angles[-1, 0])
    assert_allclose(motion.memory.shape, (25, 1, LINKS))
    laws, still = arm.joints.further_laws, jnp.zeros(LINKS)
    torque = laws.torque(laws.at(motion.angles[-1], still, still, motion.memory[-1]))
    assert_allclose(np.abs(torque), held, atol=5e-3)


def test_an_arm_without_memory_has_no_states():
    motion = simulate(arm_with({}), to_and_fro(), np.linspace(0, 0.5, 6))
    assert motion.memory is None


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["springs5", "tsit5"])
def test_derivatives_are_slopes(solver):
    command, times = to_and_fro(), np.linspace(0, END, 11)
    paths = ["joints.memory.strength", "joints.memory.yield_angle", "joints.stops.strength[0]",
             "joints.stops.yield_angle[1]", "joints.pitch_stiffness"]  # fmt: skip
    arm = arm_with(LAWS["both"])
    start = jnp.asarray([0.3, 0.02, 0.1, 0.05, 3.0])

    @jax.jit
    def angles(values):
        own = replace(arm, dict(zip(paths, values, strict=True)))
        # With a ten times larger tolerance, rounding decides which corners end a step, which
        # changes a derivative by 5 %.
        motion = simulate(own, command, times, solver=solver, rtol=1e-9, atol=1e-9, throw=False)
        return motion.angles

    found = jax.jit(jax.jacfwd(angles))(start)
    assert np.all(np.isfinite(found))
    for index in range(len(paths)):
        # With a larger difference, steps would end at other corners.
        step = 2e-4 * start[index]
        off = jnp.zeros_like(start).at[index].set(step)
        slope = (angles(start + off) - angles(start - off)) / (2 * step)
        # Differences of a motion with corners are not more accurate.
        assert_allclose(found[..., index], slope, atol=0.02 * np.max(np.abs(slope)))


@pytest.mark.long
@pytest.mark.parametrize("solver", ["springs5", "tsit5"])
def test_a_gradient_in_reverse_is_that_of_forward_mode(solver):
    command, times = to_and_fro(), np.linspace(0, 0.6, 4)
    arm = arm_with(LAWS["both"])

    def height(strength, derivatives):
        own = replace(arm, {"joints.memory.strength": strength})
        options = {"solver": solver, "derivatives": derivatives, "max_steps": 500}
        return simulate(own, command, times, **options).tip[-1, 2]

    forward = float(jax.jacfwd(lambda x: height(x, "forward"))(0.3))
    assert float(jax.grad(lambda x: height(x, "reverse"))(0.3)) == pytest.approx(forward, rel=1e-6)


@pytest.mark.slow
def test_a_batch_is_its_items():
    command, times = to_and_fro(), np.linspace(0, 0.6, 4)
    arm = arm_with(LAWS["both"])

    def angles(strength):
        own = replace(arm, {"joints.stops.strength[1]": strength})
        return simulate(own, command, times, throw=False).angles

    strengths = jnp.asarray([0.05, 0.2, 0.4])
    batch = jax.vmap(angles)(strengths)
    for index, strength in enumerate(strengths):
        assert_allclose(batch[index], angles(strength), atol=1e-10)


def test_a_method_that_iterates_has_the_tolerances_of_its_steps():
    inner = with_return_mapping(solver_named("kvaerno3"), 1e-7, 1e-8, "forward").solver
    assert (inner.root_finder.rtol, inner.root_finder.atol) == (1e-7, 1e-8)


def test_bad_values_are_refused():
    with pytest.raises(InputError, match="3 values: give one finite number"):
        arm_with({"joints.memory.strength": [0.1, 0.1, 0.1]})


@pytest.mark.slow
def test_a_derivative_by_when_a_command_turns_is_that_of_the_motion():
    """It excludes the derivatives of the step ends, each of which depends on earlier ones."""
    arm = arm_with({"joints.memory.strength": 0.1, "joints.memory.yield_angle": 0.005})
    times = np.linspace(0.0, END, 21)

    def angles(lasting):
        knots = jnp.stack([jnp.zeros(()), lasting, jnp.asarray(1.0), 1.0 + lasting])
        values = jnp.zeros((4, LINKS)).at[1:3].set(0.5)
        slopes = jnp.zeros((4, LINKS)).at[0].set(0.5 / lasting).at[2].set(-0.5 / lasting)
        command = Signal(knots, values, slopes, jnp.full(4, jnp.inf))
        options = {"solver": "springs5", "steps_for": "derivatives"}
        return simulate(arm, command, times, rtol=1e-6, atol=1e-6, **options).angles

    at, step = jnp.asarray(0.37), 1e-3
    found = jax.jvp(angles, (at,), (jnp.ones(()),))[1]
    expected = (angles(at + step) - angles(at - step)) / (2 * step)
    assert np.abs(expected).max() > 0.2
    # With steps that move with the command, the error was in the thousands.
    assert_allclose(found, expected, atol=0.1)


TAKEICHI = {
    "memory": {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.001},
    "stops": {"joints.stops.strength": [0.03, 0.03], "joints.stops.yield_angle": [1e-3, 4e-3]},
}


@pytest.mark.slow
@pytest.mark.parametrize("law", TAKEICHI)
def test_turns_of_many_joints_cost_few_steps(law):
    """A few more than without hysteresis, although in 25 s there are more reversals than steps."""
    command = joint_ramps(20, {1: np.deg2rad(30), 2: np.deg2rad(20)}, start=0.5, duration=1.0)
    times = np.linspace(0.0, 25.0, 251)
    arms = {"plain": takeichi_20m(), law: takeichi_20m(parameters=TAKEICHI[law])}
    options = {"solver": "springs5", "rtol": 3e-5, "atol": 3e-5}
    steps = {name: simulate(arm, command, times, **options).steps for name, arm in arms.items()}
    motion = simulate(arms[law], command, times, **options)
    fine = simulate(arms[law], command, times, solver="springs5", rtol=1e-9, atol=1e-9)
    turned = np.sum(np.diff(np.sign(fine.rates), axis=0) != 0)
    assert turned > np.sum(steps[law])
    assert np.sum(steps[law]) < 2 * np.sum(steps["plain"])
    assert np.max(np.linalg.norm(motion.tip - fine.tip, axis=1)) < 3e-4


@pytest.mark.slow
def test_states_between_two_steps_are_those_of_the_way():
    """At samples within long steps in which joints reverse, compared with short steps."""
    arm = arm_with({"joints.memory.strength": 0.1, "joints.memory.yield_angle": 0.02})
    times = np.linspace(0.0, END, 201)
    long, short = (
        simulate(arm, to_and_fro(), times, solver="springs5", rtol=tolerance, atol=tolerance)
        for tolerance in (1e-5, 1e-9)
    )
    assert 3 * np.sum(long.steps) < np.sum(short.steps)
    assert_allclose(long.memory, short.memory, rtol=0, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["dahl", "stops"])
def test_derivatives_of_long_steps_are_those_of_short_ones(law):
    """Joints reverse within steps, and a stage must have the derivatives of the side of its end."""
    links, paths = 6, ["air.drag_coefficient", "joints.pitch_stiffness"]
    values = {
        "dahl": {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.001},
        "stops": {"joints.stops.strength": [0.06], "joints.stops.yield_angle": [0.001]},
    }
    arm = takeichi_20m(links, parameters=values[law])
    command = joint_ramps(links, {1: 0.5, 2: 0.3}, start=0.2, duration=0.5)
    times, start = np.linspace(0.0, 6.0, 31), jnp.asarray([1.2, 3.0])

    def tips(at, tolerance):
        own = replace(arm, dict(zip(paths, at, strict=True)))
        return simulate(own, command, times, solver="springs5", rtol=tolerance, atol=tolerance).tip

    jacobian = jax.jit(jax.jacfwd(tips))

    def slopes(tolerance):
        return jacobian(start, jnp.asarray(tolerance))

    exact = slopes(1e-9)
    size = np.max(np.abs(exact), axis=(0, 1))
    assert np.all(size > 0)
    for tolerance in (1e-4, 1e-5):
        assert np.all(np.abs(slopes(tolerance) - exact) < 0.1 * size)
