"""Winds as functions of place and time: forces, names in files, and invalid winds."""

import dataclasses
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.mechanics.arm import (
    AbstractWind,
    PointMasses,
    acceleration,
    drag_force,
    drag_power,
    inverse_dynamics,
    link_centres,
    takeichi_20m,
    with_wind,
)
from giajax.recordings import Definition
from giajax.runtime.plugins import sources_named, sources_of
from giajax.runtime.programs import content, structure
from giajax.schema.parameters import declared, default_free, parameter
from giajax.simulation import Stepper, constant, is_disturbance, joint_steps, logged, simulate
from giajax.testing import check_wind

WIND = jnp.asarray([1.0, -0.5, 0.2])
MOVING = np.random.default_rng(0).normal(size=(2, 3))
# A body off the axis with its own drag, and all effects of the air.
BODY = PointMasses(
    (2,),
    mass=jnp.asarray([0.1]),
    position=jnp.asarray([0.4]),
    left=jnp.asarray([0.3]),
    up=jnp.asarray([0.2]),
    drag_area=jnp.asarray([0.05]),
)
FULL = {"air.axial_coefficient": 0.02, "air.added_mass_coefficient": 1.0}


def full_arm(**changes):
    return takeichi_20m(
        3, drag="strip", strip_points=4, point_masses=BODY, parameters=FULL, **changes
    )


def everywhere(vector, position):
    """Broadcast explicitly, because the tests forbid implicit rank promotion."""
    return jnp.broadcast_to(jnp.asarray(vector), position.shape)


@giajax.register
class Sheared(AbstractWind):
    """A linear function of place and time: along x by y, along y by z and time, along z by x."""

    gradient: jax.Array = parameter((0.3, 0.1, -0.2), unit="1/s", shape=(3,), doc="by place")
    growth: jax.Array = parameter(0.4, unit="m/s^2", frozen=False, doc="of the wind along y")

    def __call__(self, position, time):
        grown = everywhere(self.growth * time * jnp.array([0.0, 1.0, 0.0]), position)
        return position[..., np.array([1, 2, 0])] * everywhere(self.gradient, position) + grown


def breeze(position, time):
    return everywhere(WIND, position)


def growing(position, time):
    return everywhere(WIND * jnp.sin(time), position)


def test_a_wind_that_is_the_same_everywhere_is_a_constant_wind():
    rates = jnp.asarray(MOVING)
    for arm in (takeichi_20m(3), full_arm()):
        blown = with_wind(arm, breeze)
        for function in (drag_force, drag_power):
            expected = function(arm, *rates, WIND)
            assert_allclose(function(blown, *rates), expected, rtol=1e-13)
            # In addition to the wind of the run and the arm's own wind.
            assert_allclose(function(blown, *rates, -WIND), function(arm, *rates), rtol=1e-9)
        command = jnp.zeros(3)
        assert_allclose(
            acceleration(blown, *rates, command), acceleration(arm, *rates, command, WIND),
            rtol=1e-10,
        )  # fmt: skip


def test_the_wind_is_that_of_each_place_along_a_link_and_of_each_body():
    """Drag on an arm at rest, compared with a sum over many pieces of its links."""
    wind = Sheared(gradient=jnp.asarray([3.0, -2.0, 1.0]))
    angles, time = jnp.asarray(MOVING[0]), 2.0
    still = jnp.zeros(3)
    arm = takeichi_20m(3, drag="strip", strip_points=20, wind_field=wind)
    found = drag_force(arm, angles, still, time=time)
    centres = np.asarray(link_centres(arm, angles))
    here = giajax.mechanics.arm.pose(arm, angles)
    expected = np.zeros((3, 3))
    for link, axis in enumerate(np.asarray(here.direction.T)):
        for part in (np.arange(400) + 0.5) / 400 - 0.5:
            place = centres[link] + part * 0.99 * axis
            velocity = [3.0 * place[1], -2.0 * place[2] + 0.4 * time, place[0]]
            across = velocity - axis * (axis @ velocity)
            size = 0.5 * 1.204 * 1.2 * 0.3 * 0.99 / 400
            expected[link] += size * np.linalg.norm(across) * across
    assert_allclose(found, expected, rtol=1e-3, atol=1e-4)
    assert np.abs(drag_force(arm, angles, still) - found).max() > 0.01
    # Drag of a body alone, at the end of a lever.
    bare = {"air.drag_coefficient": 0.0}
    arm = takeichi_20m(3, point_masses=BODY, wind_field=wind, parameters=bare)
    here = giajax.mechanics.arm.pose(arm, angles, sideways=True)
    place = here.joint[:, 1] + 0.4 * here.direction[:, 1] + 0.3 * here.left[:, 1]
    velocity = wind(place + 0.2 * here.up[:, 1], jnp.asarray(time))
    expected = 0.5 * 1.204 * 0.05 * jnp.linalg.norm(velocity) * velocity
    assert_allclose(drag_force(arm, angles, still, time=time)[1], expected, rtol=1e-10)


def test_drag_along_a_link_is_by_the_wind_at_each_place():
    def stretching(position, time):
        return position * everywhere([1.0, 0.0, 0.0], position)

    arm = dataclasses.replace(full_arm(wind_field=stretching), point_masses=None)
    # Straight along x, the wind at x is x, so the drag of the skin depends on its mean square.
    x = np.asarray([0.0, 0.99, 1.98])
    expected = 0.5 * 1.204 * 0.3 * 0.02 * ((x + 0.99) ** 3 - x**3) / 3
    assert_allclose(drag_force(arm, jnp.zeros(3), jnp.zeros(3))[:, 0], expected, rtol=1e-12)


def test_added_mass_feels_the_rate_of_the_air_that_passes():
    """For a field u(x, t), du/dt = growth + gradient u; without drag, as with a wind per link."""
    none = {**FULL, "air.drag_coefficient": 0.0, "air.axial_coefficient": 0.0, "air.wind": WIND}
    plain = takeichi_20m(3, drag="strip", parameters=none)
    wind = Sheared()
    angles, rates = map(jnp.asarray, MOVING)
    centres = link_centres(plain, angles)
    velocity = wind(centres, jnp.asarray(2.0))
    rate = np.asarray(velocity + WIND[None])[:, [1, 2, 0]] * np.asarray(wind.gradient)
    rate[:, 1] += 0.4
    still = jnp.zeros(3)
    expected = inverse_dynamics(plain, angles, rates, still, velocity, jnp.asarray(rate))
    found = inverse_dynamics(with_wind(plain, wind), angles, rates, still, time=2.0)
    assert_allclose(found, expected, rtol=1e-12)


def test_a_motion_in_a_function_is_that_in_its_recording():
    arm, times = takeichi_20m(2), np.linspace(0.0, 3.0, 31)
    command = joint_steps(2, {})
    dense = np.linspace(0.0, 3.0, 601)
    recorded = logged(dense, np.sin(dense)[:, None] * np.asarray(WIND), "linear")
    expected = simulate(arm, command, times, wind=recorded, rtol=1e-8, atol=1e-8)
    found = simulate(arm, command, times, wind=growing, rtol=1e-8, atol=1e-8)
    assert_allclose(found.angles, expected.angles, atol=2e-6)
    assert np.ptp(found.angles) > 0.01
    assert_allclose(found.accelerations, expected.accelerations, atol=2e-4)
    # Each interval of the stepper starts at time 0, but the wind must continue.
    stepper = Stepper(found.arm, interval=0.1, steps=4)
    moment = stepper.start()
    for _ in range(30):
        moment = stepper.advance(moment, np.zeros(2))
    assert_allclose(moment.angles, found.angles[-1], atol=1e-5)


def test_derivatives_by_its_parameters_are_those_of_differences_at_rest_too():
    arm = takeichi_20m(2, wind_field=Sheared(growth=jnp.zeros(())))
    times, path = jnp.linspace(0.0, 1.0, 3), "air.wind_field.growth"
    assert is_disturbance(path)

    def tip(growth, steps_for="derivatives"):
        moved = giajax.replace(arm, {path: growth})
        options = {"steps_for": steps_for, "rtol": 1e-9, "atol": 1e-9, "throw": False}
        return simulate(moved, constant(np.zeros(2)), times, **options).tip[-1]

    for at in (0.0, 0.3):
        slope = jax.jvp(tip, (jnp.asarray(at),), (jnp.ones(()),))[1]
        step = 1e-4
        expected = (tip(at + step) - tip(at - step)) / (2 * step)
        assert_allclose(slope, expected, rtol=1e-4, atol=1e-6)
    assert np.abs(expected).max() > 1e-3
    with pytest.raises(TypeError, match="differentiated with respect to a disturbance"):
        jax.jvp(lambda growth: tip(growth, "motion"), (jnp.ones(()),), (jnp.ones(()),))


def test_an_arm_in_a_wind_goes_through_its_definition_and_its_class_is_in_keys():
    arm = takeichi_20m(2, wind_field="Sheared", parameters={"air.wind_field.growth": 0.7})
    assert "air.wind_field.gradient" in declared(arm)
    assert "air.wind_field.growth" in default_free(arm)
    model = giajax.ArmModel(giajax.replace(arm, {"air.wind_field.growth": 0.4}))
    assert model.definition()["arm"]["wind_field"] == "Sheared"
    again = giajax.ArmModel.from_definition(model.definition())
    assert eqx.tree_equal(again.arm.air, model.arm.air)
    assert "wind_field" not in giajax.ArmModel(takeichi_20m(2)).definition()["arm"]
    here = "test_wind_field.py"
    assert here in sources_of(model)
    assert here in sources_named('wind_field = "Sheared"')
    for text in (structure, content):
        assert text(arm) != text(takeichi_20m(2))
        assert text(takeichi_20m(2, wind_field=breeze)) != text(takeichi_20m(2, wind_field=growing))
        assert "wind_field" not in text(takeichi_20m(2)) or text is structure
    with pytest.raises(InputError, match=r"the wind WindFunction is not registered.*write a class"):
        giajax.ArmModel(takeichi_20m(2, wind_field=breeze)).definition()
    with pytest.raises(InputError, match="wind_field = 'Nobodys' must be a registered wind"):
        Definition.parse({"arm": {"wind_field": "Nobodys"}}, "test")


def test_a_program_with_an_edited_function_is_another_one(monkeypatch):
    """The key of a function depends on its source, like that of a class."""
    arm = takeichi_20m(1, wind_field=breeze)
    before = structure(arm)
    monkeypatch.setattr("giajax.runtime.programs.mark", lambda value: "edited")
    assert structure(arm) != before


def shapeless(position, time):
    return time


def endless(position, time):
    return position / 0.0


def rough(position, time):
    return jnp.sqrt(position - position)


def chosen(position, time):
    return position if position[0, 0] > 0 else -position


def silent(position, time):
    raise ValueError


def mixed(position, time):
    return position - position[..., :1, :]


def averaged(position, time):
    return position.mean(axis=-2, keepdims=True) + 0 * position


def outermost(position, time):
    return position.max(axis=-2, keepdims=True) + 0 * position


class Late(Sheared):
    def __call__(self, position, time):
        return position / (time - 60.0)


@pytest.mark.parametrize(
    ("wind", "said"),
    [
        (shapeless, r"shapeless returns the shape \(\) for positions of shape \(3, 3\)"),
        (endless, "endless has a value that is not finite at 0 s at the position of the arm"),
        (rough, "rough has a derivative that is not finite"),
        (chosen, r"chosen fails \(TracerBoolConversionError"),
        (silent, r"silent fails \(ValueError\): correct it"),
        (mixed, "mixed does not return a separate wind for each position .*: index positions"),
        (averaged, "averaged does not return a separate wind for each position"),
        (outermost, "outermost does not return a separate wind for each position"),
        (Late(), "Late has a value that is not finite at 60 s"),
        (sys.intern, "the wind field is .*: give a plain def or lambda of position"),
        (jax.jit(silent), "the wind field is .*: give a plain def or lambda of position"),
    ],
    ids=lambda value: getattr(value, "__name__", type(value).__name__),
)
def test_a_wrong_wind_is_refused_before_anything_is_fitted(wind, said):
    for take in (check_wind, lambda wind: takeichi_20m(2, wind_field=wind)):
        with pytest.raises(InputError, match=said):
            take(wind)


def test_a_wind_is_tried_where_the_arm_is():
    def above_ground(position, time):
        return jnp.log(position[..., 2:] + 3.0) * everywhere(WIND, position)

    check_wind(above_ground)
    upright = {"links": 4, "length": 2.0}
    takeichi_20m(**upright, base_rotation=(0.0, -np.pi / 2, 0.0), wind_field=above_ground)
    with pytest.raises(InputError, match="above_ground has a value that is not finite"):
        takeichi_20m(**upright, base_rotation=(0.0, np.pi / 2, 0.0), wind_field=above_ground)
    with pytest.raises(InputError, match="there is no registered wind 'Nobodys': register it"):
        takeichi_20m(2, wind_field="Nobodys")


def test_a_wind_without_its_method_is_refused_by_its_name():
    with pytest.raises(InputError, match="Unfinished lacks __call__: implement it"):

        @giajax.register
        class Unfinished(AbstractWind):
            pass
