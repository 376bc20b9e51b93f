"""Motions with closed-form solutions, each derived next to its test."""

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigh
from scipy.special import ellipj

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import SOLVERS, constant, joint_ramps, joint_steps, simulate

TIGHT = {"rtol": 1e-9, "atol": 1e-9}
TIMES = np.linspace(0.0, 10.0, 101)


def one_link(*, stiffness=0.0, damping=0.0, drag=0.0, **options):
    """A rod of 2 m and 0.5 kg on a pitch joint; inertia about the joint I = 0.5 2^2 / 3."""
    rod = {"length": 2.0, "mass": 0.5, "diameter": 0.3, "inertia_transverse": 0.5 * 2.0**2 / 12}
    return replace(
        takeichi_20m(1, joint_axes=["pitch"], **rod, **options),
        {
            "joints.pitch_stiffness": stiffness,
            "joints.damping": damping,
            "air.drag_coefficient": drag,
        },
    )


INERTIA = 0.5 * 2.0**2 / 3
STILL = constant([0.0])


@pytest.mark.parametrize("amplitude", [1e-4, 1.0, 3.0])
def test_a_pendulum_of_any_amplitude(amplitude):
    """Hanging from its joint: I q'' = -m g c sin q, so sin(q/2) = k cd(w t, k), k = sin(a/2)."""
    arm = one_link(gravity=9.81, base_rotation=[0.0, np.pi / 2, 0.0])
    motion = simulate(arm, STILL, TIMES, initial=([amplitude], [0.0]), **TIGHT)
    modulus = np.sin(amplitude / 2)
    frequency = np.sqrt(0.5 * 9.81 * 1.0 / INERTIA)
    _, cn, dn, _ = ellipj(frequency * TIMES, modulus**2)
    expected = 2 * np.arcsin(modulus * cn / dn)
    assert_allclose(motion.angles[:, 0], expected, rtol=0, atol=1e-6 * amplitude + 1e-8)
    # The tip is 2 m below the joint when it passes the lowest point.
    lowest = np.argmin(np.abs(motion.angles[:, 0]))
    assert motion.tip[lowest, 2] < -2 * np.cos(amplitude / 4)


def oscillation(stiffness, damping, times):
    """Return the response of I q'' + c q' + k q = k to a step from rest."""
    decay = damping / (2 * INERTIA)
    frequency = np.sqrt(stiffness / INERTIA - decay**2)
    ring = np.cos(frequency * times) + decay / frequency * np.sin(frequency * times)
    return np.where(times < 0, 0.0, 1 - np.exp(-decay * times) * ring)


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_spring_and_a_damper_after_a_step_with_every_solver(solver):
    arm = one_link(stiffness=3.0, damping=0.2)
    command = joint_steps(1, {1: 0.5}, time=0.73)
    tolerance = {"heun": 1e-5, "bosh3": 1e-7}.get(solver, 1e-8)
    motion = simulate(arm, command, TIMES, solver=solver, rtol=tolerance, atol=tolerance)
    expected = 0.5 * oscillation(3.0, 0.2, TIMES - 0.73)
    assert_allclose(motion.angles[:, 0], expected, rtol=0, atol=100 * tolerance)


def test_a_spring_after_a_ramp():
    """Undamped, with a command of constant speed s: q = s (t - sin(w t) / w)."""
    arm = one_link(stiffness=3.0)
    command = joint_ramps(1, {1: 0.4}, start=0.73, duration=2.0)
    motion = simulate(arm, command, TIMES, **TIGHT)
    frequency = np.sqrt(3.0 / INERTIA)

    def pulled(time):
        time = np.maximum(time, 0)
        return 0.2 * (time - np.sin(frequency * time) / frequency)

    expected = pulled(TIMES - 0.73) - pulled(TIMES - 2.73)
    assert_allclose(motion.angles[:, 0], expected, rtol=0, atol=1e-7)


def test_a_rigid_link_slowed_down_by_the_air():
    """I w' = -b w |w|, b = rho C_D L d (L/2)^3 / 2: w = w0 / (1 + b w0 t / I)."""
    arm = one_link(drag=1.3)
    motion = simulate(arm, STILL, TIMES, initial=([0.0], [2.0]), **TIGHT)
    drag = 0.5 * 1.204 * 1.3 * 2.0 * 0.3 * 1.0**3
    slowing = 1 + drag * 2.0 * TIMES / INERTIA
    assert_allclose(motion.rates[:, 0], 2.0 / slowing, rtol=1e-6)
    assert_allclose(motion.angles[:, 0], INERTIA / drag * np.log(slowing), rtol=1e-6, atol=1e-9)


def test_a_link_points_down_the_wind():
    """Small angles q in a wind U along the arm: I q'' = -K U (L/2) (U q + (L/2) q')."""
    arm = one_link(drag=1.3)
    wind, small = 1.5, 1e-5
    options = {"rtol": 1e-10, "atol": 1e-14}
    motion = simulate(arm, STILL, TIMES, wind=[wind, 0.0, 0.0], initial=([small], [0.0]), **options)
    force = 0.5 * 1.204 * 1.3 * 2.0 * 0.3
    decay = force * wind / (2 * INERTIA)
    frequency = np.sqrt(force * wind**2 / INERTIA - decay**2)
    ring = np.cos(frequency * TIMES) + decay / frequency * np.sin(frequency * TIMES)
    expected = small * np.exp(-decay * TIMES) * ring
    assert_allclose(motion.angles[:, 0], expected, rtol=0, atol=1e-6 * small)


def test_two_rods_swing_in_their_modes():
    """Small planar swings of a double rod: M q'' = -K q with M by hand, relative angles.

    M11 = I1 + m1 c1^2 + I2 + m2 (L1 + c2)^2, M12 = I2 + m2 c2 (L1 + c2), M22 = I2 + m2 c2^2.
    """
    m, c, inertia, length = (0.2, 0.3), (0.4, 0.8), (0.02, 0.05), (1.2, 1.5)
    arm = takeichi_20m(
        2,
        length=length,
        mass=m,
        centre_of_mass=c,
        inertia_transverse=inertia,
        joint_axes=["pitch", "pitch"],
    )
    arm = replace(arm, {"air.drag_coefficient": 0.0, "joints.damping": 0.0})
    reach = length[0] + c[1]
    coupling = inertia[1] + m[1] * c[1] * reach
    outer = inertia[1] + m[1] * c[1] ** 2
    inner = inertia[0] + m[0] * c[0] ** 2 + inertia[1] + m[1] * reach**2
    squares, modes = eigh(3.0 * np.eye(2), [[inner, coupling], [coupling, outer]])
    start = 1e-5 * np.array([1.0, -0.7])
    weights = np.linalg.solve(modes, start)
    expected = (weights * np.cos(np.sqrt(squares) * TIMES[:, None])) @ modes.T
    motion = simulate(
        arm,
        constant(np.zeros(2)),
        TIMES,
        initial=(start, jnp.zeros(2)),
        rtol=1e-10,
        atol=1e-14,
    )
    assert_allclose(motion.angles, expected, rtol=0, atol=1e-10)
