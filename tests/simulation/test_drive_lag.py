"""Drives that follow their command with a lag: motions, energy, invalid values, and a fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import ArmModel, InputError
from giajax.apps.mjcf import export_mjcf
from giajax.mechanics.arm import damping_power, drag_power, kinetic_energy, potential_energy
from giajax.simulation import Stepper, joint_steps, ramps, simulate

LINKS = 3
LAGS = np.asarray([0.4, 0.1, 0.25])
TIMES = np.linspace(0.0, 3.0, 31)
CORNERS = np.asarray([0.0, 0.3, 1.0, 1.6, 4.0])
ANGLES = np.asarray(
    [[0, 0, 0], [0, 0, 0], [0.5, 0.2, 0], [0.3, -0.2, 0.1], [0.3, -0.2, 0.1]], float
)


def arm(lag, **options):
    return giajax.takeichi_20m(LINKS, parameters={"joints.drive_lag": lag}, **options)


def commanded(times):
    return np.stack([np.interp(times, CORNERS, row) for row in ANGLES.T], axis=1)


def followed(times, values, lag):
    """Filter by small steps, each of which is exact for a linear input."""
    rows = [values[0]]
    for step, before, after in zip(np.diff(times), values[:-1], values[1:], strict=True):
        slope, kept = (after - before) / step, np.exp(-step / lag)
        rows.append(after - lag * slope + (rows[-1] - before + lag * slope) * kept)
    return np.stack(rows)


@pytest.mark.parametrize(
    ("solver", "options"),
    [
        pytest.param("tsit5", {}, marks=pytest.mark.long),
        pytest.param("springs5", {}, marks=pytest.mark.slow),
        pytest.param("springs5", {"muscles": "pitch"}, marks=pytest.mark.long),
    ],
)
def test_an_arm_moves_as_one_whose_command_is_filtered_before(solver, options):
    fine = np.linspace(0.0, 4.0, 2001)
    slow = ramps(fine, followed(fine, commanded(fine), LAGS), tolerance=1e-9)
    how = {"solver": solver, "rtol": 1e-8, "atol": 1e-8}
    found = simulate(arm(LAGS, **options), ramps(CORNERS, ANGLES), TIMES, **how)
    plain = giajax.takeichi_20m(LINKS, **options)
    expected = simulate(plain, slow, TIMES, **how)
    np.testing.assert_allclose(found.angles, expected.angles, atol=1e-5)
    np.testing.assert_allclose(found.followed, expected.commands, atol=1e-6)
    np.testing.assert_allclose(found.commands, commanded(TIMES), atol=1e-12)
    np.testing.assert_allclose(found.accelerations, expected.accelerations, atol=1e-3)
    assert np.abs(found.angles - simulate(plain, ramps(CORNERS, ANGLES), TIMES).angles).max() > 0.01


@pytest.mark.slow
def test_a_jump_takes_the_lag():
    """After a jump, the spring is at 1 - exp(-t / lag) of it, and there are few steps."""
    found = simulate(arm(0.2), joint_steps(LINKS, {1: 0.5}, time=0.5), TIMES)
    expected = np.where(TIMES < 0.5, 0, 0.5 * -np.expm1(-(TIMES - 0.5) / 0.2))
    np.testing.assert_allclose(found.followed[:, 0], expected, atol=1e-12)
    assert np.abs(found.angles[:6]).max() < 1e-12
    assert int(found.steps.sum()) < 300


@pytest.mark.slow
def test_energy_changes_by_the_work_of_the_spring_that_follows():
    """dE/dt = k (y - q) dy/dt minus the power of drag and dampers; y is the delayed command."""
    times = np.linspace(0.0, 3.0, 1501)
    moved = simulate(arm(LAGS), ramps(CORNERS, ANGLES), times, rtol=1e-9, atol=1e-9)

    def energies(angles, rates, at):
        total = kinetic_energy(moved.arm, angles, rates) + potential_energy(moved.arm, angles, at)
        return total, drag_power(moved.arm, angles, rates) + damping_power(moved.arm, rates)

    total, power = jax.jit(jax.vmap(energies))(moved.angles, moved.rates, moved.followed)
    rate = (moved.commands - moved.followed) / LAGS[None]
    pulled = moved.arm.spring_stiffness[None] * (moved.followed - moved.angles)
    gained = np.asarray(power + jnp.sum(pulled * rate, axis=1))
    work = np.concatenate([[0], np.cumsum((gained[1:] + gained[:-1]) / 2 * np.diff(times))])
    assert np.ptp(total) > 0.01
    np.testing.assert_allclose(total - total[0], work, atol=1e-5)


def test_what_does_not_follow_a_lag_says_so():
    with pytest.raises(
        InputError,
        match=r"joints\.drive_lag, which stepwise simulation does not "
        r"support",
    ):
        Stepper(arm(0.1), interval=0.1)
    assert "omitted: the lag of the drives" in export_mjcf(arm(0.1)).lost


@pytest.mark.slow
def test_a_lag_is_found_together_with_the_drag_coefficient():
    commands = {f"joint{i + 1:02d}_command": row for i, row in enumerate(commanded(TIMES).T)}
    names = ("link01_z", "link02_y", "link02_z", "link03_y", "link03_z")
    truth = ArmModel(arm(0.4))
    noise = {"position": 0.002}
    run = giajax.synthesise(truth, TIMES, commands, names, noise=noise, seed=3)
    model = ArmModel(giajax.takeichi_20m(LINKS))
    free = ["joints.drive_lag", "air.drag_coefficient", "joints.pitch_stiffness"]
    start = {"joints.drive_lag": 0.1, "air.drag_coefficient": 0.8, "joints.pitch_stiffness": 2.0}
    result = giajax.fit(model, run, free=free, start=start)
    assert result.status == "converged"
    for path, known in zip(free, (0.4, 1.2, 3.0), strict=True):
        found = result.parameters[path]
        assert abs(found.value - known) < 3 * found.standard_error, path
        assert found.standard_error < 0.3 * known, path
    assert result.gradient_check.relative_difference < 1e-5
    # A lag for each joint can be written, read and tested like a common one.
    again = ArmModel.from_definition(ArmModel(arm(LAGS)).definition())
    np.testing.assert_array_equal(again.arm.joints.drive_lag, LAGS)
