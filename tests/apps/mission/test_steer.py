"""Model predictive control: the plan and its simulation, the available information, the end."""

import dataclasses
import json
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import lsq_linear

from giajax import InputError, simulate
from giajax.apps.mission import (
    CONTROLLERS,
    Picture,
    Scene,
    box_least_squares,
    mission_figure,
    mission_json,
)
from giajax.apps.tracking import Gaussian, Held
from giajax.mechanics.arm import clearance, tip_position
from giajax.schema.parameters import replace
from giajax.simulation import Stepper, ramps
from small_mission import mission_of, small_mission

FOLDER = Path(__file__).resolve().parents[3] / "missions"


def steered(controller="mpc", **changes):
    text = (FOLDER / "naraha.toml").read_text(encoding="utf-8")
    return mission_of(text, controller, {"mission__limit_s": 120.0, **changes})


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_quadratic_program_is_solved_within_its_bounds(seed):
    """Compared with scipy's trust-region method; few iterations come close, within the bounds."""
    rng = np.random.default_rng(seed)
    matrix, values = rng.normal(size=(60, 40)), rng.normal(size=60)
    bounds = -np.abs(rng.normal(size=40)) / 10, np.abs(rng.normal(size=40)) / 10
    exact = lsq_linear(matrix, values, bounds, tol=1e-12)
    assert 5 < np.sum(exact.active_mask != 0) < 40
    given = (*map(jnp.asarray, (matrix, values, *bounds)), jnp.asarray(rng.normal(size=40)))
    many, few = (np.asarray(box_least_squares(*given, count)) for count in (2000, 60))
    assert_allclose(many, exact.x, atol=1e-8)
    assert np.all((bounds[0] <= few) & (few <= bounds[1]))
    cost = np.sum((matrix @ few - values) ** 2) / 2
    assert cost < 1.001 * exact.cost


@pytest.mark.slow
def test_a_plan_goes_where_a_simulation_of_it_goes():
    """From rest and some centimetres away, the tip comes to the place in front of the opening.

    The plan is linearised, and simulated by another method. The simulation omits drag, which has
    zero slope at rest, and the rotation of the camera, for which joints have to turn far.
    """
    mission = steered(arm__parameters={"air.drag_coefficient": 1e-6})
    steering = mission.controller
    arm = dataclasses.replace(mission.model.arm, contact=None)
    scene = Scene(arm, mission.camera, mission.opening, jnp.asarray(0.1))
    place = mission.opening.centre + steering.stand_off * mission.opening.frame[:, 0]
    command = steering.approach
    for _ in range(10):
        slope = jax.jacfwd(lambda q: tip_position(arm, q))(command)
        off = place + 0.03 - tip_position(arm, command)
        command = command + slope.T @ jnp.linalg.solve(slope @ slope.T, off)
    mean = steering.start_at.mean.at[: len(command)].set(command)
    now = Gaussian(mean, jnp.zeros_like(steering.start_at.root))
    nothing = jnp.asarray(0.0)
    steering = dataclasses.replace(steering, deep=-steering.stand_off, aim_weight=nothing)
    last = jnp.zeros((10, len(command)))
    plan = eqx.filter_jit(steering.plan)(scene, now, command, last, jnp.asarray(False))
    plan = np.asarray(plan)
    assert np.all(np.abs(plan) <= float(steering.rate_limit))
    lengths = np.array([1, 1, 2, 2, 3, 3, 4, 4, 5, 5.0])
    times = np.concatenate([[0.0], np.cumsum(lengths)])
    rows = np.asarray(command) + np.concatenate(
        [np.zeros((1, len(command))), np.cumsum(lengths[:, None] * plan, axis=0)]
    )
    begun = command, jnp.zeros_like(command)
    found = simulate(arm, ramps(times, rows), times, initial=begun, solver="tsit5")
    gaps = np.linalg.norm(np.asarray(found.tip) - np.asarray(place), axis=1)
    assert gaps[0] > 0.05
    assert np.all(gaps[3:] < 0.25 * gaps[0])
    slope = jax.jacfwd(lambda q: tip_position(arm, q))(found.angles[-1])
    assert np.linalg.norm(slope @ found.rates[-1]) < 0.05


@pytest.mark.parametrize(
    "late", [pytest.param(0, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.long)]
)
def test_without_a_picture_the_estimate_is_the_simulated_state(late):
    """Each command is applied in its own interval from the start on, however late pictures are."""
    mission = small_mission()
    steering = mission.controller
    arm = dataclasses.replace(mission.model.arm, contact=None)
    scene = Scene(arm, mission.camera, mission.opening, jnp.asarray(0.1))
    memory = steering.start(scene, late)
    stepper = Stepper(arm, 0.1)
    advance = eqx.filter_jit(stepper.advance)
    estimate, now = eqx.filter_jit(steering.estimate), eqx.filter_jit(steering.now)
    moment, gaps = stepper.start(), []
    turn = jnp.deg2rad(jnp.linspace(0.2, -0.1, 8))
    # The tracker starts with still air, which is its mean.
    for row in range(12):
        nothing = Picture(jnp.zeros((4, 2)), jnp.zeros(4, bool), jnp.asarray(False), turn)
        memory = estimate(scene, memory, nothing, moment.command)
        found = steering.tracked.arm_state(now(scene, memory).mean)
        gaps.append(np.abs(np.asarray(found[:2] - moment.state[:2])).max())
        moment = advance(moment, moment.command + (1 + row % 3) * turn)
    assert np.abs(moment.rates).max() > 1e-2
    assert max(gaps) < 1e-6


def test_what_is_expected_is_the_middle_of_what_may_come():
    """Without process noise, the arm of the tracker moves like its mean."""
    tracked = steered().controller.tracked
    rng = np.random.default_rng(0)
    vector = steered().controller.start_at.mean
    vector = vector.at[:40].add(jnp.asarray(0.05 * rng.normal(size=40)))
    held = Held(
        jnp.asarray(0.0), jnp.asarray(0.1), jnp.asarray(rng.normal(size=(2, 20)) / 10),
        jnp.zeros((2, 3)),
    )  # fmt: skip
    mean = eqx.filter_jit(lambda v: tracked.moved(v, held)[0])(vector)
    alone = eqx.filter_jit(lambda v: tracked.expected(v, held))(vector)
    assert_allclose(alone, mean, atol=1e-12)
    assert np.abs(np.asarray(alone - vector)[:20]).max() > 1e-5


@pytest.mark.long
def test_the_tip_comes_in_sooner():
    """The paper's arm in its air, for which the operator takes three minutes."""
    flown = steered().fly(1)
    assert flown.reached is not None
    assert flown.reached < 110
    assert flown.flattening == 0
    assert np.abs(flown.command).max() <= np.deg2rad(60) + 1e-12
    assert (np.abs(np.diff(flown.command, axis=0)) / 0.1).max() <= np.deg2rad(2.0) * (1 + 1e-9)


@pytest.fixture(scope="module")
def flown():
    """A mission of a short arm; the tests below use it."""
    return small_mission().fly(1)


@pytest.mark.long
def test_the_arm_goes_through_the_middle_of_the_frame(flown):
    """With the tip on the axis, the arm would pass one side at a distance of 0.19 m."""
    arm = small_mission().model.arm
    gaps = jax.jit(jax.vmap(lambda angles: clearance(arm, angles)))(jnp.asarray(flown.angles))
    assert flown.reached is not None
    assert gaps.min() > 0.4


@pytest.mark.long
def test_it_knows_no_more_than_pictures_show(flown):
    """Without pictures, the commands of two arms in different air are the same."""
    blind = small_mission(mission__camera_stops_s=0.0)
    soft = blind.with_model(replace(blind.model, {"joints.pitch_stiffness": 2.0}))
    one, other = blind.fly(1), soft.in_wind(0.3).fly(2, drawn=blind)
    assert np.linalg.norm(one.tip[-1] - other.tip[-1]) > 0.1
    assert_allclose(one.command, other.command, atol=1e-12)
    assert one.reason == "the camera stopped before the tip was inside the opening"
    assert one.corners.max() == 0
    # Until the first picture arrives, the commands with and without pictures are the same.
    seen = int(np.argmax(flown.corners >= 1))
    assert seen > 20
    assert_allclose(flown.command[: seen + 4], one.command[: seen + 4], atol=1e-12)
    # The safe state is the approach, at which the commands stay.
    approach = np.asarray(blind.controller.approach)
    assert np.abs(one.command[-1] - approach).max() < np.deg2rad(3.0)
    assert np.abs(one.command[-1] - one.command[-50]).max() < np.deg2rad(0.5)


@pytest.mark.long
def test_a_camera_that_stops_ends_in_the_safe_state(flown):
    stopped = small_mission(mission__camera_stops_s=15.0).fly(1)
    assert_allclose(stopped.command[:150], flown.command[:150], atol=1e-12)
    assert stopped.reached is None
    assert stopped.reason == "the camera stopped before the tip was inside the opening"
    late = stopped.command[-100:]
    assert np.abs(np.diff(late, axis=0)).max() / 0.1 < np.deg2rad(0.2)


@pytest.mark.slow
def test_the_tip_is_held_before_the_opening():
    """In moving air, with pictures."""
    held = small_mission().keeping_station(100.0)
    outcome = held.case(1).fly(1, drawn=held)
    assert outcome.reached is None
    late = outcome.tip[-300:]
    assert np.sqrt(np.mean(np.sum((late - late.mean(axis=0)) ** 2, axis=1))) < 0.2
    local = np.asarray(held.opening.local(jnp.asarray(outcome.tip[-300:])))
    assert_allclose(local.mean(axis=0), [2.5, 0.0, 0.0], atol=0.2)
    facts = json.loads(mission_json(held, outcome))
    assert (facts["controller"], facts["keeps_station"]) == ("mpc", True)
    assert facts["swing_m"] == outcome.swing
    assert "in front of the opening to within" in mission_figure(held, outcome).get_suptitle()


@pytest.mark.long
def test_an_estimate_that_is_no_number_stops_all_commands():
    mission = small_mission()
    steering = mission.controller
    scene = Scene(mission.model.arm, mission.camera, mission.opening, jnp.asarray(0.1))
    memory = steering.start(scene, 4)
    moves = jnp.full_like(memory.plan, 0.01)
    lost = memory._replace(state=memory.state._replace(mean=memory.state.mean * jnp.nan))
    nothing = Picture(jnp.zeros((4, 2)), jnp.zeros(4, bool), jnp.asarray(False), steering.approach)
    decide = eqx.filter_jit(steering.decide)
    command = jnp.linspace(-0.1, 0.1, 8)
    for decisions in (0, 1):
        given = lost._replace(plan=moves, decisions=jnp.asarray(decisions))
        assert_allclose(decide(scene, given, nothing, command)[1], command, atol=1e-15)
    assert np.abs(decide(scene, memory, nothing, command)[1] - command).max() > 1e-4


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"controller": "pid"}, "the controller is 'pid': give one of operator, mpc"),
        ({"arm__links": 10, "mission__operator__approach": {"joints": [1], "angles_deg": [3.0]}},
         r"the opening is 15\.9 m from the base, but the arm is only 9\.9 m long"),
        ({"mission__steering": {"speed_m_per_s": 0.0}}, "speed_m_per_s = 0.0 must be a positive"),
        ({"mission__camera_stops_s": -1.0}, "camera_stops_s = -1.0"),
    ],
)  # fmt: skip
def test_what_is_no_mission_of_it_is_refused(changes, sentence):
    with pytest.raises(InputError, match=sentence):
        steered(**changes)


def test_each_controller_is_of_its_section():
    assert set(CONTROLLERS) == {"operator", "mpc"}
    slow = steered(mission__steering={"speed_m_per_s": 0.1, "stand_off_m": 1.0})
    assert float(slow.controller.speed) == 0.1
    assert float(slow.controller.stand_off) == 1.0
    calm = steered(mission__steering={"air_m_per_s": 0.1}).controller.tracked.gusts
    windy = steered(mission__steering={"air_m_per_s": 0.4}).controller.tracked.gusts
    assert_allclose(windy.root, 4 * calm.root, rtol=1e-6)
