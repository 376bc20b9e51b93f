"""The Preisach operator: compared with single relays, and its characteristic properties."""

import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from giajax import InputError
from giajax.mechanics.hysteresis import PrandtlIshlinskii, Preisach, history_by_steps


@eqx.filter_jit
def history(it, inputs, memory=None):
    return it.history(inputs, memory)


def operator(rows=12, **changed):
    values = {
        "slope": 0.3,
        "saturation": 0.8,
        "coercivity": 0.25,
        "coercivity_spread": 0.6,
        "bias": 0.05,
        "interaction": 0.35,
    }
    return Preisach(**{**values, **changed}, extent=1.2, rows=rows)


def path(turns, samples=40):
    """Return a history through turning points, and their positions in it."""
    pieces = [np.linspace(a, b, samples) for a, b in itertools.pairwise(turns)]
    return jnp.asarray(np.concatenate([[turns[0]], *(piece[1:] for piece in pieces)]))


def relays(it, inputs, fine=200):
    """Switch each relay of the same density by its two thresholds, in NumPy."""
    weights = np.repeat(np.asarray(it.cells()), fine, axis=1) / fine
    r = np.asarray(it.half_widths)[:, None]
    fractions = (np.arange(weights.shape[1]) + 0.5) / weights.shape[1]
    s = (it.extent - r) * (2 * fractions[None] - 1)
    up = s < 0
    outputs = []
    for u in np.asarray(inputs):
        up = np.where(u >= s + r, True, np.where(u <= s - r, False, up))
        total = np.sum(np.where(up, weights, -weights))
        outputs.append(float(it.slope) * u + float(it.saturation) * total)
    return np.asarray(outputs)


def test_it_is_its_relays():
    it = operator()
    # An input exactly at the threshold of relays would switch them or not, depending on rounding.
    inputs = path([0, 0.9, -0.7, 0.5, -0.2, 0.35, -1.1, 1.15, 0.0], 25) + 1.7e-5
    expected = relays(it, inputs)
    # A play cuts at most one fine relay per row, which is 1/4800.
    np.testing.assert_allclose(history(it, inputs)[0], expected, atol=2e-4)
    assert np.ptp(expected) > 1


def test_steps_are_the_history():
    it, inputs = operator(), path([0, 0.8, -0.5, 0.3], 10)
    outputs, end = history(it, inputs)
    stepped, last = history_by_steps(it, inputs, None)
    np.testing.assert_allclose(stepped, outputs, atol=1e-15)
    np.testing.assert_allclose(last, end, atol=1e-15)


def test_the_weights_are_a_density():
    it = operator()
    assert float(jnp.sum(it.cells())) == pytest.approx(1.0)
    saturated, _ = history(it, jnp.asarray([0.0, 1.3, -1.3]))
    np.testing.assert_allclose(
        saturated, [saturated[0], 0.3 * 1.3 + 0.8, -0.3 * 1.3 - 0.8], atol=1e-14
    )


@pytest.mark.slow
def test_a_larger_extreme_wipes_out_what_was_before():
    it = operator()
    _, quiet = history(it, path([0, -0.9, 0.8]))
    _, busy = history(it, path([0, -0.9, 0.3, -0.4, 0.2, -0.1, 0.6, -0.7, 0.8]))
    np.testing.assert_array_equal(quiet, busy)
    # Without the larger extreme at the end, it is remembered.
    _, kept = history(it, path([0, -0.9, 0.3, -0.4, 0.2]))
    _, other = history(it, path([0, -0.9, 0.2]))
    assert float(jnp.max(jnp.abs(kept - other))) > 0.01


def test_minor_loops_return_to_where_they_began():
    """Return-point memory for nested loops."""
    it = operator()
    turns = [0, 1.0, -0.6, 0.7, -0.3, 0.5, -0.1, 0.3, -0.1, 0.5, -0.3, 0.7, -0.6, 1.0]
    outputs = np.asarray(history(it, path(turns, 30))[0])[::29]
    for inner in range(1, 7):
        assert outputs[inner] == pytest.approx(outputs[-inner], abs=1e-14)
    # Every level gives another output, so the equalities are not trivial.
    assert len(set(np.round(outputs[:8], 6))) == 8


def loop_between(it, before):
    inputs = path([0, *before, 0.1, 0.5, 0.1, 0.5, 0.1], 30)
    outputs = np.asarray(history(it, inputs)[0])
    return outputs[-58:]


def test_loops_between_the_same_inputs_are_congruent():
    it = operator()
    above = loop_between(it, [1.1])
    below = loop_between(it, [-1.1])
    np.testing.assert_allclose(above - above[0], below - below[0], atol=1e-14)
    assert above[0] - below[0] > 0.05
    # A non-linear curve after the operator violates congruency.
    assert np.max(np.abs((above**2 - above[0] ** 2) - (below**2 - below[0] ** 2))) > 1e-3


def test_a_density_without_centre_is_a_prandtl_ishlinskii_operator():
    """Relays with a constant density along s form plays."""
    it = operator(rows=20, bias=0.0, interaction=1e6, saturation=1.0)
    weights = np.asarray(it.cells())
    r = np.asarray(it.half_widths)
    per_length = weights[:, 0] / ((it.extent - r) / it.rows)
    plays = PrandtlIshlinskii(elastic=0.3, weights=2 * per_length, thresholds=r)
    inputs = path([0, 0.9, -0.7, 0.5, -0.2, 0.35])
    np.testing.assert_allclose(history(it, inputs)[0], history(plays, inputs)[0], atol=1e-13)


@pytest.mark.slow
def test_the_mesh_converges():
    inputs = path([0, 0.9, -0.7, 0.5, -0.2, 0.35])
    coarse, fine, finest = (np.asarray(history(operator(n), inputs)[0]) for n in (20, 40, 160))
    error = np.max(np.abs(coarse - finest)), np.max(np.abs(fine - finest))
    assert error[1] < 0.5 * error[0]
    assert error[1] < 5e-3


def test_derivatives_against_differences():
    it, inputs = operator(), path([0, 0.9, -0.7, 0.5, -0.2, 0.35], 12)
    leaves, tree = jax.tree.flatten(it)

    @jax.jit
    def value(leaves):
        return jnp.sum(jnp.sin(2 * history(jax.tree.unflatten(tree, leaves), inputs)[0]))

    gradient = jax.jit(jax.grad(value))(leaves)
    forward = jax.jacfwd(value)(leaves)
    for k, slope in enumerate(gradient):
        ahead, behind = (
            value([*leaves[:k], leaves[k] + sign * 1e-6, *leaves[k + 1 :]]) for sign in (1, -1)
        )
        assert float(slope) == pytest.approx(float(forward[k]), abs=1e-10)
        assert float(slope) == pytest.approx(float(ahead - behind) / 2e-6, abs=1e-6)
        assert abs(float(slope)) > 1e-4


def test_the_output_is_continuous_in_the_input():
    """The exact memory is not a staircase: a small change of the input has a small effect."""
    it = operator()
    fine = jnp.linspace(0.0, 1.1, 20_001)
    assert float(jnp.max(jnp.abs(jnp.diff(history(it, fine)[0])))) < 4 * 1.1 / 20_000


@pytest.mark.parametrize(("extent", "rows"), [(0.0, 10), (-1.0, 10), (1.0, 1)])
def test_bad_meshes_are_refused(extent, rows):
    with pytest.raises(InputError, match="give"):
        Preisach(extent=extent, rows=rows)
