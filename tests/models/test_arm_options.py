"""The options of the arm as a model: written to files and read back, and fitted."""

import equinox as eqx
import jax
import numpy as np
import pytest

import giajax
from giajax import InputError, Run
from giajax.fitting import fit
from giajax.models import (
    ArmModel,
    arm_from_definition,
    arm_to_definition,
    build_model,
    parameter_values,
)
from giajax.recordings import Definition
from giajax.simulation import ramps, simulate
from peers.arms import full_arm

TIMES = np.linspace(0.0, 3.0, 31)
RAMP = np.clip(TIMES - 0.3, 0, 0.7)


def through_toml(definition):
    return Definition.parse({"arm": definition})


def test_axes_are_named_where_they_have_a_name():
    axes = [[0.0, -1.0, 0.0], [0.0, -1.0, 0.0]]
    assert (
        arm_to_definition(arm_from_definition(through_toml({"joint_axes": axes})))["joint_axes"]
        == axes
    )
    named = arm_from_definition(through_toml({"links": 2}))
    assert arm_to_definition(named)["joint_axes"] == "pitch_yaw"


@pytest.mark.parametrize("links", [1, 3])
def test_a_full_arm_goes_through_its_definition(links):
    model = ArmModel(full_arm(links))
    again = build_model("arm", model.definition(), parameter_values(model))
    # In the file, the rotation of the base is in degrees, which causes rounding.
    assert eqx.tree_equal(again.arm, model.arm, rtol=1e-14, atol=1e-15)
    # Parameters that a fit frees by default are not constants; the constants are read back.
    constants = arm_from_definition(through_toml(arm_to_definition(model.arm)))
    again, stated = arm_to_definition(constants), arm_to_definition(model.arm)
    np.testing.assert_allclose(again.pop("base_rotation_deg"), stated.pop("base_rotation_deg"))
    assert again == stated


def test_the_floating_preset_goes_through_its_definition():
    arm = giajax.takeichi_20m_full(5)
    again = arm_from_definition(through_toml(arm_to_definition(arm)))
    assert eqx.tree_equal(again, arm, rtol=1e-15, atol=0)


@pytest.mark.parametrize(
    ("section", "same"),
    [
        ({"links": 3, "drag": "strip", "strip_points": 5}, {"drag": "strip", "strip_points": 5}),
        ({"links": 3, "drag_curve": "cylinder"}, {"drag_curve": "cylinder"}),
        ({"links": 3, "trim": True, "gravity_m_per_s2": 9.8}, {"trim": True, "gravity": 9.8}),
        (
            {"links": 3, "parameters": {"air": {"added_mass_coefficient": 0.9}}},
            {"parameters": {"air.added_mass_coefficient": 0.9}},
        ),
        (
            {"links": 3, "buoyancy": True, "parameters": {"buoyancy.imbalance": [0.1, 0.2, 0.3]}},
            {"buoyancy": True, "parameters": {"buoyancy.imbalance": [0.1, 0.2, 0.3]}},
        ),
    ],
)
def test_every_key_is_an_argument_of_chain(section, same):
    stated = arm_from_definition(through_toml(section))
    assert eqx.tree_equal(stated, giajax.takeichi_20m(3, **same))
    assert not eqx.tree_equal(stated, giajax.takeichi_20m(3))


def run_of(model, channels, **changes):
    values = {"joint01_command": RAMP, **dict.fromkeys(channels, np.zeros_like(TIMES))}
    blank = Run.from_arrays(TIMES, values, **changes)
    exact = giajax.predict(model, blank)
    random = np.random.default_rng(3)
    noisy = {name: value + random.normal(scale=1e-3, size=31) for name, value in exact.items()}
    return Run.from_arrays(TIMES, values | noisy, noise={"position": 1e-3}, **changes)


@pytest.fixture(scope="module")
def fitted():
    """Fit added mass, friction and a wind of a short arm."""
    options = {
        "air.added_mass_coefficient": 0.9,
        "air.wind": [0.1, 0.2, -0.3],
        "joints.friction": 0.06,
    }
    truth = ArmModel(giajax.takeichi_20m(2, drag="strip", parameters=options))
    section = arm_to_definition(truth.arm)
    run = run_of(
        truth, ("link01_z", "link02_x", "link02_y", "link02_z"), definition={"arm": section}
    )
    start = {
        "air.added_mass_coefficient": 0.4,
        "joints.friction": 0.15,
        "air.wind[1]": 0.05,
        "air.wind[2]": -0.1,
    }
    held = (
        "air.drag_coefficient",
        "joints.pitch_stiffness",
        "joints.damping",
        "joints.yaw_stiffness",
    )
    known = {path: float(giajax.get(truth, path)) for path in held}
    model = ArmModel(arm_from_definition(through_toml(section)))
    result = fit(model, run, free=list(start), start=start, fix=known, nuisances=False)
    return truth, run, result


@pytest.mark.slow
def test_options_are_fitted(fitted):
    truth, _, result = fitted
    assert result.status == "converged", result.message
    for path, estimate in result.free.items():
        value = float(giajax.schema.parameters.find(truth, path).value(truth))
        assert abs(estimate.value - value) < 3 * estimate.standard_error, path
        assert estimate.standard_error < 0.2 * abs(value), path
    assert result.gradient_check.relative_difference < 1e-5


@pytest.mark.slow
def test_a_result_with_options_rebuilds_its_model(fitted, tmp_path):
    _, run, result = fitted
    (tmp_path / "result.json").write_text(result.to_json())
    loaded = giajax.load_result(tmp_path)
    for name, values in result.predict(run).items():
        np.testing.assert_allclose(loaded.predict(run)[name], values, rtol=0, atol=1e-12)
    assert loaded.parameters == result.parameters


def test_a_wind_that_jumps_is_refused_where_added_mass_is_on():
    gust = {"wind_y": np.where(TIMES < 1, 0.0, 0.5), "joint01_command": RAMP, "tip_z": 0 * TIMES}
    section = {"links": 2, "parameters": {"air.added_mass_coefficient": 1.0}}
    for interpolation, jumps in ("zoh", True), ("linear", False):
        definition = {"arm": section, "wind": {"interpolation": interpolation}}
        run = Run.from_arrays(TIMES, gust, definition=definition)
        model = giajax.model_for([run])
        if jumps:
            with pytest.raises(
                InputError, match=r"the wind is discontinuous, .* \(interpolation = \"linear\""
            ):
                model.prepare(run)
        else:
            model.prepare(run)


def test_a_stiffness_that_drifts_and_one_for_each_joint():
    """Compared with another method, differences, and an arm with the final stiffness."""
    model = ArmModel(giajax.takeichi_20m(2))
    fast = {"joint01_command": RAMP, "tip_z": 0 * TIMES}
    run = giajax.Run.from_arrays(TIMES, fast, definition={"arm": {"links": 2}})
    inputs = model.prepare(run)

    def tip(drift, **integration):
        there = giajax.replace(model, {"joints.stiffness_drift": drift})
        there = there.with_integration(**integration)
        return there.predict(inputs, ("tip_z",))[0]["tip_z"]

    ours = {"solver": "springs5", "tolerance": 1e-10}
    leaking = tip(-0.05, **ours)
    other = tip(-0.05, solver="tsit5", tolerance=1e-11)
    np.testing.assert_allclose(leaking, other, rtol=0, atol=1e-8)
    still = model.with_integration(**ours).predict(inputs, ("tip_z",))[0]["tip_z"]
    assert np.max(np.abs(leaking - still)) > 1e-3
    np.testing.assert_allclose(tip(0.0, **ours), still, rtol=0, atol=1e-9)
    slope = jax.jvp(lambda drift: tip(drift, **ours), (-0.05,), (1.0,))[1]
    differences = (tip(-0.05 + 1e-4, **ours) - tip(-0.05 - 1e-4, **ours)) / 2e-4
    np.testing.assert_allclose(slope, differences, rtol=0, atol=1e-4 * np.max(np.abs(slope)))
    joints = giajax.replace(
        model, {"joints.stiffness_drift": -0.05, "joints.stiffness_factor": [1.0, 2.0]}
    ).arm.joints
    own = model.arm.joints.stiffness
    np.testing.assert_allclose(joints.stiffness, own * np.array([1.0, 2.0]))
    np.testing.assert_allclose(joints.at_time(4.0).stiffness, own * np.array([0.8, 1.6]))
    np.testing.assert_allclose(joints.at_time(40.0).stiffness, 0)


def test_lift_that_drifts_bends_a_joint_as_slowly():
    """For a floating link, the torque of the lift at its centre equals that of the spring."""
    drift, stiffness, times = -1e-3, 2.0, np.linspace(0.0, 30.0, 4)
    values = {"buoyancy.imbalance_drift": drift, "joints.pitch_stiffness": stiffness}
    arm = giajax.takeichi_20m(1, trim=True, gravity=9.81, parameters=values)
    found = simulate(arm, ramps([0.0], [[0.0]]), times, solver="springs5")
    behind = 0.05 / stiffness  # s, delay due to the damper
    expected = drift * (times - behind) * 0.99 / 2 / stiffness
    np.testing.assert_allclose(found.angles[1:, 0], expected[1:], rtol=5e-3)


def test_drives_that_saturate_are_those_of_commands_that_do():
    """A saturated command is not linear between rows, so the comparison uses dense rows."""
    arm, times = giajax.takeichi_20m(2), np.linspace(0.0, 1.5, 1501)
    commands = np.stack([np.clip(times, 0, 0.9), -0.5 * np.clip(times, 0.2, 0.7)], axis=1)
    size = np.array([1.2, 0.4])
    shown = commands / np.sqrt(1 + size * commands**2)
    weak = giajax.replace(arm, {"joints.drive_saturation": size})
    exact = {"rtol": 1e-9, "atol": 1e-9}
    found = simulate(weak, ramps(times, commands), times[::100], **exact)
    other = simulate(arm, ramps(times, shown, tolerance=1e-9), times[::100], **exact)
    np.testing.assert_allclose(found.angles, other.angles, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.followed, shown[::100], rtol=0, atol=1e-12)
    assert np.max(np.abs(commands - shown)) > 0.1


def test_drives_with_a_gain_are_those_of_smaller_commands():
    model = ArmModel(giajax.takeichi_20m(2))

    def tip(model, gain):
        fast = {"joint01_command": gain * RAMP, "tip_z": 0 * TIMES}
        run = giajax.Run.from_arrays(TIMES, fast, definition={"arm": {"links": 2}})
        return model.predict(model.prepare(run), ("tip_z",))[0]["tip_z"]

    weak = giajax.replace(model, {"joints.drive_gain": 0.9})
    np.testing.assert_allclose(tip(weak, 1.0), tip(model, 0.9), rtol=0, atol=1e-7)
    lagging = giajax.replace(weak, {"joints.drive_lag": 0.2})
    late = giajax.replace(model, {"joints.drive_lag": 0.2})
    np.testing.assert_allclose(tip(lagging, 1.0), tip(late, 0.9), rtol=0, atol=1e-7)
