"""Energy is conserved without air and damping; with them, it decreases with their power."""

import equinox as eqx
import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import (
    damping_power,
    drag_power,
    kinetic_energy,
    potential_energy,
    takeichi_20m,
)
from giajax.schema.parameters import replace
from giajax.simulation import constant, joint_ramps, simulate
from peers.arms import full_arm, general_arm

TIGHT = {"solver": "dopri8", "rtol": 1e-11, "atol": 1e-11}


def thirty_degrees(links):
    """Return a constant command, which strains the springs initially and does no further work."""
    command = np.zeros(links)
    command[:2] = np.deg2rad([30.0, 20.0])
    return constant(command)


@eqx.filter_jit
def energies(motion):
    def at(angles, rates, command, wind):
        kinetic = kinetic_energy(motion.arm, angles, rates)
        potential = potential_energy(motion.arm, angles, command, wind)
        power = drag_power(motion.arm, angles, rates, wind) + damping_power(motion.arm, rates)
        return kinetic, potential, power

    wind = None if motion.wind is None else jax.vmap(motion.wind)(motion.times)
    in_axes = (0, 0, 0, None if wind is None else 0)
    return jax.vmap(at, in_axes)(motion.angles, motion.rates, motion.commands, wind)


def gauss_times(end, panels, order=6):
    """Return Gauss nodes and weights on equal panels, with the first and the last time added."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    edges = np.linspace(0.0, end, panels + 1)
    half = np.diff(edges)[:, None] / 2
    times = (edges[:-1, None] + half * (nodes + 1)).ravel()
    return np.concatenate([[0.0], times, [end]]), (half * weights).ravel()


def with_added_mass(arm):
    return replace(arm, {"air.added_mass_coefficient": 1.0})


def without_losses(arm):
    losses = ("air.axial_coefficient", "joints.friction", "point_masses.drag_area")
    return replace(arm, dict.fromkeys(losses, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "arm",
    [
        pytest.param(takeichi_20m(), id="the paper's arm"),
        pytest.param(general_arm(4), id="a general arm in gravity"),
        pytest.param(with_added_mass(takeichi_20m(4)), id="the short arm with added mass"),
        pytest.param(without_losses(full_arm(4)), id="every option, in a steady wind"),
    ],
)
def test_energy_is_conserved_without_air_and_damping(arm):
    ideal = replace(arm, {"air.drag_coefficient": 0.0, "joints.damping": 0.0})
    motion = simulate(ideal, thirty_degrees(arm.count), np.linspace(0, 25, 251), **TIGHT)
    kinetic, potential, _ = energies(motion)
    total = np.asarray(kinetic + potential)
    assert kinetic.max() > 0.1
    assert_allclose(total, total[0], rtol=0, atol=1e-6 * float(kinetic.max()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "command", "wind"),
    [
        pytest.param(takeichi_20m(), thirty_degrees(20), None, id="the paper's arm"),
        pytest.param(
            general_arm(4),
            joint_ramps(4, {1: 0.5, 2: 0.3}, start=0.5, duration=1.0),
            constant([0.3, -0.2, 0.5]),
            id="a general arm, driven, in wind",
        ),
        pytest.param(
            full_arm(4),
            joint_ramps(4, {1: 0.5, 2: 0.3}, start=0.5, duration=1.0),
            constant([0.3, -0.2, 0.5]),
            id="every option, driven, in wind",
        ),
    ],
)
def test_energy_changes_by_the_work_of_drag_damping_and_command(arm, command, wind):
    """A moving command strains its spring: dE/dt includes k (command - q) d(command)/dt."""
    times, weights = gauss_times(25.0, 1250)
    motion = simulate(arm, command, times, wind=wind, **TIGHT)
    kinetic, potential, power = (np.asarray(x) for x in energies(motion))
    speed = jax.vmap(jax.jacfwd(command))(motion.times)
    winding = np.asarray(speed * (motion.commands - motion.angles)) @ arm.joints.stiffness
    work = (weights * (power + winding)[1:-1]).sum()
    assert abs((weights * power[1:-1]).sum()) > 0.1
    total = kinetic + potential
    assert_allclose(total[-1] - total[0], work, rtol=0, atol=1e-6 * kinetic.max())
