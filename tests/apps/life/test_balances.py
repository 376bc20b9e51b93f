"""Gas and motion of an arm over its life: balances of helium, energy and momentum."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import giajax
from giajax import InputError, fill, replace, takeichi_20m
from giajax.apps.life import (
    Handling,
    as_one_bag,
    audit,
    check_audited,
    gas_at,
    gas_course,
)
from giajax.mechanics.arm import Contact
from giajax.mechanics.inflation import Filling, bag_energy, bag_state
from giajax.mechanics.obstacles import Plane
from giajax.mechanics.unrolling import Unrolling

LINKS = 3
AREA = np.pi * 0.15**2


def handled(unrolling, begin, **what):
    usual = dict.fromkeys(Handling._fields, 0.0)
    usual |= {"force": -1.0, "pressure": -1.0, "duration": 2e4} | what
    handling = Handling(**{name: jnp.asarray(value) for name, value in usual.items()})
    return gas_course(unrolling, handling, begin, jnp.asarray(1e-7), 11)


def balanced(course, before):
    """Return the relative errors of the helium balance and of the energy balance."""
    full = 0.1664 * LINKS * 0.99 * AREA
    moved = float(course.end.fed - before.fed) - float(course.end.let_out - before.let_out)
    works = [float(a - b) for a, b in zip(course.end.works, before.works, strict=True)]
    assert bool(course.succeeded)
    energy = float(course.stored[1] - course.stored[0]) - sum(works)
    helium = float(course.mass[1] - course.mass[0]) - moved
    return abs(helium) / full, abs(energy) / sum(map(abs, works))


@functools.cache
def fed():
    unrolling = Unrolling(filling=Filling(arm=takeichi_20m(LINKS)))
    empty = gas_at(unrolling.filling, jnp.zeros(LINKS))
    full = handled(unrolling, empty, feeds=1.0)
    return unrolling, empty, full, handled(unrolling, full.end, feeds=1.0, force=50.1)


def test_gas_and_skin_store_what_gas_brings():
    """dU/dm = R T log(P / p_room), and U from an empty bag by scipy's quadrature."""
    filling = Filling(arm=takeichi_20m(LINKS))
    gas, skin, stretch = filling.gas, filling.skin, filling.stretch
    share = jnp.asarray([0.9985, 1.0008, 1.06])

    def stored(share):
        return sum(bag_energy(gas, skin, stretch, share))

    def worth(share):
        pressure = bag_state(gas, skin, stretch, share).pressure
        return 101325.0 * jnp.log1p(pressure / 101325.0)

    slope = jax.grad(lambda x: jnp.sum(stored(x)))(share)
    np.testing.assert_allclose(slope, worth(share), rtol=1e-8)
    for place, whole in zip(share, stored(share), strict=True):
        one = jnp.ones(LINKS)
        found = quad(lambda x, one=one: float(worth(x * one)[0]), 0.97, float(place), epsabs=1e-12)
        assert found[0] == pytest.approx(float(whole), rel=1e-8)


def test_a_fed_arm_balances_and_holds_a_muscle():
    unrolling, empty, full, held = fed()
    filled = fill(unrolling.filling)
    assert float(full.times[-1]) == pytest.approx(filled.duration, rel=1e-6)
    np.testing.assert_allclose(full.pressure[-1], filled.pressure[-1], rtol=1e-4)
    assert max(balanced(full, empty)) < 1e-6
    assert balanced(full, empty)[0] < 1e-10
    assert bool(held.reached)
    assert float(jnp.min(held.pressure[-1])) * AREA == pytest.approx(50.1, rel=1e-6)
    helium, energy = balanced(held, full.end)
    assert helium < 1e-10
    assert energy < 1e-6


def test_what_is_reached_at_the_beginning_takes_no_time():
    """An arm unrolled by gas may be full as soon as it is unrolled."""
    unrolling, _, full, held = fed()
    for what in ({"feeds": 1.0}, {"feeds": 1.0, "force": 50.0}):
        again = handled(unrolling, held.end, **what)
        assert bool(again.reached)
        assert float(again.times[-1]) < 0.1
        np.testing.assert_allclose(again.pressure[-1], held.pressure[-1], rtol=1e-3)
    assert float(handled(unrolling, full.end, feeds=1.0, force=50.1).times[-1]) > 0.1


def test_a_vented_arm_is_pressed_out_by_a_hand():
    unrolling, _, _, held = fed()
    settled = handled(unrolling, held.end, settles=1.0, duration=60.0)
    assert np.ptp(settled.pressure[-1]) <= 0.0101 * float(jnp.max(settled.pressure[-1]))
    vented = handled(unrolling, settled.end, opens=1.0, pressure=7.0)
    assert float(jnp.max(vented.pressure[-1])) == pytest.approx(7.0, rel=1e-6)
    one = as_one_bag(unrolling)
    rest = gas_at(one.filling, jnp.mean(vented.end.share)[None])
    speed = 1e-3 / AREA
    rolled = handled(one, rest, opens=1.0, rolls=speed, duration=LINKS * 0.99 / speed)
    for course, before in ((settled, held.end), (vented, settled.end), (rolled, rest)):
        helium, energy = balanced(course, before)
        assert helium < 1e-10
        assert energy < 1e-6
    # The hand does the work p V. A hundredth of the arm stays open.
    pressure = float(np.median(rolled.pressure[:, 0]))
    volume = LINKS * 0.99 * AREA
    assert float(rolled.end.works.hand) == pytest.approx(0.99 * pressure * volume, rel=0.02)
    assert float(rolled.mass[1] / rolled.mass[0]) == pytest.approx(0.01, rel=0.01)


def moving(**changes):
    ground = Plane(centre=[0.0, 0.0, -0.2])
    parameters = {"joints.memory.strength": 0.05, "joints.pitch_stiffness": 2.0}
    parameters |= {"joints.damping": 0.05, **changes}
    return takeichi_20m(
        2,
        gravity=9.81,
        buoyancy=True,
        contact=Contact(obstacles=(ground,), friction=0.3),
        parameters=parameters,
    )


def test_a_motion_balances_energy_and_momentum():
    """A drooping arm is driven down to the ground in gusts."""
    arm = moving()
    rows = np.linspace(0.0, 1.0, 31)
    command = np.stack([0.5 * np.sin(5 * rows), 0.2 * np.sin(6 * rows)], axis=1)
    wind = np.zeros((31, 6))
    wind[:, [0, 4]] = 0.5 * np.sin(9 * rows)[:, None]
    given = jnp.asarray(0.1), jnp.asarray(command), jnp.asarray(wind), jnp.asarray(1e-7)
    found = audit(arm, *given)
    works = {name: np.asarray(row) for name, row in found.works._asdict().items()}
    for name in ("drives", "drag", "damping", "hysteresis", "contact"):
        assert np.abs(works[name]).max() > 1e-4, name
    assert works["damping"][-1] < 0
    assert works["hysteresis"][-1] < 0
    exchanged = sum(abs(row[-1]) for row in works.values())
    off = np.asarray(found.energy - found.energy[0]) - sum(works.values())
    assert np.abs(off).max() < 1e-6 * exchanged
    impulses = [np.asarray(row) for row in found.impulses]
    assert all(np.abs(row).max() > 1e-3 for row in impulses)
    momentum = np.asarray(found.momentum)
    changed = momentum - momentum[0] - sum(impulses)
    assert np.abs(changed).max() < 1e-6 * sum(np.linalg.norm(row[-1]) for row in impulses)


def test_what_is_not_balanced_is_refused():
    with pytest.raises(InputError, match="the energy of the air that moves with the links"):
        check_audited(giajax.takeichi_20m_full(2))
    stops = {"joints.stops.strength": [0.1], "joints.stops.yield_angle": [0.01]}
    with pytest.raises(InputError, match="joints with Stops, whose state variables have no rate"):
        check_audited(takeichi_20m(2, parameters=stops))
    check_audited(replace(takeichi_20m(2), {"links.mass": 0.05}))
