"""Arms with muscles and necks in their joints: energy, derivatives, and jumps."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicHermiteSpline

from giajax.mechanics.arm import (
    Pneumatics,
    damping_power,
    drag_power,
    kinetic_energy,
    muscle_power,
    potential_energy,
    takeichi_20m,
)
from giajax.mechanics.joint import equilibria, net_torque, slow_history
from giajax.schema.parameters import replace
from giajax.simulation import Pressures, joint_steps, logged, simulate, steps

NECK = {"neck.radius": 0.045, "neck.length": 0.03}
EXACT = {"rtol": 1e-10, "atol": 1e-10}
commanded = eqx.filter_jit(Pneumatics.commanded)


def arm_with(links=1, **parameters):
    return takeichi_20m(links, muscles="pitch", parameters={**NECK, **parameters})


def held(arm, degrees):
    """Return the constant pressures that hold a hinge at an angle."""
    command = jnp.zeros(arm.count).at[0].set(np.deg2rad(degrees))
    pressures = np.asarray(commanded(arm.pneumatics, command))
    return Pressures(steps([0.0], [pressures.ravel()]), arm.pneumatics.joints), pressures


FREE = {"joints.damping": 0.0, "air.drag_coefficient": 0.0}
LOSSY = {"joints.damping": 0.05}


@functools.cache
def swinging(lossy=False):
    """Simulate a joint that swings through 0; its neck is tight, wrinkles and folds."""
    arm = arm_with(**(LOSSY if lossy else FREE))
    pressure, _ = held(arm, 20.0)
    times = np.linspace(0.0, 2.0, 8001)
    start = (np.deg2rad([50.0]), np.asarray([-1.5]))
    motion = simulate(
        arm, joint_steps(1, {}), times, pressure=pressure, initial=start, solver="tsit5", **EXACT
    )
    return arm, motion


def test_a_free_motion_at_constant_pressures_conserves_energy():
    """Kinetic energy plus the integral of the static joint torque over the angle is constant."""
    arm, motion = swinging()
    angles, rates = np.asarray(motion.angles[:, 0]), np.asarray(motion.rates)
    assert angles.max() > 0.6 > -0.5 > angles.min()
    pair = arm.pneumatics.in_links(arm.links).pair
    pressures = motion.pressures[0, :, 0]
    nodes, weights = np.polynomial.legendre.leggauss(16)
    # Use short intervals where the neck is tight, which end at its limits.
    near = np.geomspace(1e-5, 0.05, 60)
    cuts = np.concatenate([near, np.linspace(0.05, 1.0, 200), [0.03 / (2 * 0.045)]])
    cuts = np.unique(np.concatenate([-cuts, [0.0], cuts]))
    middle, half = (cuts[1:] + cuts[:-1]) / 2, np.diff(cuts) / 2
    at = jnp.asarray(middle[:, None] + half[:, None] * nodes)
    torque = eqx.filter_jit(net_torque)(pair, pressures, jnp.zeros(()), at, at >= 0)
    stored = np.concatenate([[0.0], -np.cumsum((np.asarray(torque) @ weights) * half)])
    moving = jax.jit(jax.vmap(functools.partial(kinetic_energy, arm)))(motion.angles, rates)
    slopes = -np.asarray(
        eqx.filter_jit(net_torque)(pair, pressures, jnp.zeros(()), jnp.asarray(cuts), cuts >= 0)
    )
    potential = CubicHermiteSpline(cuts, stored, slopes)(angles)
    whole = np.asarray(moving) + potential
    assert np.ptp(np.asarray(moving)) > 0.01
    assert np.ptp(whole) < 1e-5 * np.ptp(np.asarray(moving))


def test_what_pressures_do_is_stored_or_lost():
    """The power that necks absorb is included in that of the muscles."""
    arm, motion = swinging(lossy=True)
    angles, rates, pressures = motion.angles, motion.rates, motion.pressures

    @jax.jit
    @jax.vmap
    def energies(angles, rates, pressures):
        stored = kinetic_energy(arm, angles, rates) + potential_energy(arm, angles, jnp.zeros(1))
        lost = damping_power(arm, rates) + drag_power(arm, angles, rates)
        return stored, lost, muscle_power(arm, angles, rates, pressures)

    stored, lost, supplied = map(np.asarray, energies(angles, rates, pressures))
    power, step = lost + supplied, float(motion.times[1] - motion.times[0])
    work = np.sum(power[:-2:2] + 4 * power[1:-1:2] + power[2::2]) * step / 3
    size = np.sum(np.abs(supplied)) * step
    assert stored[-1] - stored[0] == pytest.approx(work, abs=1e-5 * size)
    assert size > 0.004


PATHS = ("neck.radius", "neck.length", "links.pressure", "muscle.effectiveness")


START = jnp.asarray([0.045, 0.03, 1e3, 1.0])


def swung(values, pressure, **options):
    """Return the angles of a joint that swings from a folded state through 0, by `PATHS`."""
    own = replace(arm_with(**LOSSY), dict(zip(PATHS, values, strict=True)))
    options |= {"steps_for": "derivatives", "throw": False, **EXACT}
    motion = simulate(
        own,
        joint_steps(1, {}),
        np.linspace(0.0, 0.4, 5),
        pressure=pressure,
        initial=(np.deg2rad([50.0]), np.asarray([-8.0])),
        **options,
    )
    return motion.angles[1:, 0]


@functools.cache
def forwards(solver):
    """Compile the motion by a method, and its derivatives."""
    pressure, _ = held(arm_with(), 20.0)
    angles = functools.partial(swung, pressure=pressure, solver=solver)
    return jax.jit(angles), jax.jit(jax.jacfwd(angles))(START)


@pytest.mark.parametrize("solver", ["tsit5", pytest.param("springs5", marks=pytest.mark.slow)])
def test_derivatives_of_a_motion_through_the_limits_are_slopes(solver):
    one, forward = forwards(solver)
    passed = np.asarray(one(START))
    assert passed[0] > 0.03 / (2 * 0.045)  # folded, then wrinkled and tight, then wrinkled again
    assert passed[-1] < -0.03
    for index, value in enumerate(START):
        off = jnp.zeros(4).at[index].set(1e-5 * value)
        slope = (one(START + off) - one(START - off)) / (2e-5 * value)
        assert_allclose(forward[:, index], slope, atol=2e-3 * np.max(np.abs(slope)))
        assert np.max(np.abs(slope)) * float(value) > 1e-3


@pytest.mark.long
def test_derivatives_backwards_are_those_forwards():
    """At the onset of wrinkling, the second derivative is infinite, so steps have an effect."""
    pressure, _ = held(arm_with(), 20.0)
    options = {"pressure": pressure, "solver": "tsit5", "derivatives": "reverse"}
    weights = jnp.asarray([1.0, -2.0, 0.5, 3.0])
    found = jax.jit(jax.grad(lambda values: weights @ swung(values, **options)))(START)
    assert_allclose(found, weights @ forwards("tsit5")[1], rtol=1e-2)


def test_a_motion_in_which_muscles_crush_the_neck_goes_on():
    """It ends like a hinge: the film carries no load, and all numbers are finite."""
    arm = arm_with(links=1, **{"joints.damping": 0.5, "links.pressure": 200.0})
    pressure, pressures = held(arm, 12.0)
    start = (np.deg2rad([8.0]), np.zeros(1))
    motion = simulate(
        arm, joint_steps(1, {}), np.linspace(0, 60.0, 3), pressure=pressure, initial=start, **EXACT
    )
    hinge = Pneumatics((1,)).pair
    rests = np.asarray([each.angle for each in equilibria(hinge, pressures[:, 0]).stable])
    assert np.min(np.abs(rests - float(motion.angles[-1, 0]))) < 1e-6
    assert np.rad2deg(motion.angles[-1, 0]) == pytest.approx(12, abs=0.1)


def test_a_slow_way_through_0_is_that_of_the_joint_at_rest():
    """The bistable pair with a neck stays, folds, snaps and returns as in the statics."""
    arm = arm_with(**{"joints.damping": 0.3, "neck.radius": 0.036, "neck.length": 0.02})
    degrees = np.concatenate([np.arange(30.0, -40, -1), np.arange(-40.0, 41)])
    times = np.linspace(0.0, 20.0 * degrees.size, degrees.size)
    command = np.deg2rad(degrees)
    motion = simulate(
        arm,
        logged(times, command[:, None]),
        times,
        initial=(command[:1], np.zeros(1)),
        solver="springs5",
    )
    moved = np.asarray(motion.angles[:, 0])
    pair = arm.pneumatics.in_links(arm.links).pair
    grid = np.linspace(-60, 60, 4801)
    angles = jnp.deg2rad(jnp.asarray(grid))
    rows = jax.vmap(lambda both: net_torque(pair, both, jnp.zeros(()), angles, angles >= 0))
    torques = eqx.filter_jit(rows)(motion.pressures[:, :, 0])
    expected = np.asarray(slow_history(torques, angles, jnp.asarray(0.0), jnp.asarray(moved[0])))
    off = np.abs(moved - expected)
    jumps = np.flatnonzero(np.abs(np.diff(expected)) > np.deg2rad(5))
    assert jumps.size >= 6
    # Inertia and damping may delay a jump by a row, and the first row is not at rest.
    apart = ~np.isin(np.arange(off.size), [0, *jumps, *(jumps + 1)])
    assert np.sum(apart) > 0.75 * off.size
    assert np.max(off[apart]) < np.deg2rad(0.7)
