"""A drive: it follows the clock, agrees with the simulation, and can be saved as a run."""

from collections import deque
from pathlib import Path

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.apps.control import Compensator
from giajax.apps.driving import (
    Compensation,
    PadMapping,
    Session,
    TipCamera,
    Unfinished,
    read_pad,
    replay,
)
from giajax.apps.synthetic import gusts
from giajax.cli import main
from giajax.cli._drive import Drives
from giajax.mechanics.arm import takeichi_20m, tip_position
from giajax.mechanics.hysteresis import PrandtlIshlinskii
from giajax.models import ArmModel
from giajax.recordings import Channel, read_run
from giajax.simulation import ramps, simulate

STIFF = {"joints.pitch_stiffness": 6.0, "joints.yaw_stiffness": 6.0, "joints.damping": 0.3}


@pytest.fixture(scope="module")
def model():
    return ArmModel(takeichi_20m(4, parameters=STIFF))


def raises(error):
    """Return a function that raises an error."""

    def function(*_, **__):
        raise error

    return function


def pad(duration, rows=20):
    """Return sticks that move to and fro, and a button that is pressed at the end."""
    times = np.arange(round(duration * rows)) / rows
    late = (times > 0.8 * duration).astype(float)
    axes = {"axis0": np.sin(times), "axis1": -np.cos(times / 2), "axis3": 0.7 * np.sin(2 * times)}
    return {"time_s": times, **axes, "button0": late}


def test_a_replay_is_the_simulation_of_its_commands(model):
    session = Session(model, steps=4)
    replay(session, pad(8.0), until=8.0)
    record = session.record
    assert_allclose(record.times, np.arange(241) / 30, atol=1e-12)
    command = ramps(record.times, record.commands, tolerance=0.0)
    about = {"solver": "springs5", "rtol": 1e-10, "atol": 1e-10}
    motion = simulate(model.arm, command, record.times, **about)
    tip = jax.jit(jax.vmap(lambda angles: tip_position(model.arm, angles)))
    assert np.linalg.norm(tip(record.angles) - motion.tip, axis=1).max() < 1e-6
    # Check that the arm moved.
    assert np.linalg.norm(np.ptp(motion.tip, axis=0)) > 0.3


def test_it_keeps_step_with_the_clock(model):
    session = Session(model)
    assert session.tick(100.0).time == 0.0
    assert session.tick(100.0 + 0.5).time == pytest.approx(0.5)
    # The steps are not multiples of the interval.
    for index in range(1, 101):
        pose = session.tick(100.5 + index * 0.011)
    assert pose.time == pytest.approx(1.6, abs=session.interval)
    assert pose.lost == 0
    # Time that cannot be caught up is skipped, and reported.
    pose = session.tick(110.0)
    assert pose.lost == pytest.approx(110.0 - 101.6, abs=2 * session.interval)
    assert session.tick(110.5).time == pytest.approx(2.1, abs=3 * session.interval)
    # `most` limits the steps while a page waits. The timeout of a lost page follows the clock.
    before = session.tick(110.5).time
    session.receive({"type": "joint", "joint": 1, "deg": 60.0}, 110.5)
    pose = session.tick(111.2, most=2)
    assert pose.time == pytest.approx(before + 2 * session.interval)
    assert "no message" in pose.stopped


def test_messages_hold_from_the_next_interval_on(model):
    session = Session(model)
    session.tick(0.0)
    session.receive({"type": "joint", "joint": 2, "deg": 1.0}, 0.0)
    pose = session.tick(session.interval)
    assert pose.command[1] > 0
    assert pose.stopped is None
    assert "no message" in session.tick(0.9).stopped


def test_gusts_are_switched(model):
    wind = gusts([0.0, 0.3, 0.0], intensity=0.3, length_scale=5.0, duration=5.0)
    session = Session(model, gusts=wind)
    assert session.can_gust
    blown = session.tick(0.0)
    assert_allclose(blown.wind, [wind.values[f"wind_{axis}"][0] for axis in "xyz"])
    session.receive({"type": "gusts", "on": False}, 0.0)
    assert not np.any(session.tick(0.2).wind)
    session.receive({"type": "gusts", "on": True}, 0.2)
    # After their end, the gusts start again.
    for second in np.arange(0.4, 7.5, 0.5):
        pose = session.tick(float(second))
    expected = wind.at(np.array([pose.time % 4.9]))["wind_y"][0]
    assert pose.wind[1] == pytest.approx(expected, rel=1e-6) or wind.times[-1] != 4.9
    still = Session(model)
    assert not still.can_gust
    still.receive({"type": "gusts", "on": True}, 0.0)
    assert not still.gusty


def test_what_joints_remember_is_left_out():
    stops = {"joints.stops.strength": [0.5, 1.0], "joints.stops.yield_angle": [0.01, 0.05]}
    remembering = ArmModel(takeichi_20m(2, parameters=STIFF | stops))
    table = pad(3.0)
    ends = []
    for memory in (True, False):
        session = Session(remembering, PadMapping.usual(2), memory=memory)
        replay(session, table)
        ends.append(session.pose.angles)
    plain = Session(ArmModel(takeichi_20m(2, parameters=STIFF)), PadMapping.usual(2))
    replay(plain, table)
    assert_allclose(ends[1], plain.pose.angles, atol=1e-6)
    assert np.abs(ends[0] - ends[1]).max() > 1e-3
    with pytest.raises(InputError, match="there is nothing to disable"):
        Session(ArmModel(takeichi_20m(2)), memory=False)


def test_compensated_commands_undo_a_joints_hysteresis():
    """Compensation sample by sample equals compensation of the whole command, for each joint."""
    operator = PrandtlIshlinskii(weights=[0.3, 0.2], thresholds=[0.02, 0.1])
    channel = Channel.named("joint01_command")
    # The inverse is an operator of the same type.
    inverse, state = operator.inverse(), None
    compensator = Compensator(inverse, state, 0.0, (-1.0, 1.0), channel)
    compensation = Compensation(compensator, 2)
    wanted = np.stack([0.5 * np.sin(np.arange(40) / 6), 0.3 * np.cos(np.arange(40) / 4)], axis=1)
    commands = np.array([compensation(row) for row in wanted])
    for joint in (0, 1):
        assert_allclose(commands[:, joint], inverse.history(wanted[:, joint])[0], atol=1e-12)
        assert_allclose(operator.history(commands[:, joint])[0], wanted[:, joint], atol=1e-10)
    pressure = Compensator(inverse, state, 0.0, (-1.0, 1.0), Channel.named("pressure"))
    with pytest.raises(InputError, match="the joints of an arm are driven by angles"):
        Compensation(pressure, 2)


def test_the_camera_at_the_tip_is_late(model):
    camera = TipCamera(model, latency=0.2)
    lifted = np.array([0.3, 0.0, 0.0, 0.0])
    camera.see(0.0, np.zeros(4))
    before = camera.see(0.1, lifted)
    assert_allclose(before.centre[2], 0.0, atol=1e-12)
    assert_allclose(before.axes[:, 2], [1.0, 0.0, 0.0], atol=1e-12)
    assert_allclose(camera.see(0.29, lifted).centre[2], 0.0, atol=1e-12)
    now = camera.see(0.3, lifted)
    assert_allclose(now.axes[:, 2], [np.cos(0.3), 0.0, np.sin(0.3)], atol=1e-12)
    with pytest.raises(InputError, match="the latency is -1 s"):
        TipCamera(model, latency=-1.0)


def test_drives_that_are_none(model):
    with pytest.raises(InputError, match="the rate is 0 poses per second"):
        Session(model, rate=0.0)
    with pytest.raises(
        InputError, match="steps per pose is 1,000,000,000: give a number from 1 to 1,000"
    ):
        Session(model, steps=10**9)
    session = Session(model)
    with pytest.raises(
        InputError, match=r"lasts 1e\+09 s, but may last at most 16666\.7 s at 30 pos"
    ):
        replay(session, {"time_s": np.array([0.0, 1e9]), "axis0": np.zeros(2)})
    many = np.linspace(0.0, 1.0, 500_001)
    with pytest.raises(InputError, match="the drive has 500,001 rows: give at most 500,000"):
        replay(session, {"time_s": many, "axis0": many})
    with pytest.raises(InputError, match="the drive has no duration"):
        session.record.run(["tip_z"])
    session.tick(0.0)
    session.tick(1.0)
    with pytest.raises(InputError, match="no joint was moved"):
        session.record.run(["tip_z"])


def test_a_drive_is_saved_as_a_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text("[arm]\npreset = 'takeichi_20m'\nlinks = 3\n")
    table = pad(4.0)
    rows = np.stack(list(table.values()), axis=1)
    np.savetxt("pad.csv", rows, delimiter=",", header=",".join(table), comments="")
    words = ["drive", "arm.toml", "--replay", "pad.csv", "--noise", "position_m=0.01"]
    assert main([*words, "--channels", "link03", "--wind", "0,0.1,0"]) == 0
    assert "wrote drive-1.csv and drive-1.toml" in capsys.readouterr().out
    run = read_run("drive-1.csv")
    assert sorted(run.observations) == ["link03_x", "link03_y", "link03_z"]
    assert_allclose(run.values["wind_y"], 0.1)
    assert np.isfinite(run.values["link03_z"]).mean() == pytest.approx(1 / 3, abs=0.01)
    assert run.noise("link03_z") == 0.01
    # If a drive cannot be saved, its temporary file is kept.
    with monkeypatch.context() as full:
        full.setattr("giajax.cli._drive.write_and_say", raises(InputError("no")))
        assert main([*words]) == 2
    kept = "drive-2-unfinished.csv"
    assert f"giajax: no; the recorded part of the drive is in {kept}\n" in capsys.readouterr().err
    assert len(read_run(kept).times) == len(run.times)
    assert main([*words]) == 0
    assert "wrote drive-3.csv" in capsys.readouterr().out
    assert main([*words, "--to", "drive-1.csv"]) == 2
    assert "drive-1.csv exists" in capsys.readouterr().err
    (tmp_path / "pad.csv").write_text("time_s,button0\n0,1\n")
    assert main(words) == 2
    assert "has no column for a pad axis" in capsys.readouterr().err
    # Another spelling of a number would never be read, or would create unused columns.
    for name in ("axis00", "axis256", "axis٣", "axis-1", "axis1_0", "button"):
        (tmp_path / "pad.csv").write_text(f"time_s,axis0,{name}\n0,0,0\n1,0,0\n")
        with pytest.raises(
            InputError, match=f"has the unknown column '{name}': use names such as axis0"
        ):
            read_pad("pad.csv")
    (tmp_path / "pad.csv").write_text("time_s,axis0\n0,0\n1e9,1\n")
    assert main(words) == 2
    error = capsys.readouterr().err
    assert "lasts 1e+09 s, but may last at most 16666.7 s" in error
    assert error.count("\n") == 1


def test_another_drive_begins_as_the_first_did(model):
    table, drives = pad(4.0), []
    wind = gusts([0.0, 0.3, 0.0], intensity=0.3, length_scale=5.0, duration=5.0)
    session = Session(model, gusts=wind)
    for _ in range(2):
        replay(session, table, until=4.0)
        drives.append(session.restart())
        assert session.time == 0
        assert len(session.record) == 1
    for name in ("times", "commands", "angles", "winds"):
        first, second = (getattr(each, name) for each in drives)
        assert len(first) == 121
        np.testing.assert_array_equal(first, second)
    assert drives[0].duration == pytest.approx(4.0)


def test_drives_that_cannot_be_saved_are_not_lost(model, tmp_path, monkeypatch):
    """Two of three fail, one by Ctrl-C; each leaves either its run or its unfinished run."""
    monkeypatch.chdir(tmp_path)
    session, said = Session(model), []
    names = (Path(f"run-{number}.csv") for number in range(1, 9))
    how = {"noise": None, "every": 3, "seed": 0, "origin": ""}
    drives = Drives(session, names, ["tip_z"], force=False, quiet=True, complain=said.append, **how)
    waiting = deque()
    for _ in range(2):
        replay(session, pad(1.0), until=1.0)
        drives.keep(deque())
        waiting.append(session.restart())
    replay(session, pad(1.0), until=1.0)
    with monkeypatch.context() as broken:
        broken.setattr("giajax.cli._drive.write_and_say", raises(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            drives.keep(waiting)
        broken.setattr("giajax.cli._drive.write_and_say", raises(InputError("no")))
        first = waiting[0]
        drives.keep(deque([first]))
    waiting.popleft()
    assert said == ["giajax: no; the recorded part of the drive is in run-1-unfinished.csv"]
    drives.keep(waiting)
    assert not waiting
    with pytest.raises(InputError, match="not all drives of this session could be saved"):
        drives.end()
    written = sorted(path.name for path in tmp_path.glob("*.csv"))
    assert written == ["run-1-unfinished.csv", "run-2.csv", "run-3.csv"]
    for name in written:
        assert len(read_run(name).times) == 31


def test_rows_that_a_full_disk_does_not_take_are_written_later(model, tmp_path, monkeypatch):
    """No row is truncated, and the problem is reported once."""
    session, said = Session(model), []
    path = tmp_path / "unfinished.csv"
    unfinished = Unfinished(session.record, path, complain=said.append)
    for now in (0.0, 0.5):
        session.tick(now)
        unfinished.add()
    whole = path.read_bytes()
    assert whole.count(b"\n") == 1 + 16
    with monkeypatch.context() as full:
        full.setattr("os.fsync", raises(OSError(28, "No space left on device")))
        for now in (1.0, 1.5):
            session.tick(now)
            unfinished.add()
            assert path.read_bytes() == whole
    assert len(said) == 1
    assert "unfinished.csv cannot be written (No space left on device)" in said[0]
    session.tick(2.0)
    unfinished.add()
    assert path.read_bytes().startswith(whole)
    np.testing.assert_array_equal(read_run(path).times, session.record.times)


@pytest.mark.long
def test_a_drive_gives_the_arm_back():
    """A fit to a camera recording of the drive finds the true drag and stiffness."""
    truth = {"air.drag_coefficient": 1.3, "joints.pitch_stiffness": 4.0, "joints.damping": 0.5}
    model = ArmModel(giajax.replace(takeichi_20m(4, parameters=STIFF), truth))
    session = Session(model)
    replay(session, pad(25.0))
    channels = [f"{where}_{axis}" for where in ("link02", "tip") for axis in "xyz"]
    run = session.record.run(channels, noise={"position_m": 0.005}, every=3, seed=4)
    start = {"air.drag_coefficient": 0.7, "joints.pitch_stiffness": 7.0, "joints.damping": 0.2}
    result = giajax.fit(model, [run], free=list(truth), start=start, check=False)
    for path, value in truth.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
        assert estimate.standard_error < 0.2 * value
