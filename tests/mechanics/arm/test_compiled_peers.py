"""The peers of `make bench`: equations derived by CasADi, and MuJoCo with its drag in C."""

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import acceleration
from giajax.schema.parameters import replace
from giajax.simulation import joint_ramps
from peers import compiling
from peers.arms import driven_arm, full_arm, general_arm, random_states
from peers.compiling import SOURCES, NoCompilerError
from peers.mujoco_chain import MujocoChain
from peers.plain_arm import PARAMETERS, PlainArm
from peers.scipy_chain import ScipyChain

casadi_chain = pytest.importorskip("peers.casadi_chain", reason="casadi is not installed")
casadi_c = pytest.importorskip("peers.casadi_c", reason="casadi is not installed")
mujoco_c = pytest.importorskip("peers.mujoco_c", reason="mujoco is not installed")

TIMES = np.linspace(0.0, 2.0, 5)
STEP = 0.0125


def compiled(kind, *arguments):
    try:
        return kind(*arguments)
    except NoCompilerError as error:
        pytest.skip(str(error))


def in_c(arm, command=None):
    return compiled(casadi_c.CasadiInC, arm, command)


def mujoco(arm, command=None):
    return compiled(mujoco_c.MujocoInC, arm, command)


def numbers(links, count=10):
    states = random_states(links, count)
    return [
        {name: np.asarray(states[name][row]) for name in ("angles", "rates", "command")}
        for row in range(count)
    ]


@pytest.fixture(scope="module")
def short():
    """Return an arm without symmetry, with both stiffnesses, and a command for both joints."""
    arm = general_arm(2)
    assert set(PlainArm(arm).yaws) == {False, True}
    return arm, joint_ramps(2, {1: 0.5, 2: -0.3}, start=0.25, duration=0.5)


@pytest.fixture(scope="module")
def generated(short):
    return in_c(*short)


def ends_by_callback(arm, command):
    """Return the ends of the links by MuJoCo with its forces in Python."""
    angles = MujocoChain(arm, command).trajectory(TIMES, STEP)[:, 0]
    chain = ScipyChain(arm)
    along = np.array([chain.orientations(row)[:, :, 0] for row in angles])
    return np.cumsum(chain.length[:, None] * along, axis=1)


def test_accelerations_are_those_of_giajax(short, generated):
    """Random axes, a rotated base, gravity, springs, dampers and drag."""
    arm, _ = short
    ours = jax.jit(acceleration)
    peers = [casadi_chain.CasadiChain(arm), generated, mujoco(arm)]
    for state in numbers(2):
        expected = np.asarray(ours(arm, **state))
        atol = 1e-9 * np.abs(expected).max()
        for peer in peers:
            assert_allclose(peer.acceleration(**state), expected, rtol=0, atol=atol)


def test_casadi_derives_the_papers_arm():
    arm, _ = driven_arm()
    chain, other = casadi_chain.CasadiChain(arm), ScipyChain(arm)
    for state in numbers(20, 3):
        expected = other.acceleration(**state)
        atol = 1e-9 * np.abs(expected).max()
        assert_allclose(chain.acceleration(**state), expected, rtol=0, atol=atol)


def test_the_same_steps_lead_to_the_same_place(short, generated):
    """Classical Runge-Kutta steps by MuJoCo, in Python and in C, and with CasADi's code."""
    expected = ends_by_callback(*short)
    assert np.abs(np.diff(expected[:, -1], axis=0)).max() > 0.1
    assert_allclose(mujoco(*short).ends(TIMES, STEP), expected, rtol=0, atol=1e-12)
    assert_allclose(generated.ends(TIMES, STEP), expected, rtol=0, atol=1e-11)
    third = generated.ends(TIMES, STEP, "RK3")
    assert 1e-8 < np.abs(third - expected).max() < 1e-3


def test_derivatives_of_generated_code_are_those_of_its_steps(generated):
    """This includes the state of rest, in which the arm starts."""
    values = np.array(list(generated.parameters.values()))
    ends, jacobian = generated.ends_and_jacobian(TIMES, STEP)
    assert_allclose(ends, generated.ends(TIMES, STEP), rtol=0, atol=1e-13)
    assert jacobian.shape == (5, 2, 3, len(PARAMETERS))
    for index, value in enumerate(values):
        step = np.zeros_like(values)
        step[index] = 1e-5 * value
        forth = generated.ends(TIMES, STEP, parameters=values + step)
        back = generated.ends(TIMES, STEP, parameters=values - step)
        slope = (forth - back) / (2 * step[index])
        assert np.abs(slope).max() > 1e-3
        atol = 1e-6 * np.abs(slope).max()
        assert_allclose(jacobian[..., index], slope, rtol=0, atol=atol)


def test_parameters_are_changed_in_place(short, generated):
    arm, command = short
    values = {path: 1.3 * value for path, value in generated.parameters.items()}
    expected = ends_by_callback(replace(arm, values), command)
    engine = mujoco(arm, command)
    before = engine.ends(TIMES, STEP)
    engine.set_parameters(values)
    assert np.abs(before - expected).max() > 1e-2
    assert_allclose(engine.ends(TIMES, STEP), expected, rtol=0, atol=1e-12)
    theirs = generated.ends(TIMES, STEP, parameters=values.values())
    assert_allclose(theirs, expected, rtol=0, atol=1e-11)


def test_many_states_on_threads(short):
    states = numbers(2, 7)
    stacked = [np.stack([state[name] for state in states]) for name in states[0]]
    engine = mujoco(short[0])
    alone = np.stack([engine.acceleration(**state) for state in states])
    assert_allclose(engine.batch(*stacked, threads=2), alone, rtol=0, atol=0)
    assert_allclose(engine.batch(*stacked, threads=8), alone, rtol=0, atol=0)


def test_steps_that_are_too_long_are_said(short, generated):
    with pytest.raises(FloatingPointError, match="unstable"):
        mujoco(*short).ends(TIMES, 0.25)
    with pytest.raises(FloatingPointError, match="unstable"):
        generated.ends(TIMES, 0.25)
    with pytest.raises(ValueError, match="corners do not fall on steps"):
        generated.ends(TIMES, 0.5)


def test_an_arm_with_more_is_refused():
    with pytest.raises(ValueError, match="buoyancy, point masses, friction, armature, wind"):
        casadi_chain.CasadiChain(full_arm(2))


def test_a_machine_without_a_compiler_is_told(monkeypatch):
    monkeypatch.setattr(compiling.shutil, "which", lambda name: None)
    with pytest.raises(NoCompilerError, match=r"^no C compiler is there: install one"):
        compiling.compiled(SOURCES / "mujoco_run.c")
