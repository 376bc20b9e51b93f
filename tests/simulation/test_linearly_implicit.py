"""The linearly implicit method: its order conditions, its order, and its purpose."""

from functools import lru_cache
from itertools import combinations_with_replacement

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import (
    Inputs,
    LinearlyImplicit,
    constant,
    joint_ramps,
    joint_steps,
    motion,
    pull,
    ramps,
    simulate,
    springs,
    tableau,
)
from peers.arms import driven_arm

# Order conditions of W-methods (Hairer and Wanner, Solving ODEs II, IV.7). A node of a tree is the
# equation's f, with any number of branches, or the matrix J, which is linear and has one branch. In
# the form of a W-method, a stage is Y = y0 + sum A h f(Y) + sum B h J Y. The solution does not
# depend on J, so the weight of a tree with a J must vanish. That of any other tree is 1 / gamma.


@lru_cache
def trees(order):
    """Return the trees with this number of nodes, as (kind, branches)."""
    found = [("J", (tree,)) for tree in (trees(order - 1) if order > 1 else ())]
    return [("f", branches) for branches in forests(order - 1)] + found


def forests(order, largest=None):
    """Return multisets of trees with this total number of nodes."""
    if order == 0:
        return [()]
    found = []
    for size in range(min(order, largest or order), 0, -1):
        for count in range(order // size, 0, -1):
            for together in combinations_with_replacement(trees(size), count):
                rest = order - size * count
                smaller = forests(rest, size - 1) if size > 1 else ([()] if rest == 0 else [])
                found += [together + more for more in smaller]
    return found


def nodes(tree):
    return 1 + sum(nodes(branch) for branch in tree[1])


def density(tree):
    return nodes(tree) * np.prod([density(branch) for branch in tree[1]])


def has_matrix(tree):
    return tree[0] == "J" or any(has_matrix(branch) for branch in tree[1])


def stages(tree, A, B):
    """Return the contribution of a branch to each stage, before its own sum over stages."""
    grown = [(A if branch[0] == "f" else B) @ stages(branch, A, B) for branch in tree[1]]
    return np.prod([np.ones(len(A)), *grown], axis=0)


def residuals(weights, order):
    """Return the residual of every condition up to an order."""
    combine, _, _, gamma = tableau()
    size = len(combine) - 1
    A, B = np.moveaxis(combine[:-1, :size], 2, 0)
    B = B + gamma * np.diag([0, *[1] * (size - 1)])
    return [
        weights @ stages(tree, A, B) - (0 if has_matrix(tree) else 1 / density(tree))
        for nodes_of in range(1, order + 1)
        for tree in trees(nodes_of)
        if tree[0] == "f"  # the result of the step is a sum of slopes
    ]


def test_there_are_as_many_trees_as_there_are():
    found = [[tree for tree in trees(order) if tree[0] == "f"] for order in range(1, 6)]
    # The number of rooted trees is known. By hand, those with a J are: none, none, f(J(f)), and
    # then f(f, J(f)), f(f(J(f))), f(J(f(f))) and f(J(J(f))).
    assert [sum(not has_matrix(tree) for tree in each) for each in found] == [1, 1, 2, 4, 9]
    assert [sum(has_matrix(tree) for tree in each) for each in found[:4]] == [0, 0, 1, 4]


def test_the_conditions_hold_for_any_matrix():
    combine, _, error, _ = tableau()
    weights = combine[-1, : len(error) - 1, 0]
    # The coefficients are quotients of integers with thirteen digits.
    assert_allclose(residuals(weights, 5), 0, atol=1e-11)
    embedded = weights - error[:-1]
    assert_allclose(residuals(embedded, 4), 0, atol=1e-11)
    assert np.abs(residuals(weights, 6)).max() > 1e-5
    assert np.abs(residuals(embedded, 5)).max() > 1e-5


TIMES = np.linspace(0.0, 1.0, 41)


def pushed(stiffness, steps, solver=None):
    """Simulate an arm in a cross-wind for one second, from rest, with steps of fixed length."""
    arm = replace(takeichi_20m(6), {"joints.yaw_stiffness": stiffness, "joints.damping": 0.3})
    inputs = Inputs(
        arm, constant([0.6, 0.0, 0.3, 0.0, 0.0, 0.0]), constant([0.1, 0.5, 0.2]), None, jnp.ones(())
    )
    return diffrax.diffeqsolve(
        diffrax.ODETerm(motion),
        LinearlyImplicit(springs, pull) if solver is None else solver,
        t0=TIMES[0],
        t1=TIMES[-1],
        dt0=jnp.asarray(1 / steps),
        y0=jnp.zeros((2, 6)),
        args=inputs,
        saveat=diffrax.SaveAt(ts=TIMES),
        max_steps=None,
    ).ys


def test_a_step_is_the_same_whichever_way_it_can_be_differentiated():
    forward = pushed(30.0, 64, LinearlyImplicit(springs, pull, reverse=False))
    assert_allclose(forward, pushed(30.0, 64), atol=1e-12)


def observed_orders(stiffness, steps):
    """Return the observed orders of angles and rates at 41 times, from coarse to fine steps."""
    exact = pushed(stiffness, 4096)
    errors = np.stack(
        [np.abs(pushed(stiffness, count) - exact).max(axis=(0, 2)) for count in steps]
    )
    return np.diff(np.log(errors), axis=0).T / -np.diff(np.log(steps))


@pytest.mark.slow
def test_the_order_is_five_where_nothing_is_stiff():
    angles, rates = observed_orders(3.0, [16, 32, 64, 128])
    assert_allclose(angles, 5, atol=0.35)
    assert rates.mean() > 4.7


@pytest.mark.slow
def test_the_order_is_five_on_a_stiff_arm_once_steps_are_short():
    angles, rates = observed_orders(300.0, [128, 256, 512])
    assert np.all(angles > 4.4)
    assert rates.mean() > 4.4


def test_a_stiff_arm_is_stable_with_steps_that_an_explicit_method_cannot_take():
    exact = pushed(3000.0, 4096)
    assert np.abs(pushed(3000.0, 8) - exact)[:, 0].max() < 1e-3
    explicit = pushed(3000.0, 64, diffrax.Tsit5())
    assert not np.abs(explicit - exact)[:, 0].max() < 1


def test_what_pulls_is_the_command_and_the_drive():
    """The change of the torque between two times in the same state, compared with the motion."""
    command = ramps([0.0, 1.0], [np.zeros(4), [0.0, 0.4, 0.1, 0.0]])
    drive = ramps([0.0, 1.0], [np.zeros(4), [0.3, 0.0, 0.0, 0.2]])
    inputs = Inputs(takeichi_20m(4), command, None, drive, jnp.ones(()))
    state = jnp.asarray(np.random.default_rng(0).normal(size=(2, 4)))
    late, early = jnp.asarray(0.7), jnp.asarray(0.2)

    @eqx.filter_jit
    def both(time):
        mass = springs(time, state, inputs)[0]
        return mass @ motion(time, state, inputs)[1], pull(time, state, inputs)

    (moved, pulled), (before, held) = both(late), both(early)
    assert_allclose(pulled - held, moved - before, atol=1e-10)


@pytest.mark.slow
def test_the_springs_are_those_of_the_motion():
    """At rest in still air, the Jacobian of the accelerations contains only springs and dampers."""
    arm = replace(takeichi_20m(4), {"joints.damping": 0.3})
    inputs = Inputs(arm, constant(np.zeros(4)), None, None, jnp.ones(()))
    rest = jnp.zeros((2, 4))
    mass, stiffness, damping, memory, contact, borne = springs(0.0, rest, inputs)
    assert memory is None
    assert contact is None
    assert not borne.size
    jacobian = jax.jacfwd(lambda state: motion(0.0, state, inputs))(rest)[1]
    assert_allclose(-mass @ jacobian[:, 0], np.diag(stiffness), atol=1e-10)
    assert_allclose(-mass @ jacobian[:, 1], np.diag(damping), atol=1e-10)
    assert_allclose(stiffness, arm.joints.stiffness)
    assert_allclose(damping, 0.3)


@pytest.mark.slow
def test_the_strain_of_joints_is_that_of_the_motion():
    """Derivatives of torques by states and of states by rates, at a reversal and while sliding."""
    arm = replace(takeichi_20m(4), {"joints.memory.strength": 0.2, "joints.memory.delta": 0.2})
    inputs = Inputs(arm, constant(np.zeros(4)), None, None, jnp.ones(()))
    states = jnp.asarray([0.3, -0.9, 0.5, 0.0])
    rates = jnp.asarray([0.2, 0.1, -0.3, 0.4])
    state = jnp.stack([jnp.zeros(4), rates, states])
    found = springs(0.0, state, inputs)
    mass, strain = found.mass, found.memory
    jacobian = jax.jacfwd(lambda state: motion(0.0, state, inputs))(state)
    assert_allclose(-mass @ jacobian[1][:, 2], np.diag(strain.torque[0]), atol=1e-10)
    assert_allclose(jacobian[2][:, 1], np.diag(strain.filling[0]), atol=1e-10)
    assert_allclose(jacobian[2][:, 2], -np.diag(strain.forgetting[0]), atol=1e-10)


ARM, COMMAND = driven_arm(4)
RUN = np.linspace(0.0, 4.0, 21)
NAMES = ["air.drag_coefficient", "joints.pitch_stiffness", "joints.yaw_stiffness", "links.mass"]
POINT = jnp.array([1.2, 3.0, 300.0, 0.05, 0.0, 0.0, 0.0])


def angles(vector, solver, tolerance=1e-8, derivatives="forward"):
    """Return the angles of a run for parameters and a wind, which is zero here."""
    values = dict(zip(NAMES, vector[:4], strict=True))
    return simulate(
        replace(ARM, values),
        COMMAND,
        RUN,
        wind=vector[4:],
        solver=solver,
        rtol=tolerance,
        atol=tolerance,
        derivatives=derivatives,
        steps_for="derivatives",
        throw=False,
    ).angles


@eqx.filter_jit
def jacobian(solver, tolerance):
    return jax.jacfwd(lambda x: angles(x, solver, tolerance))(POINT)


@pytest.mark.slow
def test_derivatives_are_those_of_an_explicit_method():
    """Another test compares these with central differences."""
    expected, tight, loose = (
        np.asarray(jacobian(solver, jnp.asarray(tolerance)))
        for solver, tolerance in (("dopri8", 1e-11), ("springs5", 1e-10), ("springs5", 1e-6))
    )
    scale = np.abs(expected).max(axis=(0, 1))
    assert np.all(scale > 1e-5)
    assert_allclose(tight / scale, expected / scale, rtol=0, atol=2e-5)
    # The error is largest for the stiffness of the fast joints, which changes their frequency.
    assert_allclose(loose / scale, expected / scale, rtol=0, atol=2e-2)


@pytest.mark.long
def test_reverse_mode_is_forward_mode():
    # The largest program of all tests needs a compiler process that holds few others.
    jax.clear_caches()
    seen = jnp.asarray(np.random.default_rng(0).normal(size=(21, 4)))

    @jax.jit
    def gradient(vector):
        return jax.grad(lambda x: jnp.vdot(seen, angles(x, "springs5", 1e-9, "reverse")))(vector)

    expected = jnp.tensordot(seen, jacobian("springs5", jnp.asarray(1e-9)), 2)
    assert_allclose(gradient(POINT), expected, rtol=1e-5)


@pytest.mark.slow
def test_a_batch_is_each():
    stiffnesses = [3.0, 30.0, 3000.0]
    points = jnp.stack([POINT.at[2].set(stiffness) for stiffness in stiffnesses])
    together = jax.vmap(lambda x: angles(x, "springs5", 1e-6))(points)
    for one, point in zip(together, points, strict=True):
        # Rounding may change the steps, with an effect far below the tolerance.
        assert_allclose(one, angles(point, "springs5", 1e-6), rtol=0, atol=1e-6)


def steps_of_both(stiffness, command):
    """Return the numbers of steps of Tsit5 and springs5, whose motions agree."""
    arm = replace(takeichi_20m(4), {"joints.yaw_stiffness": stiffness})
    options = {"wind": [0.0, 0.1, 0.0], "rtol": 1e-6, "atol": 1e-6}
    explicit, implicit = (
        simulate(arm, command, RUN, solver=solver, **options) for solver in ("tsit5", "springs5")
    )
    assert_allclose(implicit.angles, explicit.angles, rtol=0, atol=1e-5)
    return int(explicit.steps.sum()), int(implicit.steps.sum())


@pytest.mark.slow
def test_steps_do_not_grow_with_the_stiffness_as_those_of_explicit_methods():
    command = joint_ramps(4, {1: 0.5}, start=0.5, duration=1.0)
    explicit, implicit = steps_of_both(3e4, command)
    assert 10 * implicit < explicit


@pytest.mark.slow
def test_a_stiff_joint_follows_its_command_in_long_steps():
    """Steps were half as long when only the spring was implicit, not the pull on it."""
    command = joint_ramps(4, {2: 0.5}, start=0.5, duration=3.0)
    assert steps_of_both(300.0, command)[1] < 700


@pytest.mark.slow
def test_a_tolerance_means_the_error_that_it_means_with_an_explicit_method():
    """When errors of rates had full weight, a tolerance of 1e-8 gave a fifth of the usual error."""
    arm, command = driven_arm()
    times = np.linspace(0.0, 25.0, 51)

    def moved(solver, tolerance):
        return simulate(arm, command, times, solver=solver, rtol=tolerance, atol=tolerance)

    exact = moved("dopri8", 1e-11).tip
    for tolerance, most in [(1e-4, 98), (1e-6, 290), (1e-8, 840)]:
        implicit, explicit = moved("springs5", tolerance), moved("tsit5", tolerance)
        error, usual = (np.abs(motion.tip - exact).max() for motion in (implicit, explicit))
        assert usual / 3 < error < 3 * usual
        assert implicit.steps.sum() < most


@pytest.mark.slow
def test_a_jump_starts_anew():
    """A slope from before the jump would corrupt the first step after it."""
    command = joint_steps(4, {1: 0.5, 2: 0.3}, time=1.234)
    options = {"rtol": 1e-9, "atol": 1e-9}
    explicit, implicit = (
        simulate(ARM, command, RUN, solver=solver, **options).angles
        for solver in ("dopri8", "springs5")
    )
    assert_allclose(implicit, explicit, rtol=0, atol=1e-7)
