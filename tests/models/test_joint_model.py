"""The joint as a model: its predictions, invalid input, and statements of a fit."""

import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import InputError, JointModel, Run, fit, model_for, predict, synthesise
from giajax.mechanics.joint import Correction, Joint, JointGeometry, muscle_state


def run_of(degrees, sides, **more):
    count = len(degrees)
    channels = {"angle": np.deg2rad(degrees), "side": sides, "contraction": np.zeros(count), **more}
    definition = {"noise": {"contraction": 0.004}}
    return Run.from_arrays(None, channels, definition=definition)


def test_it_predicts_the_statics():
    degrees, sides = [0.0, 30.0, 0.0, -50.0], ["inner", "inner", "outer", "outer"]
    torque = np.array([0.2, 0.3, 0.4, 0.5])
    predicted = predict(
        JointModel(Joint()), run_of(degrees, sides, torque=torque), ["force", "contraction"]
    )
    for i in range(4):
        state = muscle_state(Joint(), np.deg2rad(degrees[i]), torque[i], side=sides[i])
        assert predicted["force"][i] == pytest.approx(float(state.force), rel=1e-14)
        assert predicted["contraction"][i] == pytest.approx(float(state.contraction), rel=1e-14)
    # Without a torque column, the torque is that of the joint.
    alone = predict(JointModel(Joint(torque=0.4)), run_of(degrees, sides), ["force"])
    assert alone["force"][2] == pytest.approx(predicted["force"][2], rel=1e-14)


def test_the_sidecar_states_the_joint_and_comes_back():
    section = {
        "correction": "printed",
        "blend_deg": 2.0,
        "torque_N_m": 0.25,
        "anchor_m": [0.91, 0.17],
        "wire_m": [0.02, 0.05],
        "contact_m": [0.05, 0.14],
        "wire_length_m": 0.36,
        "muscle_length_m": 1.9,
    }
    stated = Run.from_arrays(
        None, dict(run_of([10.0], ["inner"]).values), definition={"joint": section}
    )
    model = model_for([stated])
    found = model.definition()["joint"]
    assert found.pop("blend_deg") == pytest.approx(2.0)
    assert found == {key: value for key, value in section.items() if key != "blend_deg"}
    again = giajax.build_model("joint", model.definition(), {})
    assert predict(again, stated, ["force"]) == predict(model, stated, ["force"])
    # Every key has an effect.
    default = JointModel(Joint()).definition()["joint"]
    assert all(section[key] != default[key] for key in section)
    assert set(section) == set(default)


@pytest.mark.parametrize(
    ("channels", "sentence"),
    [
        ({"angle": [0.1], "contraction": [0.1]}, "has no side"),
        ({"side": ["inner"], "contraction": [0.1]}, "has no angle"),
        (
            {"angle": [0.1], "side": ["outer"], "force": [1.0]},
            "side is outer and the angle is 5.73 deg",
        ),
        (
            {"angle": [-0.1], "side": ["inner"], "force": [1.0]},
            "side is inner and the angle is -5.73 deg",
        ),
        ({"angle": [30.0], "side": ["inner"], "force": [1.0]}, "at most 90 deg"),
        ({"angle": [0.1, np.nan], "side": ["inner"] * 2, "force": [1.0, 1.0]}, "empty in sample 1"),
        ({"angle": [0.1], "side": ["left"], "force": [1.0]}, "must be inner or outer"),
    ],
)
def test_a_bad_run_is_refused_with_a_sentence(channels, sentence):
    with pytest.raises(InputError, match=sentence):
        Run.from_arrays(None, channels, definition={"model": "joint"})


def test_runs_that_disagree_and_joints_that_cannot_be_built_are_refused():
    one = run_of([10.0], ["inner"])
    other = Run.from_arrays(
        None, dict(one.values), name="other", definition={"joint": {"wire_length_m": 0.4}}
    )
    with pytest.raises(InputError, match=r"disagree in \[joint\] wire_length_m"):
        model_for([one, other])
    impossible = Run.from_arrays(
        None, dict(one.values), definition={"joint": {"wire_length_m": 0.04}}
    )
    with pytest.raises(
        InputError, match="cannot be built at 10 deg, where D_x is not less than half"
    ):
        model_for([impossible])


def recorded(degrees, truth, noise=0.02, seed=0):
    """Return both sides at the given absolute angles, with noise relative to full scale."""
    sizes = np.asarray(degrees, dtype=float)
    angle = np.deg2rad(np.concatenate([sizes, -sizes]))
    sides = ["inner"] * len(sizes) + ["outer"] * len(sizes)
    return synthesise(
        giajax.replace(JointModel(Joint()), truth),
        None,
        {"angle": angle, "side": sides},
        ["contraction", "force"],
        noise={"contraction": 0.2 * noise, "force": 3.0 * noise},
        seed=seed,
    )


@pytest.mark.slow
def test_alpha_and_beta_come_back_from_50_percent_off():
    """Noise of 2 % of full scale; within 2.5 standard errors; unidentifiable ones are named."""
    truth = {
        path: float(giajax.get(JointModel(Joint()), path)) for path in giajax.declared(Joint())
    }
    truth = {path: v for path, v in truth.items() if path.startswith(("alpha.", "beta."))}
    assert len(truth) == 7
    # Angles at intervals of 5 deg, as in an experiment, so only 0 itself is within the 2 deg of
    # beta's wedge.
    run = recorded(np.repeat(np.arange(0, 61, 5), 6), {})
    # The initial guesses are below the true values, because a threshold beyond the last angle has
    # no effect.
    start = {path: 0.5 * value for path, value in truth.items()}
    result = fit(model_for([run]), run, start=start)
    assert result.status == "converged"
    for path, value in truth.items():
        estimate = result.parameters[path]
        if path == "beta.width":
            assert estimate.standard_error is None
            assert estimate.remark.startswith("not determined")
            continue
        assert abs(estimate.value - value) < 2.5 * estimate.standard_error, path
        assert estimate.standard_error < 0.2 * abs(value) or path == "beta.offset"
    assert result.reduced_chi_square == pytest.approx(1, abs=0.3)
    assert any("geometry.anchor_x" in sentence for sentence in result.conditions)
    assert any("does not record" in sentence for sentence in result.conditions)


@pytest.mark.slow
def test_the_standard_errors_cover():
    """Over many noise realisations, well-determined coefficients are within their errors."""
    paths = ("alpha.offset", "alpha.threshold", "alpha.curvature", "beta.curvature")
    truth = {path: float(giajax.get(JointModel(Joint()), path)) for path in paths}
    away = []
    for seed in range(30):
        run = recorded(np.repeat(np.arange(0, 61, 4), 5), {}, seed=seed)
        result = fit(
            JointModel(Joint()),
            run,
            free=paths,
            start={path: 0.6 * v for path, v in truth.items()},
            check=False,
        )
        away += [
            (result.parameters[path].value - truth[path]) / result.parameters[path].standard_error
            for path in paths
        ]
    away = np.abs(away)
    assert np.mean(away < 2.5) > 0.95
    assert 0.55 < np.mean(away < 1) < 0.80


def test_a_fit_without_corrections_says_that_nothing_responds():
    run = recorded([10.0, 20.0], {})
    plain = JointModel(Joint(correction=Correction(reading="none")))
    result = fit(plain, run, start={"alpha.offset": 0.1})
    assert result.status == "not_converged"
    assert "no channel responds" in result.message


def test_an_impossible_geometry_is_a_failed_prediction():
    model = JointModel(Joint(JointGeometry(wire_length=0.05)))
    inputs = model.prepare(run_of([10.0], ["inner"]))
    predicted, successful = model.predict(inputs, ("force",))
    assert not bool(successful)
    assert jnp.isnan(predicted["force"][0])
    assert "D_x is not less than" in model.failure(inputs)
    # A wire that is too short for the other side is allowed on the way, but reported.
    short = JointModel(Joint(JointGeometry(wire_length=0.25)))
    assert bool(short.predict(inputs, ("force",))[1])
    assert "does not reach" in short.conditions(["geometry.wire_length"])[0]


def test_other_channels_are_refused():
    with pytest.raises(InputError, match="contraction, force"):
        predict(JointModel(Joint()), run_of([10.0], ["inner"]), ["pressure"])
    other = Run.from_arrays(None, {"pressure": [1e5], "contraction": [0.1], "force": [1.0]})
    with pytest.raises(InputError, match="run of the muscle model"):
        JointModel(Joint()).prepare(other)
