"""The parts of a filling: holes, bags and skins, against closed forms and published tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from fluids.compressible import P_critical_flow, T_critical_flow
from fluids.safety_valve import API520_A_g
from scipy.constants import R
from scipy.optimize import brentq

from giajax import replace, takeichi_20m
from giajax.apps.filling import State, rates
from giajax.mechanics.inflation import (
    Filling,
    Gas,
    Hole,
    Skin,
    Supply,
    bag_state,
    critical_ratio,
    inflow,
    mass_flow,
)

HELIUM = Gas()
ROOM = float(HELIUM.ambient_pressure)
RT = ROOM / float(HELIUM.density)
# A short, sharp-edged hole has a negligible laminar part.
SHORT = Hole(jnp.asarray(1e-3), jnp.asarray(1e-12), jnp.asarray(1.0))
PORT = Hole(jnp.asarray(0.01), jnp.asarray(0.005), jnp.asarray(0.61))
AREA = np.pi / 4 * 1e-6


def flows(hole, before, after, gas=HELIUM):
    return np.asarray(
        jax.vmap(lambda p, q: mass_flow(gas, hole, p, q))(
            jnp.asarray(before, float), jnp.asarray(after, float)
        )
    )


def test_choked_flow_is_the_published_closed_form():
    """C A p0 sqrt(k / (R T)) (2 / (k + 1))^((k + 1) / (2 (k - 1))), whatever the exit pressure is.

    Written as in Anderson, Modern Compressible Flow, eq. (5.21); k = 5/3.
    """
    k, before = 5 / 3, 3e5
    published = AREA * before * np.sqrt(k / RT) * (2 / (k + 1)) ** ((k + 1) / (2 * (k - 1)))
    after = np.array([0.0, 0.2, 0.4, 0.487]) * before
    np.testing.assert_allclose(flows(SHORT, np.full(4, before), after), published, rtol=1e-7)
    assert float(critical_ratio(HELIUM)) == pytest.approx(0.4871, abs=5e-5)


@pytest.mark.parametrize("k", [5 / 3, 1.4])
def test_choked_flow_is_that_of_another_library(k):
    """Compare with the sonic flow of `fluids`, and with the hole size of API 520."""
    gas, before, temperature = Gas(heat_capacity_ratio=k), 3e5, 293.15
    (found,) = flows(SHORT, [before], [1e5], gas)
    throat = T_critical_flow(temperature, k) / temperature * RT
    sonic = AREA * P_critical_flow(before, k) / throat * np.sqrt(k * throat)
    np.testing.assert_allclose(found, sonic, rtol=1e-7)
    assert float(critical_ratio(gas)) == pytest.approx(P_critical_flow(1.0, k), rel=1e-12)
    weight = 1e3 * R * temperature / RT
    asked = API520_A_g(found, temperature, 1.0, weight, k, before, 1e5, Kd=1.0)
    # The constant of API 520 has four digits.
    np.testing.assert_allclose(asked, AREA, rtol=2e-3)


def test_flow_agrees_with_printed_tables():
    """NACA Report 1135, table I, and White's table B.1 (k = 1.4): p / p0 and A / A* by Mach number.

    The flow through a hole is A* / A times the choked flow, which is 0.6847 A p0 / sqrt(R T).
    """
    air = Gas(heat_capacity_ratio=1.4)
    before = 2e5
    choked = AREA * before / np.sqrt(RT) * 0.6847
    assert float(critical_ratio(air)) == pytest.approx(0.5283, abs=5e-5)
    ratios, areas = np.array([0.9395, 0.8430, 0.6560, 0.5283]), [2.0351, 1.3398, 1.0382, 1.0]
    found = flows(SHORT, np.full(4, before), ratios * before, air)
    np.testing.assert_allclose(found, choked / np.array(areas), rtol=3e-4)


def test_a_port_is_laminar_and_turbulent_in_series():
    """dp = a Q + b Q |Q| in both directions, if dp is small compared with the pressure."""
    d, length, c, density = 0.01, 0.005, 0.61, float(HELIUM.density)
    a = 128 * float(HELIUM.viscosity) * length / (np.pi * d**4)
    b = density / (2 * c**2 * (np.pi / 4 * d**2) ** 2)
    for drop in (1e-6, 1e-3, 0.1, 1.0, 38.0):
        volume = brentq(lambda q, drop=drop: a * q + b * q * q - drop, 0, 1, xtol=1e-18, rtol=1e-14)
        there, back = flows(PORT, [ROOM + drop, ROOM], [ROOM, ROOM + drop])
        # For larger differences, the density of the gas is lower by up to 4e-4.
        assert there / density == pytest.approx(volume, rel=max(1e-8, 10 * drop / ROOM))
        assert back == -there
    assert flows(PORT, [ROOM], [ROOM]) == 0


@pytest.mark.parametrize("ratio", [1.0, 0.999, 0.6, 0.48713928, 0.3])
def test_a_hole_has_a_slope_everywhere(ratio):
    """This includes zero flow and choking, with forward and reverse differentiation."""
    after = jnp.asarray(ratio * ROOM)

    def flow(p):
        return mass_flow(HELIUM, PORT, p, after)

    here, step = jnp.asarray(ROOM), 1e-6 if ratio == 1 else 1e-2
    forward = jax.jit(lambda p: jax.jvp(flow, (p,), (jnp.ones_like(p),))[1])(here)
    backward = jax.jit(jax.grad(flow))(here)
    difference = (flow(here + step) - flow(here - step)) / (2 * step)
    assert float(forward) == pytest.approx(float(difference), rel=1e-3)
    assert float(backward) == pytest.approx(float(forward), rel=1e-12)
    if ratio == 1:
        a = 128 * float(HELIUM.viscosity) * 0.005 / (np.pi * 0.01**4)
        assert float(forward) == pytest.approx(float(HELIUM.density) / a, rel=1e-9)


def test_a_bag_is_limp_until_it_is_full():
    skin, stretch = Skin(), jnp.asarray([41.6e3])
    share = np.array([0.0, 0.5, 0.95, 1.05, 1.5])
    pressure, fullness = (
        np.concatenate([np.asarray(each) for each in column])
        for column in zip(
            *(bag_state(HELIUM, skin, stretch, jnp.asarray([s])) for s in share), strict=True
        )
    )
    assert np.all(pressure[:3] < 1e-15 * ROOM)
    np.testing.assert_allclose(fullness[:3], share[:3], rtol=1e-14)
    # A full bag: its mass consists of the compression of the gas and the stretching of the skin.
    np.testing.assert_allclose((1 + pressure / ROOM) * (1 + pressure / 41.6e3), share.clip(1))
    np.testing.assert_allclose(fullness[3:], 1 + pressure[3:] / 41.6e3, rtol=1e-12)


def test_the_skin_stretches_as_a_thin_tube_does():
    """Strains of a closed tube of radius 0.15 m under 100 Pa, by Hooke's law for plane stress."""
    filling, p, r, nu, et = Filling(), 100.0, 0.15, 0.45, 1e4
    hoop, along = p * r, p * r / 2
    volume = (1 + (hoop - nu * along) / et) ** 2 * (1 + (along - nu * hoop) / et)
    assert p / float(filling.stretch[0]) == pytest.approx(volume - 1, rel=2e-3)


def test_a_supply_feeds_what_its_nozzle_lets_through():
    none = jnp.zeros(())
    volume = float(inflow(HELIUM, Supply(), none, none)) / float(HELIUM.density)
    assert volume == pytest.approx(61e-3 / 60)
    choked = inflow(HELIUM, Supply(kind="regulator"), none, none)
    against = inflow(HELIUM, Supply(kind="regulator"), none + 3e4, none)
    assert float(choked) == float(against) > 0
    weak = Supply(kind="regulator", pressure=1e4)
    assert float(inflow(HELIUM, weak, none + 1e4, none)) == 0
    assert float(inflow(HELIUM, weak, none + 5e3, none)) > 0
    bottle = Supply(kind="bottle")
    held = float(bottle.bottle_pressure) * float(bottle.bottle_volume) / RT
    begin, half = (float(inflow(HELIUM, bottle, none, none + part * held)) for part in (0, 0.5))
    assert half == pytest.approx(begin * (0.5 * 200e5 + ROOM) / (200e5 + ROOM), rel=1e-4)
    assert float(inflow(HELIUM, bottle, none, none + held)) == pytest.approx(0, abs=1e-15)


def test_tight_bags_in_a_laminar_ladder_are_its_linear_network():
    """The Jacobian of the rates at rest consists of port conductances over bag capacities."""
    diameters = np.array([2e-3, 3e-3, 2.5e-3])
    made = Filling(arm=takeichi_20m(4, length=[1.0, 0.8, 1.2, 0.9]))
    made = replace(made, {"ports.diameter": diameters, "ports.length": 0.2})

    def slope(share):
        return rates(0.0, State(share, jnp.zeros(())), made).share

    found = np.asarray(jax.jit(jax.jacfwd(slope))(jnp.full(4, 1.02)))
    # Resistors between capacitors: conductances G in kg/s/Pa, capacities from dp / d share.
    skin, room = 41666.666666666664, ROOM
    p = brentq(lambda p: (1 + p / room) * (1 + p / skin) - 1.02, 0, 1e4, xtol=1e-12, rtol=1e-14)
    slope = 1 / ((1 + p / skin) / room + (1 + p / room) / skin)
    density = float(HELIUM.density) * (1 + p / room)
    g = density * np.pi * diameters**4 / (128 * float(HELIUM.viscosity) * 0.2)
    network = np.diag(np.append(g, 0) + np.append(0, g)) - np.diag(g, 1) - np.diag(g, -1)
    mass = float(HELIUM.density) * np.pi * 0.15**2 * np.array([1.0, 0.8, 1.2, 0.9])
    np.testing.assert_allclose(found, -network * slope / mass[:, None], rtol=1e-7, atol=1e-12)
