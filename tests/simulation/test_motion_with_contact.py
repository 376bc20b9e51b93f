"""Motion among obstacles: compared with MuJoCo, at rest, and over random impacts."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.mechanics.arm import (
    Contact,
    contact_energy,
    kinetic_energy,
    mass_matrix,
    potential_energy,
    takeichi_20m,
    touch,
)
from giajax.mechanics.obstacles import Box, Plane, WallWithOpening
from giajax.simulation import constant, contacts, joint_ramps, simulate
from peers.mujoco_contact import MujocoContact

WALL = ([1.9, 0.0, 0.5], [0.4, 0.2, 0.2], [0.0, 0.0, 0.4])
EDGE = ([1.3, 0.35, 0.0], [0.15, 0.15, 1.0], [0.0, 0.0, 0.7])


def arm_at(box, pressure=1000.0, **about):
    centre, half, turn = box
    obstacle = Box(centre=centre, size=2 * np.asarray(half), rotation=turn)
    stiff = {"joints.pitch_stiffness": 3.0, "joints.yaw_stiffness": 3.0, "joints.damping": 0.1}
    stiff["links.pressure"] = pressure
    return takeichi_20m(2, contact=Contact(obstacles=(obstacle,), **about), parameters=stiff)


THEIRS = {}


@pytest.mark.parametrize(
    ("box", "joint", "solver"),
    [
        pytest.param(WALL, 1, "springs5", marks=pytest.mark.slow),
        pytest.param(EDGE, 2, "springs5", marks=pytest.mark.slow),
        pytest.param(WALL, 1, "tsit5", marks=pytest.mark.slow),
        # The test below compares both solvers.
        pytest.param(EDGE, 2, "tsit5", marks=pytest.mark.long),
    ],
    ids=[
        f"{solver}-{what}"
        for solver in ("springs5", "tsit5")
        for what in ("swing into a wall", "press on an edge")
    ],
)
def test_the_same_penalty_in_mujoco(box, joint, solver):
    """MuJoCo uses its own distances at 200 points per link; giajax uses 15 in each contact."""
    arm = arm_at(box, pressure=200.0)
    command = joint_ramps(2, {joint: 0.6}, start=0.0, duration=0.25)
    times = np.linspace(0.0, 2.0, 41)
    motion = simulate(arm, command, times, solver=solver, rtol=1e-8, atol=1e-8)
    flat = contacts(motion).flattening
    assert 2e-3 < flat.max() < 0.15
    if joint not in THEIRS:  # one reference for both solvers
        THEIRS[joint] = MujocoContact(arm, [box], command).trajectory(times, 0.005)
    expected = THEIRS[joint]
    theirs = dataclasses.replace(motion, angles=jnp.asarray(expected[:, 0]))
    assert np.linalg.norm(theirs.tip - motion.tip, axis=1).max() < 1e-4


def resting():
    """Simulate a link that rests on the ground, while the wind pushes it sideways."""
    ground = Plane(centre=[0.0, 0.0, -0.6])
    return takeichi_20m(
        2,
        gravity=9.81,
        joint_axes=["pitch", "yaw"],
        contact=Contact(obstacles=(ground,), friction=0.5),
        parameters={
            "joints.pitch_stiffness": 0.2,
            "joints.yaw_stiffness": 0.1,
            "joints.damping": 0.02,
        },
    )


@pytest.mark.slow
def test_what_rests_does_not_drift():
    arm = resting()
    times = np.concatenate([np.linspace(0.0, 60.0, 31), np.linspace(120.0, 600.0, 5)])
    still = constant(jnp.zeros(2))
    about = {"wind": [0.0, 1.0, 0.0], "solver": "springs5", "rtol": 1e-8, "atol": 1e-8}
    motion = simulate(arm, still, times, **about)
    tip = np.asarray(motion.tip)
    assert np.abs(tip[-1] - tip[30]).max() < 1e-7
    # Without friction, the final position differs; with it, the force is within the friction cone.
    smooth = dataclasses.replace(arm, contact=dataclasses.replace(arm.contact, friction=None))
    slid = simulate(smooth, still, times, **about)
    assert np.linalg.norm(np.asarray(slid.tip[-1]) - tip[-1]) > 0.1
    force = np.asarray(contacts(motion).force[-1, 1, 0])
    assert 0.01 < np.hypot(force[0], force[1]) < 0.5 * force[2] * (1 + 1e-9)
    # Implicit contact needs few steps: the skin has 138 rad/s, and each run takes a second or two.
    assert int(motion.steps.sum()) < 4000


def test_impulse_is_what_the_motion_lost():
    """A free link that bounces off a wall: twice its angular momentum, apart from the damping."""
    wall = Box(centre=[0.9, 0.0, -0.45], size=[0.3, 0.6, 0.4])
    none = {"joints.pitch_stiffness": 1e-9, "joints.damping": 0.0, "air.drag_coefficient": 1e-9}
    none |= {"links.pressure": 50.0}
    for damping, kept in ((0.0, 1.0), (1.0, None)):
        arm = takeichi_20m(1, contact=Contact(obstacles=(wall,), damping=damping), parameters=none)
        times = np.linspace(0.0, 0.6, 3001)
        start = (jnp.zeros(1), jnp.asarray([-0.8]))
        motion = simulate(arm, constant(jnp.zeros(1)), times, initial=start, rtol=1e-9, atol=1e-9)
        rate, found = float(motion.rates[-1, 0]), contacts(motion)
        assert rate > 0
        assert found.flattening[-1, 0, 0] == 0
        inertia = float(jax.jit(mass_matrix)(arm, jnp.zeros(1))[0, 0])
        if kept is not None:
            assert_allclose(rate, 0.8, rtol=1e-4)
        else:
            assert rate > -0.75
        moment = inertia * (rate + 0.8)
        push = found.impulse[0, 0, 2]
        # The wall starts at x = 0.75, so the lever is between this and the tip.
        assert 0.7 < moment / float(push) < 0.99


SCENE = (
    Box(centre=[1.5, 0.0, -0.6], size=[0.8, 1.0, 0.8], rotation=[0.1, 0.2, 0.3]),
    Plane(centre=[0.0, 0.0, -0.9], normal=[0.1, 0.1, 1.0]),
    WallWithOpening(centre=[2.6, 0.0, 0.0], opening=[0.8, 0.7], thickness=0.1),
)


@pytest.mark.parametrize(
    ("solver", "obstacles", "count"),
    [
        # With so few pairs of links and boxes, all are evaluated together.
        pytest.param("springs5", SCENE[:2], 30, marks=pytest.mark.long),
        pytest.param("tsit5", SCENE, 15, marks=pytest.mark.long),
        pytest.param("springs5", SCENE, 1000, marks=pytest.mark.long),
        pytest.param("tsit5", SCENE, 1000, marks=pytest.mark.long),
    ],
    ids=["springs5-30", "tsit5-15", "springs5-1000", "tsit5-1000"],
)
def test_energy_does_not_grow_over_random_impacts(solver, obstacles, count):
    """Without air and joint damping, only contact with friction and damping remains.

    The force is the derivative of the computed energy, even if there are few points.
    """
    none = {"joints.damping": 0.0, "air.drag_coefficient": 0.0}
    contact = Contact(obstacles=obstacles, friction=0.3, points=2)
    arm = takeichi_20m(3, contact=contact, parameters=none)
    times = jnp.linspace(0.0, 1.5, 61)
    still = constant(jnp.zeros(3))

    def energies(rates):
        motion = simulate(
            arm,
            still,
            times,
            initial=(jnp.zeros(3), rates),
            solver=solver,
            rtol=1e-7,
            atol=1e-7,
            throw=False,
        )

        def of(q, v, s):
            held = arm.contact.hold(s, touch(arm, q, v, s).normal)
            pressed = contact_energy(arm, q)
            whole = kinetic_energy(arm, q, v) + potential_energy(arm, q, jnp.zeros(3))
            return whole + contact_energy(arm, q, held), pressed

        return (*jax.vmap(of)(motion.angles, motion.rates, motion.skin), motion.successful)

    random = np.random.default_rng(11)
    rates = jnp.asarray(random.normal(size=(count, 3)) * 0.6)
    # One after the other, because in a batch each would take as long as the slowest.
    found = jax.jit(lambda rates: jax.lax.map(energies, rates))(rates)
    energy, pressed, good = map(np.asarray, found)
    assert good.all()
    assert (pressed.max(axis=1) > 1e-6).mean() > 0.9
    growth = np.diff(energy, axis=1).max(axis=1) / energy[:, 0]
    assert growth.max() < 1e-4
    assert np.median(growth) < 1e-6
    assert np.median(energy[:, -1] / energy[:, 0]) < 0.9


@pytest.mark.slow
def test_both_solvers_agree():
    arm = resting()
    times = np.linspace(0.0, 3.0, 36)  # as many as above, so the program is the same
    still = constant(jnp.zeros(2))
    tips = [
        simulate(arm, still, times, wind=[0.0, 1.0, 0.0], solver=solver, rtol=1e-8, atol=1e-8).tip
        for solver in ("tsit5", "springs5")
    ]
    # For sliding skin, its stretch ends steps and depends on where they end.
    assert_allclose(tips[0], tips[1], atol=3e-4)


@pytest.mark.long
def test_joints_that_remember_and_links_that_stick_go_together():
    """XLA refused this program for twenty links."""
    ground = Plane(centre=[0.0, 0.0, -0.2])
    arm = giajax.takeichi_20m(
        contact=Contact(obstacles=(ground,), friction=0.3),
        parameters={"joints.memory.strength": 0.05},
    )
    command = joint_ramps(20, {1: -0.2}, start=0.0, duration=2.0)
    motion = simulate(arm, command, np.linspace(0.0, 5.0, 11), solver="springs5")
    found = contacts(motion)
    assert found.flattening.max() > 1e-4
    assert motion.memory is not None
    assert np.abs(motion.memory).max() > 1e-3
    assert np.all(np.isfinite(motion.angles))
    free = simulate(
        dataclasses.replace(arm, contact=None), command, motion.times, solver="springs5"
    )
    # Up to half a second before contact is visible.
    before = int(np.argmax(np.any(found.flattening > 0, axis=(1, 2)))) - 2
    assert before > 1
    assert_allclose(motion.angles[:before], free.angles[:before], atol=1e-5)
    assert not np.allclose(motion.angles[-1], free.angles[-1], atol=1e-2)


@pytest.mark.slow
def test_derivatives_through_an_impact_are_differences():
    arm = arm_at(WALL)
    command = joint_ramps(2, {1: 0.6}, start=0.0, duration=0.25)
    times = np.linspace(0.0, 1.0, 11)

    def end(pressure, stiffness):
        changes = {"links.pressure": pressure, "joints.pitch_stiffness": stiffness}
        moved = giajax.replace(arm, changes)
        motion = simulate(moved, command, times, solver="springs5", rtol=1e-9, atol=1e-9)
        return motion.tip[-1]

    at = jnp.asarray([300.0, 3.0])
    # One program for values and derivatives.
    along = jax.jit(lambda at, change: jax.jvp(lambda at: end(*at), (at,), (change,)))
    for step, change in zip((0.05, 5e-4), jnp.eye(2), strict=True):
        slope = along(at, change)[1]
        ahead, back = (along(at + sign * step * change, change)[0] for sign in (1, -1))
        difference = (ahead - back) / (2 * step)
        assert_allclose(slope, difference, atol=1e-4 * np.abs(difference).max())


def test_an_arm_without_obstacles_has_no_contacts():
    motion = simulate(takeichi_20m(1), constant(jnp.zeros(1)), [0.0, 1.0])
    with pytest.raises(InputError, match="the arm has no obstacles"):
        contacts(motion)
