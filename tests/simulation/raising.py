"""A failed check in a compiled program raises, as in a library without settings.

Equinox reads only once per process what a failed check does. The other tests use NaN instead, so
`test_raising.py` runs these tests in a separate process.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import constant, joint_steps, simulate

LINKS = 3
TIMES = np.linspace(0.0, 3.0, 16)
ARM = takeichi_20m(LINKS)
STEP = joint_steps(LINKS, {1: 0.5})


def last_angle(coefficient, derivatives="forward"):
    arm = replace(ARM, {"air.drag_coefficient": coefficient})
    return simulate(arm, STEP, TIMES, derivatives=derivatives).angles[-1, 0]


def test_a_failure_inside_a_compiled_program_raises():
    found = eqx.filter_jit(last_angle)
    assert_allclose(found(jnp.asarray(1.2)), last_angle(jnp.asarray(1.2)), atol=1e-12)
    with pytest.raises(RuntimeError, match="became infinite or NaN"):
        found(jnp.asarray(jnp.nan))


def test_a_failing_simulation_raises_while_it_is_differentiated():
    @eqx.filter_jit
    def both(coefficient):
        return jax.jvp(last_angle, (coefficient,), (jnp.ones(()),))

    assert np.all(np.isfinite(both(jnp.asarray(1.2))))
    with pytest.raises(RuntimeError, match="became infinite or NaN"):
        both(jnp.asarray(jnp.nan))


@pytest.mark.parametrize("compiled", [False, True])
def test_reverse_through_a_forward_simulation_is_refused_with_a_sentence(compiled):
    gradient = jax.grad(last_angle)
    with pytest.raises(RuntimeError, match=r"call it with derivatives='reverse', or use jax\.jvp"):
        (jax.jit(gradient) if compiled else gradient)(1.2)


@pytest.mark.parametrize("part", ["command", "wind", "initial"])
def test_the_refusal_covers_every_input(part):
    def last(x):
        still = (jnp.zeros(LINKS), jnp.zeros(LINKS))
        inputs = {"command": STEP, "wind": constant(np.zeros(3)), "initial": still}
        inputs[part] = jax.tree.map(lambda leaf: leaf + x, inputs[part])
        options = {"derivatives": "forward", "steps_for": "derivatives", "throw": False}
        return simulate(ARM, times=TIMES, **inputs, **options).rates[-1, 0]

    with pytest.raises(RuntimeError, match="derivatives='reverse'"):
        jax.grad(last)(0.0)
