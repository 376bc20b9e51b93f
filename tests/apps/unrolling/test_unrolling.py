"""Unrolling of an arm: carpets, fronts limited by the flow, balances, and the hand-over."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import giajax
from giajax import InputError, fill, replace, takeichi_20m
from giajax.apps.unrolling import unroll, unrolling_time
from giajax.mechanics.inflation import Filling, Gas, Hole, Supply, mass_flow
from giajax.mechanics.unrolling import Hand, Unrolling
from giajax.schema import UnrollingSection

LENGTH, MASS, G = 19.8, 0.94, 9.80665
DENSITY, ROOM = 0.1664, 101325.0
AREA = np.pi * 0.15**2
FREE = {"hand.force": 0.0, "film.peel": 0.0, "film.loss": 0.0, "film.thickness": 1e-12}


def made(order="roll first", hand="speed", carried=False, links=20, kind="flow", **values):
    filling = Filling(arm=takeichi_20m(links), supply=Supply(kind=kind))
    unrolling = Unrolling(filling=filling, order=order, hand=Hand(kind=hand), carried=carried)
    return replace(unrolling, {path.replace("__", "."): value for path, value in values.items()})


@functools.cache
def by_hand():
    return unroll()


@functools.cache
def by_gas():
    """Unroll by 1.0 l/s in a tube of 300 mm."""
    return unroll(made("by gas", supply__flow=1e-3))


@functools.cache
def carpet(carried):
    """Return a roll that is driven only by its weight or its initial speed."""
    speed = {"roll.start_speed": 0.2} if carried else {}
    return unroll(replace(made(hand="force", carried=carried), FREE | speed))


def energy(found):
    return np.sum(np.asarray(found.energies), axis=0)


# A rigid carpet: no gas, no hand, no losses.


@pytest.mark.parametrize("carried", [False, True])
def test_a_carpet_keeps_its_energy(carried):
    found = carpet(carried)
    assert found.finished
    assert np.max(np.abs(energy(found) / energy(found)[0] - 1)) < 1e-8
    assert found.speed[-1] > 2.5 * 0.2


@pytest.mark.parametrize("carried", [False, True])
def test_the_speed_of_a_carpet_is_in_closed_form(carried):
    """v^2 = (M0 v0^2 + 2 (U0 - U)) / M, with M and U of the wound rings, written out here."""
    found = carpet(carried)
    x = found.paid_out
    square = 0.05**2 + (0.1**2 - 0.05**2) * (1 - x / LENGTH)
    wound = MASS * (1 - x / LENGTH)
    inertia = wound + 0.1 + (wound * (square + 0.05**2) / 2 + 0.1 * 0.05**2) / square
    weight = 0 * x if carried else (wound + 0.1) * G * np.sqrt(square)
    begin = 0.2 if carried else 0.0
    speed = np.sqrt((inertia[0] * begin**2 + 2 * (weight[0] - weight)) / inertia)
    np.testing.assert_allclose(found.speed, speed, rtol=1e-7, atol=1e-9)


def test_a_carpet_at_half_of_its_radius_has_the_speed_of_the_textbook():
    """sqrt(14 g R / 3) for a carpet without a core that starts at rest; later it diverges."""
    coreless = {"roll.core_radius": 1e-4, "roll.core_mass": 1e-9, "roll.start": 1e-3}
    found = unroll(replace(made(hand="force"), FREE | coreless), limit=22.5)
    expected = np.sqrt(14 * G * 0.1 / 3)
    assert found.radius[-1] < 0.05
    assert np.interp(-0.05, -found.radius, found.speed) == pytest.approx(expected, rel=1e-3)


def test_the_momentum_of_a_carpet_is_not_kept():
    """The carpet that is laid down is at rest, so the floor has taken its momentum.

    The speed of the roll changes, too, unlike that of a body that sheds mass.
    """
    found = carpet(carried=True)
    momentum = (MASS * (1 - found.paid_out / LENGTH) + 0.1) * found.speed
    assert momentum[-1] < 0.3 * momentum[0]
    assert found.speed[-1] > 2.8 * found.speed[0]


# Driven by gas.


def test_the_front_goes_as_fast_as_its_flow_fills_the_tube():
    """v = Q / A: 14.15 mm/s for 1.0 l/s in 300 mm, and 23.3 min for 19.8 m."""
    found = by_gas()
    speed = 1e-3 / AREA
    assert speed * 1e3 == pytest.approx(14.15, abs=0.005)
    moving = found.times > 60
    assert moving.sum() > 50
    np.testing.assert_allclose(found.speed[moving], speed, rtol=0.01)
    assert found.handed_over / 60 == pytest.approx(23.3, rel=0.01)
    assert found.handed_over == pytest.approx(LENGTH * AREA / 1e-3, rel=0.01)


def test_gas_is_conserved_from_the_supply_to_the_links():
    """The fed gas is in the tube (pressure times volume), and in the links after that."""
    found = by_gas()
    assert found.imbalance < 1e-10
    fed = DENSITY * 1e-3 * found.times
    np.testing.assert_allclose(found.gas, fed, rtol=1e-10, atol=1e-15)
    # Gas law: the open part is filled until it is tight, at room pressure plus overpressure.
    held = DENSITY * (1 + found.pressure / ROOM) * AREA * found.paid_out
    moving = found.times > 60
    np.testing.assert_allclose(held[moving], found.gas[moving], rtol=3e-3)
    filled = found.filled
    np.testing.assert_allclose(filled.gas[0].sum(), found.gas[-1], rtol=1e-12)
    np.testing.assert_allclose(filled.supplied[0], found.gas[-1], rtol=1e-12)
    fed = found.gas[-1] + DENSITY * 1e-3 * filled.duration
    np.testing.assert_allclose(filled.gas[-1].sum(), fed, rtol=1e-10)


def test_the_work_of_the_gas_is_what_the_roll_has_and_has_lost():
    """For a roll that is driven by gas, to 1e-8 of that work; also computed from the columns."""
    found = by_gas()
    work = found.works.gas[-1]
    assert work > 5
    assert found.energy_imbalance < 1e-8 * work
    gained = energy(found)[-1] - energy(found)[0]
    parts = gained + found.works.peel[-1] + found.works.loss[-1]
    assert parts == pytest.approx(work, rel=1e-8)
    # Work is the integral of force over length, here a sum over rows.
    for name in ("gas", "peel", "loss"):
        force = np.abs(getattr(found.forces, name))
        summed = np.sum(np.diff(found.paid_out) * (force[1:] + force[:-1]) / 2)
        assert getattr(found.works, name)[-1] == pytest.approx(summed, rel=5e-3)
    assert found.works.peel[-1] == pytest.approx(0.3 * (LENGTH - 0.1), rel=1e-4)


def test_the_pressure_is_what_holds_the_front_over_its_area():
    """At constant speed: peel, losses, bending and the weight of the roll, divided by the area."""
    found = by_gas()
    middle = np.searchsorted(found.paid_out, 10.0)
    x = found.paid_out[middle]
    square = 0.05**2 + (0.1**2 - 0.05**2) * (1 - x / LENGTH)
    radius, wound = np.sqrt(square), MASS * (1 - x / LENGTH) + 0.1
    weight = G * (MASS / LENGTH * radius + wound * (0.1**2 - 0.05**2) / (2 * LENGTH * radius))
    bending = 2e8 * 50e-6**3 / (12 * (1 - 0.45**2)) * np.pi * 0.15 / square
    held = 0.3 + 10 * found.speed[middle] + bending - weight
    # The rest is the change of the roll's inertia, which is proportional to v^2 and small.
    assert found.pressure[middle] == pytest.approx(held / AREA, rel=1e-3)


def test_a_regulator_and_its_roll_are_those_of_scipy():
    """Three links at 200 Pa: the equation of motion is written out here for another solver."""
    nozzle = {"supply__pressure": 200.0, "supply__nozzle_diameter": 6e-3}
    case = made("by gas", links=3, kind="regulator", film__loss=20.0, **nozzle)
    found = unroll(case)
    length, mass = 2.97, 0.141
    hole, gas = Hole(*map(jnp.asarray, (6e-3, 1e-3, 0.8))), Gas()
    flow = jax.jit(lambda p: mass_flow(gas, hole, ROOM + 200.0, ROOM + p))
    stretch, slack = 1e4 / (0.15 * 1.6), 1e-3

    def slopes(t, y):
        x, v, held = min(y[0], length), y[1], y[2]
        beyond = slack * np.logaddexp(0, (held / (DENSITY * AREA * x) - 1) / slack)
        p = np.roots([1 / (ROOM * stretch), 1 / ROOM + 1 / stretch, -beyond]).max()
        span = (0.1**2 - 0.05**2) / length
        square = 0.05**2 + span * (length - x)
        wound, radius = mass * (1 - x / length), np.sqrt(square)
        inertia = wound + 0.1 + (wound * (square + 0.05**2) / 2 + 0.1 * 0.05**2) / square
        step = 1e-6
        later = 0.05**2 + span * (length - x - step)
        less = mass * (1 - (x + step) / length)
        then = less + 0.1 + (less * (later + 0.05**2) / 2 + 0.1 * 0.05**2) / later
        weight = G * (mass / length * radius + (wound + 0.1) * span / (2 * radius))
        bending = 2e8 * 50e-6**3 / (12 * (1 - 0.45**2)) * np.pi * 0.15 / square
        force = p * AREA + weight - bending - 0.3 * np.tanh(v / 1e-4) - 20 * v
        force -= (then - inertia) / step * v**2 / 2
        return [v, force / inertia, float(flow(p))]

    def end(t, y):
        return y[0] - length

    end.terminal = True
    times = (0, 2 * found.handed_over)
    there = solve_ivp(slopes, times, [0.1, 0, 0], "Radau", rtol=1e-6, atol=1e-10, events=end)
    assert found.handed_over == pytest.approx(there.t[-1], rel=1e-5)
    np.testing.assert_allclose(found.speed[-1], there.y[1, -1], rtol=1e-4)


# Unrolled by hand.


def test_a_hand_that_holds_its_speed_takes_a_length_over_it():
    found = by_hand()
    assert found.handed_over == pytest.approx((LENGTH - 0.1) / 0.1, rel=1e-12)
    np.testing.assert_allclose(found.speed, 0.1)
    assert np.all(found.gas == 0)
    assert found.energy_imbalance < 1e-8 * found.works.hand[-1]
    # Peel and losses at this speed, minus the weight, give about 1.24 N everywhere.
    assert found.hand_force[0] == pytest.approx(0.3 + 1.0 - 0.066, abs=2e-3)


def test_a_hand_that_holds_its_force_has_its_work_in_the_balance():
    found = unroll(made(hand="force", hand__force=1.0))
    assert found.works.hand[-1] == pytest.approx(LENGTH - 0.1, rel=1e-9)
    assert found.energy_imbalance < 1e-8 * found.works.hand[-1]


def test_a_hand_that_is_too_weak_does_not_unroll():
    found = unroll(made(hand="force", hand__force=0.1), limit=600)
    assert not found.finished
    assert found.filled is None
    assert np.isnan([found.handed_over, found.duration, found.arm_lift_off]).all()
    assert found.paid_out[-1] < 0.2


# The hand-over.


def test_what_is_unrolled_first_is_filled_as_ever():
    """The paper's order: the results of `fill`, bit for bit, with times after the hand-over."""
    found, filled = by_hand(), fill()
    for name in ("times", "gas", "pressure", "fullness", "supplied", "lift_off", "full"):
        np.testing.assert_array_equal(getattr(found.filled, name), getattr(filled, name))
    assert found.duration == pytest.approx(found.handed_over + filled.duration, rel=1e-12)
    assert found.arm_lift_off == pytest.approx(found.handed_over + filled.arm_lift_off, rel=1e-12)
    np.testing.assert_allclose(found.lift_off, found.handed_over + filled.lift_off)


def test_what_gas_unrolls_lifts_itself_before_it_is_all_paid_out():
    """It needs as much gas as in `fill`; a link lifts when enough of it is open to carry it."""
    found = by_gas()
    wanted = MASS / (1.204 - DENSITY) / 1e-3
    assert found.arm_lift_off == pytest.approx(wanted, rel=1e-4)
    assert found.arm_lift_off < found.handed_over < found.duration
    open_part = 0.047 / (1.204 - DENSITY) / AREA
    at = np.interp(found.lift_off, found.times, found.paid_out) - 0.99 * np.arange(20)
    np.testing.assert_allclose(at, open_part, rtol=5e-3)
    assert np.all(found.filled.fullness[0] == pytest.approx(found.filled.fullness[0, 0]))
    assert found.filled.finished


def test_an_arm_that_is_tight_at_the_hand_over_is_full_at_once():
    """The layers stick so strongly that the tube has 50 Pa."""
    found = unroll(made("by gas", links=3, film__peel=4.0, film__loss=30.0))
    assert found.pressure[-1] > 50
    assert found.filled.finished
    assert found.filled.duration == 0
    assert found.filled.times[-1] < 1
    assert found.duration == found.handed_over


def test_a_roll_that_runs_off_leaves_gas_behind():
    """Without peel and losses, its weight unrolls it with little gas; the filling adds the rest."""
    found = unroll(made("by gas", links=3, film__peel=0.0, film__loss=0.0))
    assert found.filled.gas[0].sum() == pytest.approx(found.gas[-1])
    assert found.gas[-1] < 0.3 * found.filled.supplied[-1]
    assert found.duration == pytest.approx(3 * 0.99 * AREA / (61e-3 / 60), rel=0.01)
    assert found.imbalance < 1e-10


@pytest.mark.parametrize(
    ("share", "sentence"),
    [
        (-0.1, "a filled share is -0.1: give zero or a positive number"),
        (
            [0.1, 0.2],
            r"the filled share has the shape \(2,\), but the arm has 20 bags: give one number",
        ),
    ],
)
def test_a_share_that_cannot_be_is_refused(share, sentence):
    with pytest.raises(InputError, match=sentence):
        fill(share=share)


# Derivatives.

SLOPES = {
    "by gas": ("supply.flow", "film.peel", "film.loss"),
    "roll first": ("hand.force", "film.peel", "film.loss", "roll.radius", "roll.core_mass"),
}


@pytest.mark.parametrize(
    "order",
    [pytest.param(each, marks=pytest.mark.long if each == "roll first" else ()) for each in SLOPES],
)
def test_the_time_has_a_slope(order):
    """Forward-mode derivatives, against differences."""
    case, paths = made(order, "speed" if order == "by gas" else "force", links=3), SLOPES[order]
    here = np.array([float(giajax.get(case, path)) for path in paths])

    def time(values):
        return unrolling_time(replace(case, dict(zip(paths, values, strict=True))))

    slopes = np.asarray(jax.jit(jax.jacfwd(time))(jnp.asarray(here)))
    for k, slope in enumerate(slopes):
        step = np.zeros_like(here)
        step[k] = 1e-4 * here[k]
        difference = (float(time(here + step)) - float(time(here - step))) / (2 * step[k])
        assert slope == pytest.approx(difference, rel=2e-4)
        assert abs(slope * here[k]) > 1e-4
    if order == "by gas":
        assert slopes[0] * here[0] / float(time(here)) == pytest.approx(-1, rel=2e-3)


# Settings.

CHANGES = {
    "order": {"order": "by gas"},
    "hand": {"hand": "force"},
    "carried": {"carried": True},
    "roll_radius_mm": {"roll_radius_mm": 80.0},
    "core_radius_mm": {"core_radius_mm": 30.0},
    "core_mass_kg": {"core_mass_kg": 0.2},
    "start_length_m": {"start_length_m": 0.5},
    "start_speed_m_per_s": {"start_speed_m_per_s": 0.1},
    "film_thickness_mm": {"film_thickness_mm": 0.1},
    "film_creep": {"film_creep": 0.2},
    "peel_force_N": {"peel_force_N": 0.2},
    "front_loss_N_s_per_m": {"front_loss_N_s_per_m": 20.0},
    "hand_speed_m_per_s": {"hand_speed_m_per_s": 0.2},
    "hand_force_N": {"hand_force_N": 2.0},
}


@pytest.mark.quick
def test_every_key_is_tried():
    assert set(CHANGES) == set(UnrollingSection.model_fields)


@functools.cache
def time_of(**section):
    filling = Filling(arm=takeichi_20m(3))
    stated = UnrollingSection.model_validate(section)
    return float(unrolling_time(Unrolling.from_section(stated, filling)))


@pytest.mark.parametrize("key", CHANGES)
def test_every_key_changes_something(key):
    before = {} if key in ("order", "hand", "hand_speed_m_per_s") else {"hand": "force"}
    assert abs(time_of(**before | CHANGES[key]) / time_of(**before) - 1) > 1e-6


@pytest.mark.quick
def test_a_definition_goes_to_the_unrolling_and_back():
    stated = {name: value for each in CHANGES.values() for name, value in each.items()}
    filling = Filling(arm=takeichi_20m(3))
    case = Unrolling.from_section(UnrollingSection.model_validate(stated), filling)
    assert case.definition() == pytest.approx(stated)
    assert (case.order, case.hand.kind, case.carried) == ("by gas", "force", True)
    again = Unrolling.from_section(UnrollingSection.model_validate(case.definition()), filling)
    assert again.definition() == case.definition()


# Bad input.

BAD = {
    "smaller than its core": (
        {"roll__radius": 0.04},
        "the radius of the roll is 40 mm, but its core has a radius of 50 mm: give a roll larger",
    ),
    "denser than its film": (
        {"film__thickness": 1e-3},
        "a layer of the roll is only 1.19 mm thick, but two films are 2 mm: "
        "give a larger roll.radius",
    ),
    "paid out": (
        {"roll__start": 20.0},
        r"20 m are paid out .* the arm is only 19.8 m long: reduce",
    ),
    "no core": ({"roll__core_mass": 0.0}, "roll.core_mass = 0 kg is outside its bounds: choose"),
    "creep": ({"film__creep": 1.5}, "film.creep = 1.5 is outside its bounds: choose a value"),
    "no number": ({"film__peel": np.nan}, "film.peel = nan N is outside its bounds: choose"),
    "pulled": ({"hand__force": -1.0}, "hand.force = -1 N is outside its bounds: choose"),
    "density": ({"gas__density": -1.0}, "gas.density = -1 kg/m.3 is outside its bounds: choose"),
    "no flow": (
        {"order": "by gas", "supply__flow": 0.0},
        "the arm is set to unroll by gas, but no gas flows with supply.flow = 0: "
        "give a positive number, or",
    ),
    "no pressure": (
        {"order": "by gas", "kind": "regulator", "supply__pressure": 0.0},
        "the arm is set to unroll by gas, but no gas flows with supply.pressure = 0: "
        "give a positive number",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_an_unrolling_that_cannot_be_is_refused(case):
    values, sentence = BAD[case]
    with pytest.raises(InputError, match=sentence):
        unroll(made(**values))


@pytest.mark.quick
def test_bad_words_and_limits_are_refused():
    with pytest.raises(InputError, match="no order 'backwards': use one of roll first, by gas"):
        Unrolling(order="backwards")
    with pytest.raises(InputError, match="no hand 'foot': use one of speed, force"):
        Hand(kind="foot")
    with pytest.raises(InputError, match="the limit is 0 s: give a positive number of seconds"):
        unroll(limit=0)


def test_a_bottle_with_too_little_stops_on_the_way():
    bottle = {"supply__bottle_pressure": 1e5, "supply__nozzle_diameter": 1e-3, "film__peel": 3.0}
    found = unroll(made("by gas", links=3, kind="bottle", **bottle), limit=300)
    assert not found.finished
    # From 20 l at twice the room pressure, a bottle of 10 l keeps 10 l.
    assert found.paid_out[-1] == pytest.approx(0.01 / AREA, rel=0.02)


def test_what_cannot_be_followed_is_said():
    """A roll that moves in jerks, a hundred per second."""
    with pytest.raises(InputError, match=r"of the unrolling failed at .* increase film.loss"):
        unroll(made("by gas", film__loss=0.5))
