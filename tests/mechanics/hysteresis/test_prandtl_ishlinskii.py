"""Prandtl-Ishlinskii operators, plain and modified: limits, and inverses for rough histories."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_play_stop import definition

from giajax import InputError
from giajax.mechanics.hysteresis import (
    DeadZones,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    history_by_steps,
)


@eqx.filter_jit
def history(it, inputs, memory=None):
    return it.history(inputs, memory)


def operator(elements="play", seed=0, count=12):
    random = np.random.default_rng(seed)
    return PrandtlIshlinskii(
        elastic=0.4,
        weights=random.uniform(0.02, 0.4, count),
        thresholds=np.sort(random.uniform(0.0, 1.0, count)),
        elements=elements,
    )


def curve():
    # Soft about 0, stiffer beyond, and asymmetric.
    return DeadZones(1.4, [0.05, 0.3, 0.9], [0.3, 0.15, 0.4], [0.08, 0.5], [0.5, 0.1])


def modified(seed=0):
    it = operator(seed=seed)
    return ModifiedPrandtlIshlinskii(curve(), it.weights, it.thresholds)


def stops(seed=0):
    return operator("stop", seed)


def plays(seed=0):
    return operator("play", seed)


def rough(samples=2000, seed=1):
    """Return a history with nested loops, up to about 1.5."""
    random = np.random.default_rng(seed)
    turns = random.uniform(-1.5, 1.5, 60) * random.uniform(0.1, 1.0, 60)
    turns[0] = 0.0
    return jnp.asarray(np.interp(np.linspace(0, 59, samples), np.arange(60), turns))


@pytest.mark.parametrize("elements", ["play", "stop"])
def test_it_is_the_weighted_sum(elements):
    inputs, it = rough(), operator(elements)
    plays = definition(np.asarray(inputs), np.asarray(it.thresholds))
    parts = plays if elements == "play" else np.asarray(inputs)[:, None] - plays
    expected = 0.4 * np.asarray(inputs) + parts @ np.asarray(it.weights)
    np.testing.assert_allclose(history(it, inputs)[0], expected, atol=1e-13)


def test_steps_are_the_history():
    inputs = rough(200)
    for it in (operator(), operator("stop"), modified().inverse()):
        outputs, end = history(it, inputs)
        stepped, last = history_by_steps(it, inputs, None)
        np.testing.assert_allclose(stepped, outputs, atol=1e-14)
        np.testing.assert_allclose(last, end, atol=1e-14)


@pytest.mark.parametrize("elements", ["play", "stop"])
def test_the_virgin_curve_is_the_loading_curve(elements):
    up = jnp.linspace(0.0, 2.0, 101)
    it = operator(elements)
    np.testing.assert_allclose(history(it, up)[0], it.loading(up), atol=1e-13)


@pytest.mark.parametrize("make", [plays, stops, modified])
@pytest.mark.parametrize("seed", range(5))
def test_the_inverse_undoes_it(make, seed):
    it = make(seed)
    wanted = rough(seed=seed + 10)
    command = history(it.inverse(), wanted)[0]
    span = float(jnp.ptp(wanted))
    assert float(jnp.max(jnp.abs(history(it, command)[0] - wanted))) < 1e-10 * span
    # The inverse must have an effect: without it, the error of the output is large.
    assert float(jnp.max(jnp.abs(history(it, wanted)[0] - wanted))) > 0.05 * span


@pytest.mark.parametrize("make", [plays, stops, modified])
def test_the_inverse_takes_up_a_memory(make):
    it = make()
    first, wanted = rough(300, seed=3), rough(300, seed=4)
    _, memory = history(it, first)
    inverse = it.inverse()
    command, _ = history(inverse, wanted, it.inverse_state(memory))
    found, _ = history(it, command, memory)
    assert float(jnp.max(jnp.abs(found - wanted))) < 1e-10 * float(jnp.ptp(wanted))


def test_the_inverse_of_the_inverse():
    it = operator(seed=7)
    again = it.inverse().inverse()
    np.testing.assert_allclose(again.weights, it.weights, atol=1e-12)
    np.testing.assert_allclose(again.thresholds, it.thresholds, atol=1e-12)
    x = jnp.linspace(-3.0, 3.0, 401)
    np.testing.assert_allclose(curve().inverse()(curve()(x)), x, atol=1e-14)
    np.testing.assert_allclose(curve()(curve().inverse()(x)), x, atol=1e-14)


def test_unsorted_thresholds_are_the_same_operator():
    it, inputs = operator(seed=8), rough(seed=5)
    order = np.random.default_rng(0).permutation(12)
    shuffled = PrandtlIshlinskii(it.elastic, it.weights[order], it.thresholds[order])
    np.testing.assert_allclose(history(shuffled, inputs)[0], history(it, inputs)[0], atol=1e-13)
    np.testing.assert_allclose(
        history(shuffled.inverse(), inputs)[0], history(it.inverse(), inputs)[0], atol=1e-12
    )


def test_only_the_modified_form_has_a_place_of_its_own():
    """A large shift of the input shifts the loops of the plain operator, but not of the other."""
    base = np.concatenate([np.linspace(0, 3, 100), np.tile([3.2, 2.8], 20)])
    far = jnp.asarray(np.concatenate([base, np.linspace(2.8, 0.2, 50), np.tile([0.2, -0.2], 20)]))
    for it, same in ((operator(), True), (modified(), False)):
        outputs = np.asarray(history(it, far)[0])
        away, near = np.ptp(outputs[110:140]), np.ptp(outputs[-20:])
        assert (abs(away - near) < 1e-12) == same


def test_the_curve_by_its_definition():
    it = curve()
    x = np.linspace(-2.0, 2.0, 81)
    nodes = np.asarray([-2.0, -0.5, -0.08, 0.0, 0.05, 0.3, 0.9, 2.0])
    slopes = np.asarray([0.1, 0.5, 1.4, 1.4, 0.3, 0.15, 0.4])
    values = np.concatenate([[0.0], np.cumsum(slopes * np.diff(nodes))])
    values -= values[3]
    np.testing.assert_allclose(it(jnp.asarray(x)), np.interp(x, nodes, values), atol=1e-14)


def test_where_the_curve_is_level_its_inverse_jumps():
    """A fit may leave a slope at its bound of zero."""
    level = eqx.tree_at(lambda it: it.upper_slopes, curve(), jnp.asarray([0.0, 0.15, 0.4]))
    x = jnp.asarray([-2.0, -0.3, 0.04, 0.06, 0.29, 0.31, 1.5])
    back = np.asarray(level.inverse()(level(x)))
    np.testing.assert_allclose(np.delete(back, [3, 4]), np.delete(x, [3, 4]), rtol=1e-5)
    assert np.all((back[3:5] >= 0.05 - 1e-6) & (back[3:5] <= 0.3 + 1e-6))


@pytest.mark.slow
@pytest.mark.parametrize("make", [plays, stops, modified])
def test_derivatives_against_differences(make):
    inputs, it = rough(120), make(seed=2)
    leaves, tree = jax.tree.flatten(it)

    @jax.jit
    def value(leaves):
        rebuilt = jax.tree.unflatten(tree, leaves)
        there = history(rebuilt, inputs)[0]
        back = history(rebuilt.inverse(), inputs)[0]
        return jnp.sum(jnp.sin(3 * there)) + jnp.sum(jnp.cos(back))

    gradient = jax.jit(jax.grad(value))(leaves)
    forward = jax.jacfwd(value)(leaves)
    for k, (leaf, slopes) in enumerate(zip(leaves, gradient, strict=True)):
        np.testing.assert_allclose(slopes, forward[k], rtol=1e-9, atol=1e-10)
        direction = jnp.ones_like(leaf)
        ahead, behind = (
            value([*leaves[:k], leaf + sign * 1e-6 * direction, *leaves[k + 1 :]])
            for sign in (1, -1)
        )
        expected = float(ahead - behind) / 2e-6
        assert float(jnp.sum(slopes)) == pytest.approx(expected, rel=2e-6, abs=1e-6)


def test_what_has_no_inverse_says_so():
    with pytest.raises(InputError, match="slope of the loading curve"):
        PrandtlIshlinskii(elastic=0.0, weights=[0.3], thresholds=[0.2]).inverse()
    with pytest.raises(InputError, match="positive"):
        DeadZones(1.0, [1.0], [-0.1], [1.0], [1.0]).inverse()


def test_bad_lists_are_refused():
    with pytest.raises(InputError, match="one weight for each threshold"):
        PrandtlIshlinskii(weights=[0.1, 0.2], thresholds=[0.1])
    with pytest.raises(InputError, match="play or stop"):
        PrandtlIshlinskii(weights=[0.1], thresholds=[0.1], elements="relay")
    with pytest.raises(InputError, match="one slope for each dead zone"):
        DeadZones(1.0, [1.0], [0.1, 0.2], [1.0], [1.0])
    with pytest.raises(InputError, match="is not positive: give positive distances"):
        DeadZones(1.0, [0.0], [0.1], [1.0], [1.0])
