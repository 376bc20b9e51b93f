"""Muscles and cylinders as a model: laws, friction by phase and by motion, a real cylinder."""

from pathlib import Path

import numpy as np
import pytest

import giajax
from giajax import InputError, MuscleModel, Run, fit, model_for, predict, read_run
from giajax.mechanics.joint import BraidedMuscle, EmpiricalMuscle, Friction, Piston, muscle_force

PISTON = Path(__file__).parents[2] / "data" / "recorded" / "pneumatic_piston_friction"


def run_of(channels, section=None, times=None):
    return Run.from_arrays(times, channels, definition={"muscle": section or {}})


def test_it_predicts_the_law():
    pressure, contraction = np.array([0.5e5, 1e5, 2e5]), np.array([0.0, 0.1, 0.2])
    run = run_of({"pressure": pressure, "contraction": contraction, "force": np.zeros(3)})
    for muscle in (BraidedMuscle(), EmpiricalMuscle()):
        expected = muscle_force(muscle, pressure, contraction)
        np.testing.assert_allclose(predict(MuscleModel(muscle), run)["force"], expected, rtol=1e-14)
    # A position is a contraction of the resting length.
    moved = run_of({"pressure": pressure, "position": 1.5 * contraction, "force": np.zeros(3)})
    model = MuscleModel(BraidedMuscle(), length=1.5)
    np.testing.assert_allclose(
        predict(model, moved)["force"], muscle_force(BraidedMuscle(), pressure, contraction)
    )


def test_friction_takes_from_the_force_while_filling():
    channels = {
        "pressure": np.full(4, 2e5),
        "contraction": np.full(4, 0.1),
        "phase": ["fill", "fill", "exhaust", "exhaust"],
        "force": np.zeros(4),
    }
    run = run_of(channels, {"friction": "coulomb"})
    model = giajax.replace(model_for([run]), {"friction.half_width": 0.7})
    without = float(muscle_force(BraidedMuscle(), 2e5, 0.1))
    np.testing.assert_allclose(
        predict(model, run)["force"] - without, [-0.7, -0.7, 0.7, 0.7], rtol=1e-12
    )


def test_friction_follows_the_motion():
    """Both ways to specify the direction agree, except near the turning points."""
    times = np.linspace(0, 4, 401)
    position = 0.1 * (1 - np.abs((times % 2) - 1))  # in and out, twice
    pressure = np.full(401, 2e5)
    for law, own in ((BraidedMuscle(), 1), (Piston(), -1)):
        channels = {"pressure": pressure, "position": position, "force": np.zeros(401)}
        run = run_of(channels, {"law": law.name, "friction": "coulomb"}, times)
        model = giajax.replace(
            model_for([run]), {"friction.half_width": 0.7, "friction.presliding": 1e-3}
        )
        frictionless = MuscleModel(model.muscle, None, model.length)
        friction = predict(model, run)["force"] - predict(frictionless, run)["force"]
        velocity = np.gradient(position, times)
        sliding = np.abs(np.abs((times % 1) - 0.5)) < 0.45
        np.testing.assert_allclose(
            friction[sliding], -own * 0.7 * np.sign(velocity[sliding]), rtol=1e-9
        )
        # Dry friction must dissipate energy over the loop.
        assert np.all(np.abs(friction) <= 0.7 * (1 + 1e-12))
        work = -own * np.sum(friction[1:] * np.diff(position))
        assert work > 0


def test_half_widths_are_linear_between_their_pressures():
    friction = Friction.at_pressures((1e5, 3e5))
    friction = giajax.replace(friction, {"half_width[0]": 2.0, "half_width[1]": 6.0})
    widths = friction.width(np.array([0.5e5, 1e5, 2e5, 3e5, 9e5]))
    np.testing.assert_allclose(widths, [2, 2, 4, 6, 6])
    with pytest.raises(InputError, match="friction pressures do not increase"):
        Friction.at_pressures((3e5, 1e5))


def test_the_sidecar_states_the_muscle_and_comes_back():
    section = {
        "law": "braided",
        "length_m": 1.5,
        "diameter_m": 0.0045,
        "braid_angle_deg": 20.0,
        "pressure_limit_kPa": 250.0,
        "pressure": "mean",
        "friction": "coulomb",
        "friction_pressures_kPa": [50.0, 150.0],
    }
    channels = {"pressure": [1e5, 3e5], "contraction": [0.1, 0.1], "phase": ["fill"] * 2}
    run = run_of({**channels, "force": [1.0, 1.0]}, section)
    model = model_for([run])
    found = model.definition()["muscle"]
    assert {k: found[k] for k in section} == {
        key: pytest.approx(value) if key == "braid_angle_deg" else value
        for key, value in section.items()
    }
    force = predict(model, run)["force"]
    assert force[0] == force[1]  # the mean pressure
    again = giajax.build_model("muscle", model.definition(), {})
    np.testing.assert_array_equal(predict(again, run)["force"], force)


@pytest.mark.parametrize(
    ("channels", "section", "sentence"),
    [
        ({"contraction": [0.1], "force": [1.0]}, {}, "has no pressure"),
        ({"pressure": [1e5], "force": [1.0]}, {}, "neither contraction nor position"),
        (
            {"pressure": [1e5], "position": [0.1], "force": [1.0]},
            {"law": "piston"},
            "friction requires the direction",
        ),
        ({"pressure": [np.nan, 1e5], "contraction": [0.1] * 2, "force": [1.0] * 2}, {}, "is empty"),
    ],
)
def test_a_bad_run_is_refused_with_a_sentence(channels, section, sentence):
    with pytest.raises(InputError, match=sentence):
        Run.from_arrays(None, channels, definition={"model": "muscle", "muscle": section})


@pytest.mark.parametrize(
    ("section", "sentence"),
    [
        ({"law": "empirical", "diameter_m": 0.003}, "'empirical' does not have it"),
        ({"friction_pressures_kPa": [10.0]}, "but no friction"),
        ({"friction": "coulomb", "friction_pressures_kPa": [10.0, 5.0]}, "must increase"),
        ({"law": "ideal"}, "braided"),
    ],
)
def test_a_bad_section_is_refused_with_a_sentence(section, sentence):
    channels = {"pressure": [1e5], "contraction": [0.1], "phase": ["fill"], "force": [1.0]}
    with pytest.raises(InputError, match=sentence):
        model_for([run_of(channels, section)])


def test_runs_that_disagree_are_refused():
    channels = {"pressure": [1e5], "contraction": [0.1], "force": [1.0]}
    runs = [run_of(channels, {"length_m": 1.0}), run_of(channels, {"length_m": 1.2})]
    with pytest.raises(InputError, match=r"disagree in \[muscle\] length_m"):
        model_for(runs)


def cylinder(section=None):
    definition = giajax.Definition.parse({"muscle": section or {}})
    return [
        read_run(PISTON / f"O-ring257_{bar}bar.csv", definition=definition) for bar in (1, 3, 5, 7)
    ]


@pytest.mark.slow
def test_the_bore_of_a_real_cylinder():
    """Fit of four pressures: bore within 0.5 % of 25.7 mm, and friction that increases."""
    start = {"muscle.bore": 0.04, "friction.half_width": 2.0, "friction.presliding": 1e-3}
    widths = {}
    for pressure, expected in (
        ("measured", [4.6, 5.75, 6.95, 7.6]),
        # The whole loop at the set pressure.
        ("mean", [7.0, 8.5, 10.0, 12.0]),
    ):
        runs = cylinder({"pressure": pressure})
        # The residuals are correlated friction effects that the model omits, not noise.
        result = fit(model_for(runs), runs, start=start, noise_model="white")
        assert result.status == "converged"
        found = {path: estimate.value for path, estimate in result.free.items()}
        assert found["muscle.bore"] == pytest.approx(25.7e-3, rel=0.005)
        widths[pressure] = np.array([found[f"friction.half_width[{i}]"] for i in range(4)])
        np.testing.assert_allclose(widths[pressure], expected, rtol=0.06)
        assert np.all(np.diff(widths[pressure]) > 0)
        assert result.gradient_check.relative_difference < 1e-6
    # The pressure variation at the gauge causes 2 to 4 N of the loop, due to the regulator.
    swing = [np.pi / 4 * 25.7e-3**2 * np.std(run.values["pressure"]) for run in cylinder()]
    np.testing.assert_allclose(widths["mean"] - widths["measured"], swing, rtol=0.2)


def test_the_runs_of_the_cylinder_are_whole():
    for run, rows in zip(cylinder(), (5828, 6340, 7090, 8557), strict=True):
        assert len(run.times) == rows
        assert run.definition.sha256 == run.sha256
        assert run.definition.licence == "CC0-1.0"
        assert "EvaZillen" in run.definition.origin
    assert (PISTON / "LICENSE").read_text().startswith("Creative Commons Legal Code")
