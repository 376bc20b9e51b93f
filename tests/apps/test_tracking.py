"""An arm that is tracked: motions that giajax simulates, seen late, with noise and in a wind."""

import csv
import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import InputError, Run, replace
from giajax.apps.tracking import (
    Air,
    Bias,
    Held,
    Unknown,
    judge,
    nees,
    track,
    tracked_arm,
    unseen,
)
from giajax.apps.wind import first_guess
from giajax.cli import main

DATA = Path(__file__).parents[2] / "data" / "synthetic"
LINKS = 4
NOISE = {"tip_x": 0.005, "tip_y": 0.005, "tip_z": 0.005, "joint01_angle": 0.002}
WIND = first_guess([0.0, 0.3, 0.0], 0.3, 5.0, 12.0)


@pytest.fixture(scope="module")
def model():
    return giajax.ArmModel(giajax.takeichi_20m_full(LINKS))


def moved(arm, times, wind=None):
    command = giajax.joint_ramps(LINKS, {1: 0.3, 2: -0.2}, start=2.0, duration=3.0)
    return giajax.simulate(arm, command, times, wind=wind), command


def recorded(arm, *, late=0.0, wind=None, seed=0, lasts=20.0):
    """A run with the tip `late` s later than the encoder, and the motion at the exposures."""
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
    """Errors of angles and rates at the events that the truth has, and their covariances."""
    at = np.minimum(np.searchsorted(times, found.times.round(9)), len(times) - 1)
    same = np.abs(times[at] - found.times) < 1e-6
    states = found.filtered
    mean = np.concatenate([states.angles, states.rates], axis=1)[same]
    root = states.root[same][:, : mean.shape[1]]
    return true[at[same]] - mean, root @ root.transpose(0, 2, 1)


def test_a_step_is_that_of_the_simulation_and_its_derivatives_are_differences(model):
    known = tracked_arm(
        model,
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
    # Derivatives are those of the motion, to the order of the step: a short one here.
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
    # Without chance the arm moves as `simulate` has it, in a wind that stays.
    start = jnp.zeros(known.size)
    flow = jnp.asarray([0.0, 0.3, 0.0])
    start = start.at[known.slices()["mean flow"]].set(flow)
    start = start.at[known.slices()["parameters"]].set(model.arm.air.drag_coefficient)
    state = start
    step_on = jax.jit(
        lambda x, ramp: known.moved(x, held._replace(length=jnp.asarray(0.02), command=ramp))[0]
    )
    for k in range(50):
        ramp = jnp.full((2, LINKS), 0.002) * jnp.asarray([[k], [k + 1.0]])
        state = step_on(state, ramp)
    command = giajax.joint_ramps(LINKS, dict.fromkeys(range(1, LINKS + 1), 0.1))
    there = giajax.simulate(model.arm, command, [0.0, 1.0], wind=giajax.simulation.constant(flow))
    np.testing.assert_allclose(known.arm_state(state)[0], there.angles[-1], atol=3e-4)
    np.testing.assert_allclose(known.arm_state(state)[1], there.rates[-1], atol=2e-3)
    np.testing.assert_allclose(shown(state)[0][:3], there.tip[-1], atol=1e-4)


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
    assert square < 1.3  # nothing but noise is random here
    assert share > 0.93
    with pytest.raises(InputError, match="no true angle or rate"):
        nees(found, Run.from_arrays(times, driven | {"tip_x": tip[:, 0]}))
    verdict = judge(late, found)
    assert verdict.adequate, verdict.sentence
    # The smoother knows more than the filter, which knows more than what comes too late.
    assert np.mean(found.smoothed.tip_deviations) < 0.9 * np.mean(found.filtered.tip_deviations)
    assert found.now is not None
    assert np.mean(found.now.tip_deviations[20:]) > np.mean(found.filtered.tip_deviations[20:])
    known = np.searchsorted(times, found.now_times.round(9))
    there = known < len(times)
    assert np.sqrt(np.mean((tip[known[there]] - found.now.tip[there])[20:] ** 2)) < 0.02


def test_a_wind_that_is_missing_is_called_and_one_that_is_tracked_is_found(model):
    wind = giajax.simulation.constant([0.0, 0.3, 0.0])
    run, *_ = recorded(model.arm, wind=wind, lasts=40.0)
    without = judge(model, track(model, run))
    assert not without.adequate
    assert any(cause.name == "a wind with gusts" for cause in without.causes)
    # From the opposite of it.
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
    # The filter is not moved, and neither is the verdict by one outlier.
    assert np.max(found.nis) > 1e4
    assert judge(model, found, look=False).adequate


def test_what_channels_do_not_show_is_named_before_anything_is_measured(model):
    run, *_ = recorded(model.arm)
    # A bias of the camera is not seen where only the command says where the tip is.
    biases = (Bias(("tip_x",), 1e-4), Bias(("tip_y",), 0.1))
    unknown = Unknown(biases=biases, torque=1e-2)
    hidden = unseen(model, run, unknown=unknown)
    assert [name for name, _, _ in hidden] == ["bias 1"]
    before, after = hidden[0][1:]
    assert before == pytest.approx(1e-4)
    assert 0.9 * before < after <= before * (1 + 1e-9)
    values = {name: column + 1.0 for name, column in run.values.items() if "command" not in name}
    commands = {name: column for name, column in run.values.items() if "command" in name}
    other = Run.from_arrays(run.times, values | commands, noise=NOISE)
    # But for the start, which the first rows decide.
    again = unseen(model, other, unknown=unknown)
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
    # Neighbours are swapped: what the camera and the encoder measured is out of order, too.
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


def test_what_cannot_be_tracked_is_refused(model):
    run, *_ = recorded(model.arm, lasts=2.0)
    quiet = Run.from_arrays(run.times, run.values)
    with pytest.raises(InputError, match=r"the noise of .* is not known"):
        track(model, quiet)
    joint = giajax.model_for([giajax.read_run(DATA / "joint.csv")])
    with pytest.raises(InputError, match="arms are tracked"):
        track(joint, run)
    with pytest.raises(InputError, match=r"clock_rate is 0\.01"):
        track(replace(model, {"camera.clock_rate": 0.01}), run)
    torque = Run.from_arrays(
        run.times,
        {"joint01_torque": np.zeros(len(run.times)), "tip_x": run.values["tip_x"]},
        noise={"tip_x": 0.01},
    )
    with pytest.raises(InputError, match="follows commanded angles"):
        track(model, torque)
    with pytest.raises(InputError, match="gusts are tracked at 9 places"):
        track(model, run, unknown=Unknown(air=Air(WIND, 0.1, places=9)))
    with pytest.raises(InputError, match="each positive"):
        giajax.Tracker(model, noise={})


@pytest.mark.slow
def test_the_command_writes_a_run_bands_a_page_and_says_what_is_wrong(model, tmp_path, capsys):
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
    facts = json.loads((out / "track.json").read_text())
    assert facts["verdict"]["causes"][0]["value"] == pytest.approx(0.2, abs=0.05)
    estimate = giajax.read_run(out / "estimate.csv")
    assert estimate.definition.arm.links == LINKS
    with (out / "bands.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert float(rows[-1]["filtered_tip_x_deviation_m"]) > 0
    assert float(rows[-1]["known_at_s"]) == pytest.approx(float(rows[-1]["time_s"]) + 0.3)
    page = (out / "track.html").read_text()
    assert "camera.delay" in page
    assert page.count("data:image/png") == 1
    assert main(given) == 2
    assert "--force" in capsys.readouterr().err
