"""The success probability of a mission from a recording of the resting arm: inputs, calibration."""

import dataclasses
import json
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.special import expit
from scipy.stats import norm

from giajax import Definition, InputError
from giajax.apps.mission import (
    Case,
    Mission,
    RestedCase,
    Resting,
    Waiting,
    certificate,
    fly_rested,
)
from giajax.cli import main
from giajax.recordings import Run, read_run, write_run
from small_mission import FILE, small_mission

FOLDER = Path(__file__).resolve().parents[3] / "missions"
TIP = ("tip_x", "tip_y", "tip_z")


def planned(**changes):
    data = tomllib.loads((FOLDER / "naraha.toml").read_text(encoding="utf-8"))
    data["mission"] |= changes
    return Mission.from_definition(Definition.parse(data))


def resting(seconds=60.0, rate=10.0, commands=None, noise=0.005, stated=None, **values):
    """Return a run in which the tip swings by 0.3 m with a period of 20 s."""
    times = np.arange(round(seconds * rate) + 1) / rate
    random = np.random.default_rng(0)
    tip = {
        name: 0.3 * np.sin(2 * np.pi * times / 20) + noise * random.normal(size=len(times))
        for name in TIP
    }
    commands = {"joint01_command": 0.0} | (commands or {})
    commanded = {name: np.full(len(times), value) for name, value in commands.items()}
    mission = planned()
    return Run.from_arrays(
        times,
        tip | commanded | values,
        name="resting",
        definition={"model": "arm", "arm": {"preset": "takeichi_20m"}, "noise": stated or {}},
    ), mission.model


def test_a_recording_is_its_means_over_half_a_second():
    found = Resting.from_run(*resting(noise=0.02))
    assert found.channels == TIP
    assert found.bins.shape == (120, 3)
    assert found.seconds == 60
    # Each mean is over five rows, so its noise is that of a row divided by their root.
    assert np.all(np.abs(found.noise - 0.02 / np.sqrt(5)) < 0.15 * 0.02 / np.sqrt(5))
    shown = found.shown()
    assert np.all(np.abs(shown[0]) < 0.01)
    assert np.all(np.abs(shown[1] - 0.3 / np.sqrt(2)) < 0.005)
    # In two seconds, a sine with a period of 20 s changes by 2 sin(pi / 10) times its amplitude.
    moves = 2 * np.sin(np.pi / 10) * 0.3 / np.sqrt(2)
    assert np.all(np.abs(shown[2] - moves) < 0.01)


def test_of_a_long_recording_the_end_counts():
    long, model = resting(seconds=300.0)
    found = Resting.from_run(long, model)
    assert found.seconds == 120
    changed = {name: np.where(long.times < 180, 5.0, long.values[name]) for name in TIP}
    values = {**long.values, **changed}
    other = Run.from_arrays(long.times, values, name="resting", definition=long.definition)
    assert np.array_equal(Resting.from_run(other, model).bins, found.bins)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"seconds": 12.0}, "lasts only 12\\.0 s: record the resting arm for at least 30 s"),
        ({"commands": {"joint03_command": np.deg2rad(20)}}, r"joint03_command .* is 20\.0 deg"),
        (
            {"joint02_command": np.linspace(0, 0.2, 601)},
            r"joint02_command .* moves by 11\.5 deg: give a recording of the arm at rest",
        ),
        ({"joint31_angle": np.zeros(601)}, "joint31_angle"),
        (
            {"joint01_torque": np.full(601, 5.0)},
            "driven by joint01_torque, but a mission is driven by",
        ),
        ({"rate": 1.0}, "tip_x of 'resting' is sampled too slowly to separate noise"),
        ({"imu03_accel_x": np.zeros(601)}, "simulate"),
        (
            {"tip_x": np.where(np.arange(601) % 33, np.nan, 0.1), "stated": {"position_m": 0.01}},
            "tip_x of 'resting' does not have two values that are 2 s apart: record the channel",
        ),
    ],
)
def test_what_is_no_resting_arm_is_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        Resting.from_run(*resting(**changes))


def drawn(count, seed, slope=-12.0):
    """Return missions whose rest motions scatter about the air speed by 20 %, with recordings."""
    random = np.random.default_rng(seed)
    cases = []
    for number in range(count):
        air = random.uniform(0.1, 0.7)
        inside = random.uniform() < expit(slope * (air - 0.4))
        sizes = air * np.exp(0.2 * random.normal(size=3))
        shown = np.array([sizes[0] * random.normal(size=3), [sizes[1]] * 3, [0.3 * sizes[2]] * 3])
        reached = float(random.uniform(60, 300)) if inside else None
        case = Case(air, number, reached, "" if inside else "late", 0.0, 0.0, ())
        cases.append(RestedCase(case, shown))
    return cases


def chance_of(case, known):
    return certificate(TIP, case.shown, known)


def test_chances_are_calibrated_and_skilful():
    """On other missions: Spiegelhalter's test, and a Brier score better than the base rate's."""
    known = drawn(400, seed=1)
    others = drawn(600, seed=2)
    chance = np.array([chance_of(each, known).chance for each in others])
    inside = np.array([each.case.reached is not None for each in others], float)
    z = np.sum((inside - chance) * (1 - 2 * chance)) / np.sqrt(
        np.sum((1 - 2 * chance) ** 2 * chance * (1 - chance))
    )
    assert abs(z) < norm.ppf(0.975)
    for low, high in ((0.0, 0.3), (0.3, 0.7), (0.7, 1.0)):
        these = (chance >= low) & (chance < high)
        spread = np.sqrt(np.mean(chance[these] * (1 - chance[these])) / np.sum(these))
        assert abs(np.mean(inside[these]) - np.mean(chance[these])) < 3 * spread
    brier = np.mean((inside - chance) ** 2)
    assert 1 - brier / np.mean((inside - np.mean(inside)) ** 2) > 0.2


def test_the_interval_is_what_so_few_missions_leave_open():
    """Over many sets of missions, the probability for one recording scatters as it says."""
    one = drawn(1, seed=5)[0]
    found = [chance_of(one, drawn(200, seed=10 + k)) for k in range(200)]
    truth = chance_of(one, drawn(20_000, seed=3)).chance
    holds = [low <= truth <= high for low, high in (each.interval for each in found)]
    assert 0.91 < np.mean(holds) < 0.985
    wide = np.mean([high - low for low, high in (each.interval for each in found)])
    narrow = chance_of(one, drawn(20_000, seed=4)).interval
    assert narrow[1] - narrow[0] < 0.2 * wide


def test_air_is_that_of_rests_that_look_alike_and_others_are_unlike():
    known = drawn(400, seed=1)
    calm = min(drawn(100, seed=2), key=lambda each: each.case.wind)
    found = chance_of(calm, known)
    least, middle, most = found.air
    assert len(found.near) == 40
    assert least <= middle <= most
    assert middle < 0.3
    assert not found.unlike
    strange = dataclasses.replace(calm, shown=1000 * calm.shown)
    assert chance_of(strange, known).unlike


@pytest.mark.parametrize("reached", [None, 60.0])
def test_where_all_or_none_succeed_there_is_still_an_interval(reached):
    cases = [
        dataclasses.replace(each, case=dataclasses.replace(each.case, reached=reached))
        for each in drawn(200, seed=1)
    ]
    found = chance_of(cases[0], cases)
    low, high = found.interval if reached else (1 - found.interval[1], 1 - found.interval[0])
    assert 0.8 < low < 0.999
    assert high > 0.999


def test_few_missions_are_no_certificate():
    with pytest.raises(
        InputError,
        match="only 12 of 12 missions could be simulated at rest, but a probability needs at "
        "least 20",
    ):
        chance_of(drawn(1, seed=5)[0], drawn(12, seed=1))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Write a recording of the tip of the resting short arm, and its mission file."""
    folder = tmp_path_factory.mktemp("morning")
    (folder / "mission.toml").write_text(FILE.replace("limit_s = 100.0", "limit_s = 40.0"))
    run, _ = resting(seconds=30.0, noise=0.0)
    values = {**run.values, "tip_z": run.values["tip_z"] + 7.9}
    write_run(folder / "resting.csv", run.times, values, definition={"model": "arm"})
    return folder


@pytest.mark.long
def test_the_command_says_the_chance_and_writes_what_is_behind_it(recording, monkeypatch, capsys):
    monkeypatch.chdir(recording)
    words = ["mission", "mission.toml", "--from-recording", "resting.csv", "--cases", "24"]
    given = [*words, "--speeds", "0.1,0.9", "--controller", "mpc", "--seed", "3"]
    assert main([*given, "--out", "chance"]) == 0
    said = capsys.readouterr().out
    assert "of the 2 missions (of 24) whose motion at rest is most similar to the recording" in said
    assert "probability of success within 40 s: " in said
    facts = json.loads(Path("chance/certificate.json").read_text())
    assert facts["interval"][0] < facts["chance"] < facts["interval"][1]
    rows = pl.read_csv("chance/certificate.csv").to_dict(as_series=False)
    rows = {name: np.array(row) for name, row in rows.items()}
    rows["reached_s"] = rows["reached_s"].astype(float)
    assert rows["seed"].tolist() == list(range(3, 27))
    assert np.sum(np.isfinite(rows["reached_s"])) == facts["inside"]
    assert np.all((rows["wind_m_per_s"] > 0.1) & (rows["wind_m_per_s"] < 0.9))
    # A mission does not start before its rest is over, and ends within its time limit.
    assert np.nanmin(rows["reached_s"]) > 10
    assert np.nanmax(rows["reached_s"]) <= 40
    assert Path("chance/certificate.png").stat().st_size > 10_000
    assert main([*given, "--out", "chance"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*given, "--case", "4"]) == 2
    assert "--case applies to a single mission: omit --from-recording" in capsys.readouterr().err


@pytest.mark.long
def test_missions_begin_after_a_rest(recording):
    """The recorded rest is the motion of a mission without commands, with recording noise."""
    mission = small_mission(mission__limit_s=40.0)
    found = Resting.from_run(read_run(recording / "resting.csv"), mission.model)
    bins = found.bins.copy()
    bins[5, 0] = np.nan
    found = dataclasses.replace(found, bins=bins, noise=np.zeros(3))
    one, *others = fly_rested(mission, found, (0.5, 0.5001), 3, seed=3)
    # The same length: two minutes, the half minute of the recording, and the mission.
    rests = dataclasses.replace(
        mission,
        section=mission.section.model_copy(update={"limit_s": 190.0}),
        controller=Waiting(mission.controller, 150.0),
    )
    outcome = rests.in_wind(one.case.wind).case(3).fly(3, drawn=mission)
    end = np.argmax(np.any(outcome.command != 0, axis=1))
    assert outcome.times[end] == pytest.approx(150.1)
    rows = (outcome.times > 120 + 1e-9) & (outcome.times < 150 + 1e-9)
    means = outcome.tip[rows].reshape(60, 5, 3).mean(axis=1)
    means[5, 0] = np.nan
    np.testing.assert_allclose(one.shown[0], np.nanmean(means, axis=0), atol=1e-9)
    np.testing.assert_allclose(one.shown[1], np.nanstd(means, axis=0), atol=1e-9)
    assert len({each.case.wind for each in (one, *others)}) == 3
    loud = dataclasses.replace(found, noise=np.full(3, 1.0))
    heard = loud.like(rests, outcome, np.random.default_rng(0)).shown()
    added = heard[2] ** 2 - one.shown[2] ** 2
    assert np.mean(added) == pytest.approx(2.0, rel=0.3)


@pytest.mark.slow
def test_flights_can_be_stopped_and_a_camera_stops_after_the_rest(recording):
    mission = small_mission(mission__limit_s=40.0, mission__camera_stops_s=39.0)
    found = Resting.from_run(read_run(recording / "resting.csv"), mission.model)

    def stop(done, whole):
        raise KeyboardInterrupt

    calm = fly_rested(mission, found, (0.1, 0.11), 6, seed=3, on_case=stop)
    assert 0 < len(calm) < 6
    assert calm[0].case.reached is not None
    blind = small_mission(mission__limit_s=40.0, mission__camera_stops_s=0.0)
    (never,) = fly_rested(blind, found, (0.1, 0.11), 1, seed=3)
    assert never.case.reason == "the camera stopped before the tip was inside the opening"
