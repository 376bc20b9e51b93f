"""Motions in air with closed-form solutions, each derived next to its test."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import kinetic_energy, potential_energy, takeichi_20m
from giajax.runtime.text import InputError
from giajax.schema.parameters import replace
from giajax.simulation import constant, ramps, simulate, steps

DENSITY, LENGTH, DIAMETER, DRAG = 1.204, 0.99, 0.3, 1.2
DISPLACED = DENSITY * np.pi / 4 * DIAMETER**2 * LENGTH


@pytest.mark.slow
# The next test uses the other two pairs.
@pytest.mark.parametrize(("drag", "added"), [("centre", None), ("strip", 0.9)])
def test_a_falling_horizontal_cylinder(drag, added):
    """(m + m_a) v' = (m - rho V) g - 1/2 rho C_D L d v^2, with m_a = C_a rho V, from rest:

    v = v_t tanh(t / T),  z = -v_t T log cosh(t / T),
    v_t^2 = 2 (m - rho V) g / (rho C_D L d),  T = (m + m_a) v_t / ((m - rho V) g).

    The cylinder is perpendicular to the end of a massless lever of R = 1e5 m. All of its points
    have the same distance from the joint of the lever, and so fall in the same way. On the circle,
    gravity acts with g cos(z / R), which is smaller by (z / R)^2 / 2. The height has the same
    relative error, 3e-9 after 7 m. A pitching lever also turns the cylinder about its own axis,
    which has no drag and adds I / (m R^2), 1e-13 of its mass.
    """
    lever, mass, gravity = 1e5, 0.2, 9.81
    parameters = {"buoyancy.helium_density": 0.0}
    if added is not None:
        parameters["air.added_mass_coefficient"] = added
    arm = takeichi_20m(
        2,
        length=[lever, LENGTH],
        diameter=[1e-15, DIAMETER],
        mass=[1e-12, mass],
        gravity=gravity,
        drag=drag,
        buoyancy=True,
        parameters=parameters,
    )
    across = np.array([0.0, np.pi / 2])
    times = np.linspace(0.0, 3.0, 31)
    motion = simulate(
        arm,
        # The torque of the pitch spring is negligible: k / R^2 is 3e-10 N/m.
        constant(across),
        times,
        initial=(across, np.zeros(2)),
        rtol=1e-10,
        atol=1e-14,
    )
    force = (mass - DISPLACED) * gravity
    speed = np.sqrt(2 * force / (DENSITY * DRAG * LENGTH * DIAMETER))
    moving = mass + (0.0 if added is None else added * DISPLACED)
    time = moving * speed / force
    assert times[-1] > 3 * time  # the cylinder reaches 99 % of its terminal speed
    fall = -speed * time * np.log(np.cosh(times / time))
    assert_allclose(motion.link_centres[:, 1, 2], fall, rtol=1e-6, atol=1e-8)
    found = -lever * motion.rates[:, 0]
    assert_allclose(found, speed * np.tanh(times / time), rtol=1e-6, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drag", "share", "added"), [("centre", 1 / 16, 1.0), ("strip", 1 / 8, None)]
)
def test_a_link_that_swings_loses_energy_to_the_air(drag, share, added):
    """To first order, the link swings as q = a cos(w t) with w^2 = k / I, and the drag torque is
    b q' |q'|, with b = rho C_D d L^4 / 16 at the centre, and rho C_D d L^4 / 8 along the link.
    In one period, the dissipated energy is

        b a^3 w^2 int_0^(2 pi) |sin|^3 = 8/3 b a^3 w^2.

    The next order is smaller by the factor b a / I, and so is proportional to the amplitude.
    """
    stiffness = 3.0
    options = {} if added is None else {"parameters": {"air.added_mass_coefficient": added}}
    arm = takeichi_20m(1, joint_axes=["pitch"], drag=drag, **options)
    arm = replace(arm, {"joints.damping": 0.0})
    inertia = 0.047 * (0.15**2 / 2 + LENGTH**2 / 3)
    if added is not None:
        inertia += DISPLACED * LENGTH**2 / 3
    frequency = np.sqrt(stiffness / inertia)
    resistance = DENSITY * DRAG * DIAMETER * LENGTH**4 * share
    still = constant([0.0])
    off = []
    for amplitude in 4e-3, 2e-3:
        start = ([amplitude], [0.0])
        times = np.array([0.0, 2 * np.pi / frequency])
        motion = simulate(arm, still, times, initial=start, rtol=1e-12, atol=1e-15)
        energy = [
            float(kinetic_energy(arm, q, v) + potential_energy(arm, q, still.values[0]))
            for q, v in zip(motion.angles, motion.rates, strict=True)
        ]
        loss = 8 / 3 * resistance * amplitude**3 * frequency**2
        off.append((energy[0] - energy[1]) / loss - 1)
        assert abs(off[-1]) < 4 * resistance * amplitude / inertia
    # The error of the first-order result is proportional to the amplitude.
    assert off[1] / off[0] == pytest.approx(0.5, rel=0.05)


@pytest.mark.slow
def test_a_trimmed_arm_stays_where_it_is_put():
    """It floats in any pose, unlike an arm without trim weights."""
    springless = {"joints.pitch_stiffness": 0.0, "joints.yaw_stiffness": 0.0}
    pose = np.array([0.4, -0.7, 0.2, 0.9])
    times = np.linspace(0.0, 10.0, 3)
    moved = {}
    for trim in True, False:
        arm = takeichi_20m(4, gravity=9.81, buoyancy=True, trim=trim)
        arm = replace(arm, springless)
        motion = simulate(arm, constant(np.zeros(4)), times, initial=(pose, np.zeros(4)))
        moved[trim] = np.abs(np.asarray(motion.angles) - pose).max()
    assert moved[True] < 1e-9
    assert moved[False] > 0.5


@pytest.mark.slow
def test_a_wind_that_grows_pushes_a_link_and_one_that_jumps_is_refused():
    """Without drag, I q'' = rho V (1 + C_a) (L / 2) du/dt with I of the link and its added mass."""
    arm = takeichi_20m(1, joint_axes=["yaw"], parameters={"air.added_mass_coefficient": 0.8})
    arm = replace(
        arm, {"air.drag_coefficient": 0.0, "joints.yaw_stiffness": 0.0, "joints.damping": 0.0}
    )
    gust, times = 1e-4, np.linspace(0.0, 1.0, 11)
    wind = ramps([0.0, 1.0], [[0.0, 0.0, 0.0], [0.0, gust, 0.0]])
    motion = simulate(arm, constant([0.0]), times, wind=wind, rtol=1e-10, atol=1e-14)
    inertia = 0.047 * (0.15**2 / 2 + LENGTH**2 / 3) + 0.8 * DISPLACED * LENGTH**2 / 3
    torque = DISPLACED * 1.8 * gust * LENGTH / 2
    # Munk's couple is of second order in the wind.
    assert_allclose(motion.angles[:, 0], torque / inertia * times**2 / 2, rtol=1e-6, atol=1e-12)
    jumping = steps([0.0, 0.5], [[0.0, 0.0, 0.0], [0.0, gust, 0.0]])
    with pytest.raises(
        InputError, match="the wind is discontinuous, which causes an infinite force"
    ):
        simulate(arm, constant([0.0]), times, wind=jumping)
    plain = takeichi_20m(1, joint_axes=["yaw"])
    assert simulate(plain, constant([0.0]), times, wind=jumping).successful
    assert simulate(arm, constant([0.0]), times, wind=[0.0, 1.0, 0.0]).successful


def test_coulomb_friction_brings_a_link_to_rest():
    """At rates above the smoothing rate, I w' = -f: w = w0 - f t / I, until it stops."""
    parameters = {"joints.friction": 0.02, "joints.friction_rate": 1e-3}
    arm = takeichi_20m(1, joint_axes=["pitch"], parameters=parameters)
    nothing = ("air.drag_coefficient", "joints.pitch_stiffness", "joints.damping")
    arm = replace(arm, dict.fromkeys(nothing, 0.0))
    inertia = 0.047 * (0.15**2 / 2 + LENGTH**2 / 3)
    stop = inertia * 2.0 / 0.02
    times = np.array([0.0, 0.5 * stop, 0.9 * stop, 1.5 * stop])
    motion = simulate(arm, constant([0.0]), times, initial=([0.0], [2.0]), rtol=1e-9, atol=1e-9)
    assert_allclose(motion.rates[:3, 0], 2.0 * (1 - times[:3] / stop), rtol=1e-6)
    assert abs(motion.rates[3, 0]) < 1e-6
