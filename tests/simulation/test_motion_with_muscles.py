"""Arms with muscles in their joints: positions of rest, jumps, lags, and inputs."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics.arm import (
    AbstractJointLaw,
    Pneumatics,
    damping_power,
    drag_power,
    kinetic_energy,
    mass_matrix,
    muscle_power,
    potential_energy,
    takeichi_20m,
)
from giajax.mechanics.joint import equilibria
from giajax.schema.parameters import replace
from giajax.simulation import (
    Pressures,
    check_muscles,
    constant,
    fastest_rate,
    joint_ramps,
    joint_steps,
    logged,
    ramps,
    simulate,
    steps,
)

LINKS = 3
DAMPED = {"joints.damping": 0.6, "joints.yaw_stiffness": 5.0}
EXACT = {"rtol": 1e-10, "atol": 1e-10}
commanded = eqx.filter_jit(Pneumatics.commanded)


def arm_with(parameters=DAMPED, links=LINKS, muscles="pitch"):
    return takeichi_20m(links, muscles=muscles, parameters=parameters)


def supplied(arm, command, joints=None):
    """Return the pressures that hold commanded angles (rad), constant in time."""
    pressures = commanded(arm.pneumatics, jnp.asarray(command))
    signal = steps([0.0], [np.asarray(pressures).ravel()])
    return Pressures(signal, arm.pneumatics.joints if joints is None else joints)


SLOW_TOO = ["springs5", pytest.param("tsit5", marks=pytest.mark.slow)]


@pytest.mark.parametrize("solver", SLOW_TOO)
def test_an_arm_at_rest_has_the_controllers_angles(solver):
    """With commanded angles and with their pressures, for angles that are stable."""
    arm = arm_with()
    target = np.deg2rad([25.0, 0.0, -30.0])
    command = joint_steps(LINKS, dict(enumerate(target, start=1)), time=0.0)
    times, options = np.linspace(0.0, 400.0, 3), {"solver": solver, **EXACT}
    by_angle = simulate(arm, command, times, **options)
    assert_allclose(by_angle.angles[-1], target, rtol=0, atol=1e-9)
    assert_allclose(by_angle.rates[-1], 0, atol=1e-9)
    still = joint_steps(LINKS, {})
    pressure = supplied(arm, target)
    by_pressure = simulate(arm, still, times, pressure=pressure, **options)
    assert_allclose(by_pressure.angles[-1], target, rtol=0, atol=1e-9)
    assert_allclose(by_pressure.pressures[-1], by_angle.pressures[-1], rtol=1e-12)


def test_where_a_pair_is_unstable_the_joint_goes_where_the_equilibria_are():
    arm = arm_with()
    command = np.deg2rad([2.0, 0.0, 20.0])
    # The first joint starts near its command, and the last one on the other side of 0.
    begin = np.deg2rad([2.1, 0.0, -8.0])
    motion = simulate(
        arm,
        joint_steps(LINKS, {}),
        np.linspace(0.0, 500.0, 3),
        pressure=supplied(arm, command),
        initial=(begin, np.zeros(LINKS)),
        solver="springs5",  # shares the program of the arm at rest above
        **EXACT,
    )
    ends = np.asarray(motion.angles[-1])
    for joint in (0, 2):
        found = equilibria(arm.pneumatics.pair, motion.pressures[-1, :, joint])
        stable = np.asarray([item.angle for item in found.stable])
        unstable = [item.angle for item in found.every if not item.stable]
        # The joint stays in its initial basin of attraction.
        nearest = min(unstable, key=lambda angle: abs(angle - begin[joint]))
        side = np.sign(begin[joint] - nearest)
        expected = min(stable[(stable - nearest) * side > 0], key=lambda a: abs(a - nearest))
        assert ends[joint] == pytest.approx(expected, abs=1e-9)
        assert abs(ends[joint] - command[joint]) > np.deg2rad(5)


def test_pressures_that_cross_the_window_make_the_joint_jump():
    """On a slow path from 20 to -32 deg, the joint follows its branch to the end and jumps."""
    arm = arm_with({"joints.damping": 0.5}, links=1)
    times = np.linspace(0.0, 2000.0, 401)
    command = np.interp(times, [0, 2000], np.deg2rad([20.0, -32.0]))
    start = (command[:1], np.zeros(1))
    motion = simulate(arm, logged(times, command[:, None]), times, initial=start)
    angles = np.asarray(motion.angles[:, 0])
    jump = int(np.argmin(np.diff(angles)))
    # The joint stays behind its command for long, and then jumps to the correct angle.
    assert command[jump] < np.deg2rad(-20)
    assert angles[jump] - angles[jump + 1] > np.deg2rad(5)
    for row in (jump - 15, jump + 15):
        found = equilibria(arm.pneumatics.pair, motion.pressures[row, :, 0])
        assert any(item.angle > 0 for item in found.stable) == (row < jump)
        nearest = min(abs(item.angle - angles[row]) for item in found.stable)
        assert nearest < np.deg2rad(0.3)
    assert angles[-1] == pytest.approx(command[-1], abs=np.deg2rad(0.1))


@pytest.mark.parametrize("solver", ["tsit5", pytest.param("springs5", marks=pytest.mark.slow)])
def test_pressures_lag_by_an_exponential(solver):
    arm = arm_with({**DAMPED, "drive.lag": 0.4})
    command = joint_steps(LINKS, {1: 0.4, 3: -0.3}, time=0.5)
    times = np.linspace(0.0, 4.0, 9)
    motion = simulate(arm, command, times, solver=solver, rtol=1e-8, atol=1e-8)
    before, after = (commanded(arm.pneumatics, command(jnp.asarray(t))) for t in (0.0, 1.0))
    left = np.exp(-np.maximum(times - 0.5, 0) / 0.4)[:, None, None]
    expected = np.asarray(after) + left * np.asarray(before - after)
    assert_allclose(motion.pressures, expected, rtol=0, atol=1.0)  # Pa
    quick = simulate(arm_with(), command, times, solver=solver)
    assert np.max(np.abs(quick.angles - motion.angles)) > 0.05


def swinging(lag, solver):
    """Return an arm that swings while its muscle pressures increase, and its motion."""
    options = {"joints.damping": 0.05, "joints.yaw_stiffness": 0.0}
    arm = arm_with(options | ({} if lag is None else {"drive.lag": lag}))
    command = joint_ramps(LINKS, {1: 0.5, 3: -0.4}, start=0.0, duration=100.0)
    begin = (np.asarray([0.2, 0.1, 0.3]), np.asarray([0.3, -0.2, 0.5]))
    times = np.linspace(0.0, 6.0, 2001)
    return arm, simulate(arm, command, times, initial=begin, solver=solver, **EXACT)


def test_a_short_lag_is_a_fast_motion_of_explicit_steps():
    plain, quick = arm_with(links=1), arm_with({**DAMPED, "drive.lag": 1e-3}, links=1)
    rate, still = eqx.filter_jit(fastest_rate), jnp.zeros(1)
    assert float(rate(plain, still)) < 500
    assert float(rate(quick, still)) > 1000
    assert float(rate(quick, still, springs=False)) == 0


class Stiffened(AbstractJointLaw):
    """A bellows whose stiffness depends on its pressures; it has no controller."""

    passive = False

    def commanded(self, command):
        return jnp.zeros((2, command.size))

    def torque(self, at):
        return -1e-3 * jnp.sum(at.pressures, axis=0) * at.angles

    def energy(self, at):
        return jnp.zeros_like(at.angles)


def test_steps_for_derivatives_are_short_while_pressures_of_a_run_stiffen_a_law_of_ones_own():
    arm = takeichi_20m(1, joint_laws=[Stiffened()])
    rate = np.sqrt(1e-3 * 6e5 / float(jax.jit(mass_matrix)(arm, jnp.zeros(1))[0, 0]))

    def taken(*pressures):
        """Return the steps of an arm at rest in two seconds, with one pressure in each second."""
        signal = steps([0.0, 1.0], [[pressure] * 2 for pressure in pressures])
        options = {"pressure": Pressures(signal, (1,)), "steps_for": "derivatives"}
        return int(simulate(arm, joint_steps(1, {}), np.linspace(0.0, 2.0, 3), **options).steps[0])

    soft, late, stiff = taken(0, 0), taken(0, 3e5), taken(3e5, 3e5)
    # tsit5 is stable for steps of 2 / rate.
    assert late - soft / 2 >= rate / 2
    assert stiff >= rate
    assert soft < rate / 2


@pytest.mark.slow
@pytest.mark.parametrize("lag", [None, 0.3])
def test_methods_agree(lag):
    one, other = (swinging(lag, solver)[1] for solver in ("springs5", "tsit5"))
    assert_allclose(one.angles, other.angles, rtol=0, atol=1e-7)


@pytest.mark.parametrize("lag", [None, pytest.param(0.3, marks=pytest.mark.slow)])
def test_what_pressures_do_is_stored_or_lost(lag):
    arm, motion = swinging(lag, "tsit5")
    angles, rates, pressures = motion.angles, motion.rates, motion.pressures
    times = np.asarray(motion.times)

    @jax.jit
    @jax.vmap
    def energies(angles, rates, pressures):
        stored = kinetic_energy(arm, angles, rates)
        stored = stored + potential_energy(arm, angles, jnp.zeros(LINKS))
        lost = damping_power(arm, rates) + drag_power(arm, angles, rates)
        return stored, lost, muscle_power(arm, angles, rates, pressures)

    stored, lost, supplied_power = map(np.asarray, energies(angles, rates, pressures))
    power = lost + supplied_power
    # Simpson's rule.
    work = np.sum(power[:-2:2] + 4 * power[1:-1:2] + power[2::2]) * (times[1] - times[0]) / 3
    size = np.sum(np.abs(supplied_power)) * (times[1] - times[0])
    assert stored[-1] - stored[0] == pytest.approx(work, abs=1e-5 * size)
    assert size > 0.004


@pytest.mark.parametrize(
    ("solver", "lag"),
    [
        # Each solver and each kind of drive occurs once.
        pytest.param("springs5", None, marks=pytest.mark.long),
        pytest.param("springs5", 0.3, marks=pytest.mark.slow),
        pytest.param("tsit5", None, marks=pytest.mark.slow),
    ],
)
def test_derivatives_from_rest_are_slopes(solver, lag):
    """The arm is initially straight and at rest, where many of its laws have corners."""
    paths = ["muscle.effectiveness", "muscle.dead_band", "geometry.anchor_y", "alpha.curvature",
             "beta.offset", "air.drag_coefficient"]  # fmt: skip
    arm = arm_with(DAMPED | ({} if lag is None else {"drive.lag": lag}))
    if lag is not None:
        paths = [*paths, "drive.lag"]
    pressures = np.asarray(commanded(arm.pneumatics, jnp.asarray([0.5, 0.0, -0.9]))).ravel()
    zero = np.asarray(commanded(arm.pneumatics, jnp.zeros(LINKS))).ravel()
    pressure = Pressures(logged([0.0, 0.5, 1.0], [zero, zero, pressures]), (1, 3))
    times, command = np.linspace(0.0, 3.0, 7), joint_ramps(LINKS, {2: 0.3})
    start = jnp.asarray([1.0, 1e4, 0.18, 2.0, 0.01, 1.2, lag or 0.0][: len(paths)])

    @jax.jit
    def angles(values):
        own = replace(arm, dict(zip(paths, values, strict=True)))
        options = {"steps_for": "derivatives", "throw": False, **EXACT}
        return simulate(own, command, times, pressure=pressure, solver=solver, **options).angles

    found = jax.jit(jax.jacfwd(angles))(start)
    assert np.all(np.isfinite(found))
    for index, path in enumerate(paths):
        # Smaller differences show rounding errors, because the motion is unstable at 0 initially.
        step = 1e-3 * start[index]
        off = jnp.zeros_like(start).at[index].set(step)
        slope = (angles(start + off) - angles(start - off)) / (2 * step)
        # With a lag, the derivatives along one direction and along all differ by 0.4 %. Without a
        # lag, at this tolerance, springs5 has an error of 0.2 % for the anchors, and tsit5 of 0.04
        # %.
        off = (4e-3 if lag is None else 1e-2) * np.max(np.abs(slope))
        assert_allclose(found[..., index], slope, atol=off, err_msg=path)


def test_commanded_angles_do_not_depend_on_the_effectiveness():
    """The controller compensates for it, and no derivative may show it even at a loose tolerance.

    A rounding error per step remains, which is far below the response of other parameters.
    """
    arm = arm_with()
    command = ramps([0.0, 0.2, 1.2], np.outer([0.0, 0.0, 1.0], [0.4, -0.3, 0.3]))

    def angles(number):
        stronger = replace(arm, {"muscle.effectiveness": number})
        how = {"rtol": 1e-4, "atol": 1e-4, "steps_for": "derivatives"}
        return simulate(stronger, command, np.linspace(0.0, 3.0, 31), **how).angles

    number = arm.pneumatics.muscle.effectiveness
    assert np.max(np.abs(jax.jacfwd(angles)(number))) < 1e-11


def test_the_last_sample_has_the_pressures_after_a_jump_there():
    arm, times = arm_with(links=2, muscles="all"), np.linspace(0.0, 1.0, 6)
    rows = np.concatenate([np.outer(np.arange(6) + 1, [1e3, 1e3]), np.full((6, 2), 1e3)], axis=1)
    held = Pressures(steps(times, rows), (1, 2))
    motion = simulate(arm, constant([0.0, 0.0]), times, pressure=held)
    assert_allclose(motion.pressures[:, 0, 0], rows[:, 0])


def test_what_muscles_cannot_do_is_refused():
    arm, times = arm_with(), np.linspace(0.0, 1.0, 3)
    still = joint_steps(LINKS, {})
    with pytest.raises(InputError, match="joint 3 is commanded to 75 deg"):
        simulate(arm, joint_ramps(LINKS, {3: np.deg2rad(75)}), times)
    signal = steps([0.0], [np.zeros(2 * LINKS)])
    with pytest.raises(InputError, match="joint 2 is driven by pressures, but it has no muscles"):
        simulate(arm, still, times, pressure=Pressures(signal, (1, 2)))
    with pytest.raises(InputError, match="joint 1 is driven by pressures, but it has no muscles"):
        simulate(takeichi_20m(LINKS), still, times, pressure=Pressures(signal, (1,)))
    low = steps([0.0], [np.full(2 * LINKS, -5.0)])
    with pytest.raises(InputError, match="is -5 Pa"):
        simulate(arm, still, times, pressure=Pressures(low, (1,)))
    # Only pressures of joints that are driven by pressure are checked.
    check_muscles(arm, still, Pressures(steps([0.0], [[1e4, 9e9, 0, 1e4, -5.0, 9e9]]), (1,)))
    with pytest.raises(InputError, match=r"is 3e\+07 Pa: .* muscle.pressure_limit = 300000 Pa"):
        check_muscles(arm, still, Pressures(steps([0.0], [np.full(2 * LINKS, 3e7)]), (1,)))
    thin, far = arm_with({"muscle.diameter": 2e-3}), joint_steps(LINKS, {3: np.deg2rad(60)})
    with pytest.raises(InputError, match=r"commanded angle of 60 deg.*exceeds the pressure lim"):
        check_muscles(thin, far, None)
    check_muscles(arm, far, None)
    check_muscles(thin, still, None)
    with pytest.raises(InputError, match=r"jumps at 0 deg from 0\.\d+ to 0\.\d+ m"):
        check_muscles(
            arm_with({"geometry.contact_y": 0.19, "geometry.wire_length": 0.4}), still, None
        )
    with pytest.raises(InputError, match="3 columns, but the arm has 3 joints"):
        simulate(arm, still, times, pressure=Pressures(steps([0.0], [np.zeros(3)]), (1,)))
