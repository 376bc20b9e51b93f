"""Sensitivities along a run, and the standard errors that they predict for a fit."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import ArmModel, InputError, model_for
from giajax.apps.synthetic import synthesise
from giajax.studies import expected_errors, sensitivity

TIMES = np.linspace(0.0, 4.0, 41)
COMMAND = {"joint01_command": np.interp(TIMES, [0.5, 1.5], [0.0, 0.5])}
FREE = ["air.drag_coefficient", "joints.pitch_stiffness"]
ALL = [*FREE, "joints.yaw_stiffness", "joints.damping", "camera.origin", "links.mass[1]"]
RUN = giajax.apps.synthetic.planned(TIMES, COMMAND, links=3)


def model():
    return ArmModel(giajax.takeichi_20m(3), tolerance=jnp.asarray(1e-9))


@pytest.fixture(scope="module")
def everything():
    """Compute the sensitivities to all parameters with one program."""
    return sensitivity(model(), RUN, ALL)


def part(whole, rows):
    """Return the sensitivities to some parameters."""
    return dataclasses.replace(
        whole,
        parameters=whole.parameters[rows],
        units=whole.units[rows],
        values=whole.values[rows],
        derivatives=whole.derivatives[rows],
    )


@pytest.fixture(scope="module")
def found(everything):
    return part(everything, slice(0, 2))


def test_derivatives_are_those_of_differences(found):
    for row, path in enumerate(FREE):
        value = float(giajax.get(model(), path))
        step = 1e-4 * value
        ahead, behind = (
            giajax.predict(giajax.replace(model(), {path: value + sign * step}), RUN)
            for sign in (1, -1)
        )
        for column, name in enumerate(found.channels):
            if name.endswith("_y"):
                continue
            difference = (ahead[name] - behind[name]) / (2 * step)
            error = np.linalg.norm(found.derivatives[row, :, column] - difference)
            # Both are computed with the tolerance of a prediction.
            assert error < 1e-4 * np.linalg.norm(difference)


def test_a_body_is_its_three_components(found):
    names, lengths = found.lengths()
    assert names == ("link01", "link02", "link03")
    assert lengths.shape == (2, 41, 3)
    np.testing.assert_allclose(
        lengths[0, 7, 1] ** 2, np.sum(found.derivatives[0, 7, 3:6] ** 2), rtol=1e-12
    )
    # Before the command changes, no parameter has an effect.
    assert np.all(lengths[:, :5] == 0)


@pytest.mark.slow
def test_information_adds_and_promises_what_a_fit_finds(found):
    """The Cramer-Rao bound equals the standard error of a fit with that noise."""
    sigma = 0.005
    truth = dict(zip(FREE, found.values, strict=True))
    recorded = synthesise(model(), TIMES, COMMAND, found.channels, noise={"position": sigma})
    start = {path: 0.7 * value for path, value in truth.items()}
    result = giajax.fit(model_for([recorded]), recorded, free=FREE, start=start, check=False)
    stated = [result.parameters[path].standard_error for path in FREE]
    np.testing.assert_allclose(found.standard_errors(sigma), stated, rtol=0.05)
    whole = found.information(sigma).sum(axis=0)
    np.testing.assert_allclose(
        found.standard_errors(sigma) ** 2, np.diag(np.linalg.inv(whole)), rtol=1e-10
    )
    by_body = found.errors_by_body(sigma)
    np.testing.assert_allclose(np.sum(by_body[:, 0] ** -2.0), whole[0, 0], rtol=1e-12)
    # The tip moves most, and gives the most information.
    assert np.all(np.diff(by_body[:, 0]) < 0)


def test_noise_by_channel(found):
    deviations = np.full(9, 0.01)
    deviations[6:] = np.inf
    one = found.information(deviations)
    np.testing.assert_allclose(one[:2], found.information(0.01)[:2])
    assert np.all(one[2] == 0)
    with pytest.raises(InputError, match="noise is 0"):
        found.information(0.0)


@pytest.mark.slow
def test_what_no_channel_tells_has_an_infinite_error(everything):
    both = np.array([[4.0, 4.0, 0.0], [4.0, 4.0, 0.0], [0.0, 0.0, 25.0]])
    np.testing.assert_allclose(expected_errors(both), [np.inf, np.inf, 0.2])
    planar = part(everything, slice(2, 4))
    errors = planar.standard_errors(0.01)
    assert np.isinf(errors[0])
    assert np.isfinite(errors[1])


@pytest.mark.slow
def test_arrays_are_taken_element_by_element_and_options_are_switched_on(everything):
    some = part(everything, slice(4, None))
    assert some.parameters == (*(f"camera.origin[{i}]" for i in range(3)), "links.mass[1]")
    height = some.channels.index("link03_z")
    expected = [[0.0] * 41, [0.0] * 41, [-1.0] * 41]
    np.testing.assert_allclose(some.derivatives[:3, :, height], expected, atol=1e-15)
    assert some.units == ("m", "m", "m", "kg")


def test_without_air_there_is_no_drag_to_feel():
    still = giajax.replace(model(), {"air.density": 0.0})
    assert np.all(sensitivity(still, RUN, ALL).derivatives[0] == 0)


def test_what_makes_no_sense_is_one_sentence():
    with pytest.raises(InputError, match="no parameter is given: give"):
        sensitivity(model(), RUN, [])
    with pytest.raises(InputError, match=r"did you mean 'air\.drag_coefficient'"):
        sensitivity(model(), RUN, ["drag_coefficient"])
    with pytest.raises(InputError, match="no measured channel"):
        sensitivity(model(), RUN, FREE, [])
