"""Filling an arm: closed forms, networks, conservation, and the effect of every setting."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import giajax
from giajax import InputError, fill, replace, takeichi_20m
from giajax.apps.filling import State, filling_curve, rates
from giajax.mechanics.inflation import Filling, Ports, Supply
from giajax.schema import FillingSection

ROOM, DENSITY, AIR = 101325.0, 0.1664, 1.204
LINK = np.pi * 0.15**2 * 0.99
FLOW = 61e-3 / 60


@functools.cache
def small(kind="flow", **values):
    """Return three links and a supply that fills them within minutes."""
    made = Filling(arm=takeichi_20m(3), supply=Supply(kind=kind))
    return replace(made, {path.replace("__", "."): value for path, value in values.items()})


@functools.cache
def filled(kind="flow", **values):
    return fill(small(kind, **values))


@functools.cache
def paper():
    return fill()


def test_one_bag_is_full_after_its_volume_over_the_flow():
    """Within 1e-9, and proportional to time; for one link, and for three with equal pressure."""
    for links, shared in ((1, ()), (3, ((1, 2, 3),))):
        found = fill(Filling(arm=takeichi_20m(links), shared=shared))
        expected = links * LINK / FLOW
        assert found.duration == pytest.approx(expected, rel=1e-9)
        np.testing.assert_allclose(found.full, found.duration)
        np.testing.assert_allclose(
            found.gas.sum(axis=1), DENSITY * FLOW * found.times, rtol=1e-9, atol=1e-15
        )
        lifts = 0.047 / (AIR - DENSITY) / LINK * expected
        np.testing.assert_allclose(found.lift_off, lifts, rtol=1e-9)
        assert found.arm_lift_off == pytest.approx(lifts, rel=1e-9)


@pytest.mark.parametrize("kind", ["flow", "regulator", "bottle"])
def test_helium_is_conserved(kind):
    """The fed helium equals that in the links at every time, and that lost by a bottle."""
    values = {"supply__nozzle_diameter": 2e-4} if kind == "bottle" else {}
    found = filled(kind, **values)
    assert found.finished
    assert found.imbalance < 1e-10
    # Compare with the sum of the flow over many rows, which is less accurate.
    rows = np.diff(found.times) * (found.flow[1:] + found.flow[:-1]) / 2
    assert rows.sum() * DENSITY == pytest.approx(found.supplied[-1], rel=1e-5)
    if kind == "bottle":
        begin, end = found.flow[[0, -1]]
        held = 200e5 * 0.01 / (ROOM / DENSITY)
        left = 200e5 * (1 - found.supplied[-1] / held) + ROOM
        assert end / begin == pytest.approx(left / (200e5 + ROOM), rel=1e-4)


def test_the_paper_s_arm_is_filled_in_its_time():
    """1.40 m^3 at 61 l/min take 22.9 min; the compressed gas in the bags takes the rest."""
    found = paper()
    assert np.sum(np.asarray(found.filling.volume)) == pytest.approx(1.3996, abs=1e-4)
    assert found.duration / 60 == pytest.approx(23, abs=0.3)
    ahead = np.diff(found.full)
    assert np.all(ahead > 0.98 * LINK / FLOW)
    # The last link is limp. All flow through 18 ports, except that which stretches bags: 38 Pa.
    drops = -np.diff(found.pressure[np.searchsorted(found.fullness[:, -1], 0.5)])[:18]
    np.testing.assert_allclose(drops, 37.8, rtol=0.03)
    stored = found.gas[-1] / (DENSITY * LINK) - 1
    assert found.duration == pytest.approx(20 * LINK / FLOW * (1 + stored.mean()), rel=1e-9)


def test_lift_and_stiffness_grow_with_fullness():
    found = paper()
    wanted = 20 * 0.047 / (AIR - DENSITY) / FLOW
    # Stretched bags displace a little more air, and compressed gas is heavier.
    assert found.arm_lift_off == pytest.approx(wanted, rel=0.01)
    assert found.net_lift[-1].sum() == pytest.approx(20 * LINK * (AIR - DENSITY) - 0.94, rel=0.03)
    assert np.all(found.lift_off < found.full)
    np.testing.assert_allclose(found.folding_moment, np.pi * 0.15**3 * found.pressure)
    assert np.all(found.stiffness[found.fullness < 0.99] == 0)
    assert found.stiffness[-1, 0] == pytest.approx(1e4 * np.pi * 0.15**3, rel=1e-9)
    assert np.diff(found.stiffness[:, 5]).min() > -1e-4


def test_links_that_are_not_welded_apart_fill_together():
    found = fill(Filling(arm=takeichi_20m(3), shared=((2, 3),)))
    assert found.full[1] == found.full[2] > found.full[0]
    np.testing.assert_array_equal(found.pressure[:, 1], found.pressure[:, 2])
    assert found.filling.bags == 2


def test_a_ladder_in_the_laminar_range_is_a_network_of_resistors():
    """While the last bag is limp, bag i has (N - i) R Q at a flow of 10 ml/min through tubes."""
    d, length, flow = 4e-3, 0.5, 1e-5 / 60
    values = {"ports__diameter": d, "ports__length": length, "supply__flow": flow}
    made = small(**values)
    found = fill(made, limit=1e7)
    resistance = 128 * 1.96e-5 * length / (np.pi * d**4)
    row = np.searchsorted(found.fullness[:, -1], 0.9)
    np.testing.assert_allclose(
        found.pressure[row], resistance * flow * np.array([2, 1, 0]), rtol=3e-4, atol=1e-6
    )


def test_a_disturbed_ladder_settles_as_its_network_does():
    """Four tight bags, one with more gas: scipy against the matrix exponential of the network."""
    made = Filling(
        arm=takeichi_20m(4), ports=Ports(diameter=2e-3, length=0.3), supply=Supply(flow=1e-30)
    )
    more = 1e-7
    begin = np.array([more, 0, 0, 0])

    def slope(t, beyond):
        return np.asarray(rates(t, State(1.02 + jnp.asarray(beyond), jnp.zeros(())), made).share)

    times = np.linspace(0, 40, 9)
    found = solve_ivp(slope, (0, 40), begin, "Radau", times, rtol=1e-7, atol=1e-13).y
    skin = 1e4 / (0.15 * 1.6)
    p = np.roots([1 / (ROOM * skin), 1 / ROOM + 1 / skin, -0.02]).max()
    stiffness = 1 / ((1 + p / skin) / ROOM + (1 + p / ROOM) / skin)
    conductance = (1 + p / ROOM) * np.pi * 2e-3**4 / (128 * 1.96e-5 * 0.3)
    laplace = np.diag([1.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1)
    network = -laplace * conductance * stiffness / LINK
    expected = np.array([expm(network * t) @ [more, 0, 0, 0] for t in times]).T
    np.testing.assert_allclose(found, expected, atol=2e-4 * more)
    # Check that the state has changed.
    assert expected[0, -1] < 0.6 * more


def test_a_regulator_that_is_not_choked_fills_to_its_pressure():
    """At 1 kPa with a wide hole, the flow is large at first and decreases with each full bag."""
    values = {"supply__pressure": 1e3, "supply__nozzle_diameter": 0.01}
    found = filled("regulator", **values)
    assert found.finished
    assert found.pressure.max() < 1e3
    assert found.flow[-1] < found.flow[0]
    # For small pressures: C A sqrt(2 dp / rho), reduced by the short tube.
    free = 0.8 * np.pi / 4 * 0.01**2 * np.sqrt(2 * 1e3 / DENSITY)
    assert found.flow[0] == pytest.approx(free, rel=0.01)


def test_a_bottle_with_too_little_leaves_links_limp():
    values = {"supply__bottle_pressure": 10e5, "supply__nozzle_diameter": 1e-3}
    found = fill(small("bottle", **values), limit=3600)
    assert not found.finished
    assert np.isnan(found.duration)
    assert np.isnan(found.full[-1])
    assert found.full[0] > 0
    assert np.isnan(found.lift_off[-1])
    assert found.imbalance < 1e-10
    assert found.supplied[-1] <= 10e5 * 0.01 / (ROOM / DENSITY)


def test_what_cannot_be_followed_is_said():
    made = small("bottle", supply__nozzle_diameter=0.5)
    with pytest.raises(InputError, match=r"of the filling failed at .* s, after 20000 steps"):
        fill(made)
    assert np.isnan(filling_curve(made, duration=300, diameters=(0.01,)).flows).all()


@pytest.mark.parametrize("kind", ["flow", "regulator", "bottle"])
def test_every_pair_of_the_curve_fills_in_its_time(kind):
    curve = filling_curve(small(kind), duration=300, diameters=(0.004, 0.006, 0.01))
    assert curve.path == giajax.mechanics.inflation.STRENGTHS[kind]
    assert np.all(np.diff(curve.flows) < 0)
    assert np.all(np.diff(curve.pressures) < 0)
    for diameter, strength in zip(curve.diameters, curve.strengths, strict=True):
        pair = {"ports.diameter": diameter, curve.path: strength}
        assert fill(replace(small(kind), pair)).duration == pytest.approx(300, rel=3e-6)


@pytest.mark.parametrize("kind", ["flow", "bottle"])
def test_a_filling_goes_on_from_where_another_one_was(kind):
    """Start from the gas of a row in the middle: remaining time and final gas are the same."""
    values = {"supply__nozzle_diameter": 2e-4} if kind == "bottle" else {}
    whole = filled(kind, **values)
    row = 200
    rest = fill(small(kind, **values), share=whole.gas[row] / (DENSITY * LINK))
    assert rest.times[0] == 0
    np.testing.assert_allclose(rest.gas[0], whole.gas[row], rtol=1e-12, atol=1e-15)
    assert rest.supplied[0] == pytest.approx(whole.supplied[row], rel=1e-9)
    assert rest.duration == pytest.approx(whole.duration - whole.times[row], rel=1e-5)
    np.testing.assert_allclose(rest.gas[-1], whole.gas[-1], rtol=1e-6)
    assert rest.full[0] == 0
    assert rest.imbalance < 1e-10


def test_no_nozzle_fills_what_a_supply_has_too_little_for():
    made = small("bottle", supply__bottle_pressure=10e5)
    curve = filling_curve(made, duration=300, diameters=(0.01,))
    assert np.isnan(curve.strengths).all()
    assert np.isnan(curve.flows).all()


CHANGES = {
    "supply_flow_l_per_min": ("flow", 70.0),
    "supply_pressure_bar": ("regulator", 3.0),
    "bottle_volume_l": ("bottle", 20.0),
    "bottle_pressure_bar": ("bottle", 150.0),
    "nozzle_diameter_mm": ("regulator", 1.2),
    "nozzle_length_mm": ("regulator", 20.0),
    "nozzle_discharge_coefficient": ("regulator", 0.7),
    "port_diameter_mm": ("flow", 8.0),
    "port_length_mm": ("flow", 50.0),
    "port_discharge_coefficient": ("flow", 0.8),
    "gas_density_kg_per_m3": ("flow", 0.18),
    "ambient_pressure_kPa": ("flow", 95.0),
    "gas_viscosity_Pa_s": ("flow", 1e-4),
    "gas_heat_capacity_ratio": ("regulator", 1.4),
    "skin_stiffness_N_per_m": ("flow", 2e4),
    "skin_poisson_ratio": ("flow", 0.3),
    "skin_slack": ("flow", 2e-3),
    "shared": ("flow", [[2, 3]]),
    "supply": ("flow", "regulator"),
}


@pytest.mark.quick
def test_every_key_is_tried():
    assert set(CHANGES) == set(FillingSection.model_fields)


@pytest.mark.parametrize("key", CHANGES)
def test_every_key_changes_something(key):
    kind, value = CHANGES[key]
    fine = {"nozzle_diameter_mm": 0.2} if kind == "bottle" else {}
    stated = {"supply": kind, **fine, key: value}
    arm = takeichi_20m(3)
    before, after = (
        fill(Filling.from_section(FillingSection.model_validate(section), arm))
        for section in ({"supply": kind, **fine}, stated)
    )
    changes = np.abs(after.pressure[-1] - before.pressure[-1]).max() / before.pressure.max()
    assert changes > 1e-4 or abs(after.duration / before.duration - 1) > 1e-6


@pytest.mark.quick
def test_a_definition_goes_to_the_filling_and_back():
    stated = {key: value for key, (_, value) in CHANGES.items()} | {"port_diameter_mm": [8.0]}
    made = Filling.from_section(FillingSection.model_validate(stated), takeichi_20m(3))
    again = Filling.from_section(FillingSection.model_validate(made.definition()), takeichi_20m(3))
    assert made.supply.kind == "regulator"
    assert again.definition() == made.definition()
    assert set(made.definition()) == set(FillingSection.model_fields)


BAD = {
    "shares alone": ({"shared": ((2,),)}, r"the links \[2\] share a bag, but must be neighbours"),
    "no neighbours": ({"shared": ((1, 3),)}, r"the links \[1, 3\] share a bag, but must be"),
    "beyond": ({"shared": ((3, 4),)}, "link 4 shares a bag, but the arm has only 3 links: correct"),
    "twice": (
        {"shared": ((1, 2), (2, 3))},
        "link 2 is in two lists of shared bags, but can belong to only one bag: put all",
    ),
    "ports": (
        {"ports": Ports(diameter=[0.01, 0.01, 0.02])},
        "the ports have 3 values of diameter, but there are 2 ports between 3 bags: give one",
    ),
}


@pytest.mark.quick
@pytest.mark.parametrize("case", BAD)
def test_a_filling_that_cannot_be_is_refused(case):
    about, sentence = BAD[case]
    with pytest.raises(InputError, match=sentence):
        Filling(arm=takeichi_20m(3), **about)


def test_bad_numbers_are_refused():
    with pytest.raises(InputError, match="no supply 'pump': use one of flow, regulator, bottle"):
        Supply(kind="pump")
    for path, value in (("ports.diameter", 0.0), ("supply.flow", -1.0), ("gas.density", np.nan)):
        with pytest.raises(InputError, match=f"{path} = .* is outside its bounds: choose a value"):
            fill(replace(Filling(arm=takeichi_20m(3)), {path: value}))
    with pytest.raises(InputError, match="the limit is -1 s: give a positive number of seconds"):
        fill(limit=-1)
    with pytest.raises(
        InputError, match="share one bag, which has no ports: do not request the curve"
    ):
        filling_curve(Filling(arm=takeichi_20m(1)))
    with pytest.raises(InputError, match="the duration is 0 s: give a positive number"):
        filling_curve(duration=0)
    with pytest.raises(InputError, match="no diameter is given: give at least one"):
        filling_curve(diameters=())
