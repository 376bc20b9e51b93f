"""Operator commands, and the joint commands that follow from them."""

import gzip
import os

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.apps.driving import (
    LET_GO,
    NO_PAD,
    NOT_YET,
    SILENT,
    STOPPED,
    Operator,
    PadMapping,
    read_pad,
    shaped,
)

pytestmark = pytest.mark.quick

STEP = 1 / 30
PAD = """
[pad]
dead_zone = 0.1
exponent = 1.0
largest_rate_deg_per_s = 4.0
largest_angle_deg = 30.0
timeout_s = 0.3
smoothing_s = 0.0
axes = [
    {axis = 0, joints = [2], rate_deg_per_s = -3.0},
    {axis = 1, joints = [1, 3], rate_deg_per_s = 2.0},
]
buttons = [{button = 0, preset = "up"}, {button = 1, stop = true}]
presets = [
    {name = "up", joints = [1], angles_deg = [20.0]},
    {name = "straight", joints = [1], angles_deg = [0.0], others_deg = 0.0},
]
"""


def mapping(tmp_path, text=PAD, joints=3):
    path = tmp_path / "pad.toml"
    path.write_text(text)
    return PadMapping.load(path, joints)


@pytest.fixture
def operator(tmp_path):
    return Operator(mapping(tmp_path), 3)


def pad(operator, now, *axes, buttons=()):
    operator.receive({"type": "pad", "axes": list(axes), "buttons": list(buttons)}, now)


def test_a_stick_is_at_rest_in_its_dead_zone_and_continuous_at_its_edge():
    places = np.linspace(-1.2, 1.2, 2401)
    for zone, exponent in ((0.12, 2.0), (0.0, 1.0), (0.3, 0.5)):
        found = np.array([shaped(place, zone, exponent) for place in places])
        assert np.all(np.abs(found[np.abs(places) <= zone]) < 1e-6)
        assert_allclose(found, -found[::-1], atol=1e-6)
        assert np.all(np.diff(found) >= 0)
        assert np.abs(np.diff(found)).max() < 0.05
        assert (found[0], found[-1]) == (-1, 1)
    assert shaped(float("nan"), 0.1, 2.0) == 0.0


def test_a_stick_sets_rates(operator):
    assert operator.stopped == NOT_YET
    pad(operator, 0.0, 0.55, -1.0)
    before = operator.command
    after = operator.advance(STEP, STEP)
    assert operator.stopped is None
    assert_allclose(np.rad2deg(after - before) / STEP, [-2.0, -1.5, -2.0])


def test_a_slider_and_a_preset_are_approached_no_faster_than_allowed(operator):
    operator.receive({"type": "joint", "joint": 2, "deg": 1.0}, 0.0)
    operator.receive({"type": "preset", "name": "up"}, 0.0)
    commands = [operator.command]
    for index in range(1, 301):
        now = index * STEP
        operator.receive({"type": "alive"}, now)
        commands.append(operator.advance(now, STEP))
    rates = np.rad2deg(np.diff(commands, axis=0)) / STEP
    assert rates.max() == pytest.approx(4.0)
    assert_allclose(np.rad2deg(commands[-1]), [20.0, 1.0, 0.0], atol=1e-12)
    # A preset of all joints acts like one of some joints, and a stick overrides it.
    operator.receive({"type": "preset", "name": "straight"}, now)
    pad(operator, now, 0.0, 1.0)
    for _ in range(5):
        operator.advance(now, STEP)
    assert operator.command[0] > commands[-1][0]
    assert operator.command[1] < commands[-1][1]


def test_nothing_is_faster_or_further_than_allowed(operator):
    random = np.random.default_rng(5)
    now, kinds = 0.0, ("pad", "joint", "preset", "alive", "none")
    for _ in range(3000):
        kind = random.choice(kinds)
        if kind == "pad":
            pad(operator, now, *random.uniform(-3, 3, 4), buttons=random.integers(0, 2, 3).tolist())
        elif kind == "joint":
            angle = float(random.normal() * 100)
            operator.receive(
                {"type": "joint", "joint": int(random.integers(1, 4)), "deg": angle}, now
            )
        elif kind == "preset":
            operator.receive({"type": "preset", "name": "up"}, now)
        elif kind == "alive":
            operator.receive({"type": "alive"}, now)
        before, now = operator.command, now + STEP
        after = operator.advance(now, STEP)
        assert np.rad2deg(np.abs(after - before).max()) <= 4.0 * STEP * (1 + 1e-9)
        assert np.rad2deg(np.abs(after).max()) <= 30.0 * (1 + 1e-12)


def test_a_page_that_loads_slowly_waits_for_the_first_command(operator):
    operator.receive({"type": "alive"}, 0.0)
    operator.advance(3.0, STEP)
    assert operator.stopped == NOT_YET


@pytest.mark.parametrize(
    ("happens", "why"),
    [
        (lambda operator, now: None, SILENT),
        (lambda operator, now: operator.receive({"type": "no_pad"}, now), NO_PAD),
        (lambda operator, now: operator.receive({"type": "stop"}, now), STOPPED),
        (lambda operator, now: pad(operator, now, 0.0, 1.0, buttons=[0, 1]), STOPPED),
    ],
    ids=["silence", "no pad", "stop", "the button that stops"],
)
def test_everything_stops_at_once(operator, happens, why):
    operator.receive({"type": "joint", "joint": 2, "deg": 25.0}, 0.0)
    pad(operator, 0.0, 0.0, 1.0)
    operator.advance(STEP, STEP)
    happens(operator, STEP)
    now = 2 * STEP if why != SILENT else 0.31
    held = operator.advance(now, STEP)
    assert operator.stopped == why
    # Messages do not count as input while nothing is moved.
    for index in range(20):
        operator.receive({"type": "alive"}, now + index * STEP)
        assert np.array_equal(operator.advance(now + index * STEP, STEP), held)
    pad(operator, now + 1.0, 0.0, 1.0)
    assert operator.advance(now + 1.0, STEP)[0] > held[0]
    assert operator.stopped is None


def test_a_dead_mans_button_must_be_held(tmp_path):
    text = PAD.replace("{button = 1, stop = true}", "{button = 5, dead_man = true}")
    operator = Operator(mapping(tmp_path, text), 3)
    held, free = [0.0] * 5 + [1.0], [0.0] * 6
    pad(operator, 0.0, 0.0, 1.0, buttons=free)
    assert not operator.advance(STEP, STEP).any()
    pad(operator, STEP, 0.0, 1.0, buttons=held)
    assert operator.advance(2 * STEP, STEP)[0] > 0
    pad(operator, 2 * STEP, 0.0, 1.0, buttons=free)
    stands = operator.command
    assert np.array_equal(operator.advance(3 * STEP, STEP), stands)
    assert operator.stopped == LET_GO


def test_a_button_counts_once_until_it_is_let_go(operator):
    pad(operator, 0.0, 0.0, 0.0, buttons=[1])
    operator.advance(STEP, STEP)
    operator.receive({"type": "stop"}, STEP)
    pad(operator, STEP, 0.0, 0.0, buttons=[1])
    stands = operator.advance(2 * STEP, STEP)
    assert np.array_equal(operator.advance(3 * STEP, STEP), stands)
    pad(operator, 3 * STEP, 0.0, 0.0, buttons=[0])
    pad(operator, 3 * STEP, 0.0, 0.0, buttons=[1])
    assert operator.advance(4 * STEP, STEP)[0] > stands[0]


def test_rates_follow_the_stick_smoothly(tmp_path):
    smooth = Operator(mapping(tmp_path, PAD.replace("smoothing_s = 0.0", "smoothing_s = 0.2")), 3)
    rates = []
    for index in range(60):
        pad(smooth, index * STEP, 0.0, 1.0)
        before = smooth.command
        rates.append((smooth.advance((index + 1) * STEP, STEP) - before)[0] / STEP)
    assert_allclose(rates, np.deg2rad(2.0) * -np.expm1(-np.arange(1, 61) * STEP / 0.2), rtol=1e-9)


def test_the_usual_pad_bends_base_and_tip():
    usual = PadMapping.usual(20)
    operator = Operator(usual, 20)
    pad(operator, 0.0, 0.0, -1.0, 0.0, 0.0)
    for _ in range(30):
        after = operator.advance(0.1, STEP)
    assert np.flatnonzero(after).tolist() == [0, 2, 4]
    assert after[0] > 0  # pushing the stick forwards lifts the arm
    tips = np.flatnonzero(usual.rates({3: 1.0, 2: 1.0}, 20))
    assert tips.tolist() == list(range(14, 20))
    assert PadMapping.usual(1).rates({1: -1.0}, 1) > 0
    # Equal presets are left out: one joint cannot yaw, and two have no third at the tip.
    assert list(PadMapping.usual(1).presets) == ["straight", "raised", "lowered"]
    assert list(PadMapping.usual(2).presets)[3:] == ["to the left", "to the right"]


@pytest.mark.parametrize(
    ("message", "said"),
    [
        ({"type": "fly"}, "unknown type 'fly'"),
        ({"type": "pad", "axes": [], "buttons": []}, "the pad has no axes"),
        ({"type": "pad", "axes": "x", "buttons": []}, "has no list of numbers 'axes'"),
        (
            {"type": "joint", "joint": 9, "deg": 1},
            "a slider refers to joint 9, but the arm has only 3 joints",
        ),
        ({"type": "joint", "joint": 1, "deg": float("nan")}, "which is not a valid angle"),
        ({"type": "preset", "name": "up and away"}, "the preset 'up and away' does not exist"),
    ],
)
def test_messages_that_say_nothing(operator, message, said):
    with pytest.raises(InputError, match=said):
        operator.receive(message, 0.0)
    assert not operator.advance(STEP, STEP).any()


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (
            "joints = [2]",
            "joints = [4]",
            "axis 0 refers to joint 4, but the arm has only 3 joints: correct the number",
        ),
        ("axes = [", "sticks = [", r"unknown key pad\.sticks"),
        (
            "dead_zone = 0.1",
            "dead_zone = 1.0",
            r"pad\.dead_zone = 1.0 must be a number of at least 0 and below 1",
        ),
        ('preset = "up"', 'preset = "down"', "button 0 selects 'down', which is not a preset"),
        # The second entry for the same button does not hide it.
        (
            '{button = 0, preset = "up"}',
            '{button = 0, preset = "down"}, {button = 0, preset = "up"}',
            "button 0 selects 'down', which is not a preset",
        ),
        ('name = "straight"', 'name = "up"', "two presets have the name 'up': rename one"),
        ("angles_deg = [20.0]", "angles_deg = [1.0, 2.0]", "has 2 angles for 1 joints"),
        ("[pad]", "[game]", r"\[pad\] must be a table of keys: write it as one"),
    ],
)
def test_files_that_say_what_cannot_be_done(tmp_path, before, after, said):
    assert before in PAD
    with pytest.raises(InputError, match=said):
        mapping(tmp_path, PAD.replace(before, after, 1))


def test_a_pad_that_turns_nothing(tmp_path):
    with pytest.raises(
        InputError, match=r"no axis of the pad moves a joint: add \[\[pad\.axes\]\]"
    ):
        mapping(tmp_path, "[pad]\n")
    with pytest.raises(InputError, match="does not exist: give a TOML file"):
        PadMapping.load(tmp_path / "none.toml", 3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time_s,button0\n0,0\n1,1\n", "has no column for a pad axis"),
        ("time_s,axis0,stick\n0,0,0\n1,1,0\n", "has the unknown column 'stick'"),
        ("time_s,axis0\n0,0\n1,\n", "has an empty or infinite cell in the column axis0"),
        ("time_s,axis0\n0,0\n0,1\n", "do not increase: sort the rows by time"),
        ("time_s,axis0\n0,0\n1,inf\n", "has an empty or infinite cell in the column axis0"),
        ("time_s,axis0\n0,0\n1,1_0\n", "has '1_0' in row 3, but must have a number"),
        ("time_s,axis0,axis0\n0,0,0\n1,1,0\n", "has the column 'axis0' twice"),
        ("time_s,axis0\n", "has a header but no rows"),
    ],
)
def test_tables_of_a_pad_that_are_none(tmp_path, text, said):
    path = tmp_path / "pad.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_pad(path)
    with pytest.raises(InputError, match="does not exist"):
        read_pad(tmp_path / "none.csv")


def test_what_is_no_file_of_a_pad_is_not_opened(tmp_path):
    """A pipe blocked the reader, a device filled the memory, and a .gz file was unpacked."""
    path = tmp_path / "pad.csv"
    path.symlink_to("/dev/zero")
    with pytest.raises(InputError, match="is a device, but must be a file"):
        read_pad(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(InputError, match="is a pipe, but must be a file"):
        read_pad(path)
    packed = tmp_path / "pad.csv.gz"
    packed.write_bytes(gzip.compress(b"time_s,axis0\n0,0\n1,1\n"))
    with pytest.raises(InputError, match=r"must be a run, a file whose name ends in \.csv"):
        read_pad(packed)
