"""Planned commands: derivatives, limits, a linear programme, and simulated arms."""

import dataclasses
import json
import math
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog, minimize

from giajax import ArmModel, Definition, InputError, read_run, simulate, takeichi_20m_full
from giajax.apps.planning import (
    CommandLimits,
    Pose,
    Through,
    Tip,
    plan_command,
)
from giajax.cli import main
from giajax.mechanics.arm import Contact, acceleration, clearance, takeichi_20m
from giajax.mechanics.obstacles import Box, WallWithOpening

LINKS = 3
POSE = np.deg2rad([20.0, 10.0, 0.0])
BEGIN = np.deg2rad([5.0, 0.0, 0.0])
LIMITS = CommandLimits(rate=np.deg2rad(8.0), angle=np.deg2rad(40.0))


def arm(**how):
    return takeichi_20m_full(LINKS, **how)


@pytest.fixture(scope="module")
def fastest():
    return plan_command(ArmModel(arm()), Pose(POSE), begin=BEGIN, limits=LIMITS)


def tips_by(arm, command, times, initial, solver="tsit5", tolerance=1e-8):
    """Return the positions of the tip by another integrator with a smaller tolerance."""
    motion = simulate(
        arm, command.signal(len(command.times)), times, initial=(initial, np.zeros(arm.count)),
        solver=solver, rtol=tolerance, atol=tolerance,
    )  # fmt: skip
    return np.asarray(motion.tip)


def test_a_plan_keeps_to_the_limits_and_ends_at_rest_by_another_integrator(fastest):
    command = fastest.planned.command
    np.testing.assert_allclose(command.angles[0], BEGIN)
    np.testing.assert_allclose(command.angles[-1], POSE, atol=1e-9)
    rates = np.diff(command.angles, axis=0) / np.diff(command.times)[:, None]
    assert np.max(np.abs(rates)) <= LIMITS.rate * (1 + 1e-6)
    assert np.max(np.abs(command.angles)) <= LIMITS.angle * (1 + 1e-6)
    end = command.times[-1]
    times = np.concatenate([[0.0], end + np.linspace(0, fastest.period, 400)])
    tips = tips_by(arm(), command, times, fastest.planned.angles[0])
    off = np.linalg.norm(tips[1:] - fastest.goal, axis=1)
    assert np.max(off) <= fastest.within * fastest.travel
    # Without the plan, the arm settles later.
    assert (fastest.direct.settled or np.inf) > 1.5 * fastest.planned.settled
    assert fastest.direct.residual > 3 * fastest.planned.residual


def test_a_longer_command_leaves_less_and_is_as_long_as_it_is_to_be(fastest):
    model, before = ArmModel(arm()), fastest.direct.missed
    for duration in (1.95, 2.4):
        found = plan_command(
            model, Pose(POSE), begin=BEGIN, limits=LIMITS, duration=duration, draw_count=0
        )
        assert found.planned.command.times[-1] == pytest.approx(duration)
        assert found.planned.missed < 0.8 * before
        before = found.planned.missed
        assert bool(found.notes) == (before > found.within * found.travel)


def test_values_of_a_plan_have_their_slopes(fastest):
    """Derivatives with respect to the duration and the coefficients, against differences."""
    problem = pickle.loads(pickle.dumps(fastest)).problem
    rng = np.random.default_rng(0)
    y = problem.start.copy()
    y[1:-2] += 0.2 * rng.normal(size=len(y) - 3)
    slopes = problem.slopes(y)
    for place in (0, 1, 5, len(y) - 2):
        # The difference must be larger than the tolerance of the motion.
        step = 3e-3
        one, other = y.copy(), y.copy()
        one[place] += step
        other[place] -= step
        slope = (problem.values(one) - problem.values(other)) / (2 * step)
        np.testing.assert_allclose(slopes[:, place], slope, atol=0.1 * np.max(np.abs(slope)))


def test_a_plan_has_the_same_numbers_on_any_number_of_cores(fastest, monkeypatch):
    problem = pickle.loads(pickle.dumps(fastest)).problem
    ends = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("GIAJAX_CORES", count)
        y = problem.start + 1e-3 * np.append(np.ones(len(problem.start) - 2), [0.0, 0.0])
        again = problem.closer(1.0, y)  # it has evaluated no other point
        ends.append((again.values(y), again.slopes(y)))
    for other in ends[1:]:
        for one, same in zip(ends[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_the_least_time_of_a_linear_arm_is_that_of_a_linear_programme():
    """One link with small motions and without air is an oscillator that is linear in the knots."""
    still = {"air.density": 1e-6, "joints.damping": 0.05}
    one = takeichi_20m(1, parameters=still)
    goal, limits, knots = np.deg2rad(1.0), CommandLimits(rate=np.deg2rad(10.0)), 8
    found = plan_command(
        ArmModel(one), Pose(np.array([goal])), limits=limits, knots=knots, draw_count=0
    )
    rest = found.planned.angles[-1, 0]

    # Linearise the oscillator by differences of the arm itself.
    def pulled(q, v, u):
        each = (jnp.asarray([float(x)]) for x in (q, v, u))
        return float(acceleration(one, *each)[0])

    h, base = 1e-6, pulled(rest, 0, goal)
    by = [(pulled(rest + h * a, h * b, goal + h * c) - base) / h for a, b, c in np.eye(3)]
    system = np.zeros((4, 4))
    system[0, 1], system[1, :3], system[2, 3] = 1, by, 1

    def feasible(duration):
        """Return whether knots exist with which it settles after the command (a linear problem)."""
        step, period = duration / knots, found.period
        across = expm(system * step)
        columns = []
        for knot in range(knots + 1):
            unit = np.eye(knots + 1)[knot]
            state, rows = np.zeros(2), []
            for k in range(knots):
                slope = (unit[k + 1] - unit[k]) / step
                state = (across @ [*state, unit[k], slope])[:2]
            for time in np.linspace(0, 1, 60) ** 2 * period:
                rows.append((expm(system * time) @ [*state, unit[-1], 0.0])[0])
            columns.append(rows)
        near = 0.95 * found.within * goal
        motion = np.array(columns).T
        turned = np.eye(knots + 1, k=1)[:-1] - np.eye(knots + 1)[:-1]
        most = limits.rate * step
        ends = np.zeros((2, knots + 1))
        ends[0, 0] = ends[1, -1] = 1
        answer = linprog(
            np.zeros(knots + 1),
            np.concatenate([motion, -motion, turned, -turned]),
            [*[goal + near] * 60, *[near - goal] * 60, *[most] * (2 * knots)],
            ends, [0.0, goal], bounds=(-limits.angle, limits.angle),
        )  # fmt: skip
        return answer.status == 0

    low, high = found.direct.command.times[-1], 3 * found.period
    while high / low > 1.005:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if feasible(middle) else (middle, high)
    assert found.planned.command.times[-1] == pytest.approx(high, rel=0.03)


def test_the_tip_is_brought_to_a_place():
    place = (2.6, 0.5, 0.7)
    one = arm()
    (held,) = Tip(place).commands(one, np.zeros(LINKS), CommandLimits())
    found = plan_command(ArmModel(one), Pose(held), draw_count=0)
    np.testing.assert_allclose(found.goal, place, atol=1e-4)
    np.testing.assert_allclose(found.planned.tips[-1], place, atol=0.02 * found.travel)


@pytest.mark.long
def test_a_search_that_crawls_ends_near_the_optimum():
    """SLSQP alone takes many more steps, for a command that is hardly shorter."""
    pose, limits = np.deg2rad([30.0, -20.0, 10.0, 0, 0, 0]), CommandLimits(rate=np.deg2rad(4.0))
    found = plan_command(ArmModel(takeichi_20m(6)), Pose(pose), limits=limits, knots=24)
    task = found.problem
    alone = minimize(
        lambda y: (task.cost @ y, task.cost),
        task.start,
        jac=True,
        method="SLSQP",
        bounds=list(zip(task.low, task.high, strict=True)),
        constraints=[
            {"type": "ineq", "fun": task.values, "jac": task.slopes},
            {
                "type": "ineq",
                "fun": lambda y: task.linear @ y + task.offset,
                "jac": lambda y: task.linear,
            },
        ],
        options={"maxiter": 200, "ftol": 3e-4},
    )
    assert found.steps < 0.8 * alone.nit
    assert found.planned.command.times[-1] < 1.01 * task.command(alone.x).times[-1]
    assert found.planned.missed <= found.within * found.travel


@pytest.mark.long
def test_muscles_stay_below_their_pressure():
    pulled = takeichi_20m(2, muscles="pitch", parameters={"joints.damping": 0.5})
    begin, pose = np.deg2rad([[10.0, 0.0], [25.0, 0.0]])
    pressures = []
    for limit in (None, 31.45e3):
        found = plan_command(
            ArmModel(pulled), Pose(pose), begin=begin, draw_count=0,
            limits=CommandLimits(pressure=limit, rate=np.deg2rad(4.0)),
        )  # fmt: skip
        angles = jnp.asarray(found.planned.command.angles)
        pressures.append(max(float(jnp.max(pulled.pneumatics.commanded(row))) for row in angles))
    assert pressures[0] > 31.5e3
    assert pressures[1] <= 31.45e3 * (1 + 1e-3)


BOX = Box([3.72, 0.0, 0.0], [1.0, 2.0, 1.0], name="shelf")


def beside(arm, *things):
    return dataclasses.replace(arm, contact=Contact(things))


@pytest.mark.long
def test_a_link_is_bent_to_keep_clear_of_what_the_direct_way_is_too_near():
    """The straight arm passes a box at a distance of 0.1 m."""
    begin, pose = np.deg2rad([[-20.0, 0.0, 0.0], [20.0, 0.0, 0.0]])
    around = beside(arm(), BOX)
    found = plan_command(ArmModel(around), Pose(pose), begin=begin, limits=LIMITS, draw_count=0)
    assert found.direct.clearance < LIMITS.clearance - 0.05
    command = found.planned.command
    times = np.linspace(0.0, 1.2 * command.times[-1], 400)
    motion = simulate(
        arm(), command.signal(len(command.times)), times, solver="tsit5", rtol=1e-8, atol=1e-8,
        initial=(found.planned.angles[0], np.zeros(LINKS)),
    )  # fmt: skip
    gaps = jax.vmap(lambda each: clearance(around, each))(motion.angles)
    assert float(jnp.min(gaps)) > LIMITS.clearance - 0.01
    assert found.planned.clearance == pytest.approx(float(jnp.min(gaps)), abs=0.02)
    # The planned command bends a joint that is straight at the start and at the end.
    assert np.max(np.abs(command.angles[:, 2])) > np.deg2rad(10)


def test_ends_too_near_an_obstacle_are_refused_by_its_name():
    model = ArmModel(beside(arm(), BOX))
    near = np.deg2rad([20.0, 0.0, 0.0])
    for begin, pose, where in ((0 * near, near, "begins"), (near, 0 * near, "ends")):
        with pytest.raises(InputError, match=f"when the command {where}, link 3 is .* from shelf"):
            plan_command(model, Pose(pose), begin=begin)
    inside = ArmModel(beside(arm(), dataclasses.replace(BOX, centre=jnp.array([3.2, 0.0, 0.0]))))
    with pytest.raises(InputError, match=r"link 3 is 0\.28 m inside shelf"):
        plan_command(inside, Pose(near))


def test_a_way_past_the_opening_is_refused():
    # The outer face of the wall is towards the base.
    wall = WallWithOpening([2.0, 0.0, 0.0], [1.0, 1.0], [4.0] * 4, 0.2, [0.0, 0.0, np.pi])
    around, target = beside(arm(), wall), Through()
    x = np.linspace(0.0, 3.0, 20)
    ways = {side: np.stack([x, side + 0 * x, 0 * x], axis=1) for side in (0.4, 0.6)}
    target.check(around, ways[0.4])
    for tips in (ways[0.6], ways[0.4][:5], ways[0.4][::-1]):
        with pytest.raises(InputError, match="does not pass through the opening"):
            target.check(around, tips)


@pytest.mark.long
def test_joints_that_remember_stay_near_for_three_periods():
    memory = {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.001}
    remembers = arm(parameters=memory)
    found = plan_command(ArmModel(remembers), Pose(POSE), limits=LIMITS, draw_count=0)
    assert not found.notes
    command = found.planned.command
    end = command.times[-1]
    times = np.concatenate([[0.0], end + np.linspace(0, 3 * found.period, 300)])
    tips = tips_by(remembers, command, times, found.planned.angles[0], "springs5", 1e-7)
    off = np.linalg.norm(tips[1:] - found.goal, axis=1)
    assert np.max(off) <= 1.1 * found.within * found.travel
    assert found.direct.missed > 5 * found.planned.missed
    # Because of hysteresis, the final command differs from the pose.
    assert np.max(np.abs(command.angles[-1] - POSE)) > np.deg2rad(0.1)


@pytest.mark.long
def test_the_paper_s_arm_goes_through_the_opening():
    """A separate simulation clears the housetop, and is much faster than the direct command."""
    from giajax.apps.mission import Mission

    stated = Definition.load("missions/naraha.toml").contents()
    del stated["arm"]["parameters"]  # joints without hysteresis
    mission = Mission.from_definition(Definition.parse(stated))
    model, opening = mission.model, mission.opening
    target = Through("housetop", approach=np.asarray(mission.controller.approach))
    found = plan_command(model, target, knots=8, draw_count=0)
    local = np.asarray(opening.local(jnp.asarray(found.planned.tips)))
    ended = found.planned.times >= found.planned.command.times[-1]
    assert np.all(local[ended, 0] < -mission.section.beyond_m + 0.1)
    crossing = np.flatnonzero((local[:-1, 0] > 0) & (local[1:, 0] <= 0))
    assert len(crossing) == 1
    assert np.all(np.abs(local[crossing[0], 1:]) < np.asarray(opening.half))
    command = found.planned.command
    free = dataclasses.replace(model.arm, contact=None)
    times = np.linspace(0, 1.5 * command.times[-1], 120)
    motion = simulate(free, command.signal(len(command.times)), times, rtol=1e-6, atol=1e-6)
    least = float(jnp.min(jax.vmap(lambda row: clearance(model.arm, row))(motion.angles)))
    assert least > found.limits.clearance - 0.03
    assert found.planned.settled < 0.6 * found.direct.settled


TOO_MUCH = [
    ({"target": Pose(np.zeros(LINKS + 1))}, "the pose has 4 angles, but the arm has 3 joints"),
    ({"target": Pose(np.zeros(LINKS))}, "the tip is already at its target"),
    ({"target": Pose(np.deg2rad([70.0, 0, 0]))}, "is commanded to 70 deg"),
    ({"target": Tip((9.0, 0.0, 1.0))}, "the tip cannot be at .* choose a target within reach"),
    ({"target": Through()}, "the arm has no opening to enter"),
    (
        {"duration": 1.0},
        "the motion to the target takes 10.0 s, but the command is to last only 1 s",
    ),
    ({"limits": CommandLimits(pressure=1e4)}, "the arm has no muscles"),
    ({"begin": np.zeros(2)}, "the initial pose has 2 angles"),
    ({"within": 0.0}, "a number between 0 and 1"),
    ({"knots": 1}, "too short to brake"),
    ({"duration": -1.0}, "give a positive number"),
]


@pytest.mark.parametrize(("how", "sentence"), TOO_MUCH)
def test_what_cannot_be_planned_is_said_in_a_sentence(how, sentence):
    how = {"target": Pose(POSE), **how}
    with pytest.raises(InputError, match=sentence):
        plan_command(ArmModel(arm()), how.pop("target"), **how)


def test_limits_leave_something():
    for name in ("angle", "rate", "pressure"):
        with pytest.raises(InputError, match=f"the largest {name} is -1"):
            CommandLimits(**{name: -1.0})
    with pytest.raises(InputError, match="the clearance is -1 m"):
        CommandLimits(clearance=-1.0)


FILE = """\
schema_version = 1
model = "arm"

[arm]
preset = "takeichi_20m_full"
links = 3
"""


def test_a_plan_is_written_as_a_run_that_the_arm_follows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(FILE)
    words = ["arm.toml", "--pose", "1=20", "--pose", "2=10", "--begin", "1=5"]
    limits = ["--max-angle-rate", "8", "--max-angle", "40"]
    assert main(["plan", *words, *limits, "--out", "planned"]) == 0
    said = capsys.readouterr().out
    assert "planned" in said
    assert "next: giajax synth" in said
    facts = json.loads((tmp_path / "planned" / "plan.json").read_text())
    direct, planned = facts["commands"]
    assert planned["settled_s"] < (direct["settled_s"] or np.inf)
    run = read_run("planned/command.csv")
    assert run.times[-1] == pytest.approx(planned["ends_s"])
    rehearsal = ["--channels", "tip_x", "--channels", "tip_z", "--to", "rehearsal.csv"]
    given = ["--data", "planned/command.csv", "--model", "arm.toml"]
    assert main(["synth", *given, *rehearsal, "--quiet"]) == 0
    path = np.genfromtxt("planned/path.csv", delimiter=",", names=True)
    rehearsed = read_run("rehearsal.csv")
    for axis in "xz":
        expected = np.interp(rehearsed.times, path["time_s"], path[f"tip_{axis}_m"])
        np.testing.assert_allclose(rehearsed.values[f"tip_{axis}"], expected, atol=2e-3)
    assert main(["plan", *words, "--out", "planned"]) == 2
    assert "is not overwritten" in capsys.readouterr().err


@pytest.mark.long
def test_a_fit_gives_bands_and_its_values_to_the_command(tmp_path, monkeypatch, capsys):
    """The drives have a lag; the rehearsal uses only the written command and its sidecar."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text(f'{FILE}\n[arm.parameters]\n"joints.drive_lag" = 0.3\n')
    rows = ["time_s,joint01_command_deg,joint02_command_deg"]
    rows += [f"{t:g},{10 * min(t, 1):g},{6 * math.sin(2 * t):g}" for t in np.arange(0, 12, 0.1)]
    (tmp_path / "moved.csv").write_text("\n".join(rows))
    truth = ["--model", "arm.toml", "--set", "joints.pitch_stiffness=2.4"]
    seen = ["--channels", "tip_y", "--channels", "tip_z", "--noise", "position_m=0.02"]
    assert main(["synth", "--data", "moved.csv", *truth, *seen, "--to", "run.csv"]) == 0
    free = ["--free", "joints.pitch_stiffness", "--free", "air.drag_coefficient"]
    quick = ["--no-suspects", "--no-figures", "--quiet"]
    assert main(["fit", "--data", "run.csv", *free, *quick, "--out", "fit"]) == 0
    capsys.readouterr()
    words = ["fit", "--tip", "2.6,0.5,0.7", "--max-angle-rate", "8", "--scenarios", "8"]
    assert main(["plan", *words, "--out", "planned", "--json", "--quiet"]) == 0
    facts = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(facts["goal_m"], [2.6, 0.5, 0.7], atol=1e-4)
    assert len(facts["commands"][1]["residual_drawn_m"]) == 8
    path = np.genfromtxt("planned/path.csv", delimiter=",", names=True)
    assert np.all(path["tip_z_low_m"] < path["tip_z_high_m"])
    run = read_run("planned/command.csv")
    fitted = json.loads((tmp_path / "fit" / "result.json").read_text())["parameters"]
    stated = ArmModel.stated_in(run.definition).arm
    stiffness = fitted["joints.pitch_stiffness"]["value"]
    assert stiffness == pytest.approx(2.4, rel=0.05)
    assert float(stated.joints.pitch_stiffness) == pytest.approx(stiffness, rel=1e-12)
    to = ["--channels", "tip_z", "--to", "rehearsal.csv", "--quiet"]
    assert main(["synth", "--data", "planned/command.csv", *to]) == 0
    rehearsed = read_run("rehearsal.csv")
    expected = np.interp(rehearsed.times, path["time_s"], path["tip_z_m"])
    np.testing.assert_allclose(rehearsed.values["tip_z"], expected, atol=2e-3)
    assert "--json" not in (tmp_path / "planned" / "command.toml").read_text()
    stored = json.loads((tmp_path / "fit" / "result.json").read_text())
    stored["verdict"]["status"] = "inadequate"
    (tmp_path / "fit" / "result.json").write_text(json.dumps(stored))
    capsys.readouterr()
    assert main(["plan", "fit", "--pose", "9=20", "--out", "other"]) == 2
    said = capsys.readouterr().err
    assert "note: according to its verdict, the fit fit is inadequate" in said


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "0 targets are given, but a plan has a single target"),
        (
            ["--pose", "1=20", "--tip", "1,1,1"],
            "2 targets are given, but a plan has a single target",
        ),
        (["--tip", "1,1"], "give three numbers in m"),
        (["--pose", "first=20"], "give JOINT=DEG"),
        (["--pose", "20"], "must be JOINT=DEG with a number: write it like 1=20"),
        (["--pose", "9=20"], "the arm has joints 1 to 3"),
    ],
)
def test_targets_that_are_none(words, sentence, tmp_path, capsys):
    (tmp_path / "arm.toml").write_text(FILE)
    given = [str(tmp_path / "arm.toml"), "--out", str(tmp_path / "planned")]
    assert main(["plan", *words, *given]) == 2
    assert sentence in capsys.readouterr().err
    assert not (tmp_path / "planned").exists()
