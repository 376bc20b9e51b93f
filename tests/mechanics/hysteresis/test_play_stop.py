"""Play and stop: the scans compared with the definition, and limiting cases."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from giajax import InputError
from giajax.mechanics.hysteresis import Play, Stop, play, stop


def definition(inputs, thresholds, state=None):
    """Compute plays sample by sample, in NumPy."""
    w = np.zeros_like(thresholds) if state is None else np.array(state)
    rows = np.empty((len(inputs), len(thresholds)))
    for k, u in enumerate(inputs):
        w = np.minimum(np.maximum(w, u - thresholds), u + thresholds)
        rows[k] = w
    return rows


def walk(samples, seed=0, size=0.05):
    """Return a random input with many reversals."""
    return np.cumsum(np.random.default_rng(seed).normal(scale=size, size=samples))


@pytest.mark.slow
def test_both_scans_are_the_definition_over_a_long_history():
    inputs, thresholds = walk(100_000), np.linspace(0.0, 4.0, 200)
    expected = definition(inputs, thresholds)
    for method in ("scan", "associative"):
        found = np.asarray(play(jnp.asarray(inputs), jnp.asarray(thresholds), method=method))
        assert np.max(np.abs(found - expected)) < 1e-14
        # Bit for bit, because the operations are the same.
        np.testing.assert_array_equal(found, expected)


def test_a_memory_is_taken_up():
    inputs, thresholds = walk(200, seed=1), np.linspace(0.0, 1.0, 7)
    whole = play(jnp.asarray(inputs), jnp.asarray(thresholds))
    for method in ("scan", "associative"):
        rest = play(jnp.asarray(inputs[90:]), jnp.asarray(thresholds), whole[89], method)
        np.testing.assert_array_equal(rest, whole[90:])


def test_play_and_stop_add_up_to_the_input():
    inputs, thresholds = jnp.asarray(walk(300, seed=2)), jnp.asarray([0.1, 0.5])
    total = play(inputs, thresholds) + stop(inputs, thresholds)
    np.testing.assert_allclose(total, np.tile(inputs[:, None], (1, 2)), atol=1e-15)
    assert float(jnp.max(jnp.abs(stop(inputs, thresholds)) - thresholds[None])) <= 1e-15


@pytest.mark.parametrize("kind", [Play, Stop])
def test_steps_are_the_history(kind):
    operator = kind(thresholds=[0.0, 0.2, 1.0])
    inputs = jnp.asarray(walk(50, seed=3))
    outputs, end = operator.history(inputs)
    state = operator.reset()
    for k, value in enumerate(inputs):
        state, output = operator.step(state, value)
        np.testing.assert_array_equal(output, outputs[k])
    np.testing.assert_array_equal(state, end)


def test_limits():
    inputs = jnp.asarray(walk(100, seed=4))
    wide = float(jnp.max(jnp.abs(inputs)))
    ends = play(inputs, jnp.asarray([0.0, 2 * wide]))
    np.testing.assert_array_equal(ends[:, 0], inputs)
    np.testing.assert_array_equal(ends[:, 1], jnp.zeros(100))


def test_it_does_not_depend_on_the_speed_of_the_input():
    turns = np.asarray([0.0, 1.0, -0.6, 0.4, -0.2, 0.9])
    thresholds = jnp.linspace(0.0, 1.2, 9)
    fine = np.interp(np.linspace(0, 5, 501), np.arange(6), turns)
    slow = play(jnp.asarray(fine), thresholds)[::100]
    np.testing.assert_allclose(slow, play(jnp.asarray(turns), thresholds), atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["scan", "associative"])
def test_derivatives_against_differences(method):
    inputs, thresholds = jnp.asarray(walk(60, seed=5)), jnp.asarray([0.013, 0.11, 0.37])
    probe = jnp.asarray(np.random.default_rng(6).normal(size=(60, 3)))

    @jax.jit
    def value(inputs, thresholds):
        return jnp.sum(probe * play(inputs, thresholds, method=method))

    by_inputs, by_thresholds = jax.jit(jax.grad(value, argnums=(0, 1)))(inputs, thresholds)
    forward = jax.jacfwd(value, argnums=(0, 1))(inputs, thresholds)
    np.testing.assert_allclose(by_inputs, forward[0], atol=1e-12)
    np.testing.assert_allclose(by_thresholds, forward[1], atol=1e-12)
    step = 1e-6
    for k in (0, 7, 40):
        shift = step * jnp.eye(60)[k]
        slope = (value(inputs + shift, thresholds) - value(inputs - shift, thresholds)) / step / 2
        assert float(by_inputs[k]) == pytest.approx(float(slope), abs=1e-7)
    for k in range(3):
        shift = step * jnp.eye(3)[k]
        slope = (value(inputs, thresholds + shift) - value(inputs, thresholds - shift)) / step / 2
        assert float(by_thresholds[k]) == pytest.approx(float(slope), abs=1e-7)


def test_a_rest_does_not_lose_the_derivative():
    # After u stops, w stays at u - r, so the slopes with respect to u and r remain.
    inputs, thresholds = jnp.asarray([0.0, 1.0, 1.0, 1.0]), jnp.asarray([0.3])
    for method in ("scan", "associative"):
        slope = jax.jit(jax.jacfwd(lambda r, m=method: play(inputs, r, method=m)[-1, 0]))(
            thresholds
        )
        np.testing.assert_allclose(slope, [-1.0])
        by_level = jax.grad(lambda c, m=method: play(c * inputs, thresholds, method=m)[-1, 0])
        assert float(jax.jit(by_level)(jnp.asarray(1.0))) == pytest.approx(1.0)


def test_batches():
    inputs = jnp.stack([jnp.asarray(walk(40, seed=s)) for s in range(3)])
    thresholds = jnp.asarray([0.1, 0.2])
    together = jax.vmap(lambda u: play(u, thresholds))(inputs)
    for row, u in zip(together, inputs, strict=True):
        np.testing.assert_array_equal(row, play(u, thresholds))


@pytest.mark.parametrize(
    ("thresholds", "words"),
    [([-0.1], "at least 0"), ([np.nan], "finite"), (0.3, "list"), ([], "list")],
)
def test_bad_thresholds_are_refused(thresholds, words):
    for kind in (Play, Stop):
        with pytest.raises(InputError, match=words):
            kind(thresholds=thresholds)


def test_an_unknown_method_is_refused():
    with pytest.raises(InputError, match="associative"):
        play(jnp.zeros(3), jnp.ones(1), method="parallel")
