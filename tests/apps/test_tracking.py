"""Tracking of an arm in simulated motions, with delays, noise and wind."""

import csv
import dataclasses
import io
import json
import threading
from pathlib import Path
from time import sleep

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from docs.machinery import browse
from giajax import InputError, Run, replace
from giajax.apps.tracking import (
    BAND,
    Air,
    Bias,
    Held,
    LiveRows,
    Unknown,
    followed_live,
    judge,
    nees,
    track,
    track_facts,
    track_notes,
    track_rows,
    tracked_arm,
    unseen,
    usual_torque,
)
from giajax.apps.viewer import shown
from giajax.apps.wind import first_guess
from giajax.cli import main
from giajax.recordings import LineReader

DATA = Path(__file__).parents[2] / "data" / "synthetic"
LINKS = 4
NOISE = {"tip_x": 0.005, "tip_y": 0.005, "tip_z": 0.005, "joint01_angle": 0.002}
WIND = first_guess([0.0, 0.3, 0.0], 0.3, 5.0, 12.0)


@pytest.fixture(scope="module")
def model():
    """Return an arm without added mass, whose filters compile in half the time."""
    return giajax.ArmModel(giajax.takeichi_20m(LINKS))


@pytest.fixture(scope="module")
def full_model():
    return giajax.ArmModel(giajax.takeichi_20m_full(LINKS))


def moved(arm, times, wind=None):
    command = giajax.joint_ramps(LINKS, {1: 0.3, 2: -0.2}, start=2.0, duration=3.0)
    return giajax.simulate(arm, command, times, wind=wind), command


def recorded(arm, *, late=0.0, wind=None, seed=0, lasts=20.0):
    """Return a run with the tip delayed by `late` s, and the motion at the exposures."""
    stamps = np.linspace(0.0, lasts, round(10 * lasts) + 1)
    times = np.unique(np.concatenate([stamps, stamps - late]).round(9))
    motion, command = moved(arm, times - times[0], wind)
    command = np.asarray(jax.vmap(command)(jnp.asarray(times - times[0])))
    at = np.searchsorted(times, (stamps - late).round(9))
    now = np.searchsorted(times, stamps.round(9))
    values = {f"tip_{axis}": np.asarray(motion.tip)[at, k] for k, axis in enumerate("xyz")}
    values["joint01_angle"] = np.asarray(motion.angles)[now, 0]
    rng = np.random.default_rng(seed)
    values = {name: v + NOISE[name] * rng.normal(size=v.shape) for name, v in values.items()}
    for joint in (1, 2):
        values[f"joint{joint:02d}_command"] = command[now, joint - 1]
    true = np.concatenate([motion.angles, motion.rates], axis=1)
    return Run.from_arrays(stamps, values, noise=NOISE), times, true, np.asarray(motion.tip)


def off(found, times, true):
    """Return errors of angles and rates at events with a known truth, and their covariances."""
    at = np.minimum(np.searchsorted(times, found.times.round(9)), len(times) - 1)
    same = np.abs(times[at] - found.times) < 1e-6
    states = found.filtered
    mean = np.concatenate([states.angles, states.rates], axis=1)[same]
    root = states.root[same][:, : mean.shape[1]]
    return true[at[same]] - mean, root @ root.transpose(0, 2, 1)


def test_a_step_is_that_of_the_simulation_and_its_derivatives_are_differences(full_model):
    known = tracked_arm(
        full_model,
        list(NOISE),
        NOISE,
        air=Air(WIND, 0.1, places=2),
        biases=[Bias(("tip_x",), 0.05)],
        paths=["air.drag_coefficient"],
        torque=1e-3,
    )
    rng = np.random.default_rng(1)
    vector = jnp.asarray(0.1 * rng.normal(size=known.size))
    vector = vector.at[known.slices()["mean flow"]].set(jnp.asarray([0.0, 0.3, 0.0]))
    vector = vector.at[known.slices()["parameters"]].set(1.2)
    # The derivatives are those of the motion, to the order of the step, which is short here.
    held = Held(
        jnp.asarray(0.0),
        jnp.asarray(0.01),
        jnp.asarray(0.05 * rng.normal(size=(2, LINKS))),
        jnp.zeros((2, 3)),
    )
    step = jax.jit(lambda x: known.moved(x, held))
    shown = jax.jit(lambda x: known.shown(x, held))
    _, slope, noise = step(vector)
    _, shows = shown(vector)
    assert noise.shape[0] == known.size
    size = 1e-5
    for index in range(known.size):
        move = jnp.zeros(known.size).at[index].set(size)
        up, down = vector + move, vector - move
        np.testing.assert_allclose(
            (step(up)[0] - step(down)[0]) / (2 * size), slope[:, index], atol=2e-6
        )
        np.testing.assert_allclose(
            (shown(up)[0] - shown(down)[0]) / (2 * size), shows[:, index], atol=2e-6
        )
    # Without process noise, the arm moves as in `simulate`, in a constant wind.
    start = jnp.zeros(known.size)
    flow = jnp.asarray([0.0, 0.3, 0.0])
    start = start.at[known.slices()["mean flow"]].set(flow)
    start = start.at[known.slices()["parameters"]].set(full_model.arm.air.drag_coefficient)
    state = start
    step_on = jax.jit(
        lambda x, ramp: known.moved(x, held._replace(length=jnp.asarray(0.02), command=ramp))[0]
    )
    for k in range(50):
        ramp = jnp.full((2, LINKS), 0.002) * jnp.asarray([[k], [k + 1.0]])
        state = step_on(state, ramp)
    command = giajax.joint_ramps(LINKS, dict.fromkeys(range(1, LINKS + 1), 0.1))
    there = giajax.simulate(
        full_model.arm, command, [0.0, 1.0], wind=giajax.simulation.constant(flow)
    )
    np.testing.assert_allclose(known.arm_state(state)[0], there.angles[-1], atol=3e-4)
    np.testing.assert_allclose(known.arm_state(state)[1], there.rates[-1], atol=2e-3)
    np.testing.assert_allclose(shown(state)[0][:3], there.tip[-1], atol=1e-4)


@pytest.mark.long
def test_the_states_of_a_late_camera_are_known_as_well_as_is_said(model):
    run, times, true, tip = recorded(model.arm, late=0.5)
    late = replace(model, {"camera.delay": 0.5})
    found = track(late, run)
    errors, covariances = off(found, times, true)
    kinds = [f"joint{k + 1:02d}_{kind}" for kind in ("angle", "rate") for k in range(LINKS)]
    driven = {"joint01_command": np.zeros(len(times))}
    truth = Run.from_arrays(times, driven | dict(zip(kinds, true.T, strict=True)))
    square, share = nees(found, truth)
    expected = np.mean(np.einsum("ti,tij,tj->t", errors, np.linalg.inv(covariances), errors))
    assert square == pytest.approx(expected / errors.shape[1])
    assert square < 1.3  # measurement noise is the only random effect
    assert share > 0.93
    with pytest.raises(InputError, match="no true angle or rate"):
        nees(found, Run.from_arrays(times, driven | {"tip_x": tip[:, 0]}))
    verdict = judge(late, found)
    assert verdict.adequate, verdict.sentence
    # The smoother is more accurate than the filter, which is more accurate than the prediction.
    assert np.mean(found.smoothed.tip_deviations) < 0.9 * np.mean(found.filtered.tip_deviations)
    assert found.now is not None
    assert np.mean(found.now.tip_deviations[20:]) > np.mean(found.filtered.tip_deviations[20:])
    known = np.searchsorted(times, found.now_times.round(9))
    there = known < len(times)
    assert np.sqrt(np.mean((tip[known[there]] - found.now.tip[there])[20:] ** 2)) < 0.02


@pytest.mark.long
def test_a_wind_that_is_missing_is_called_and_one_that_is_tracked_is_found(model, monkeypatch):
    wind = giajax.simulation.constant([0.0, 0.3, 0.0])
    run, *_ = recorded(model.arm, wind=wind, lasts=40.0)
    without = judge(model, track(model, run))
    assert not without.adequate
    assert any(cause.name == "a wind with gusts" for cause in without.causes)
    monkeypatch.setenv("GIAJAX_CORES", "1")
    assert judge(model, track(model, run)) == without
    monkeypatch.undo()
    # The initial estimate has the opposite direction.
    steady = dataclasses.replace(WIND, mean=np.array([0.0, -0.2, 0.0]), deviation=1e-3)
    air = Air(steady, 0.1, drift=1e-3, places=2)
    found = track(model, run, unknown=Unknown(air=air))
    assert judge(model, found, look=False).adequate
    states = found.smoothed
    assert states.wind is not None
    assert states.wind_deviations is not None
    assert states.wind[-50, 1] == pytest.approx(0.3, abs=3 * states.wind_deviations[-50, 1])
    assert states.wind_deviations[-50, 1] < 0.06


def test_a_bias_is_found_outliers_do_not_count_and_what_is_not_seen_is_named(model):
    run, *_ = recorded(model.arm)
    values = {name: np.array(column) for name, column in run.values.items()}
    values["tip_y"] += 0.05
    values["tip_z"][60] += 3.0
    values["tip_x"][80:100] = np.nan
    shifted = Run.from_arrays(run.times, values, noise=NOISE)
    found = track(model, shifted, unknown=Unknown(biases=(Bias(("tip_y",), 0.1),)))
    assert found.smoothed.biases[-1, 0] == pytest.approx(
        0.05, abs=4 * found.smoothed.bias_deviations[-1, 0]
    )
    assert found.smoothed.bias_deviations[-1, 0] < 0.02
    event = int(np.argmin(np.abs(found.times - run.times[60])))
    column = found.arm.channels.index("tip_z")
    assert not found.used[event, column]
    assert found.nis[event] > 50**2
    assert np.max(np.abs(found.whitened)) < 6
    assert np.sum(found.there & ~found.used) == 1
    # One outlier affects neither the filter nor the verdict.
    assert np.max(found.nis) > 1e4
    assert judge(model, found, look=False).adequate


def test_what_channels_do_not_show_is_named_before_anything_is_measured(full_model):
    run, *_ = recorded(full_model.arm)
    # A bias of the camera is unobservable if only the command determines the position of the tip.
    biases = (Bias(("tip_x",), 1e-4), Bias(("tip_y",), 0.1))
    unknown = Unknown(biases=biases, torque=1e-2)
    hidden = unseen(full_model, run, unknown=unknown)
    assert [name for name, _, _ in hidden] == ["bias 1"]
    before, after = hidden[0][1:]
    assert before == pytest.approx(1e-4)
    assert 0.9 * before < after <= before * (1 + 1e-9)
    values = {name: column + 1.0 for name, column in run.values.items() if "command" not in name}
    commands = {name: column for name, column in run.values.items() if "command" in name}
    other = Run.from_arrays(run.times, values | commands, noise=NOISE)
    # The result is the same, apart from the start, which depends on the first rows.
    again = unseen(full_model, other, unknown=unknown)
    assert [row[0] for row in again] == ["bias 1"]
    assert again[0][2] == pytest.approx(after, rel=1e-3)


def test_drives_that_lag_have_states_and_their_smoother_is_finite(model):
    lag = {"joints.drive_lag": 0.5, "joints.drive_gain": 0.9}
    slow = replace(model, lag)
    run, times, true, _ = recorded(slow.arm)
    found = track(slow, run)
    errors, covariances = off(found, times, true)
    assert np.mean(np.einsum("ti,tij,tj->t", errors, np.linalg.inv(covariances), errors)) < 1.3 * 8
    assert np.all(np.isfinite(found.smoothed.root))
    assert np.sqrt(np.mean(errors[:, 0] ** 2)) < 2e-3
    assert judge(slow, found, look=False).adequate
    assert not judge(model, track(model, run), look=False).adequate


def test_errors_that_are_considered_widen_the_bands_and_estimated_ones_shrink(model):
    run, *_ = recorded(replace(model.arm, {"air.drag_coefficient": 1.3}))
    nominal = float(model.arm.air.drag_coefficient)
    sure = track(model, run)
    unsure = track(model, run, unknown=Unknown(considered={"air.drag_coefficient": 0.2}))
    assert np.mean(unsure.filtered.tip_deviations) > np.mean(sure.filtered.tip_deviations)
    assert np.all(unsure.filtered.parameters["air.drag_coefficient"] == nominal)
    found = track(model, run, unknown=Unknown(estimated={"air.drag_coefficient": 0.2}))
    value = found.filtered.parameters["air.drag_coefficient"][-1]
    error = found.filtered.parameter_deviations["air.drag_coefficient"][-1]
    assert value == pytest.approx(1.3, abs=4 * error)
    assert error < 0.1
    units = {row[0]: row[1] for row in track_rows(found)}
    assert (units["air.drag_coefficient"], units["tip_x"]) == ("-", "m")


def test_rows_one_by_one_and_out_of_order_end_where_the_whole_run_does(model):
    run, *_ = recorded(model.arm, late=0.5, lasts=6.0)
    late = replace(model, {"camera.delay": 0.5})
    found = track(late, run, unknown=Unknown(torque=1e-3))
    tracker = giajax.Tracker(
        late, noise=NOISE, unknown=Unknown(torque=1e-3), time=-0.5, angles=np.zeros(LINKS)
    )
    rows = [
        {"time": time, **{name: run.values[name][k] for name in run.values}}
        for k, time in enumerate(run.times)
    ]
    # Swap neighbouring rows, so the measurements of the camera and the encoder are out of order.
    commands = [
        {key: v for key, v in row.items() if "command" in key or key == "time"} for row in rows
    ]
    for k in range(0, len(rows), 2):
        for row in commands[k : k + 2]:
            tracker.update(row)
        for row in rows[k : k + 2][::-1]:
            last = tracker.update(row)
    np.testing.assert_allclose(last.angles[0], found.filtered.angles[-1], atol=2e-3)
    ahead = tracker.now(run.times[-1] + 0.5)
    assert np.all(ahead.tip_deviations > 0.9 * last.tip_deviations)
    assert tracker.filter.lost == 0
    with pytest.raises(InputError, match="neither a command of the arm nor a channel"):
        tracker.update({"time": 7.0, "link02_x": 1.0})
    with pytest.raises(InputError, match="has no time"):
        tracker.update({"tip_x": 1.0})


def test_a_run_that_is_followed_knows_its_wind_its_start_and_its_noise(model, tmp_path):
    times = np.linspace(0.0, 12.0, 25)
    # A command interpolated linearly until 11 s would be half a second early.
    angle = np.where(times < 2.0, 0.0, np.where(times < 11.0, 0.3, 0.9))
    command = giajax.simulation.steps(times, angle[:, None] * np.eye(LINKS)[0])
    wind, begun = [0.0, 0.3, 0.0], np.array([0.2, 0.0, -0.1, 0.0])
    given = {"wind": giajax.simulation.constant(wind), "initial": (begun, np.zeros(LINKS))}
    tip = np.asarray(giajax.simulate(model.arm, command, times, **given).tip)
    values = {f"tip_{axis}": tip[:, k] for k, axis in enumerate("xyz")}
    path = tmp_path / "run.csv"
    stated = {
        "model": "arm",
        "arm": model.definition()["arm"],
        "noise": {
            "position_m": 0.005,
            "position_correlated_m": 0.003,
            "position_correlation_s": 5.0,
        },
        "wind": {"velocity_m_per_s": wind},
        "command": {"interpolation": "zoh"},
        "initial": {"angle_deg": np.rad2deg(begun).tolist()},
    }
    giajax.write_run(path, times, values | {"joint01_command": angle}, definition=stated)
    unknown = Unknown(torque=1e-4)
    found = track(model, giajax.read_run(path), unknown=unknown)
    for latency in (0.0, 1.0):
        with path.open("rb") as file:
            rows = LiveRows(iter(file), LineReader(path), lambda run: run, pytest.fail)
            *_, last = followed_live(rows, lambda run: (model, unknown), latency=latency)
        assert last.now.biases.shape[1] == found.filtered.biases.shape[1] == 3
        off = np.max(np.abs(last.now.angles[0] - found.filtered.angles[-1]))
        assert off > 0.01 if latency else off < 0.002
    assert last.nis is not None
    assert last.nis < 2
    assert rows.kept == path.read_bytes()
    with pytest.raises(InputError, match="do not track a wind"):
        giajax.Tracker(model, noise={"tip_z": 0.01}, unknown=Unknown(air=Air(WIND, 0.1)), wind=wind)


def test_what_cannot_be_tracked_is_refused(model):
    run, *_ = recorded(model.arm, lasts=2.0)
    quiet = Run.from_arrays(run.times, run.values)
    with pytest.raises(InputError, match=r"the noise of .* is unknown"):
        track(model, quiet)
    joint = giajax.model_for([giajax.read_run(DATA / "joint.csv")])
    with pytest.raises(InputError, match="an arm model is required"):
        track(joint, run)
    with pytest.raises(InputError, match=r"clock_rate is 0\.01"):
        track(replace(model, {"camera.clock_rate": 0.01}), run)
    torque = Run.from_arrays(
        run.times,
        {"joint01_torque": np.zeros(len(run.times)), "tip_x": run.values["tip_x"]},
        noise={"tip_x": 0.01},
    )
    with pytest.raises(InputError, match="tracking needs commanded angles"):
        track(model, torque)
    with pytest.raises(InputError, match="gusts are tracked is 9: give a number"):
        track(model, run, unknown=Unknown(air=Air(WIND, 0.1, places=9)))
    with pytest.raises(InputError, match="must be a positive number in SI units"):
        giajax.Tracker(model, noise={})
    muscled = giajax.ArmModel(giajax.takeichi_20m(2, muscles="pitch"))
    with pytest.raises(InputError, match="60 deg"):
        giajax.Tracker(muscled, noise={"tip_z": 0.01}, command=[1.2, 0.0])


@pytest.mark.slow
def test_the_command_writes_a_run_bands_a_page_and_says_what_is_wrong(
    model, tmp_path, capsys, request
):
    run, *_ = recorded(model.arm, late=0.2)
    arm = {
        "model": "arm",
        "arm": model.definition()["arm"],
        "noise": {"position_m": 0.005, "angle_deg": 0.1146},
    }
    giajax.write_run(tmp_path / "run.csv", run.times, run.values, definition=arm)
    out = tmp_path / "tracked"
    given = ["track", str(tmp_path / "run.csv"), "--out", str(out), "--latency", "0.3"]
    assert main(given) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("not adequate: camera.delay")
    assert f"next: giajax view {out}" in printed
    facts = json.loads((out / "track.json").read_text())
    assert facts["verdict"]["causes"][0]["value"] == pytest.approx(0.2, abs=0.05)
    ends = {row["state"]: row["value"] for row in facts["at_the_end"]}
    estimate = giajax.read_run(out / "estimate.csv")
    assert estimate.definition.arm.links == LINKS
    with (out / "bands.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["filtered_tip_x_deviation_m"]) > 0
    assert ends["tip_x"] == pytest.approx(float(rows[-1]["filtered_tip_x_m"]), rel=1e-6)
    # The last link ends at the tip, and is drawn there.
    tip = [float(rows[-1][f"smoothed_tip_{axis}_m"]) for axis in "xyz"]
    bands = shown(out).bands
    np.testing.assert_allclose(bands.centres[-1, -1], tip)
    spread = [float(rows[-1][f"smoothed_tip_{axis}_deviation_m"]) for axis in "xyz"]
    np.testing.assert_allclose(bands.halves[-1, -1], BAND * np.array(spread), rtol=1e-6)
    assert np.all(np.diff(np.linalg.norm(bands.centres[-1], axis=1)) > 0.5)
    assert float(rows[-1]["known_at_s"]) == pytest.approx(float(rows[-1]["time_s"]) + 0.3)
    page = (out / "track.html").read_text()
    assert "camera.delay" in page
    assert page.count("data:image/png") == 1
    assert main(given) == 2
    assert "--force" in capsys.readouterr().err
    # Last, because the test is skipped here if there is no browser.
    assert browse.opened(out, request.getfixturevalue("browser")) == []


STIFFNESS = "joints.pitch_stiffness"
TIP = {f"tip_{axis}": 0.005 for axis in "xyz"}


def leaking(arm, *, at=30.0, left=0.8, lasts=60.0, moves=True, rate=5, pushed=0.4):
    """Simulate an arm whose pitch stiffness decreases while its base moves repeatedly."""
    times = np.linspace(0.0, lasts, round(rate * lasts) + 1)
    rng = np.random.default_rng(3)
    begins = np.arange(0.0, lasts + 1, 5.0)
    angles = np.zeros((len(begins), LINKS))
    angles[1:, 0] = rng.uniform(-pushed, pushed, len(begins) - 1) * moves
    command = giajax.simulation.ramps(begins, angles)
    value = float(arm.joints.pitch_stiffness)
    before, after = times[times <= at], times[times >= at]
    whole = giajax.simulate(arm, command, before)
    state = (whole.angles[-1], whole.rates[-1])
    leaked = replace(arm, {STIFFNESS: left * value})
    rest = giajax.simulate(leaked, command, after, initial=state)
    tip = np.concatenate([whole.tip, rest.tip[1:]])
    tip += 0.005 * rng.normal(size=tip.shape)
    values = {f"tip_{axis}": tip[:, k] for k, axis in enumerate("xyz")}
    values["joint01_command"] = np.interp(times, begins, angles[:, 0])
    return Run.from_arrays(times, values, name="leaking", noise=TIP)


@pytest.fixture(scope="module")
def still_arm():
    return giajax.takeichi_20m(LINKS)


def test_a_leak_is_found_with_its_time_and_followed(still_arm):
    value = float(still_arm.joints.pitch_stiffness)
    # The initial guess of the stiffness is 10 % off.
    model = giajax.ArmModel(replace(still_arm, {STIFFNESS: 1.1 * value}))
    unknown = Unknown(estimated={STIFFNESS: 0.2 * value})
    run = leaking(still_arm)
    found = track(model, run, unknown=unknown)
    (change,) = found.changes
    assert change.path == STIFFNESS
    assert change.time == pytest.approx(30.0, abs=3.0)
    assert change.found < 45.0
    assert change.size == pytest.approx(-0.2 * value, abs=4 * change.deviation)
    for time, true in ((29.0, value), (60.0, 0.8 * value)):
        event = np.searchsorted(found.times, time - 1e-6)
        for states, wide in ((found.filtered, 4), (found.smoothed, 5)):
            error = states.parameter_deviations[STIFFNESS][event]
            assert states.parameters[STIFFNESS][event] == pytest.approx(true, abs=wide * error)
            assert error < 0.03 * value

    # Tracking row by row gives the same change, and the same accuracy at the end.
    tracker = giajax.Tracker(model, noise=TIP, unknown=unknown, angles=[0] * LINKS)
    for k, time in enumerate(run.times):
        last = tracker.update({"time": time, **{name: run.values[name][k] for name in run.values}})
    (seen,) = tracker.changes
    assert (seen.path, seen.time) == (STIFFNESS, pytest.approx(30.0, abs=3.0))
    error = last.parameter_deviations[STIFFNESS][0]
    assert last.parameters[STIFFNESS][0] == pytest.approx(0.8 * value, abs=4 * error)
    assert error < 0.03 * value

    sound = track(model, leaking(still_arm, left=1.0), unknown=unknown)
    assert sound.changes == ()
    # An arm at rest gives no information, and no change is reported.
    rests = track(model, leaking(still_arm, moves=False), unknown=unknown)
    assert rests.changes == ()
    assert rests.smoothed.parameter_deviations[STIFFNESS][-1] > 0.9 * 0.2 * value


def test_a_slow_arm_is_learnt_from_at_a_hundred_rows_a_second(still_arm):
    # Within one second, the arm moves by less than the noise.
    run = leaking(still_arm, left=1.0, at=10.0, lasts=20.0, rate=100, pushed=0.3)
    noise = {f"tip_{axis}": 0.05 for axis in "xyz"}
    rng = np.random.default_rng(4)
    values = {
        name: column + 0.05 * rng.normal(size=column.shape) * (name in noise)
        for name, column in run.values.items()
    }
    run = Run.from_arrays(run.times, values, name="slow", noise=noise)
    value = float(still_arm.joints.pitch_stiffness)
    found = track(giajax.ArmModel(still_arm), run, unknown=Unknown(estimated={STIFFNESS: value}))
    assert found.smoothed.parameter_deviations[STIFFNESS][-1] < 0.7 * value


@pytest.mark.long
def test_an_estimate_without_process_noise_is_that_of_a_fit(still_arm):
    drag = "air.drag_coefficient"
    run = leaking(still_arm, left=1.0)
    true = float(still_arm.air.drag_coefficient)
    # Starting from twice the drag, the linearisation errors of the filter alone are too large.
    model = giajax.ArmModel(replace(still_arm, {drag: 2.0 * true}))
    fitted = giajax.fit(model, run, free=[drag], nuisances=False).parameters[drag]
    # As in the fit, the initial state and the model are exact.
    unknown = Unknown(estimated={drag: 0.6 * true}, torque=1e-9, at_start=(1e-7, 1e-7))
    found = track(model, run, unknown=unknown)
    assert fitted.standard_error is not None
    error = found.smoothed.parameter_deviations[drag][-1]
    assert found.smoothed.parameters[drag][-1] == pytest.approx(
        fitted.value, abs=0.03 * fitted.standard_error
    )
    assert error == pytest.approx(fitted.standard_error, rel=0.05)
    off = abs(found.filtered.parameters[drag][-1] - fitted.value)
    assert 0.2 * fitted.standard_error < off < 4 * error


def test_a_run_that_cannot_be_followed_is_tried_with_more_unmodelled_torque(still_arm, monkeypatch):
    model = giajax.ArmModel(still_arm)
    usual = usual_torque(model)
    given = iter([np.nan, usual, usual])
    monkeypatch.setattr("giajax.apps.tracking._track.usual_torque", lambda model: next(given))
    said = []
    found = track(model, leaking(still_arm, at=2.0, left=1.0, lasts=5.0), progress=said.append)
    assert found.unknown.torque == 2 * usual
    assert found.loosened == 2
    facts = track_facts(found, judge(model, found, look=False))
    assert facts["torque_n_m_root_s"] == 2 * usual
    notes = track_notes(found, judge(model, found, look=False))
    assert any("2 times this value" in note for note in notes)
    assert np.all(np.isfinite(found.smoothed.mean))
    assert any("the state became infinite; repeating with" in line for line in said)
    # A given unmodelled torque is not changed.
    run = leaking(still_arm, at=2.0, left=1.0, lasts=5.0)
    with pytest.raises(InputError, match="its state becomes infinite: allow more"):
        track(model, run, unknown=Unknown(torque=np.nan))
    given = iter([np.nan] * 5)
    with pytest.raises(InputError, match="its state becomes infinite: allow more"):
        track(model, run)


@pytest.mark.long
def test_the_command_follows_a_run_that_is_being_recorded(still_arm, tmp_path, capsys, monkeypatch):
    run = leaking(still_arm, at=20.0, lasts=40.0)
    stated = giajax.ArmModel(still_arm).definition()["arm"]
    definition = {"model": "arm", "arm": stated, "noise": {"position_m": 0.005}}
    path = tmp_path / "run.csv"
    giajax.write_run(path, run.times, run.values, definition=definition)
    (tmp_path / "arm.toml").write_text(path.with_suffix(".toml").read_text())
    out = tmp_path / "tracked"
    given = ["--model", str(tmp_path / "arm.toml"), "--free", STIFFNESS, "--no-judge"]

    def lines():
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    whole = path.read_bytes()
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(whole)))
    assert main(["track", "-", *given, "--json", "--out", str(out)]) == 0
    heard = [line for line in lines() if "time_s" in line]
    assert len(heard) > 35
    assert not heard[0]["parameters"][STIFFNESS]["shown"]
    assert heard[-1]["parameters"][STIFFNESS]["shown"]
    (change,) = [each for line in heard for each in line["changes"]]
    assert change["time"] == pytest.approx(20.0, abs=3.0)
    assert (out / "recorded.csv").read_bytes() == whole
    facts = json.loads((out / "track.json").read_text())
    (change,) = facts["changes"]
    assert change["time"] == pytest.approx(20.0, abs=3.0)

    # The file ends within a line, and is continued later.
    rows = whole.splitlines(keepends=True)
    growing = tmp_path / "growing.csv"
    growing.write_bytes(b"".join(rows[:30]) + rows[30][:5])

    def goes_on():
        sleep(1.0)
        with growing.open("ab") as file:
            file.write(rows[30][5:] + b"".join(rows[31:60]))

    writer = threading.Thread(target=goes_on)
    writer.start()
    follow = ["track", str(growing), *given, "--live", "3", "--out", str(tmp_path / "followed")]
    assert main(follow) == 0
    writer.join()
    printed = capsys.readouterr().out
    assert f"{run.times[58]:8.1f} s" in printed
    assert "(not yet determined)" in printed
    assert (tmp_path / "followed" / "track.json").exists()
    for wrong, says in (
        (["--live", "0"], "give a positive number of seconds"),
        (["--free", "arm.nothing"], "arm.nothing"),
        (["--free", f"{STIFFNESS}=-1"], "give one positive number"),
        (
            ["--free", STIFFNESS, "--uncertain", f"{STIFFNESS}=1"],
            "with both --free and --uncertain",
        ),
        (["--truth", str(tmp_path / "none.csv")], "none.csv"),
        (["--truth", str(path)], "no true angle or rate"),
    ):
        assert main(["track", str(path), *wrong, "--out", str(tmp_path / "no")]) == 2
        assert says in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"".join(rows[:2]))))
    assert main(["track", "-", *given, "--out", str(tmp_path / "no")]) == 2
    assert "before its second row" in capsys.readouterr().err
    for place, says in ((tmp_path, "is a folder"), (tmp_path / "none.csv", "does not exist")):
        assert (
            main(["track", str(place), *given, "--live", "1", "--out", str(tmp_path / "no")]) == 2
        )
        assert says in capsys.readouterr().err

    # Lines that are not valid rows are skipped, and do not affect other rows.
    wrong = rows[:20]
    wrong[10:10] = [b"\n", rows[9], b"1,2\n", b",".join([b"x"] * rows[0].count(b",")) + b",1\n"]
    whole = b"".join([b"\n", *wrong, rows[20][:-4]])
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(whole)))
    assert main(["track", "-", *given, "--json", "--out", str(tmp_path / "some")]) == 0
    said = capsys.readouterr().err
    named = [k for k in range(30) if f"row {k} is ignored" in said]
    assert named == [13, 14, 15, 26]
    assert (tmp_path / "some" / "recorded.csv").read_bytes() == b"".join(rows[:20])

    # Rows that are impossible in the whole run are skipped, too. Sensors may alternate.
    names = rows[0].decode().strip().split(",")
    table = [dict(zip(names, row.decode().strip().split(","), strict=True)) for row in rows[1:30]]
    for k, row in enumerate(table):
        row |= dict.fromkeys(("tip_x_m", "tip_y_m") if k % 2 else ("tip_z_m",), "")
    table[4]["joint01_command_deg"] = ""
    table[5]["tip_x_m"] = "inf"
    table[6]["time_s"] = "9e7"
    text = "\n".join([",".join(names), *(",".join(row.values()) for row in table), ""])
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    assert main(["track", "-", *given, "--json", "--out", str(tmp_path / "turns")]) == 0
    said = capsys.readouterr().err
    assert [k for k in range(40) if f"row {k} is ignored" in said] == [6, 7, 8]
    assert (tmp_path / "turns" / "track.json").exists()
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(rows[0][:-1])))
    assert main(["track", "-", *given, "--out", str(tmp_path / "no")]) == 2
    assert "before its second row" in capsys.readouterr().err

    # A checksum in the sidecar is that of the complete run.
    stated_there = path.with_suffix(".toml").read_text()
    assert "sha256" in stated_there
    growing.with_suffix(".toml").write_text(stated_there)
    again = ["--live", "0.5", "--latency", "2", "--json", "--out", str(tmp_path / "again")]
    assert main(["track", str(growing), "--no-judge", *again]) == 0
    assert len(lines()) > 5
