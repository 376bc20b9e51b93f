"""The roll: its geometry, inertia, energies and forces, against closed forms and quadrature."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from giajax import replace, takeichi_20m
from giajax.mechanics.inflation import Filling
from giajax.mechanics.unrolling import (
    Unrolling,
    bending_energy,
    open_volume,
    roll_forces,
    roll_inertia,
    roll_radius,
    rolling_mass,
    weight_energy,
)

LENGTH, RADIUS, CORE = 19.8, 0.1, 0.05
UNEVEN = {"length": [1.0, 0.8, 1.2], "diameter": [0.3, 0.25, 0.2], "mass": [0.05, 0.03, 0.04]}


def uneven(**values):
    """Return three links that all differ."""
    made = Unrolling(filling=Filling(arm=takeichi_20m(3, **UNEVEN)))
    return replace(made, {path.replace("__", "."): value for path, value in values.items()})


def along(x, key):
    """Return the value of a per-link quantity for the link at x."""
    ends = np.cumsum(UNEVEN["length"])
    return UNEVEN[key][int(np.searchsorted(ends[:-1], x, side="right"))]


def at(function, unrolling, x):
    return np.asarray(function(unrolling, jnp.asarray(x)))


def test_the_area_of_the_roll_is_that_of_its_layers():
    """pi (R^2 - R0^2) = h (L - x), from a full roll to the empty core."""
    made = Unrolling()
    layer = np.pi * (RADIUS**2 - CORE**2) / LENGTH
    assert float(made.pitch) == pytest.approx(layer, rel=1e-12)
    for x in (0.0, 5.0, 12.3, LENGTH):
        expected = np.sqrt(CORE**2 + layer * (LENGTH - x) / np.pi)
        assert float(at(roll_radius, made, x)) == pytest.approx(expected, rel=1e-12)
    assert float(at(roll_radius, made, LENGTH)) == pytest.approx(CORE, rel=1e-9)


@pytest.mark.parametrize("x", [0.1, 0.9, 1.5, 2.7])
def test_inertia_is_that_of_all_layers(x):
    """Quadrature over the wound part, for links that differ; the core is a thin tube."""
    made = uneven(roll__core_mass=0.2)
    layer = np.pi * (RADIUS**2 - CORE**2) / 3.0

    def of(s, power):
        density = along(s, "mass") / along(s, "length")
        return density * (CORE**2 + layer * (3.0 - s) / np.pi) ** power

    ends = [e for e in (1.0, 1.8) if e > x]
    mass = quad(of, x, 3.0, args=(0,), points=ends)[0] + 0.2
    moment = quad(of, x, 3.0, args=(1,), points=ends)[0] + 0.2 * CORE**2
    found = roll_inertia(made, jnp.asarray(x))
    assert float(found.mass) == pytest.approx(mass, rel=1e-9)
    assert float(found.moment) == pytest.approx(moment, rel=1e-9)
    radius = float(at(roll_radius, made, x))
    assert float(at(rolling_mass, made, x)) == pytest.approx(mass + moment / radius**2, rel=1e-9)
    assert float(at(weight_energy, made, x)) == pytest.approx(mass * 9.80665 * radius, rel=1e-9)


def test_a_solid_roll_has_half_of_m_r_squared():
    """A uniform arm on a very thin core has an effective mass of three halves of its mass."""
    made = replace(Unrolling(), {"roll.core_radius": 1e-9, "roll.core_mass": 1e-12})
    mass = 0.94 * (1 - 7.0 / LENGTH)
    assert float(at(rolling_mass, made, 7.0)) == pytest.approx(1.5 * mass, rel=1e-9)


@pytest.mark.parametrize("creep", [0.0, 0.3, 1.0])
def test_bending_is_what_two_plates_take(creep):
    """E t^3 / (12 (1 - nu^2)) for each film, bent from its initial curvature; by quadrature."""
    made = uneven(film__creep=creep)
    stiffness = 2e8 * 50e-6**3 / (12 * (1 - 0.45**2))
    layer = np.pi * (RADIUS**2 - CORE**2) / 3.0

    def energy(s, straight):
        wound = 1 / np.sqrt(CORE**2 + layer * (3.0 - s) / np.pi)
        curvature = 0.0 if straight else wound
        return (
            2 * stiffness / 2 * np.pi * along(s, "diameter") / 2 * (curvature - creep * wound) ** 2
        )

    x, ends = 2.4, [1.0, 1.8]
    paid = [quad(energy, 0, x, args=(straight,), points=ends)[0] for straight in (True, False)]
    found = float(at(bending_energy, made, x))
    assert found == pytest.approx(paid[0] - paid[1], rel=1e-9)
    assert (found > 0) == (creep > 0.5)


@pytest.mark.parametrize("x", [0.4, 1.3, 2.5])
def test_forces_are_slopes_of_energies(x):
    """Compare with differences; the gas acts with its pressure times the area of the tube."""
    made, speed, pressure = uneven(), 0.3, 7.0
    found = roll_forces(made, *map(jnp.asarray, (x, speed, pressure)))
    step = 1e-5

    def slope(function):
        values = [float(np.sum(at(function, made, x + d))) for d in (step, -step)]
        return (values[0] - values[1]) / (2 * step)

    area = np.pi / 4 * along(x, "diameter") ** 2
    assert float(found.gas) == pytest.approx(pressure * area, rel=1e-12)
    assert slope(open_volume) == pytest.approx(area, rel=1e-8)
    assert float(found.weight) == pytest.approx(-slope(weight_energy), rel=1e-7)
    assert float(found.bending) == pytest.approx(-slope(bending_energy), rel=1e-7)
    assert float(found.inertia) == pytest.approx(-slope(rolling_mass) * speed**2 / 2, rel=1e-7)
    assert float(found.peel) == pytest.approx(-0.3, rel=1e-12)
    assert float(found.loss) == pytest.approx(-10 * speed, rel=1e-12)


def test_a_roll_that_is_carried_has_no_weight():
    made = Unrolling(carried=True)
    found = jax.jit(roll_forces)(made, *map(jnp.asarray, (3.0, 0.1, 0.0)))
    assert float(found.weight) == 0
    assert float(at(weight_energy, made, 3.0)) == 0


def test_layers_that_are_at_rest_are_held_by_what_pushes_them():
    """The peel force has no sign at rest, but a slope."""
    made = Unrolling()

    def peel(speed):
        return roll_forces(made, jnp.asarray(3.0), speed, jnp.zeros(())).peel

    value, slope = jax.jvp(peel, (jnp.zeros(()),), (jnp.ones(()),))
    assert float(value) == 0
    assert float(slope) == pytest.approx(-0.3 / 1e-4)
