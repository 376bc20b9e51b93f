"""A joint with a film neck, which both muscles bend and compress."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics.joint import (
    JointPair,
    compression,
    equilibria,
    joint_spring,
    muscle_state,
    net_torque,
    pair_command,
    slow_history,
)
from giajax.mechanics.wrinkling import Neck, neck_moment

HINGE = JointPair()
PAIR = JointPair(neck=Neck(radius=0.045))
TARGET = np.deg2rad(30.0)


def pressures(degrees):
    return pair_command(HINGE, np.deg2rad(degrees)).pressures


def balance(pair, degrees, angle):
    angle = jnp.asarray(angle, float)
    return net_torque(pair, pressures(degrees), jnp.zeros(()), angle, angle >= 0)


def test_muscles_press_by_what_crosses_the_bisector():
    """For an inner muscle with a taut wire: the components along the link of force and wire."""
    command = pair_command(HINGE, TARGET)
    inner, outer = command.first, command.second
    x = 0.9 * np.cos(TARGET / 2) - 0.18 * np.sin(TARGET / 2)
    y = 0.9 * np.sin(TARGET / 2) + 0.18 * np.cos(TARGET / 2)
    wire_x = 0.03 * np.cos(TARGET / 2) - 0.04 * np.sin(TARGET / 2)
    wire_y = 0.03 * np.sin(TARGET / 2) + 0.04 * np.cos(TARGET / 2)
    height = float(inner.path.height)
    along = float(inner.force) * x / np.hypot(x, y - height)
    along += float(inner.wire_tension) * wire_x / np.hypot(wire_x, wire_y - height)
    angle = jnp.asarray(TARGET)
    pressed = compression(HINGE, command.pressures, angle, jnp.asarray(True))
    # The outer muscle crosses the bisector along the links.
    assert float(pressed) == pytest.approx(along + float(outer.force), rel=1e-9)


def test_a_hinge_has_no_neck_and_a_neck_takes_its_moment():
    angles = jnp.deg2rad(jnp.asarray([-50.0, -10.0, 0.02, 10.0, 50.0]))
    pressed = compression(PAIR, pressures(30.0), angles, angles >= 0)
    taken = balance(HINGE, 30.0, angles) - balance(PAIR, 30.0, angles)
    assert_allclose(taken, neck_moment(PAIR.neck, angles, pressed), rtol=1e-9)
    assert np.max(np.abs(taken)) > 0.1


def test_where_a_joint_with_a_neck_rests():
    """It stays straight under loads that bend the hinge, and every listed angle is balanced."""
    bent = equilibria(HINGE, pressures(12.0)).stable
    assert [round(float(np.rad2deg(e.angle))) for e in bent] == [-14, 0, 12]
    straight = equilibria(PAIR, pressures(12.0))
    rests = np.abs([np.rad2deg(e.angle) for e in straight.stable])
    assert rests.min() < 0.6
    # The joint is straight or folded, but not at the angles at which the hinge would rest.
    assert not np.any((rests > 0.6) & (rests < 20))
    folded = equilibria(PAIR, pressures(45.0))
    assert max(folded.angles) > np.deg2rad(40)
    for found, degrees in ((straight, 12.0), (folded, 45.0)):
        angles = [e.angle for e in found.every if not e.at_step]
        assert angles
        assert_allclose(balance(PAIR, degrees, angles), 0, atol=1e-9)


def test_the_rest_angle_has_its_slope_by_the_gas():
    """The folded joint acts like a spring; the derivative is with respect to its neck pressure."""
    near = max(equilibria(PAIR, pressures(45.0)).angles)

    def rest(p):
        pair = JointPair(neck=Neck(radius=0.045, pressure=p))
        return joint_spring(pair, pressures(45.0), near).rest_angle

    slope = float(jax.jit(jax.grad(rest))(jnp.asarray(1e3)))
    difference = (rest(jnp.asarray(1000.5)) - rest(jnp.asarray(999.5))) / 1.0
    assert slope == pytest.approx(float(difference), rel=1e-4)
    assert slope < 0


def test_a_crushed_neck_is_refused():
    with pytest.raises(InputError, match=r"gas in the neck withstands only 0\.785 N"):
        equilibria(JointPair(neck=Neck(radius=0.05, pressure=100.0)), pressures(10.0))


def test_a_slow_history_goes_where_the_equilibria_are():
    """It follows the equilibrium on its side as long as that exists, and then jumps."""
    degrees = np.concatenate([np.arange(40.0, -41, -4), np.arange(-40.0, 41, 4)])
    angles = np.deg2rad(np.linspace(-60, 60, 2401))
    torques = np.stack([balance(HINGE, d, angles) for d in degrees])
    found = slow_history(
        jnp.asarray(torques), jnp.asarray(angles), jnp.asarray(0.0), jnp.asarray(angles[2200])
    )
    at, jumps = angles[2200], 0
    for d, angle in zip(degrees, found, strict=True):
        rests = np.asarray([e.angle for e in equilibria(HINGE, pressures(d)).stable])
        driven = float(balance(HINGE, d, at)) > 0
        ways = rests[rests >= at - 1e-4] if driven else rests[rests <= at + 1e-4]
        expected = ways.min() if driven else ways.max()
        assert float(angle) == pytest.approx(expected, abs=np.deg2rad(0.05))
        jumps += abs(expected - at) > np.deg2rad(15)
        at = expected
    assert jumps == 2


def test_friction_holds_a_joint_behind():
    """A spring stays within friction / stiffness of its command, on the side of its approach."""
    angles = jnp.asarray(np.deg2rad(np.linspace(-60, 60, 241)))
    commands = np.deg2rad([10.0, 20.0, 18.0, 5.0])
    torques = jnp.asarray(0.5 * (commands[:, None] - np.asarray(angles)))
    found = slow_history(torques, angles, jnp.asarray(0.02), jnp.asarray(0.0))
    behind = np.rad2deg(0.02 / 0.5)
    expected = [10 - behind, 20 - behind, 20 - behind, 5 + behind]
    assert_allclose(np.rad2deg(found), expected, atol=1e-9)


def test_alpha_is_what_a_collapsed_neck_resists():
    """The paper's alpha of 0.03 N m at any angle is that of a neck of 29 mm with 50 mm of film."""
    forces = muscle_state(HINGE.joint, np.deg2rad([10.0, 20.0, 30.0, 40.0])).force
    angles = jnp.deg2rad(jnp.asarray([10.0, 20.0, 30.0, 40.0]))
    resisted = neck_moment(Neck(radius=0.029, length=0.05), angles, forces)
    assert_allclose(resisted, 0.03, atol=0.005)
