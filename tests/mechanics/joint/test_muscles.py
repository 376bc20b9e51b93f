"""Muscle laws: limits, textbook statics, and the pressure for a given force."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax.mechanics.joint import (
    BraidedMuscle,
    EmpiricalMuscle,
    Joint,
    Piston,
    muscle_force,
    muscle_pressure,
    muscle_state,
)

LAWS = [BraidedMuscle(), EmpiricalMuscle(), Piston(offset=1.5)]
NO_DEAD_BAND = BraidedMuscle(dead_band=0.0)
IDEAL = BraidedMuscle(end_correction=1.0, effectiveness=1.0, dead_band=0.0)


def test_the_ideal_braided_law_is_virtual_work_of_its_gas():
    """F = -p dV/dL for a cylinder of inextensible threads with n turns around it."""
    length, diameter, angle = 0.2, float(IDEAL.diameter), float(IDEAL.braid_angle)
    thread, turns = length / np.cos(angle), length * np.tan(angle) / (np.pi * diameter)

    def volume(l):  # noqa: E741
        wide = jnp.sqrt(thread**2 - l**2) / (np.pi * turns)
        return jnp.pi / 4 * wide**2 * l

    for contraction in (0.0, 0.1, 0.3):
        by_work = -150e3 * jax.grad(volume)(jnp.asarray(length * (1 - contraction)))
        law = muscle_force(IDEAL, 150e3, contraction, length)
        assert float(law) == pytest.approx(float(by_work), rel=1e-12)


def test_thin_muscles_contract_less_than_the_ideal_law_says():
    ideal, thin = float(IDEAL.largest_contraction), float(BraidedMuscle().largest_contraction)
    assert ideal == pytest.approx(0.393, abs=5e-4)
    assert 0.20 < thin < 0.25
    assert 1.6 <= ideal / thin <= 2.0
    assert float(muscle_force(BraidedMuscle(), 300e3, thin * 0.999)) > 0
    assert float(muscle_force(BraidedMuscle(), 300e3, thin * 1.001)) == 0
    # The quadratic law increases again beyond 1 / k, but the force of a muscle must not.
    assert float(muscle_force(BraidedMuscle(end_correction=2.0), 300e3, 0.95)) == 0


def test_the_dead_band_has_no_force():
    muscle = BraidedMuscle(dead_band=20e3)
    np.testing.assert_array_equal(muscle_force(muscle, [0.0, 10e3, 20e3], 0.0), 0)
    above, without = muscle_force(muscle, 120e3, 0.05), muscle_force(NO_DEAD_BAND, 1e5, 0.05)
    assert float(above) == pytest.approx(float(without), rel=1e-14)


def test_the_pressures_of_the_design():
    """With a resting diameter of 3.5 mm and no dead band: 0 to 101 kPa over the joint's range."""
    state = muscle_state(Joint(), np.deg2rad(np.linspace(-60, 60, 241)))
    answer = muscle_pressure(NO_DEAD_BAND, state.force, state.contraction)
    assert bool(jnp.all(answer.reached))
    assert float(answer.pressure.min()) == pytest.approx(0, abs=1)
    assert float(answer.pressure.max()) == pytest.approx(101e3, abs=1e3)


def test_the_empirical_shape_is_tied_at_its_corners():
    muscle = EmpiricalMuscle()
    limit, largest = float(muscle.pressure_limit), float(muscle.contraction_limit)
    full = float(muscle.largest_force(jnp.asarray(1.96)))
    assert float(muscle_force(muscle, limit, 0.0)) == pytest.approx(full, rel=1e-14)
    assert float(muscle.signed_force(*map(jnp.asarray, (limit, largest, 1.96)))) == pytest.approx(
        0, abs=1e-14
    )
    # A longer muscle has a larger force, up to force_limit. Without pressure, the force is zero.
    forces = [float(muscle.largest_force(jnp.asarray(l))) for l in (0.005, 0.02, 0.2, 2.0, 1e9)]  # noqa: E741
    assert forces[0] == 0
    assert np.all(np.diff(forces) > 0)
    assert forces[-1] == pytest.approx(float(muscle.force_limit))
    assert np.all(np.asarray(muscle_force(muscle, 0.0, np.linspace(0, 0.3, 7))) == 0)


@pytest.mark.parametrize("muscle", LAWS, ids=lambda law: law.name)
def test_the_pressure_undoes_the_force(muscle):
    pressure = np.linspace(20e3, 290e3, 28)
    for contraction in (0.0, 0.07, 0.15):
        force = muscle_force(muscle, pressure, contraction)
        pulling = np.asarray(force) > 1e-6
        assert pulling.sum() > 10
        answer = muscle_pressure(muscle, force, contraction)
        assert np.all(np.asarray(answer.reached))
        np.testing.assert_allclose(answer.pressure[pulling], pressure[pulling], rtol=1e-12)
        np.testing.assert_allclose(answer.force, force, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("muscle", LAWS[:2], ids=lambda law: law.name)
def test_an_answer_out_of_range_says_why_and_comes_nearest(muscle):
    push = muscle_pressure(muscle, -0.5, 0.1)
    assert (int(push.code), float(push.pressure), float(push.force)) == (1, 0.0, 0.0)
    assert "push" in push.message()
    strong = muscle_pressure(muscle, 500.0, 0.1)
    assert int(strong.code) == 2
    assert float(strong.pressure) == float(muscle.pressure_limit)
    assert float(strong.force) == pytest.approx(
        float(muscle_force(muscle, muscle.pressure_limit, 0.1))
    )
    assert "pressure limit" in strong.message()
    mixed = muscle_pressure(muscle, [-1.0, 1.0, 500.0], 0.1)
    assert mixed.reached.tolist() == [False, True, False]
    assert mixed.message(1) == "reached"


def test_a_contraction_beyond_reach():
    far = muscle_pressure(BraidedMuscle(), 1.0, 0.35)
    assert int(far.code) == 3
    assert float(far.force) == 0
    # At this contraction, no force requires no pressure.
    idle = muscle_pressure(BraidedMuscle(), 0.0, 0.35)
    assert bool(idle.reached)
    assert float(idle.pressure) == 0


@pytest.mark.parametrize("muscle", LAWS, ids=lambda law: law.name)
def test_the_law_can_be_differentiated(muscle):
    for path, parameter in giajax.declared(muscle).items():
        value = float(parameter.value(muscle))

        def force(v, path=path):
            return muscle_force(giajax.replace(muscle, {path: v}), 150e3, 0.1)

        slope = float(jax.grad(force)(jnp.asarray(value)))
        step = 1e-6 * max(abs(value), 1e-3)
        difference = float(force(value + step) - force(value - step)) / (2 * step)
        assert slope == pytest.approx(difference, rel=1e-5, abs=1e-9), path
    for slope in jax.grad(lambda p, e: muscle_force(muscle, p, e), (0, 1))(150e3, 0.1):
        assert np.isfinite(slope)
    # This includes zero pressure, where the muscle is slack.
    assert np.isfinite(jax.grad(lambda p: muscle_force(muscle, p, 0.1))(0.0))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((-1.0, 0.1), "at least 0"),
        ((1e5, 1.0), "not in percent"),
        ((np.nan, 0.1), "pressure is not finite"),
        (([1e5, 1e5], [0.1, 0.1, 0.1]), "arrays of the same shape"),
    ],
)
def test_bad_arguments_are_refused_with_a_sentence(arguments, sentence):
    with pytest.raises(giajax.InputError, match=sentence):
        muscle_force(BraidedMuscle(), *arguments)


@pytest.mark.parametrize(
    ("muscle", "force", "contraction"),
    [(Piston(offset=10.0), 5.0, 0.0), (EmpiricalMuscle(), 0.1, -0.1)],
)
def test_a_muscle_that_pulls_more_than_asked_without_pressure_says_so(muscle, force, contraction):
    answer = muscle_pressure(muscle, force, contraction)
    assert int(answer.code) == 4
    assert not bool(answer.reached)
    assert (
        "the force of the muscle exceeds the required force even at zero pressure"
        in answer.message()
    )
    least = float(answer.force)
    assert float(answer.pressure) == 0
    assert least == float(muscle_force(muscle, 0.0, contraction)) > 2 * force - 1e-9
    # The force without pressure and larger ones can be reached.
    assert muscle_pressure(muscle, [least, least + 1], contraction).reached.tolist() == [True, True]
