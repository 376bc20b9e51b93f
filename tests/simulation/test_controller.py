"""Step-size control for problems of known difficulty."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigh

from giajax.mechanics.arm import mass_matrix, pendulum
from giajax.schema.parameters import replace
from giajax.simulation import constant, fastest_rate, simulate, step_size_controller
from peers.arms import general_arm, random_states


def test_a_step_into_nowhere_is_tried_smaller():
    """y' = -4 y is undefined below 0 here, and a first step of 1.9 s leads there."""

    def decay(time, y, args):
        return jnp.where(y < 0, jnp.nan, -4 * y)

    tolerance = jnp.asarray(1e-8)
    controller = step_size_controller(
        diffrax.Tsit5(), tolerance, tolerance, corners=jnp.zeros(1), bends=jnp.full(1, jnp.inf)
    )
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(decay),
        diffrax.Tsit5(),
        t0=0.0,
        t1=1.9,
        dt0=1.9,
        y0=jnp.ones(()),
        stepsize_controller=controller,
        max_steps=1000,
        throw=False,
    )
    assert bool(solution.result == diffrax.RESULTS.successful)
    assert solution.stats["num_rejected_steps"] > 0
    assert_allclose(solution.ys[-1], np.exp(-4 * 1.9), atol=1e-7)


@pytest.mark.parametrize("damping", [0.0, 0.04, 5.0])
def test_the_fastest_rate_is_that_of_the_springs_and_dampers(damping):
    arm = replace(general_arm(6), {"joints.damping": damping, "gravity": 0.0})
    angles = random_states(6, 1)["angles"][0]
    matrix = np.asarray(jax.jit(mass_matrix)(arm, angles))
    springs = np.diag(arm.joints.stiffness)
    oscillation = np.sqrt(eigh(springs, matrix, eigvals_only=True)[-1])
    decay = eigh(damping * np.eye(6), matrix, eigvals_only=True)[-1]
    found = jax.jit(fastest_rate)(arm, angles)
    assert_allclose(found, np.hypot(oscillation, decay), rtol=1e-10)
    # An upper bound of every pole of the linearised arm, except for the coupling of a few per cent.
    poles = np.linalg.eigvals(
        np.block(
            [
                [np.zeros((6, 6)), np.eye(6)],
                [-np.linalg.solve(matrix, springs), -damping * np.linalg.inv(matrix)],
            ]
        )
    )
    assert found > 0.95 * np.abs(poles).max()


@pytest.mark.slow
@pytest.mark.parametrize("solver", ["tsit5", "springs5"])
def test_the_derivatives_of_what_hangs_at_rest_do_not_diverge(solver):
    """A pendulum at rest has no error, but its derivative by the initial angle is cos(w t)."""
    arm = pendulum(1)
    times = np.linspace(0.0, 20.0, 41)
    links = arm.links
    inertia = links.inertia_transverse[0] + links.mass[0] * links.centre_of_mass[0] ** 2
    frequency = np.sqrt(arm.gravity * links.mass[0] * links.centre_of_mass[0] / inertia)

    def angles(first):
        return simulate(
            arm,
            constant([0.0]),
            times,
            initial=(first, jnp.zeros(1)),
            solver=solver,
            rtol=1e-9,
            atol=1e-9,
            steps_for="derivatives",
        ).angles[:, 0]

    slope = jax.jvp(angles, (jnp.zeros(1),), (jnp.ones(1),))[1]
    assert_allclose(slope, np.cos(frequency * times), atol=5e-3)
