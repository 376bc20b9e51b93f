"""The mock-up mission: actions of the operator, and information that the operator must not have."""

import dataclasses
import json
import time
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import Definition, InputError
from giajax.apps.mission import Case, Cases, Mission, Tally, fly_cases, recorded
from giajax.apps.mission._mission import _reason
from giajax.fitting import predict
from giajax.models import model_for
from giajax.schema.parameters import replace

FOLDER = Path(__file__).resolve().parents[3] / "missions"


def mission(name="naraha", **changes):
    data = tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))
    for path, value in changes.items():
        *sections, key = path.split("__")
        table = data
        for section in sections:
            table = table[section]
        table[key] = value
        if value is None:
            del table[key]
    return Mission.from_definition(Definition.parse(data))


def blind():
    """A mission without pictures; tests that need no more share this program."""
    return mission(camera__tip__size_px=[1, 1], mission__limit_s=60.0)


@pytest.fixture(scope="module")
def flown():
    return mission().fly(1)


@pytest.mark.long
def test_the_tip_comes_in(flown):
    """In the paper's air and time, and through the frame, not through the wall."""
    assert flown.reached is not None
    assert flown.reached < 720
    assert not flown.reason
    opening = mission().opening
    local = np.asarray(opening.local(jnp.asarray(flown.tip)))
    assert local[0, 0] > 10
    # The tip is inside from the end of an interval on.
    assert np.all(local[flown.times > flown.reached + 0.05, 0] < -0.5)
    through = np.flatnonzero((local[:-1, 0] > 0) != (local[1:, 0] > 0))
    assert np.all(np.abs(local[through, 1:]) < 1)
    assert flown.times[-1] == pytest.approx(flown.reached + 3.0, abs=0.11)
    assert np.abs(flown.command).max() <= np.deg2rad(60) + 1e-12
    rates = np.abs(np.diff(flown.command, axis=0)) / 0.1
    assert rates.max() <= np.deg2rad(2.0) * (1 + 1e-9)


@pytest.mark.long
def test_the_run_of_a_mission_is_its_motion(flown):
    """The adaptive simulation of the commands in the recorded wind gives the same tip path."""
    run = recorded(mission(), flown, name="run")
    there = predict(model_for([run]), run)
    gap = [np.asarray(there[key]) - run.values[key] for key in ("tip_x", "tip_y", "tip_z")]
    assert np.linalg.norm(gap, axis=0).max() < 0.03


@pytest.mark.long
def test_nobody_tells_the_operator(flown):
    """Without pictures, the commands depend neither on the wind nor on the stiffness."""
    planned = blind()
    soft = planned.with_model(replace(planned.model, {"joints.pitch_stiffness": 2.0}))
    one, other = planned.fly(1), soft.in_wind(0.3).fly(2, drawn=planned)
    assert not np.allclose(one.tip, other.tip, atol=0.5)
    assert_allclose(one.command, other.command, atol=1e-12)
    assert_allclose(one.command[-1], planned.controller.approach, atol=1e-9)
    assert one.reason == other.reason == "the opening never came into view"
    assert one.reached is None
    # Until the opening is in view, and pictures are late, the commands are the same.
    seen = int(np.argmax(flown.corners >= 2))
    assert_allclose(one.command[: seen + 4], flown.command[: seen + 4], atol=1e-12)
    assert not np.allclose(one.command[seen + 20], flown.command[seen + 20], atol=1e-3)


@pytest.mark.long
def test_twelve_minutes_take_three_seconds():
    """In free air and for the whole time, because an operator without pictures never finishes."""
    whole = mission(camera__tip__size_px=[1, 1])
    took = []
    for _ in range(4):
        began = time.perf_counter()
        outcome = whole.fly(1)
        took.append(time.perf_counter() - began)
    assert outcome.times[-1] == pytest.approx(720.0)
    print(f"720 s in {min(took[1:]):.2f} s")
    assert min(took[1:]) < 3.0


@pytest.mark.long
def test_cases_are_drawn_alike_at_each_speed_of_the_air():
    short, told = blind(), []
    found = fly_cases(short, [0.0, 0.2], 2, seed=4, on_case=lambda *done: told.append(done))
    assert [(case.wind, case.seed) for case in found.cases] == [
        (0.0, 4), (0.0, 5), (0.2, 4), (0.2, 5),
    ]  # fmt: skip
    assert sorted(told)[-1] == (4, 4)
    assert {case.reason for case in found.cases} == {"the opening never came into view"}
    again = fly_cases(short, [0.2], 2, seed=4)
    assert again.cases == found.cases[2:]


def test_arms_are_drawn_about_the_drawn_one():
    planned = mission()
    spread = planned.section.spread
    drawn = [planned.case(seed).model for seed in range(200)]
    for read, path in ((lambda m: m.arm.joints.damping, "joints.damping"),
                       (lambda m: m.arm.contact.friction, "contact.friction")):  # fmt: skip
        ratios = np.log([float(np.ravel(read(m))[0]) for m in drawn])
        ratios -= np.log(float(np.ravel(read(planned.model))[0]))
        assert np.std(ratios) == pytest.approx(spread[path], rel=0.2)
    odd = mission(mission__spread={"arms.length": 0.1})
    with pytest.raises(InputError, match=r"'arms\.length', which is not a parameter of this arm"):
        odd.case(0)


def test_the_air_has_its_speed():
    planned = mission()
    winds = np.array([planned.wind(seed) for seed in range(12)]).reshape(-1, 20, 3)
    assert np.sqrt(np.mean(np.sum(winds**2, axis=-1))) == pytest.approx(0.2, rel=0.08)
    steady = mission(mission__wind__mean=1.0).wind(3).reshape(-1, 20, 3)
    assert_allclose(np.linalg.norm(steady, axis=-1), 0.2, rtol=1e-12)
    assert_allclose(steady[:, :, 2], 0)
    assert not np.any(planned.in_wind(0.0).wind(3))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"mission": None}, r"the file has no \[mission\]: add one"),
        ({"camera": {}}, "the tip carries no camera: give one"),
        ({"mission__camera": "other"}, "'other' is not a camera at the tip"),
        ({"mission__opening": "front"}, "'front' is not a wall with an opening"),
        ({"arm__obstacles": []}, "the arm has no opening to enter"),
        ({"mission__limit_s": -1.0}, "mission.limit_s = -1.0 must be a positive number"),
        (
            {"mission__operator__approach": {"joints": [1, 2], "angles_deg": [3.0]}},
            "give one angle for each joint",
        ),
        ({"mission__operator__approach": {"joints": [21], "angles_deg": [3.0]}}, "bends joint 21"),
    ],
)
def test_what_is_no_mission_is_refused(changes, sentence):
    if changes == {"arm__obstacles": []}:
        # Without obstacles, settings of the contact are refused first.
        changes |= {"arm__link_pressure_kPa": None, "arm__contact_friction": None}
    with pytest.raises(InputError, match=sentence):
        mission(**changes)


@pytest.mark.quick
def test_a_tally_counts():
    cases = tuple(
        Case(0.1, seed, reached, reason, flat, 10 * flat, ("wall",) if flat else ())
        for seed, (reached, reason, flat) in enumerate(
            [(100.0, "", 0.0), (200.0, "", 0.01), (None, "b", 0.02), (None, "a", 0.0),
             (None, "a", 0.0)]
        )
    )  # fmt: skip
    tally = Tally(0.1, cases)
    assert tally.inside == 2
    assert tally.touched == 2
    assert tally.reasons == {"a": 2, "b": 1}
    assert tally.quartiles == (125.0, 150.0, 175.0)
    assert tally.flattening == 0.02
    # Wilson's interval of 2 in 5, from a published table.
    assert_allclose(tally.interval, [0.1176, 0.7693], atol=1e-4)
    assert Cases(cases, 1.0).tallies == [tally]
    none = Tally(0.0, cases[2:])
    assert none.quartiles is None
    assert none.interval[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.quick
def test_reasons_are_those_of_the_rows():
    @dataclasses.dataclass
    class Seen:
        corners: np.ndarray
        inside: np.ndarray

    none, some = np.zeros(5), np.array([0, 2, 4, 0, 0])
    assert "simulation of the motion failed" in _reason(Seen(none, none), False, 1.0)
    assert "never came" in _reason(Seen(none, none), True, 1.0)
    assert "did not stay" in _reason(Seen(some, some), True, 0.1)
    assert "did not reach the opening" in _reason(Seen(some, none), True, 2.0)
    assert "close to the opening, but did not enter it" in _reason(Seen(some, none), True, 0.5)


def test_both_readings_are_14_m():
    level, slant = (mission(name) for name in ("naraha", "naraha_slant"))
    assert float(level.opening.centre[0]) == 14.0
    assert np.linalg.norm(np.asarray(slant.opening.centre)) == pytest.approx(14.0, abs=0.01)
    for each in (level, slant):
        assert float(each.opening.centre[2]) == pytest.approx(7.5)
        assert json.dumps(each.section.contents())
        assert jax.tree.leaves(each.controller)
