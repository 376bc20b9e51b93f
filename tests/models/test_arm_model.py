"""The arm as a model: its predictions, and fits with accurate estimates and honest errors."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import InputError, Run
from giajax.fitting import (
    Bijector,
    Layout,
    Noise,
    Problem,
    build_batches,
    fit,
    loss_of,
    residual,
)
from giajax.models import ArmModel, arm_to_definition, build_model, model_for, parameter_values
from giajax.recordings import Channel
from giajax.simulation import logged

TIMES = np.linspace(0.0, 6.0, 61)
LINKS = 4
TRUTH = {
    "air.drag_coefficient": 1.3,
    "joints.pitch_stiffness": 2.0,
    "joints.yaw_stiffness": 5.0,
    "joints.damping": 0.08,
}
START = {
    path: value * factor
    for (path, value), factor in zip(TRUTH.items(), (0.5, 2, 0.6, 3), strict=True)
}


def ramp(angle):
    return np.clip(TIMES - 0.5, 0, 1) * angle


def recorded(values, **changes):
    arguments = {"definition": {"arm": {"links": LINKS}}, **changes}
    return Run.from_arrays(TIMES, values, **arguments)


def commands():
    return {"joint01_command": ramp(0.6), "joint02_command": ramp(-0.4)}


def truth_model():
    return ArmModel(giajax.replace(giajax.takeichi_20m(LINKS), TRUTH))


def synthetic(*, sigma=0.005, seed=0, channels=("link02_z", "link04_y", "link04_z", "tip_x")):
    blank = recorded({**commands(), **dict.fromkeys(channels, np.zeros_like(TIMES))})
    exact = giajax.predict(truth_model(), blank)
    rng = np.random.default_rng(seed)
    noisy = {name: value + rng.normal(scale=sigma, size=61) for name, value in exact.items()}
    return recorded({**commands(), **noisy}, noise={"position": sigma})


@pytest.fixture(scope="module")
def run():
    return synthetic()


@pytest.mark.slow
def test_predictions_are_those_of_simulate(run):
    arm = truth_model().arm
    command = logged(TIMES, np.stack([ramp(0.6), ramp(-0.4), 0 * TIMES, 0 * TIMES], -1))
    motion = giajax.simulate(arm, command, TIMES, rtol=1e-9, atol=1e-9)
    names = ("link03_y", "tip_x", "joint02_angle", "joint01_rate")
    predicted = giajax.predict(truth_model(), run, names)
    expected = [motion.link_centres[:, 2, 1], motion.tip[:, 0], motion.angles[:, 1]]
    expected.append(motion.rates[:, 0])
    for name, value in zip(names, expected, strict=True):
        np.testing.assert_allclose(predicted[name], value, atol=2e-6)


@pytest.fixture(scope="module")
def result(run):
    return fit(model_for([run]), run, start=START)


@pytest.mark.slow
def test_the_truth_is_recovered(result):
    assert result.status == "converged"
    # Four of the iterations are with the estimated noise.
    assert result.iterations <= 12
    for path, value in TRUTH.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
        assert estimate.standard_error < 0.4 * value
    assert result.gradient_check.relative_difference < 1e-5
    assert result.tolerance_effect.largest_in_standard_errors < 0.01
    assert any("per unit of mass" in sentence for sentence in result.conditions)


@pytest.mark.slow
def test_a_pitch_run_does_not_determine_the_yaw_stiffness():
    command = {"joint01_command": ramp(0.6)}
    blank = recorded({**command, "link04_z": np.zeros_like(TIMES)})
    values = giajax.predict(truth_model(), blank)["link04_z"]
    noisy = values + np.random.default_rng(1).normal(scale=0.005, size=61)
    planar = recorded({**command, "link04_z": noisy}, noise={"position": 0.005})
    result = fit(model_for([planar]), planar, check=False)
    yaw = result.parameters["joints.yaw_stiffness"]
    assert "no channel responds" in yaw.remark
    assert (yaw.value, yaw.standard_error) == (30.0, None)
    assert "joints.yaw_stiffness" not in result.conditions[0].partition(":")[0]


def test_a_fitted_mass_is_conditional_on_the_forces():
    model = truth_model()
    (sentence,) = model.conditions(["links.mass[0]"], [])
    assert "fixed by links.inertia_transverse" in sentence
    assert "air.drag_coefficient = 1.3" in sentence
    everything = [path for path in giajax.declared(model) if path.startswith(("links", "j", "air"))]
    assert "no parameter fixes the scale" in model.conditions(everything, [])[0]
    assert model.conditions(["gravity"], []) == []


def test_what_an_unnamed_preset_gave_is_a_condition(run):
    """If the sidecar names no preset, fixed values from the preset are reported as a condition."""

    def said(model, free=()):
        return [each for each in model.conditions(free, [run]) if "names no preset" in each]

    model = model_for([run])
    (sentence,) = said(model)
    assert "the constants of the preset takeichi_20m are assumed" in sentence
    (sentence,) = said(model, [*giajax.schema.parameters.default_free(model), "links.mass[0]"])
    assert ": links.length, links.diameter, gravity, joint_axes of the preset" in sentence
    sizes = {"length": 0.5, "diameter": 0.1, "mass": 0.1, "joint_axes": ["yaw"] * LINKS}
    known = {"joints.yaw_stiffness": 1.0, "joints.damping": 0.1}
    assert said(ArmModel(giajax.chain(LINKS, **sizes, parameters=known))) == []


def test_long_runs_get_more_steps():
    times = np.linspace(0.0, 3000.0, 301)
    run = Run.from_arrays(
        times, {"joint01_command": 0 * times, "tip_z": 0 * times}, definition={"arm": {"links": 2}}
    )
    assert model_for([run]).max_steps == 6_000_000


@pytest.mark.slow
def test_mass_and_forces_are_only_determined_together(run):
    free = [*TRUTH, "links.mass", "links.inertia_transverse", "links.inertia_axial"]
    result = fit(model_for([run]), run, free=free, start=START, max_iterations=10, check=False)
    remark = result.parameters["air.drag_coefficient"].remark
    assert "only a combination" in remark
    assert "links.mass[" in remark
    assert result.parameters["air.drag_coefficient"].standard_error is None


def test_a_clock_that_is_off_leaves_the_prediction_and_is_a_condition(run):
    """If times are 1.2 times too large, all values with time in their unit compensate for it."""
    model, slow = truth_model(), dataclasses.replace(run, times=1.2 * run.times)
    free = ["joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping"]
    powers = [1 / 1.2**2, 1 / 1.2**2, 1 / 1.2]
    values = {p: by * giajax.get(model, p) for p, by in zip(free, powers, strict=True)}
    seen, again = giajax.predict(model, run), giajax.predict(giajax.replace(model, values), slow)
    for name in run.observations:
        np.testing.assert_allclose(again[name], seen[name], atol=1e-4)

    def said(model, runs, free):
        return [
            each for each in model.conditions(free, runs) if "seconds of the time stamps" in each
        ]

    (sentence,) = said(model, [run], free)
    scaled = "joints.pitch_stiffness, joints.yaw_stiffness by 1 / r^2 and joints.damping by 1 / r"
    assert f"{scaled} " in sentence
    turning = dataclasses.replace(
        run, values=run.values | {"joint01_rate": 0 * run.times},
        channels=run.channels | {"joint01_rate": Channel.named("joint01_rate")},
    )  # fmt: skip
    # A fixed stiffness together with a rate determines the unit of time.
    assert said(model, [run], free[::2]) == said(model, [turning], free) == []
    each = giajax.replace(model, {"joints.damping": np.full(LINKS, 0.08)})
    assert said(each, [run], [*free[:2], "joints.damping[0]"]) == []
    assert len(said(each, [run], free)) == 1
    heavy = giajax.replace(model, {"gravity": 9.81})
    for other, given in (heavy, free), (model, free[:2]), (model, ["air.drag_coefficient"]):
        assert said(other, [run], given) == []


def test_scaling_masses_and_forces_leaves_the_prediction(run):
    """This identity is the reason for the condition that every result states."""
    model = truth_model()
    scaled = giajax.replace(
        model,
        {
            path: 3 * giajax.get(model, path)
            for path in (*TRUTH, "links.mass", "links.inertia_transverse", "links.inertia_axial")
        },
    )
    one, other = giajax.predict(model, run), giajax.predict(scaled, run)
    for name in one:
        np.testing.assert_allclose(one[name], other[name], atol=1e-6)


@pytest.mark.slow
def test_the_residual_differentiates_as_differences_say(run):
    """For each parameter, at the initial guess and from rest: initially, the arm is straight."""
    model = giajax.replace(model_for([run]), START).refined(1e-4)
    bijector = Bijector.of((0.0,) * 4, (50.0, 1e3, 1e4, 1e2), list(START.values()))
    noise = Noise.of([run], "white", per_run=False)
    problem = Problem(
        model,
        build_batches(model, [run], noise, Layout.of(tuple(START), {}, 1)),
        bijector,
        tuple(START),
        loss_of("soft_l1"),
    )
    coordinate = jnp.asarray(bijector.inverse(np.array(list(START.values()))))

    @eqx.filter_jit
    def value(z):
        return residual(z, problem)[0]

    jacobian = jax.jacfwd(value)(coordinate)
    for column, direction in zip(jacobian.T, np.eye(4), strict=True):
        h = 1e-4
        difference = (value(coordinate + h * direction) - value(coordinate - h * direction)) / (
            2 * h
        )
        norm = np.linalg.norm(difference)
        assert norm > 0
        assert np.linalg.norm(column - difference) < 1e-5 * norm


@pytest.mark.slow
def test_padding_a_run_changes_nothing(run):
    """Runs of different lengths share one program, in which the last rows are repeated."""
    cut = dataclasses.replace(
        run, times=run.times[:40], values={name: v[:40] for name, v in run.values.items()}
    )
    model = truth_model()
    noise = Noise.of([run, cut], "white", per_run=False)
    (batch,) = build_batches(model, [run, cut], noise, Layout.of((), {}, 2))
    stacked = jax.vmap(lambda inputs: model.predict(inputs, batch.channels)[0])(batch.inputs)
    alone = giajax.predict(model, cut)
    for name in alone:
        np.testing.assert_allclose(stacked[name][1, :40], alone[name], atol=1e-9)


@pytest.mark.slow
def test_several_arm_runs_fit_together():
    runs = [synthetic(seed=1), synthetic(seed=2, channels=("link02_z", "link04_z"))]
    result = fit(model_for(runs), runs, start=START, check=False)
    assert result.status == "converged"
    for path, value in TRUTH.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3.5 * estimate.standard_error


@pytest.mark.slow
def test_a_stiff_trial_is_rejected_and_the_fit_goes_on(run):
    """The step limit is just large enough for the initial guess, so bolder trials fail."""
    model = ArmModel(giajax.takeichi_20m(LINKS), max_steps=700)
    result = fit(model, run, start={**START, "joints.damping": 1.5}, check=False)
    assert result.status == "converged"
    assert result.parameters["joints.damping"].value == pytest.approx(0.08, rel=0.5)


@pytest.mark.slow
def test_a_result_rebuilds_its_model(run, result, tmp_path):
    (tmp_path / "result.json").write_text(result.to_json())
    loaded = giajax.load_result(tmp_path)
    for name, values in result.predict(run).items():
        np.testing.assert_allclose(loaded.predict(run)[name], values, rtol=0, atol=1e-12)
    assert loaded.parameters == result.parameters


@pytest.mark.parametrize("content", ["", "{}", "[1]", '{"schema_version": 1, "model": "arm"}'])
def test_what_is_no_result_is_said(tmp_path, content):
    (tmp_path / "result.json").write_text(content)
    with pytest.raises(InputError, match="not a giajax result"):
        giajax.load_result(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        giajax.load_result(tmp_path / "elsewhere.json")


def test_an_arm_goes_through_its_definition():
    arm = giajax.takeichi_20m(
        3,
        length=[1.0, 0.8, 0.5],
        mass=[0.1, 0.2, 0.3],
        joint_axes=["pitch", "yaw", [1.0, 2.0, 2.0]],
        base_rotation=[0.1, -0.2, 0.3],
        gravity=9.81,
        air_density=1.1,
    )
    model = ArmModel(arm)
    again = build_model("arm", model.definition(), parameter_values(model))
    assert eqx.tree_equal(again.arm, arm, rtol=1e-14, atol=1e-15)
    assert arm_to_definition(again.arm)["links"] == 3


def test_runs_that_disagree_about_the_arm_are_refused(run):
    other = recorded(
        {**commands(), "link02_z": np.zeros_like(TIMES)},
        definition={"arm": {"links": LINKS, "link_mass_kg": 0.06}},
        name="heavier",
    )
    with pytest.raises(InputError, match=r"disagree in \[arm\] link_mass_kg"):
        model_for([run, other])


def test_the_wind_of_a_link_that_there_is_not_is_refused():
    values = {"joint01_command": 0 * TIMES, "link05_wind_x": 0 * TIMES + 0.1}
    windy = Run.from_arrays(TIMES, values)
    with pytest.raises(
        InputError, match="has a wind column for link 5, but the arm has only 4 links"
    ):
        truth_model().prepare(windy)


@pytest.mark.slow
def test_a_wind_moves_the_arm_and_steady_rows_are_merged():
    still = {"joint01_command": 0 * TIMES, "tip_z": np.zeros_like(TIMES)}
    upwards = {"wind_z": np.full_like(TIMES, 0.2)}
    calm, windy = recorded(still), recorded({**still, **upwards})
    model = truth_model()
    inputs = model.prepare(windy)
    assert inputs.wind.times.shape == (2,)
    assert np.abs(giajax.predict(model, calm)["tip_z"]).max() == 0
    assert giajax.predict(model, windy)["tip_z"][-1] > 0.1
    constant = recorded(
        still, definition={"arm": {"links": LINKS}, "wind": {"velocity_m_per_s": [0.0, 0.0, 0.2]}}
    )
    np.testing.assert_allclose(
        giajax.predict(model, constant)["tip_z"], giajax.predict(model, windy)["tip_z"], atol=1e-6
    )
