"""Reversals of joints, compared with a closed form; and steps that are repeated up to there."""

import jax.numpy as jnp
import pytest
from numpy.testing import assert_allclose

from giajax.simulation import angle_after, first_turn, solver, step_size_controller, turns

STEP = 0.4


def state(time):
    """Angles and rates of joints that reverse at 0.25 s, never, and at the end of the step."""
    angles = jnp.asarray([(time - 0.25) ** 3 - (time - 0.25) ** 2, time, (time - 0.39) ** 2])
    rates = jnp.asarray([3 * (time - 0.25) ** 2 - 2 * (time - 0.25), 1.0, 2 * (time - 0.39)])
    return jnp.stack([angles, rates])


def test_a_cubic_motion_turns_where_it_does():
    part, again = turns(STEP, state(0.0), state(STEP))
    assert again.tolist() == [1, 1, 1]
    assert_allclose(part, [0.25 / STEP, 1.0, 0.39 / STEP], rtol=1e-12)
    assert_allclose(angle_after(part, STEP, state(0.0), state(STEP))[0], 0.0, atol=1e-15)
    # A reversal at the end stays in the step.
    assert first_turn(STEP, state(0.0), state(STEP), 1e-8) == pytest.approx(0.25 / STEP)
    # A reversal does not count if nothing moves.
    assert first_turn(STEP, state(0.0), state(STEP), 10.0) == 1


@pytest.mark.parametrize("remembers", [True, False])
def test_a_good_step_is_done_again_up_to_a_turn(remembers):
    unlimited = jnp.full(1, jnp.inf)
    controller = step_size_controller(
        solver("tsit5"), 1e-6, 1e-6, unlimited, unlimited, turns=remembers
    ).controller
    y0, y1 = state(0.0), state(STEP)
    # This error is small, so a controller without reversals accepts the step.
    first = (jnp.ones(()), jnp.ones(()), jnp.asarray(False))
    keep, start, end, *_ = controller.adapt_step_size(
        jnp.asarray(0.0), jnp.asarray(STEP), y0, y1, None, 1e-9 * jnp.ones_like(y0), 5.0, first
    )
    assert bool(keep) is not remembers
    if remembers:
        assert float(start) == 0
        assert 0.25 < float(end) < 0.27
