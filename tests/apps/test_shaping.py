"""Shaped commands: closed forms, an oscillator integrated by scipy, and a simulated arm."""

import itertools
import json
import shlex

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from giajax import InputError, read_run, replace, takeichi_20m, takeichi_20m_full
from giajax.apps.shaping import (
    INSENSITIVITY,
    SHAPERS,
    Command,
    extra_insensitive,
    modes_after,
    shape_command,
    shaping_facts,
    zero_vibration,
    zero_vibration_and_derivative,
)
from giajax.cli import main
from giajax.mechanics.arm import mass_matrix
from giajax.models import ArmModel

DAMPINGS = (0.0, 0.05, 0.2, 0.5)


@pytest.mark.parametrize(("name", "damping"), [*itertools.product(SHAPERS, DAMPINGS)])
def test_impulses_pull_one_way_and_add_up_to_one(name, damping):
    impulses = SHAPERS[name].impulses(30.0, damping)
    assert np.sum(impulses.sizes) == pytest.approx(1.0, abs=1e-12)
    assert np.all(impulses.sizes > 0)
    assert impulses.times[0] == 0
    assert np.all(np.diff(impulses.times) > 0)


@pytest.mark.parametrize("damping", DAMPINGS)
def test_what_is_left_where_period_and_damping_are_right_and_near(damping):
    once, twice, robust = (shaper.impulses(30.0, damping) for shaper in SHAPERS.values())
    assert once.left(30.0, damping) < 1e-12
    assert twice.left(30.0, damping) < 1e-9  # the times are rounded
    assert robust.left(30.0, damping) == pytest.approx(INSENSITIVITY, abs=1e-8)
    # The derivative with respect to the period vanishes.
    near = 30.0 * 1.001
    assert twice.left(near, damping) < 0.01 * once.left(near, damping)
    # The residual swing also vanishes for one slower and one faster mode.
    for near in ((30.0, 60.0), (15.0, 30.0)):
        least = minimize_scalar(lambda at: robust.left(at, damping), bounds=near, method="bounded")
        assert least.fun < 1e-4


def test_without_damping_the_impulses_are_those_of_the_papers():
    kept = INSENSITIVITY
    np.testing.assert_allclose(zero_vibration(8.0, 0.0).sizes, [0.5, 0.5])
    np.testing.assert_allclose(zero_vibration(8.0, 0.0).times, [0, 4])
    np.testing.assert_allclose(
        zero_vibration_and_derivative(8.0, 0.0).sizes, [0.25, 0.5, 0.25], atol=1e-12
    )
    sizes = [(1 + kept) / 4, (1 - kept) / 2, (1 + kept) / 4]
    np.testing.assert_allclose(extra_insensitive(8.0, 0.0).sizes, sizes, atol=1e-9)
    np.testing.assert_allclose(extra_insensitive(8.0, 0.0).times, [0, 4, 8], atol=1e-8)
    with pytest.raises(
        InputError, match=r"damping ratio is 0\.6, but EI shapers exist only for ratios up to 0\.55"
    ):
        extra_insensitive(8.0, 0.6)


@pytest.mark.parametrize("name", SHAPERS)
def test_an_oscillator_of_scipys_swings_by_what_is_said_to_be_left(name):
    """A shaped ramp moves the other end of a damped spring, with a period that is 10 % off."""
    period, damping, off = 5.0, 0.1, 1.1
    impulses = SHAPERS[name].impulses(period, damping)
    ramp = Command(np.array([0.0, 0.7]), np.array([[0.0], [1.0]]))
    frequency = 2 * np.pi / (period * off)

    def swing(command):
        def rates(time, state):
            pull = command.at(np.array([time]))[0, 0] - state[0]
            return [state[1], frequency**2 * pull - 2 * damping * frequency * state[1]]

        end = command.times[-1]
        found = solve_ivp(rates, (0, end), [0, 0], rtol=1e-9, atol=1e-12, max_step=0.05)
        place, rate = found.y[:, -1]
        own = frequency * np.sqrt(1 - damping**2)
        return abs(complex(place - 1, (rate + damping * frequency * (place - 1)) / own))

    left = swing(ramp.shaped(impulses)) / swing(ramp)
    assert left == pytest.approx(impulses.left(period * off, damping), rel=1e-4)


def test_a_shaped_command_ends_where_it_ended():
    rng = np.random.default_rng(0)
    impulses = zero_vibration_and_derivative(7.0, 0.1)
    for held in (False, True):
        command = Command(np.array([0.0, 1.0, 4.0]), rng.normal(size=(3, 2)), held)
        shaped = command.shaped(impulses)
        np.testing.assert_allclose(shaped.angles[-1], command.angles[-1])
        np.testing.assert_allclose(shaped.angles[0], command.angles[0])
        assert shaped.times[-1] == pytest.approx(4.0 + impulses.times[-1])
        times = np.linspace(0.05, 12.05, 100)
        late = [size * command.at(times - at) for at, size in zip(*impulses, strict=True)]
        np.testing.assert_allclose(shaped.at(times), sum(late), atol=1e-12)
        signal = shaped.signal(20)
        found = np.stack([np.asarray(signal(jnp.asarray(time))) for time in times])
        np.testing.assert_allclose(found, shaped.at(times), atol=1e-9)


def moved(angle, joints, duration=0.01):
    angles = np.zeros((2, joints))
    angles[1, 0] = angle
    return Command(np.array([0.0, duration]), angles)


def test_a_mode_of_one_link_is_a_pendulum_with_drag_by_harmonic_balance():
    arm = replace(takeichi_20m(1), {"joints.damping": 0.0})
    mass = float(mass_matrix(arm, jnp.zeros(1))[0, 0])
    stiffness = float(jnp.max(jnp.asarray(arm.joints.pitch_stiffness)))
    (mode,) = modes_after(arm, moved(0.1, 1))
    assert mode.period == pytest.approx(2 * np.pi * np.sqrt(mass / stiffness), rel=1e-9)
    length = float(arm.links.length[0])
    # A step leaves a swing of its own size.
    assert mode.swing == pytest.approx(0.1 * length, rel=1e-3)
    # Torque of the drag at the centre of the link, divided by the square of the rate.
    centre = float(arm.links.centre_of_mass[0])
    drag = 0.5 * float(arm.air.density) * float(arm.air.drag_coefficient)
    drag *= float(arm.links.diameter[0]) * length * centre**3
    # Half of the swing; the mean of a cubed cosine gives 4 / (3 pi).
    expected = 4 / (3 * np.pi) * drag * 0.05 / mass
    assert mode.damping == pytest.approx(expected, rel=2e-3)


def test_a_damper_has_the_damping_of_a_damper():
    still = {"joints.damping": 0.02, "air.drag_coefficient": 0.0}
    arm = replace(takeichi_20m(1), still)
    mass = float(mass_matrix(arm, jnp.zeros(1))[0, 0])
    stiffness = float(jnp.max(jnp.asarray(arm.joints.pitch_stiffness)))
    (mode,) = modes_after(arm, moved(0.1, 1))
    assert mode.damping == pytest.approx(0.02 / (2 * np.sqrt(stiffness * mass)), rel=1e-6)


@pytest.fixture(scope="module")
def short():
    """Three links whose surrounding air moves with them."""
    return ArmModel(takeichi_20m_full(3))


@pytest.mark.parametrize(
    "swings",
    [
        pytest.param(0.5, marks=pytest.mark.long),
        pytest.param(1.0, marks=pytest.mark.slow),
        pytest.param(1.5, marks=pytest.mark.long),
    ],
)
def test_a_shaped_command_leaves_little_swing(short, swings):
    """2 % of the travel, and 5 % if the stiffness is 25 % off (ZVD, EI)."""
    period = modes_after(short.arm, moved(0.2, 3))[0].period
    found = shape_command(short, moved(0.2, 3, swings * period))
    before, *shaped = found.rows
    assert before.residual > 0.05 * found.travel
    for row in shaped:
        assert row.residual < 0.02 * found.travel, row.name
        assert row.residual < before.residual
        if row.name != "ZV":
            assert max(row.soft, row.stiff) < 0.05 * found.travel, row.name
    json.dumps(shaping_facts(found), allow_nan=False)


def test_what_cannot_be_shaped_is_refused(short):
    with pytest.raises(InputError, match="the shaper 'XY' is unknown: use one of ZV, ZVD, EI"):
        shape_command(short, moved(0.2, 3), shapers=["XY"])
    with pytest.raises(InputError, match="of 2 joints, but the arm has 3"):
        shape_command(short, moved(0.2, 2))
    with pytest.raises(InputError, match="the command does not move the tip"):
        shape_command(short, moved(0.0, 3))
    unstable = replace(short, {"joints.pitch_stiffness": -1.0})
    with pytest.raises(InputError, match="the pose at the end of the command is unstable"):
        shape_command(unstable, moved(0.2, 3))


def untuned(arm, command):
    found = shape_command(ArmModel(arm), command, shapers=["ZVD"], tuned=False)
    return np.array([[row.residual, row.soft, row.stiff] for row in found.rows]), found


@pytest.mark.slow
def test_a_command_that_begins_elsewhere_is_the_same_move():
    """The arm rests at the position of the first row, so there is no swing from a false start."""
    arm = takeichi_20m_full(3, parameters={"gravity": 0.0})
    base = np.deg2rad([[30.0, 0, 0], [31.0, 0, 0]])
    times = np.array([0.0, 1.0])
    here, _ = untuned(arm, Command(times, base - base[0]))
    there, found = untuned(arm, Command(times, base))
    np.testing.assert_allclose(there, here, rtol=0.02)
    assert found.rows[0].distance[0] == pytest.approx(found.travel, rel=1e-6)


def test_an_arm_that_sags_begins_at_its_sag():
    arm = takeichi_20m(2, parameters={"gravity": 1.0})
    _, found = untuned(arm, moved(0.05, 2))
    assert found.rows[0].distance[0] == pytest.approx(found.travel, rel=1e-6)
    assert found.rows[1].residual < 0.3 * found.rows[0].residual


@pytest.mark.long
def test_a_drive_with_half_of_the_gain_moves_half_as_far(short):
    plain = short.arm
    halved = takeichi_20m_full(3, parameters={"joints.drive_gain": 0.5})
    one, other = (modes_after(arm, moved(angle, 3))[0] for arm, angle in
                  ((plain, 0.1), (halved, 0.2)))  # fmt: skip
    assert other.swing == pytest.approx(one.swing, rel=1e-9)
    assert other.damping == pytest.approx(one.damping, rel=1e-9)
    late = takeichi_20m_full(3, parameters={"joints.drive_lag": one.period / (2 * np.pi)})
    behind = min(modes_after(late, moved(0.1, 3)), key=lambda mode: abs(mode.period - one.period))
    assert behind.swing == pytest.approx(one.swing / np.sqrt(2), rel=1e-9)


@pytest.mark.slow
def test_a_command_there_and_back_is_of_the_travel_in_between(short):
    angles = np.zeros((4, 3))
    angles[1:3, 0] = 0.1
    command = Command(np.array([0.0, 2.0, 9.0, 11.0]), angles)
    found = shape_command(short, command, shapers=["ZVD"], tuned=False)
    once = shape_command(short, moved(0.1, 3, 2.0), shapers=["ZVD"], tuned=False)
    assert found.travel == pytest.approx(once.travel, rel=1e-6)
    assert found.rows[1].residual < 0.1 * found.travel


def test_muscles_are_refused():
    arm = takeichi_20m(2, muscles="all", parameters={"joints.damping": 0.5})
    with pytest.raises(InputError, match="the arm has muscles"):
        shape_command(ArmModel(arm), moved(0.1, 2))


COMMAND = """time_s,joint01_command_deg
0,0
1,0
5,10
6,10
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "command.csv").write_text(COMMAND)
    (tmp_path / "arm.toml").write_text('[arm]\npreset = "takeichi_20m_full"\nlinks = 3\n')
    return tmp_path


SHAPE = ["shape", "command.csv", "--model", "arm.toml", "--out", "shaped"]


def test_the_command_writes_commands_that_can_be_driven(files, capsys):
    assert main([*SHAPE, "--shaper", "zvd", "--no-tune"]) == 0
    said = capsys.readouterr().out
    assert "unshaped" in said
    assert "next: giajax synth --data shaped/command_zvd.csv --model arm.toml" in said
    names = {path.name for path in (files / "shaped").iterdir()}
    assert names == {"command_zvd.csv", "command_zvd.toml", "shape.json", "shape.png"}
    facts = json.loads((files / "shaped" / "shape.json").read_text())
    assert [row["shaper"] for row in facts["commands"]] == ["unshaped", "ZVD"]
    run = read_run(files / "shaped" / "command_zvd.csv")
    angles = np.rad2deg(run.commands["joint01_command"])
    assert angles[-1] == pytest.approx(10.0)
    assert np.all(np.diff(angles) >= -1e-9)
    assert run.times[-1] >= 6 + facts["commands"][1]["longer_s"] - 1e-6
    # The printed command line rehearses the arm for which the command was shaped.
    printed = next(line for line in said.splitlines() if line.startswith("next: giajax "))
    assert main(shlex.split(printed)[2:]) == 0
    rehearsed = read_run(files / "rehearsal.csv")
    tips = np.stack([rehearsed.observations[f"tip_{axis}"] for axis in "xyz"], axis=1)
    travel = np.linalg.norm(tips[0] - tips[-1])
    assert travel == pytest.approx(facts["travel_m"], rel=0.02)
    capsys.readouterr()
    assert main([*SHAPE, "--shaper", "zvd", "--no-tune"]) == 2
    assert "--force" in capsys.readouterr().err
    assert main([*SHAPE, "--shaper", "zvd", "--no-tune", "--force", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("text", "arguments", "sentence"),
    [
        ("time_s,tip_z_m\n0,0\n1,0\n", [], "command.csv has no command column"),
        (
            COMMAND.replace("joint01", "joint09"),
            [],
            "refers to joint 9, but the arm has only 3 links",
        ),
        (COMMAND.replace("10", "0"), [], "the command does not move the tip"),
        (COMMAND, ["--shaper", "best"], "the shaper 'BEST' is unknown"),
        (COMMAND, ["--model", "none.toml"], "none.toml does not exist"),
    ],
)
def test_bad_input_ends_with_a_sentence(files, capsys, text, arguments, sentence):
    (files / "command.csv").write_text(text)
    assert main([*SHAPE, *arguments]) == 2
    assert sentence in capsys.readouterr().err
    assert not list(files.glob("shaped/*.csv"))
