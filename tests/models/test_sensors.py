"""Sensors between motion and recording: known transformations, derivatives, a fit."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import giajax
from giajax import ArmModel, InputError, Run
from giajax.apps.synthetic import RecordingErrors, synthesise, with_errors
from giajax.mechanics.arm import link_centres, tip_position
from giajax.models import Camera, Marker, Sensors, build_model, model_for, parameter_values
from giajax.studies import sensitivity

LINKS = 3
TIMES = np.linspace(0.0, 4.0, 41)
COMMAND = {
    "joint01_command": np.interp(TIMES, [0.3, 1.0], [0.0, 0.6]),
    "joint02_command": np.interp(TIMES, [1.0, 2.0], [0.0, -0.5]),
}
CHANNELS = tuple(f"link{i:02d}_{axis}" for i in range(1, LINKS + 1) for axis in "xyz")
EVERYTHING = (*CHANNELS, "tip_x", "tip_y", "tip_z", "joint01_angle", "joint02_rate", "link03_angle")
EACH = {
    "camera.rotation": [0.3, -0.2, 0.1],
    "camera.origin": [0.1, -0.2, 0.3],
    "camera.scale": 1.1,
    "camera.delay": 0.13,
    "camera.clock_rate": 0.03,
    "camera.lens_k1": -0.1,
    "camera.lens_k2": 0.05,
    "marker.along": 0.05,
    "marker.left": [0.1, 0.0, -0.1],
    "marker.up": 0.15,
    "marker.tip": [0.02, 0.03, 0.04],
    "encoder.offset": [0.1, -0.1, 0.05],
    "encoder.scale": 0.9,
    "encoder.delay": -0.07,
    "encoder.clock_rate": -0.02,
    "encoder.rate_offset": 0.2,
}


def model(**changes):
    parameters = {"joints.pitch_stiffness": 2.0, "joints.yaw_stiffness": 5.0, **changes}
    return giajax.replace(ArmModel(giajax.takeichi_20m(LINKS), tolerance=1e-9), parameters)


def run_of(command=COMMAND, **definition):
    blank = {"link01_z": np.zeros_like(TIMES)}
    return Run.from_arrays(
        TIMES, {**command, **blank}, definition={"arm": {"links": LINKS}, **definition}
    )


NEUTRAL = {
    path: np.broadcast_to(off.declaration.default, np.shape(EACH[path])).astype(float)
    for path, off in giajax.schema.parameters.left_out(model()).items()
    if path in EACH
}


def with_all_sensors(**changes):
    """Return a model with all sensors at neutral values except these, which shares one program."""
    return model(**NEUTRAL | changes)


@pytest.fixture(scope="module")
def plain():
    return giajax.predict(model(), run_of(), EVERYTHING)


def points(channels):
    return np.stack([channels[name] for name in CHANNELS], -1).reshape(len(TIMES), LINKS, 3)


def test_what_is_left_out_is_not_there():
    assert jax.tree.leaves(Sensors()) == []
    arm, angles = giajax.takeichi_20m(LINKS), jnp.asarray([0.3, -0.2, 0.5])
    np.testing.assert_array_equal(Marker().on_links(arm, angles), link_centres(arm, angles))
    np.testing.assert_allclose(Marker().at_tip(arm, angles), tip_position(arm, angles), rtol=1e-15)
    positions = jnp.ones((2, 3))
    assert Camera().sees(positions) is positions


@pytest.mark.slow
def test_a_camera_turned_by_a_right_angle(plain):
    """The camera's x axis is y of the base, and its y axis is -x of the base."""
    turned = with_all_sensors(**{"camera.rotation": [0.0, 0.0, np.pi / 2]})
    seen = points(giajax.predict(turned, run_of(), EVERYTHING))
    x, y, z = np.moveaxis(points(plain), -1, 0)
    np.testing.assert_allclose(seen, np.stack([y, -x, z], -1), atol=1e-12)


@pytest.mark.slow
def test_scale_acts_on_what_is_seen_from_the_origin(plain):
    changes = {"camera.origin": [0.1, 0.2, -0.3], "camera.scale": 2.0}
    changes["camera.rotation"] = [np.pi, 0.0, 0.0]
    seen = giajax.predict(with_all_sensors(**changes), run_of(), EVERYTHING)
    expected = 2 * (points(plain) - [0.1, 0.2, -0.3]) * [1, -1, -1]
    np.testing.assert_allclose(points(seen), expected, atol=1e-12)
    np.testing.assert_allclose(seen["tip_z"], -2 * (plain["tip_z"] + 0.3), atol=1e-12)
    # Equal except for rounding, because a model with a camera is another program.
    np.testing.assert_allclose(seen["joint01_angle"], plain["joint01_angle"], rtol=1e-12)


@pytest.mark.slow
def test_a_lens_draws_everything_to_the_middle_of_the_straight_arm(plain):
    lens = with_all_sensors(**{"camera.lens_k1": -0.1, "camera.lens_k2": 0.02})
    seen = points(giajax.predict(lens, run_of(), EVERYTHING))
    middle = np.array([LINKS * 0.99 / 2, 0.0, 0.0])
    away = points(plain) - middle
    square = np.sum(away**2, axis=-1, keepdims=True) / middle[0] ** 2
    expected = middle + away * (1 - 0.1 * square + 0.02 * square**2)
    np.testing.assert_allclose(seen, expected, atol=1e-12)
    assert np.max(np.abs(expected - points(plain))) > 0.05


def test_markers_move_with_their_link():
    """The base joint raises the arm upright: along is z, left is y and up is -x of the base."""
    arm, upright = giajax.takeichi_20m(LINKS), jnp.asarray([np.pi / 2, 0.0, 0.0])
    marker = Marker(along=0.1, left=[0.2, 0.0, 0.0], up=0.3, tip=[0.1, 0.2, 0.3])
    shift = marker.on_links(arm, upright) - link_centres(arm, upright)
    np.testing.assert_allclose(shift[0], [-0.3, 0.2, 0.1], atol=1e-12)
    np.testing.assert_allclose(shift[1], [-0.3, 0.0, 0.1], atol=1e-12)
    shift = marker.at_tip(arm, upright) - tip_position(arm, upright)
    np.testing.assert_allclose(shift, [-0.3, 0.2, 0.1], atol=1e-12)


def test_angle_sensors_have_a_zero_and_a_scale(plain):
    changes = {"encoder.offset": [0.1, 0.2, 0.4], "encoder.scale": 1.5, "encoder.rate_offset": 0.3}
    seen = giajax.predict(model(**changes), run_of(), EVERYTHING)
    np.testing.assert_allclose(seen["joint01_angle"], 1.5 * plain["joint01_angle"] + 0.1)
    np.testing.assert_allclose(seen["joint02_rate"], 1.5 * plain["joint02_rate"] + 0.3)
    # Absolute angles are sums of the measured joint angles.
    np.testing.assert_allclose(seen["link03_angle"], 1.5 * plain["link03_angle"] + 0.7, atol=1e-12)
    np.testing.assert_array_equal(seen["link03_z"], plain["link03_z"])


def test_a_state_in_the_first_row_is_free_of_what_a_gyroscope_shows_at_rest():
    """The initial rate is the recorded one minus the offset, divided by the scale."""
    values = {"joint01_angle": [0.4, 0.4], "joint01_rate": [0.5, 0.5]}
    about = {"arm": {"preset": "pendulum", "links": 1}, "initial": {"first_row": True}}
    run = Run.from_arrays([0.0, 0.1], values, definition=about)
    sensors = {"encoder.rate_offset": 0.2, "encoder.scale": 1.5, "encoder.offset": 0.1}
    begun = giajax.replace(model_for([run]), sensors).prepare(run).initial
    np.testing.assert_allclose([begun.angle[0], begun.rate[0]], [0.2, 0.2])


def test_a_first_row_whose_angle_was_lost_begins_on_the_line_of_the_next_ones():
    values = {"joint01_angle": [np.nan, 0.6, 0.5, 0.4], "joint01_rate": [-1.0] * 4}
    about = {
        "arm": {"preset": "pendulum", "links": 1},
        "initial": {"first_row": True, "free": True},
    }
    run = Run.from_arrays([0.0, 0.1, 0.2, 0.3], values, definition=about)
    np.testing.assert_allclose(model_for([run]).prepare(run).initial.angle, [0.7])


@pytest.mark.slow
def test_a_late_camera_shows_what_was(plain):
    """With a delay of two samples, values appear two rows later; initially, the arm is at rest."""
    late = giajax.predict(with_all_sensors(**{"camera.delay": 0.2}), run_of(), EVERYTHING)
    for name in ("link03_z", "tip_y"):
        np.testing.assert_allclose(late[name][2:], plain[name][:-2], atol=1e-7)
        np.testing.assert_allclose(late[name][:2], plain[name][0], atol=1e-12)
    np.testing.assert_allclose(late["joint01_angle"], plain["joint01_angle"], atol=1e-7)


@pytest.mark.slow
def test_clocks_of_camera_and_encoder_are_their_own(plain):
    changes = {"camera.delay": 0.3, "encoder.delay": -0.1}
    seen = giajax.predict(with_all_sensors(**changes), run_of(), EVERYTHING)
    np.testing.assert_allclose(seen["link03_z"][3:], plain["link03_z"][:-3], atol=1e-7)
    for name in ("joint01_angle", "joint02_rate", "link03_angle"):
        np.testing.assert_allclose(seen[name][:-1], plain[name][1:], atol=1e-7)


@pytest.mark.slow
def test_an_early_clock_goes_on_beyond_the_end():
    """Beyond the end, the last command is held, as in a longer run."""
    longer = np.linspace(0.0, 4.3, 44)
    command = {name: np.interp(longer, TIMES, row) for name, row in COMMAND.items()}
    more = Run.from_arrays(
        longer, {**command, "tip_z": 0 * longer}, definition={"arm": {"links": LINKS}}
    )
    expected = giajax.predict(model(), more)["tip_z"][3:]
    early = with_all_sensors(**{"camera.delay": -0.3})
    seen = giajax.predict(early, run_of(), EVERYTHING)["tip_z"]
    np.testing.assert_allclose(seen, expected, atol=1e-7)


@pytest.mark.slow
def test_a_slow_clock_stretches_what_is_seen_from_the_first_sample_on():
    """The samples are those of the actual exposure times, including those after the last stamp."""
    rate, longer = 0.04, np.linspace(0.0, 4.2, 421)
    command = {name: np.interp(longer, TIMES, row) for name, row in COMMAND.items()}
    more = Run.from_arrays(
        longer, {**command, "tip_z": 0 * longer}, definition={"arm": {"links": LINKS}}
    )
    finely = giajax.predict(model(), more, ("tip_z", "joint01_angle"))
    taken = 0.1 + TIMES[1:-1] * (1 + rate)  # with a delay of -0.1 s
    slow = {"camera.clock_rate": rate, "camera.delay": -0.1}
    seen = giajax.predict(with_all_sensors(**slow), run_of(), EVERYTHING)
    expected = CubicSpline(longer, finely["tip_z"])(taken)
    np.testing.assert_allclose(seen["tip_z"][1:-1], expected, atol=1e-5)
    # The clock of the joint sensors is exact.
    np.testing.assert_allclose(seen["joint01_angle"], finely["joint01_angle"][:401:10], atol=1e-6)


def test_before_the_run_a_moving_arm_moves_on(plain):
    """The motion is extrapolated with the initial rates, which is exact to first order."""
    moving = run_of(initial={"angle_deg": 5.0, "rate_deg_per_s": 20.0})
    late = model(**{"encoder.delay": 0.15})
    angles = giajax.predict(late, moving, ("joint01_angle",))["joint01_angle"]
    rate = np.deg2rad(20.0)
    np.testing.assert_allclose(angles[0], np.deg2rad(5.0) - 0.15 * rate, atol=1e-9)
    np.testing.assert_allclose(angles[1], np.deg2rad(5.0) - 0.05 * rate, atol=1e-9)


ELEMENTS = [(path, i) for path in EACH for i in range(np.size(EACH[path]))]


@pytest.fixture(scope="module")
def recording():
    """Return the recording with all sensors enabled, as a function of a vector of their values."""
    base, inputs = model(**EACH), model().prepare(run_of())
    ends = np.cumsum([np.size(value) for value in EACH.values()])[:-1]

    def table(row):
        parts = jnp.split(row, ends)
        values = {
            path: part.reshape(np.shape(EACH[path])) for path, part in zip(EACH, parts, strict=True)
        }
        predicted, _ = giajax.replace(base, values).predict(inputs, EVERYTHING)
        return jnp.stack([predicted[name] for name in EVERYTHING])

    return jax.jit(table), jax.jit(jax.jacfwd(table))


@pytest.mark.slow
@pytest.mark.parametrize("where", [NEUTRAL, EACH], ids=["neutral", "elsewhere"])
def test_derivatives_by_every_parameter_are_those_of_differences(recording, where):
    """Once at the neutral values with the arm at rest, and once with all sensors active."""
    table, jacobian = recording
    row = np.concatenate([np.ravel(where[path]) for path in EACH])
    derivatives = jacobian(jnp.asarray(row))
    for index, (path, _) in enumerate(ELEMENTS):
        # Samples of an exact clock are at corners of the command, where the jerk is discontinuous.
        h = 1e-6 if path.endswith(("delay", "clock_rate")) else 1e-4
        step = np.zeros(len(row))
        step[index] = h
        difference = (table(jnp.asarray(row + step)) - table(jnp.asarray(row - step))) / (2 * h)
        error = derivatives[:, :, index] - difference
        size = float(jnp.linalg.norm(difference))
        assert size > 0.01, path
        assert float(jnp.linalg.norm(error)) < 1e-5 * size, path


TRUE_FRAME = {
    "camera.rotation": np.deg2rad(5.0) * np.array([2.0, -1.0, 2.0]) / 3,
    "camera.origin": 0.1 * np.array([-2.0, 2.0, 1.0]) / 3,
    "air.drag_coefficient": 1.35,
}
FRAME = [f"camera.{part}[{i}]" for part in ("rotation", "origin") for i in range(3)]


def recorded(channels=CHANNELS, command=COMMAND, sigma=0.005, **changes):
    return synthesise(
        model(**changes),
        TIMES,
        command,
        channels,
        noise={"position": sigma},
        seed=5,
        definition={"arm": {"links": LINKS}},
        constants=model(),
    )


@pytest.mark.slow
def test_a_camera_frame_is_found_together_with_the_drag_coefficient():
    run = recorded(**TRUE_FRAME)
    assert run.definition.sensors.contents() == {}
    result = giajax.fit(
        model_for([run]),
        run,
        free=["camera.rotation", "camera.origin", "air.drag_coefficient"],
        start={
            "air.drag_coefficient": 0.7,
            "joints.pitch_stiffness": 2.0,
            "joints.yaw_stiffness": 5.0,
        },
    )
    assert result.status == "converged"
    for path in (*FRAME, "air.drag_coefficient"):
        name, _, index = path.rstrip("]").partition("[")
        truth = TRUE_FRAME[name][int(index)] if index else TRUE_FRAME[name]
        found = result.parameters[path]
        assert abs(found.value - truth) < 2 * found.standard_error, path
        assert found.standard_error < 0.3 * abs(truth), path
    assert result.gradient_check.relative_difference < 1e-5


@pytest.mark.slow
def test_the_rate_of_a_clock_is_found_together_with_the_drag_coefficient():
    run = recorded(**{"camera.clock_rate": 0.02, "air.drag_coefficient": 1.35})
    free = ["camera.clock_rate", "air.drag_coefficient", "joints.pitch_stiffness"]
    start = {"joints.pitch_stiffness": 1.7, "joints.yaw_stiffness": 5.0}
    result = giajax.fit(model_for([run]), run, free=free, start=start)
    assert result.status == "converged"
    for path, truth in zip(free, (0.02, 1.35, 2.0), strict=True):
        found = result.parameters[path]
        assert abs(found.value - truth) < 3 * found.standard_error, path
        assert found.standard_error < 0.2 * truth, path
    assert result.gradient_check.relative_difference < 1e-5
    assert any(each.startswith("camera.clock_rate: relative") for each in result.conditions)


@pytest.mark.slow
def test_a_camera_frame_is_found_as_often_as_its_errors_say():
    """Over many noise realisations, 95 % of the estimates are within 2 standard errors."""
    truth = model(**TRUE_FRAME)
    blank = dict.fromkeys(CHANNELS, np.zeros_like(TIMES))
    run = Run.from_arrays(TIMES, {**COMMAND, **blank}, definition={"arm": {"links": LINKS}})
    found = sensitivity(truth, run, ["camera.rotation", "camera.origin", "air.drag_coefficient"])
    exact = {name: found.predicted[:, i] for i, name in enumerate(CHANNELS)}
    exact_run = Run.from_arrays(TIMES, {**COMMAND, **exact}, definition={"arm": {"links": LINKS}})
    jacobian = np.stack([table.ravel() for table in found.derivatives], axis=1)
    stated = found.standard_errors(0.005)
    errors = []
    for seed in range(200):
        noisy = with_errors(exact_run, RecordingErrors(white={"position": 0.005}), seed=seed)
        residual = np.stack([noisy.values[name] - exact[name] for name in CHANNELS], axis=-1)
        errors.append(np.linalg.lstsq(jacobian, residual.ravel(), rcond=None)[0] / stated)
    within = np.mean(np.abs(errors) < 2, axis=0)
    assert np.all((within > 0.90) & (within < 0.99))
    assert np.mean(within) == pytest.approx(0.954, abs=0.02)


@pytest.mark.slow
def test_a_camera_frame_that_is_ignored_spoils_the_fit():
    """Without the parameters of the camera, the residuals show that something is wrong."""
    run = recorded(**TRUE_FRAME)
    result = giajax.fit(model_for([run]), run, free=["air.drag_coefficient"], check=False)
    assert result.reduced_chi_square > 20


@pytest.mark.slow
def test_what_a_planar_recording_cannot_tell_of_the_frame_is_named():
    """From heights in a pitch motion, rotations about x or z and shifts along x or y are hidden."""
    planar = {"joint01_command": COMMAND["joint01_command"]}
    run = recorded(("link01_z", "link02_z", "link03_z"), planar)
    free = ["camera.rotation", "camera.origin", "air.drag_coefficient"]
    start = {"joints.pitch_stiffness": 2.0, "air.drag_coefficient": 0.9}
    found = giajax.fit(model_for([run]), run, free=free, start=start, check=False).parameters
    for path in ("camera.rotation[0]", "camera.rotation[2]", "camera.origin[0]"):
        assert "no channel responds" in found[path].remark
    assert found["camera.rotation[1]"].standard_error < 0.01
    assert found["camera.origin[2]"].standard_error < 0.01


@pytest.mark.slow
def test_the_turn_of_base_and_camera_are_one():
    """Without gravity and wind, only the rotation of the arm relative to the camera matters."""
    run = recorded(**TRUE_FRAME)
    result = giajax.fit(
        model_for([run]), run, free=["camera.rotation", "base_rotation"], check=False
    )
    for index in range(3):
        remark = result.parameters[f"camera.rotation[{index}]"].remark
        assert "only a combination" in remark
        assert "base_rotation" in remark


STATED = {
    "camera_rotation_deg": [5.0, 0.0, 0.0],
    "camera_origin_m": [0.0, 0.1, 0.0],
    "camera_scale": 1.02,
    "camera_delay_s": 0.05,
    "camera_clock_rate": 0.05,
    "camera_lens_k1": -0.05,
    "camera_lens_k2": 0.05,
    "marker_along_m": 0.1,
    "marker_left_m": [0.1, 0.2, 0.3],
    "marker_up_m": 0.15,
    "marker_tip_m": [0.1, 0.0, 0.0],
    "encoder_offset_deg": [1.0, 2.0, 3.0],
    "encoder_scale": 0.98,
    "encoder_delay_s": -0.02,
    "encoder_clock_rate": -0.05,
}


OFF = {
    key: np.full(np.shape(value), 1.0 if key.endswith("scale") else 0.0).tolist()
    for key, value in STATED.items()
}


@pytest.mark.slow
@pytest.mark.parametrize("key", STATED)
def test_each_key_of_the_section_changes_the_prediction(key):
    stated = model_for([run_of(sensors=OFF | {key: STATED[key]})])
    off = model_for([run_of(sensors=OFF)])
    names = ("link03_x", "link03_y", "link03_z", "tip_x", "joint02_angle")
    one, other = (giajax.predict(m, run_of(), names) for m in (stated, off))
    changed = {name for name in names if np.abs(one[name] - other[name]).max() > 1e-3}
    prefixes = {"camera": ("link", "tip"), "marker": ("link", "tip"), "encoder": ("joint",)}
    assert changed
    assert all(name.startswith(prefixes[key.partition("_")[0]]) for name in changed)
    # The stored form gives the same model.
    again = build_model("arm", stated.definition(), parameter_values(stated))
    assert eqx.tree_equal(again, stated, rtol=1e-14, atol=1e-15)


def test_stated_angles_are_degrees():
    stated = model_for([run_of(sensors={"camera_rotation_deg": [90.0, 0.0, 0.0]})])
    np.testing.assert_allclose(stated.sensors.camera.rotation, [np.pi / 2, 0, 0], rtol=1e-15)


def test_recordings_that_disagree_about_the_sensors_are_refused():
    one, two = run_of(sensors={"camera_delay_s": 0.1}), run_of()
    with pytest.raises(InputError, match=r"\[sensors\] camera_delay_s \(0.1 and nothing\)"):
        model_for([one, two])
    with pytest.raises(InputError, match=r"\[sensors\] camera_delay_s \(nothing and 0.1\)"):
        model_for([two, one])


def test_lists_of_another_length_are_refused():
    with pytest.raises(
        InputError, match=r"key marker_up_m has 2 values, but must have one for each of the 3 links"
    ):
        model_for([run_of(sensors={"marker_up_m": [0.1, 0.2]})])


def test_what_the_sensors_are_conditional_on_is_said():
    sentences = model(**EACH).conditions(["camera.scale", "camera.delay", "encoder.offset"], [])
    assert any(s.startswith("camera.scale: valid for links.length = 0.99 m") for s in sentences)
    assert any(s.startswith("camera.delay: relative to the clock") for s in sentences)
    assert any(s.startswith("encoder.offset: relative to") for s in sentences)
    assert model(**EACH).conditions(["camera.rotation[0]"], []) == []


def test_a_first_row_read_by_a_sensor_that_is_fitted_is_said():
    def told(path="encoder.scale", **initial):
        sentences = model(**EACH).conditions([path], [run_of(initial=initial)])
        return any("computed from the first row with the start value" in s for s in sentences)

    assert told(first_row=True)
    assert told("encoder.rate_offset", first_row=True)
    assert not told(first_row=True, free=True)
    assert not told(angle_deg=0.0)


def test_no_channel_is_parsed_inside_a_trace(monkeypatch):
    """Names are parsed once, when a run is prepared, and looked up while the program is traced."""
    some, inputs = model(), model().prepare(run_of())

    def parsed(name):
        raise AssertionError(f"{name} is parsed again")

    monkeypatch.setattr("giajax.recordings._channels.match_name", parsed)
    jax.eval_shape(lambda it: some.predict(it, ("link01_z",)), inputs)
    with pytest.raises(AssertionError, match="link77_x is parsed"):
        some.predict(inputs, ("link77_x",))
