"""Fixed steps with decisions on the way: the motion equals a simulation of all decisions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics.arm import Contact, takeichi_20m
from giajax.mechanics.obstacles import Plane
from giajax.schema.parameters import replace
from giajax.simulation import Stepper, logged, simulate

INTERVAL = 1 / 30
TIMES = np.arange(61) * INTERVAL
STIFF = {"joints.pitch_stiffness": 3.0, "joints.yaw_stiffness": 3.0, "joints.damping": 0.1}
ARMS = {
    "springs": {},
    "stops": {
        "parameters": STIFF
        | {"joints.stops.strength": [0.1, 0.2], "joints.stops.yield_angle": [0.01, 0.05]}
    },
    "lagging muscles": {
        "muscles": "pitch",
        "parameters": {"joints.damping": 0.6, "joints.yaw_stiffness": 5.0, "drive.lag": 0.3},
    },
    "ground": {
        "contact": Contact(obstacles=(Plane(centre=[0.0, 0.0, -0.5]),)),
        "parameters": {"links.pressure": 200.0},
        "gravity": 9.81,
    },
}


def operated():
    """Return the commands of an operator, whose joint rates change arbitrarily."""
    random = np.random.default_rng(3)
    rates = np.repeat(random.normal(size=(6, 3)) * 0.3, 10, axis=0)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(rates * INTERVAL, axis=0)])


@eqx.filter_jit
def stepped(stepper, commands, wind=None):
    def one(moment, command):
        moment = stepper.advance(moment, command)
        return moment, moment.angles

    last, angles = jax.lax.scan(one, stepper.start(wind=wind), commands[1:])
    return last, jnp.concatenate([jnp.zeros((1, 3)), angles])


# Cases that compile quickly come first. Contact and muscles have further tests.
LONGER = ("lagging muscles", "ground")


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind in LONGER)) for kind in ARMS]
)
def test_decisions_on_the_way_are_a_log_known_before(kind):
    arm = takeichi_20m(3, **({"parameters": STIFF} | ARMS[kind]))
    commands, wind = operated(), np.array([0.3, 0.5, 0.0])
    command = logged(TIMES, commands)
    expected = simulate(arm, command, TIMES, wind=wind, solver="springs5", rtol=1e-9, atol=1e-9)
    errors = [
        np.abs(stepped(Stepper(arm, INTERVAL, steps), commands, wind)[1] - expected.angles).max()
        for steps in (1, 16)
    ]
    # Sticking, sliding and contact start and end within steps.
    coarse, fine = {"ground": (1e-2, 1e-4), "stops": (2e-3, 1e-4)}.get(kind, (1e-4, 1e-6))
    assert errors[0] < coarse
    assert errors[1] < fine
    assert errors[1] < 0.1 * errors[0]


def test_one_at_a_time_is_all_at_once():
    stepper, commands = Stepper(takeichi_20m(3, parameters=STIFF), INTERVAL, 2), operated()
    moment = stepper.start()
    for command in commands[1:]:
        moment = stepper.advance(moment, command)
    last, _ = stepped(stepper, commands)
    assert_allclose(moment.state, last.state, rtol=0, atol=1e-13)
    assert_allclose(moment.time, TIMES[-1], rtol=1e-12)


def test_a_wind_comes_up_linearly():
    """It is linear between the values of consecutive intervals, like a signal with two knots."""
    arm = takeichi_20m(3, parameters=STIFF)
    stepper = Stepper(arm, INTERVAL, 4)
    moment = stepper.start(wind=np.zeros(3))
    winds = np.outer(np.minimum(TIMES, 1.0), [0.0, 1.0, 0.5])
    for wind in winds[1:]:
        moment = stepper.advance(moment, jnp.zeros(3), wind)
    still = logged(TIMES[[0, -1]], np.zeros((2, 3)))
    motion = simulate(arm, still, TIMES, wind=logged(TIMES, winds), rtol=1e-10, atol=1e-10)
    assert_allclose(moment.angles, motion.angles[-1], rtol=0, atol=1e-7)
    assert np.abs(motion.angles[-1]).max() > 1e-3


def test_derivatives_are_those_of_the_simulation():
    """By the command and by the stiffness, through all decisions."""
    arm, commands = takeichi_20m(3, parameters=STIFF), jnp.asarray(operated())

    def last(scale, stiffness):
        moved = replace(arm, {"joints.yaw_stiffness": stiffness})
        return stepped(Stepper(moved, INTERVAL), scale * commands)[0].angles

    at = np.array([1.0, 3.0])
    # One program for values and derivatives.
    along = jax.jit(lambda at, change: jax.jvp(lambda at: last(*at), (at,), (change,)))
    for change in np.eye(2):
        slope = along(at, change)[1]
        ahead, back = (along(at + sign * 1e-4 * change, change)[0] for sign in (1, -1))
        assert_allclose(slope, (ahead - back) / 2e-4, atol=1e-6 * np.abs(slope).max())


def test_what_cannot_be_stepped_is_refused():
    arm = takeichi_20m(3)
    with pytest.raises(InputError, match=r"the interval is 0\.0 s: give one positive number"):
        Stepper(arm, 0.0)
    with pytest.raises(InputError, match="an interval has 0 steps"):
        Stepper(arm, 0.1, 0)
    with pytest.raises(InputError, match="there is no solver 'euler'"):
        Stepper(arm, 0.1, solver="euler")
    stepper = Stepper(arm, 0.1)
    with pytest.raises(InputError, match=r"the argument rates has the shape \(2,\): give 3"):
        stepper.start(rates=[0.0, 1.0])
    with pytest.raises(InputError, match=r"the argument wind has the shape \(4,\): give 3"):
        stepper.start(wind=[0.0, 1.0, 0.0, 0.0])
    with pytest.raises(InputError, match=r"the argument command has the shape \(1,\)"):
        stepper.advance(stepper.start(), [0.1])
    with pytest.raises(InputError, match="the simulation was started in still air"):
        stepper.advance(stepper.start(), np.zeros(3), [0.0, 1.0, 0.0])


@pytest.mark.slow
def test_a_tolerance_makes_steps_as_short_as_they_need_be():
    """In this interval, equal steps would be too long for the impact on a stiff ground."""
    contact = Contact(obstacles=(Plane(centre=[0.0, 0.0, -0.5]),), friction=0.5)
    stiff = STIFF | {"links.pressure": 2000.0}
    arm = takeichi_20m(3, contact=contact, gravity=9.81, parameters=stiff)
    commands, times = operated()[::3], TIMES[::3]
    found = simulate(arm, logged(times, commands), times, solver="springs5", rtol=1e-9, atol=1e-9)
    errors = {}
    for tolerance in (1e-3, 1e-6):
        stepper = Stepper(arm, 3 * INTERVAL, tolerance=tolerance)
        errors[tolerance] = np.abs(stepped(stepper, commands)[1] - found.angles).max()
    assert errors[1e-3] < 2e-2
    assert errors[1e-6] < 5e-4
    assert errors[1e-6] < 0.1 * errors[1e-3]


def test_a_tolerance_is_positive():
    with pytest.raises(InputError, match=r"the tolerance is 0\.0: give a positive number"):
        Stepper(takeichi_20m(2), 0.1, tolerance=0.0)
