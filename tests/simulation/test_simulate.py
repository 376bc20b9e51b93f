"""Simulation: corners, failures, invalid input, and no repeated compilation."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import giajax.simulation._simulate as module
from giajax.mechanics.arm import link_centres, takeichi_20m, tip_position
from giajax.runtime.text import InputError
from giajax.schema.parameters import replace
from giajax.simulation import (
    RESULTS,
    SimulationError,
    constant,
    integrate,
    joint_ramps,
    joint_steps,
    logged,
    ramps,
    simulate,
    steps,
)
from peers.scipy_chain import ScipyChain

LINKS = 3
TIMES = np.linspace(0.0, 5.0, 51)
ARM = takeichi_20m(LINKS)
STEP = joint_steps(LINKS, {1: 0.5, 2: 0.2}, time=0.5)
KNOTS = 64


def padded(signal, knots=KNOTS):
    """Return the same signal with its last knot repeated, so one compiled program serves all."""
    more = knots - signal.times.shape[0]
    last = jax.tree.map(lambda x: x[-1:], signal)
    last = eqx.tree_at(lambda s: s.slopes, last, jnp.zeros_like(last.slopes))
    return jax.tree.map(lambda x, end: jnp.concatenate([x, *[end] * more]), signal, last)


def move(command=STEP, times=TIMES, arm=ARM, **options):
    return simulate(arm, padded(command), times, **options)


def reference(command, times=TIMES, arm=ARM, wind=None):
    return ScipyChain(arm, command, wind).trajectory(times)[:, 0]


def test_an_arm_at_rest_stays_there():
    motion = move(constant(np.zeros(LINKS)))
    assert_array_equal(motion.angles, np.zeros((51, LINKS)))
    assert_array_equal(motion.rates, np.zeros((51, LINKS)))
    assert bool(motion.successful)
    assert motion.message == ""


def test_a_trajectory_says_where_the_arm_was():
    motion = move()
    assert_array_equal(motion.times, TIMES)
    assert_array_equal(motion.commands, np.where(TIMES[:, None] < 0.5, 0, [[0.5, 0.2, 0]]))
    assert motion.tip.shape == (51, 3)
    assert motion.link_centres.shape == (51, LINKS, 3)
    assert_allclose(motion.tip[20], tip_position(ARM, motion.angles[20]), rtol=1e-14)
    assert_allclose(motion.link_centres[20], link_centres(ARM, motion.angles[20]), rtol=1e-14)
    # The rates are the derivatives of the angles.
    slope = np.gradient(np.asarray(motion.angles[:, 0]), TIMES)
    assert_allclose(motion.rates[10:, 0], slope[10:], atol=0.2 * np.abs(slope).max())
    assert motion.wind is None


SINES = np.sin(TIMES)[:, None] * np.array([0.3, 0.2, 0.0])

CORNERED = {
    "a step on a sample": STEP,
    "a step between samples": joint_steps(LINKS, {1: 0.5}, time=0.5321),
    "a step at the first time": joint_steps(LINKS, {1: 0.5}, time=0.0),
    "a step before the first time": joint_steps(LINKS, {1: 0.5}, time=-1.0),
    "a step just before the last time": joint_steps(LINKS, {1: 0.5}, time=4.95),
    "a step at the last time": joint_steps(LINKS, {1: 0.5}, time=5.0),
    "a step after the last time": joint_steps(LINKS, {1: 0.5}, time=6.0),
    "a ramp of a hundredth of a second": joint_ramps(LINKS, {1: 0.5}, start=0.533, duration=0.01),
    "rows that are held": logged(TIMES, SINES, "zoh"),
    "rows that are joined": logged(TIMES, SINES, "linear"),
    "rows that start late and end early": logged(TIMES[7:33] + 0.03, SINES[7:33], "zoh"),
}


@functools.cache
def cornered_reference(name):
    """Return the reference for a command, computed once for all solvers."""
    return reference(CORNERED[name])


# These methods take longer steps, with errors closer to their tolerance.
WITHIN = {"tsit5": 5e-6, "springs5": 3e-5}


@pytest.mark.slow
@pytest.mark.parametrize("solver", WITHIN)
@pytest.mark.parametrize("name", CORNERED)
def test_corners_do_not_hurt(name, solver):
    """As accurate as a tight integration piece by piece, without a search for the corners."""
    command = CORNERED[name]
    motion = move(command, solver=solver)
    assert_allclose(motion.angles, cornered_reference(name), rtol=0, atol=WITHIN[solver])
    corners = len(command.times)
    assert int(motion.steps[1]) <= 30 + corners, "steps were rejected at the corners"
    assert int(motion.steps[0]) <= 140 + 3 * corners


def test_held_rows_move_otherwise_than_joined_ones():
    held, joined = (move(CORNERED[f"rows that are {word}"]).angles for word in ("held", "joined"))
    assert np.abs(held - joined).max() > 1e-2


@pytest.mark.slow
@pytest.mark.parametrize("ulps", [0, 1, 4])
def test_corners_of_command_and_wind_may_differ_by_rounding(ulps):
    time = 0.7
    for _ in range(ulps):
        time = np.nextafter(time, 1.0)
    wind = steps([0.0, time], [[0.0, 0.0, 0.0], [0.0, 0.1, 0.3]])
    command = joint_steps(LINKS, {1: 0.5}, time=0.7)
    motion = move(command, wind=padded(wind))
    assert_allclose(motion.angles, reference(command, wind=wind), rtol=0, atol=5e-6)
    assert int(motion.steps[1]) <= 40


@pytest.mark.parametrize("shift", [-1, 1])
def test_the_first_time_may_differ_from_a_corner_by_rounding(shift):
    times = TIMES + np.nextafter(0.3, 0.3 + shift)
    command = joint_steps(LINKS, {1: 0.5}, time=0.3)
    late = move(command, times)
    assert_allclose(late.angles, move(CORNERED["a step at the first time"]).angles, atol=5e-6)


def test_time_may_start_anywhere():
    command = joint_steps(LINKS, {1: 0.5, 2: 0.2}, time=1e4 + 0.5)
    assert_allclose(move(command, TIMES + 1e4).angles, move().angles, atol=1e-8)


def test_samples_may_lie_anywhere():
    random = np.random.default_rng(0)
    times = np.concatenate([[0.0], np.sort(random.uniform(0.0, 5.0, 49)), [5.0]])
    assert_allclose(move(times=times).angles, reference(STEP, times), rtol=0, atol=5e-6)


def test_the_initial_state_is_where_it_starts():
    angles, rates = np.array([0.3, -0.2, 0.1]), np.array([1.0, 0.0, -1.0])
    motion = move(initial=(angles, rates))
    assert_array_equal(motion.angles[0], angles)
    assert_array_equal(motion.rates[0], rates)
    expected = ScipyChain(ARM, STEP).trajectory(TIMES, initial=(angles, rates))[:, 0]
    assert_allclose(motion.angles, expected, rtol=0, atol=1e-5)


@pytest.mark.slow
def test_wind_may_be_three_numbers_or_a_signal():
    vector = [0.1, 0.2, 0.3]
    by_numbers = move(wind=vector)
    by_signal = move(wind=padded(steps([0.0, 1.0], [vector, vector])))
    assert_allclose(by_numbers.angles, by_signal.angles, atol=1e-12)
    assert_allclose(by_numbers.angles, reference(STEP, wind=constant(vector)), atol=5e-6)
    assert_allclose(move(wind=[0.0, 0.0, 0.0]).angles, move().angles, atol=1e-12)
    assert np.abs(by_numbers.angles - move().angles).max() > 1e-2


def test_a_tighter_tolerance_is_more_exact():
    expected = reference(STEP)
    errors = [
        np.abs(move(rtol=tolerance, atol=tolerance).angles - expected).max()
        for tolerance in (1e-3, 1e-6, 1e-9)
    ]
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert errors[2] < 1e-8


def test_a_batch_of_arms_is_each_arm():
    coefficients = jnp.array([0.0, 1.2, 5.0])

    @jax.vmap
    def angles(coefficient):
        return move(arm=replace(ARM, {"air.drag_coefficient": coefficient}), throw=False).angles

    together = angles(coefficients)
    for coefficient, one in zip(coefficients, together, strict=True):
        alone = move(arm=replace(ARM, {"air.drag_coefficient": coefficient})).angles
        assert_allclose(one, alone, rtol=0, atol=1e-10)


@pytest.mark.slow
def test_what_comes_after_the_data_changes_nothing_before():
    """Runs of different lengths share a program, in which the last row is repeated."""
    command = logged(TIMES, SINES)
    state = jnp.zeros((2, LINKS))
    tolerances = (jnp.asarray(1e-6), jnp.asarray(1e-6))
    options = {"solver": "tsit5", "max_steps": 10_000, "derivatives": "forward"}
    options["steps_for"] = "motion"
    wind = steps([0.0, 2.0], [[0.0, 0.0, 0.1], [0.0, 0.1, 0.0]])

    def run(times, command, wind):
        return integrate(ARM, command, jnp.asarray(times), wind, None, state, tolerances, **options)

    plain = run(TIMES, command, wind)
    longer = run(np.append(TIMES, [5.0, 5.0, 5.0]), padded(command), padded(wind))
    # The shapes differ, so these are two programs with different rounding.
    assert_allclose(longer.angles[:51], plain.angles, rtol=0, atol=1e-11)
    assert_allclose(longer.rates[:51], plain.rates, rtol=0, atol=1e-11)
    assert_array_equal(longer.angles[51:], np.tile(longer.angles[50:51], (3, 1)))
    assert_array_equal(longer.steps, plain.steps)
    assert bool(longer.successful)


def broken(path, value):
    return replace(ARM, {path: value})


FAILURES = {
    "too few steps": ({"max_steps": 60}, RESULTS.max_steps_reached, "raise max_steps"),
    "a NaN parameter": (
        {"arm": broken("air.drag_coefficient", np.nan)},
        RESULTS.not_finite,
        "check the parameters",
    ),
    "a negative mass": (
        {"arm": broken("links.mass", -0.1)},
        RESULTS.not_finite,
        "check the parameters",
    ),
    "a NaN at the start": (
        {"initial": (np.zeros(LINKS), np.array([np.nan, 0.0, 0.0]))},
        RESULTS.not_finite,
        "check the parameters and the initial state",
    ),
    "an overflow": (
        {"initial": (np.zeros(LINKS), np.array([1e200, 0.0, 0.0]))},
        RESULTS.not_finite,
        "became infinite or NaN",
    ),
    "no tolerance": ({"rtol": 0.0, "atol": 0.0}, RESULTS.step_too_small, "loosen rtol and atol"),
    "a tolerance below rounding": (
        {"rtol": 1e-30, "atol": 1e-30},
        RESULTS.step_too_small,
        "loosen rtol and atol",
    ),
}


@pytest.mark.parametrize("name", FAILURES)
def test_a_failure_has_a_code_and_a_way_on(name):
    options, code, advice = FAILURES[name]
    motion = move(**options, throw=False)
    assert not bool(motion.successful)
    assert bool(motion.result == code), motion.message
    assert advice in motion.message
    assert not np.all(np.isfinite(motion.angles))
    # A fit encounters many of these, so simulate must not try a hundred thousand steps.
    assert int(motion.steps.sum()) < 1000
    with pytest.raises(SimulationError) as raised:
        move(**options)
    assert str(raised.value) == motion.message


def test_what_was_reached_before_a_failure_is_kept():
    whole, cut = move(), move(max_steps=60, throw=False)
    reached = np.isfinite(cut.angles).all(axis=1)
    assert 0 < reached.sum() < 51
    assert_array_equal(cut.angles[reached], whole.angles[reached])
    assert np.all(np.diff(reached.astype(int)) <= 0)


REFUSED = {
    "the command drives 2 joints, but the arm has 3": {"command": joint_steps(2, {1: 0.5})},
    "the wind has 2 components: give x, y and z": {"wind": [0.1, 0.2]},
    "give a one-dimensional array of at least two times": {"times": [1.0]},
    "times has shape (2, 2)": {"times": [[0.0, 1.0], [2.0, 3.0]]},
    "times do not increase strictly": {"times": [0.0, 1.0, 1.0]},
    "give one value for each of the 3 joints": {"initial": (np.zeros(2), np.zeros(3))},
    "there is no solver 'euler': use one of tsit5, dopri5": {"solver": "euler"},
    "derivatives='both' is unknown: use 'forward'": {"derivatives": "both"},
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_cannot_be_simulated_is_refused(sentence):
    with pytest.raises(InputError) as refused:
        simulate(**{"arm": ARM, "command": STEP, "times": TIMES} | REFUSED[sentence])
    assert sentence in str(refused.value)


def test_numbers_of_any_type_compile_once(monkeypatch):
    traced = []
    motion = module.motion
    monkeypatch.setattr(module, "motion", lambda *args: traced.append(1) or motion(*args))
    jax.clear_caches()
    arm, times = takeichi_20m(1), np.linspace(0.0, 1.0, 7)
    command = joint_steps(1, {1: 0.5})
    simulate(arm, command, times)
    once = len(traced)
    assert once > 0
    simulate(replace(arm, {"air.drag_coefficient": 1}), command, times, rtol=1e-5)
    simulate(
        replace(arm, {"gravity": jnp.asarray(1.0)}), command, list(times), atol=np.float32(0.1)
    )
    simulate(arm, joint_steps(1, {1: 1}, time=1), jnp.asarray(times), rtol=jnp.asarray(1e-4))
    simulate(arm, steps([0, 1], [[0], [1]]), times, initial=([0], [0.0]))
    simulate(arm, ramps([0, 1], [[0], [1]]), np.arange(7), initial=(np.zeros(1), jnp.ones(1)))
    assert len(traced) == once
