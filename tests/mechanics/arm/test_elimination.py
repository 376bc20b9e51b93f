"""Accelerations of long arms, whose joints are eliminated in several pieces."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax.schema.parameters
from giajax.mechanics.arm import (
    acceleration,
    carried_inertia,
    eliminate_and_solve,
    forward_dynamics,
    inverse_dynamics,
    mass_matrix,
    motion_and_momentum,
    pose,
    solve_accelerations,
    solve_eliminated,
    sum_from_tip,
)
from peers.arms import driven_arm, full_arm, general_arm, random_states

# One, two, three and four pieces, and each kind of armature with few and with several pieces.
CASES = [
    (2, None), (2, "one"), (2, "each"), (48, None), (49, "each"), (130, "one"), (160, None),
]  # fmt: skip


@eqx.filter_jit
def factors(arm, angles):
    here = pose(arm, angles)
    return motion_and_momentum(arm, here, sum_from_tip(carried_inertia(arm, here)))


def states(links, seed=0):
    return {name: value[0] for name, value in random_states(links, 1, seed=seed).items()}


@eqx.filter_jit
def solved(arm, angles, more, torques):
    """Return the mass matrix, and solutions by the whole matrix and by pieces of it."""
    pieces, solution = eliminate_and_solve(*factors(arm, angles), more, torques[0])
    return mass_matrix(arm, angles), pieces, (solution, solve_eliminated(pieces, torques[1]))


@pytest.mark.parametrize(("links", "armature"), CASES)
def test_pieces_solve_with_the_whole_mass_matrix(links, armature):
    random = np.random.default_rng(links)
    arm, _ = driven_arm(links)
    angles = jnp.asarray(random.normal(size=links) * 0.1)
    torques = jnp.asarray(random.normal(size=(2, links)))
    more = {None: None, "one": 0.3, "each": random.uniform(0.1, 1.0, links)}[armature]
    held = None if more is None else jnp.asarray(more)
    matrix, pieces, solutions = solved(arm, angles, held, torques)
    assert len(pieces) == -(-links // 48)
    if more is not None:
        matrix = matrix + np.diag(np.broadcast_to(more, links))
    for torque, found in zip(torques, solutions, strict=True):
        # As accurate as a backward-stable solution.
        rounding = np.finfo(float).eps * np.abs(matrix).sum(axis=1).max() * np.abs(found).max()
        assert_allclose(matrix @ found, torque, rtol=0, atol=4 * rounding)


@pytest.mark.parametrize("armature", [None, "one", "each"])
@pytest.mark.parametrize(("links", "items"), [(2, 3), (2, 4), (20, 17), (60, 5)])
def test_a_batch_is_solved_as_its_items_are(links, items, armature):
    random = np.random.default_rng(items)
    arm, _ = driven_arm(links)
    state = {
        name: jnp.asarray(random.normal(size=(items, links))) * 0.1 for name in ("q", "v", "u")
    }
    shape = {None: None, "one": (items,), "each": (items, links)}[armature]
    added = None if shape is None else jnp.asarray(random.uniform(0.1, 1.0, shape))

    def one(q, v, u, own):
        changed = eqx.tree_at(
            lambda arm: arm.joints.armature, arm, own, is_leaf=lambda x: x is None
        )
        return acceleration(changed, q, v, u)

    given = (*state.values(), added)
    batch = jax.jit(jax.vmap(one))(*given)
    alone = jax.jit(lambda *given: jax.lax.map(lambda item: one(*item), given))(*given)
    assert_allclose(batch, alone, rtol=1e-9, atol=1e-9 * np.abs(alone).max())
    # As a batch of batches, and with derivatives, whose batch is solved by the factors.
    twice = jax.jit(jax.vmap(jax.vmap(one)))(*jax.tree.map(lambda x: jnp.stack([x, x]), given))
    assert_allclose(twice, jnp.stack([alone, alone]), rtol=1e-9, atol=1e-9 * np.abs(alone).max())
    way = jnp.asarray(random.normal(size=(items, links)))

    def along(step):
        return jax.vmap(one)(state["q"] + step * way, *given[1:])

    _, slope = jax.jit(lambda step: jax.jvp(along, (step,), (1.0,)))(0.0)
    below, above = jax.jit(along)(-1e-6), jax.jit(along)(1e-6)
    assert_allclose(slope, (above - below) / 2e-6, rtol=1e-6, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("make", [general_arm, full_arm])
def test_inverse_dynamics_undoes_forward_dynamics_of_a_long_arm(make):
    arm, state = make(100), states(100)
    torques = state["command"]

    @jax.jit
    def there_and_back(torques):
        options = state["angles"], state["rates"]
        return inverse_dynamics(arm, *options, forward_dynamics(arm, *options, torques))

    back = there_and_back(torques)
    assert_allclose(back, torques, atol=1e-8)


PATHS = ("air.drag_coefficient", "joints.pitch_stiffness", "air.added_mass_coefficient")
AT = np.array([1.2, 3.0, 0.8, 0.0])
BENT = np.random.default_rng(1).normal(size=100)


def accelerations(values, arm, state):
    """Return the accelerations for values of the inertial parameters and of the bending."""
    changed = giajax.schema.parameters.replace(arm, dict(zip(PATHS, values[:3], strict=True)))
    angles = state["angles"] + values[3] * BENT
    return acceleration(changed, angles, state["rates"], state["command"])


@functools.cache
def long_arm():
    """Return an arm, a state, and finite differences of its accelerations by the values."""
    about = full_arm(100), {name: 0.3 * value for name, value in states(100).items()}
    steps = np.array([1e-3, 1e-3, 1e-4, 1e-6])
    rows = np.concatenate([AT + np.diag(steps), AT - np.diag(steps)])
    found = jax.jit(accelerations)
    ahead, back = np.split(np.stack([found(row, *about) for row in rows]), 2)
    return *about, (ahead - back).T / (2 * steps)


@jax.jit
def forwards(change, arm, state):
    return jax.jvp(lambda values: accelerations(values, arm, state), (AT,), (change,))[1]


@jax.jit
def backwards(weights, arm, state):
    return jax.vjp(lambda values: accelerations(values, arm, state), AT)[1](weights)[0]


@pytest.mark.parametrize("mode", ["forwards", "backwards"])
def test_derivatives_of_a_long_arm_are_its_differences(mode):
    """The arm is eliminated in three pieces."""
    *about, differences = long_arm()
    if mode == "forwards":
        slopes = np.stack([forwards(change, *about) for change in np.eye(4)], axis=1)
    else:
        slopes = np.stack([backwards(weights, *about) for weights in np.eye(100)])
    sizes = np.abs(slopes).max(axis=0)
    assert np.all(sizes > 0)
    assert_allclose(slopes / sizes, differences / sizes, rtol=0, atol=1e-5)


def test_what_no_inertia_has_fails_in_every_joint():
    arm, _ = driven_arm(100)
    motion, momentum = factors(arm, jnp.zeros(100))
    _, solution = eliminate_and_solve(motion, -momentum, None, jnp.ones(100))
    assert np.all(np.isnan(solution))
    # In a batch, only the items fail that have no inertia; the motion is the same for all.
    signs = jnp.asarray([1.0, -1.0, 1.0, -1.0, 1.0])
    batch = jax.vmap(solve_accelerations, (None, 0, None, None))
    found = batch(motion, signs[:, None, None] * momentum[None], None, jnp.ones(100))
    assert np.array_equal(np.isnan(found), np.broadcast_to(signs[:, None] < 0, (5, 100)))


def test_in_32_bit_a_long_arm_is_less_exact_but_right():
    arm, _ = driven_arm(60)
    state = states(60)
    call = jax.jit(acceleration)
    exact = call(arm, state["angles"], state["rates"], state["command"])
    with jax.enable_x64(False):
        rough, _ = driven_arm(60)
        found = call(rough, *(np.float32(state[name]) for name in ("angles", "rates", "command")))
        given = [np.tile(np.float32(state[n]), (5, 1)) for n in ("angles", "rates", "command")]
        batch = jax.jit(jax.vmap(acceleration, (None, 0, 0, 0)))(rough, *given)
    for each in (found, *batch):
        assert each.dtype == np.float32
        off = np.linalg.norm(np.asarray(each, float) - np.asarray(exact))
        assert off < 0.02 * np.linalg.norm(exact)
