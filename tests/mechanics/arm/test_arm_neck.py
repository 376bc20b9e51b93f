"""Necks in the joints with muscles of an arm: the joint torque at rest with the gas of the arm."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError
from giajax.mechanics import arm as mechanics, joint as statics
from giajax.mechanics.arm import forward_dynamics, takeichi_20m
from giajax.mechanics.joint import JointPair, compression
from giajax.mechanics.wrinkling import Neck, stretching
from giajax.schema.parameters import declared, left_out, replace

LINKS = 4
NECK = {"neck.radius": 0.045, "neck.length": 0.03}
GAS = np.asarray([1100.0, 950.0, 1200.0, 1000.0])
PRESSURES = jnp.asarray([[2.8e4, 0, 3.1e4, 0], [2.6e4, 0, 2.2e4, 0]])
FIRST = 0.03 * (950.0 * np.pi * 0.045**2 - 3.5) / (2 * np.pi * 1e4 * 0.045**2)
"""Angle at which the neck of joint 3 starts to wrinkle, rad."""
SHUT = 0.03 / (2 * 0.045)
"""Angle at which the compressed side of the neck has no volume, rad."""

net_torque = eqx.filter_jit(statics.net_torque)
joint_torque = eqx.filter_jit(mechanics.joint_torque)


def arm_with(parameters=NECK, **changes):
    return takeichi_20m(LINKS, muscles="pitch", parameters=parameters, **changes)


def inflated(**changes):
    """Return an arm whose links have four different pressures."""
    return arm_with({**NECK, "links.pressure": GAS, **changes})


def test_a_neck_has_the_gas_of_the_softer_link():
    """Joint 1 is in front of link 1, joint 3 between links 2 and 3, and link 2 has less gas."""
    arm, still = inflated(), jnp.zeros(LINKS)
    angles = jnp.asarray([0.15, -0.3, -0.4, 0.2])
    found = joint_torque(arm, angles, still, still, pressures=PRESSURES)
    joint, muscle = arm.pneumatics.joint, arm.pneumatics.muscle
    for place, gas in ((0, 1100.0), (2, 950.0)):
        pair = JointPair(joint, muscle, Neck(radius=0.045, length=0.03, pressure=gas))
        at = angles[place]
        own = net_torque(pair, PRESSURES[:, place], jnp.zeros(()), at, at >= 0)
        assert float(found[place]) == pytest.approx(float(own), rel=1e-12)
    hinge = joint_torque(arm_with({}), angles, still, still, pressures=PRESSURES)
    assert np.all(np.abs((found - hinge)[::2]) > 0.05)
    assert_allclose(found[1::2], hinge[1::2], rtol=1e-14)


def test_gas_of_an_arm_is_declared_once():
    arm = inflated()
    assert not any(path.startswith("neck.pressure") for path in {**declared(arm), **left_out(arm)})
    assert {"neck.radius", "neck.length", "neck.film_stiffness"} <= declared(arm).keys()
    assert "neck.radius" in left_out(arm_with({}))
    with pytest.raises(InputError, match="share the gas of the links"):
        _ = arm.pneumatics.pair
    with pytest.raises(InputError, match=r"neck\.length is 0: make it positive"):
        arm_with({"neck.radius": 0.05, "neck.length": 0.0})
    with pytest.raises(InputError, match=r"no parameter 'neck\.radius'"):
        takeichi_20m(LINKS, parameters=NECK)


def operations(arm):
    """Return the operations of the equation of motion with the joint torques."""
    still = jnp.zeros(LINKS)

    def moved(angles):
        torque = mechanics.joint_torque(arm, angles, still, still)
        return forward_dynamics(arm, angles, still, torque)

    return jax.jit(moved).lower(still).as_text()


def test_without_a_neck_nothing_of_it_is_computed():
    """The cube root is absent, and the law of the joints is the arm's own."""
    assert "cbrt" not in operations(arm_with({}))
    assert "cbrt" in operations(arm_with())
    arm = arm_with({"links.pressure": GAS})
    assert arm.further_laws.driven is arm.pneumatics


PATHS = ("neck.radius", "neck.length", "neck.film_stiffness", "links.pressure", "muscle.diameter")
STEPS = (1e-7, 1e-7, 1e-2, 1e-3, 1e-8)


@eqx.filter_jit
def torque_of(x, arm):
    """Return the torque of joint 3 for values of `PATHS`, its angle and its two pressures."""
    own = replace(arm, dict(zip(PATHS, x[: len(PATHS)], strict=True)))
    still = jnp.zeros(LINKS)
    angles = still.at[2].set(x[-3])
    pressures = jnp.zeros((2, LINKS)).at[:, 2].set(x[-2:])
    return mechanics.joint_torque(own, angles, still, still, pressures=pressures)[2]


forwards = eqx.filter_jit(jax.jacfwd(torque_of))
backwards = eqx.filter_jit(jax.jacrev(torque_of))


@pytest.mark.parametrize(
    "angle", [0.0, 0.6 * FIRST, 4 * FIRST, 0.2, -0.2, 0.99 * SHUT, 1.4 * SHUT, -1.1, 1.3]
)
def test_slopes_of_the_torque_by_everything(angle):
    """Both modes, for tight, wrinkled and folded necks, and beyond 60 deg."""
    arm = arm_with({**NECK, "links.pressure": 950.0})
    known = declared(arm)
    at = jnp.asarray([*(known[path].value(arm) for path in PATHS), angle, 2.8e4, 2.2e4])
    forward, backward = forwards(at, arm), backwards(at, arm)
    steps = np.diag([*STEPS, 1e-8, 1e-2, 1e-2])
    ends = [(torque_of(at + step, arm), torque_of(at - step, arm)) for step in steps]
    found = [
        (ahead - back) / (2 * step.sum()) for (ahead, back), step in zip(ends, steps, strict=True)
    ]
    assert_allclose(forward, found, rtol=2e-5, atol=1e-6)
    assert_allclose(backward, forward, rtol=1e-10, atol=1e-14)
    assert angle == 0 or np.all(np.abs(np.asarray(forward)[[0, 4]]) > 0)


def test_a_neck_is_never_stiffer_than_the_bound():
    """Compare for any pressures, through both limits; the tight straight neck is near the bound."""
    arm = inflated()
    angles = np.concatenate([np.linspace(-1, 1, 41), np.linspace(-5, 5, 41) * FIRST])
    held = np.asarray([[a, b] for a in (0, 3e4, 3e5) for b in (0, 3e4, 3e5)])
    laws = arm.joint_laws

    def slope(angle, pressures):
        still = jnp.zeros(LINKS)
        both = jnp.broadcast_to(pressures[:, None], (2, LINKS))
        at = laws.at(jnp.full(LINKS, angle), still, still, None, both)
        return laws.driven.slopes(at)[0][2]

    found = jax.jit(jax.vmap(jax.vmap(slope, (0, None)), (None, 0)))(
        jnp.asarray(angles), jnp.asarray(held)
    )
    still = jnp.zeros(LINKS)
    bound = laws.driven.stiffest(laws.at(still, still, still, None, jnp.zeros((2, LINKS))))
    assert np.max(found) <= bound[2] < 1.2 * np.max(found)
    assert bound[2] > np.pi * 1e4 * 0.045**3 / 0.03


def test_a_neck_that_muscles_crush_is_a_hinge_with_its_gas():
    """From p pi r^2 = F on, the film carries no load, and the torque is continuous."""
    arm = arm_with({**NECK, "links.pressure": 700.0})
    pair = arm.pneumatics.in_links(arm.links).pair
    angle = jnp.asarray(0.25)
    one = jnp.asarray([1.0, 1.0])

    @jax.jit
    def at(size):
        pressures = size * one
        pressed = compression(pair, pressures, angle, angle >= 0)
        full = jnp.zeros((2, LINKS)).at[:, 0].set(pressures)
        torque = mechanics.joint_torque(
            arm, jnp.zeros(LINKS).at[0].set(angle), jnp.zeros(LINKS), jnp.zeros(LINKS),
            pressures=full,
        )[0]  # fmt: skip
        return stretching(pair.neck, pressed), torque

    sizes = np.linspace(2e4, 8e4, 601)
    force, torque = jax.vmap(at)(jnp.asarray(sizes))
    last = int(np.flatnonzero(np.asarray(force) > 0)[-1])
    assert 0 < last < len(sizes) - 1
    assert np.all(np.isfinite(torque))
    assert np.max(np.abs(np.diff(torque))) < 2e-3
    slopes = jax.jit(jax.vmap(jax.grad(lambda size: at(size)[1])))(jnp.asarray(sizes))
    assert np.all(np.isfinite(slopes))
    # Within its folding angle, the crushed neck acts as the hinge, without a torque of its own.
    hinge = net_torque(
        JointPair(pair.joint, pair.muscle), one * sizes[-1], jnp.zeros(()), angle, angle >= 0
    )
    assert float(torque[-1]) == pytest.approx(float(hinge), rel=1e-12)
