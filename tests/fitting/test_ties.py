"""Tied parameters, which are expressed by others, and expressions over paths."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError, Run, fit, predict, takeichi_20m
from giajax.fitting import resolved_ties, set_up, tied, within_bounds
from giajax.models import ArmModel
from giajax.schema import Expression
from giajax.schema.parameters import replace
from toy_model import Decay, run

NOISE = 0.02


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a", 3.0),
        ("2 * (a - b.c) / -b.c", -1.0),
        ("+a+b.c*2e-1", 3.4),
        ("sqrt(a * 12) - exp(0 * a) + log(b.c / 2)", 5.0),
        ("b.d[1] - b.d[0]", 5.0),
        ("  1.5*a ", 4.5),
        (".5*a - 2.", -0.5),
    ],
)
def test_an_expression_is_arithmetic(text, value):
    numbers = {"a": 3.0, "b.c": 2.0, "b.d[0]": 4.0, "b.d[1]": 9.0}
    functions = {"sqrt": math.sqrt, "exp": math.exp, "log": math.log}
    expression = Expression.parse(text)
    assert set(expression.paths) <= set(numbers)
    assert expression.value(numbers.__getitem__, functions) == pytest.approx(value)


@pytest.mark.parametrize(
    "text",
    [
        *("", "a +", "a b", "f(a)", "sqrt(a, b)", "sqrt(x=a)", "a ** 2", "a // b", "a[b]", "a[-1]"),
        *("a[1][2]", "a if b else c", "lambda: a", "a, b", "a == b", "'a'", "1_0 * a", "0x1 * a"),
        *(
            "1j * a",
            "1e999 * a",
            "a\n+ b",
            "a # b",
            "__import__('os')",
            "(a).b()",
            "\N{GREEK SMALL LETTER ALPHA}",
            "\N{ARABIC-INDIC DIGIT ONE} * a",
        ),
        *(
            "(" * 400 + "a" + ")" * 400,
            "-" * 900 + "a",
            "+".join("a" * 300),
            "a" * 2000,
            "a" * 999 + "#",
        ),
    ],
)
def test_what_is_no_arithmetic_is_refused(text):
    with pytest.raises(
        InputError, match=r"may contain only numbers, parameter paths.*: remove everything else"
    ):
        Expression.parse(text)


def test_a_tie_is_a_reparametrised_model():
    """amplitude = 6 offset leaves one free parameter: a straight line through the origin."""
    recorded = run(sigma=NOISE)
    column = (6 * np.exp(-0.7 * recorded.times) + 1) / NOISE
    data = recorded.observations["tip_z"] / NOISE
    value, error = column @ data / (column @ column), 1 / np.linalg.norm(column)
    scale = max(1.0, np.sqrt(np.sum((column * value - data) ** 2) / 59))

    result = fit(
        Decay(decay=0.7),
        recorded,
        free=["offset"],
        start={"offset": 0.1},
        ties={"amplitude": "6 * offset"},
        noise_model="white",
    )
    offset, amplitude = result.parameters["offset"], result.parameters["amplitude"]
    assert result.status == "converged"
    assert_allclose(offset.value, value, atol=0.02 * error)
    assert_allclose(offset.standard_error, error * scale, rtol=1e-6)
    assert_allclose(amplitude.value, 6 * offset.value)
    assert_allclose(amplitude.standard_error, 6 * offset.standard_error)
    assert (amplitude.free, amplitude.remark) == (False, "tied: 6 * offset")
    assert result.derived["amplitude"].standard_error == amplitude.standard_error
    assert float(result.model.amplitude) == amplitude.value
    assert list(result.free) == ["offset"]
    assert result.gradient_check.relative_difference < 1e-6
    assert "tied: 6 * offset" in str(result)


def test_the_error_of_a_nonlinear_tie_is_that_of_its_slope():
    """offset = log(decay) / decay, compared with differences of the fitted expression."""
    model = Decay(amplitude=1.0)
    result = fit(
        model, run(), free=["amplitude", "decay"], ties={"offset": "log(1 + decay) / (decay + 1)"}
    )
    value = result.parameters["decay"].value
    (ahead, behind) = (math.log1p(d) / (1 + d) for d in (value + 1e-5, value - 1e-5))
    slope = (ahead - behind) / 2e-5
    expected = abs(slope) * result.parameters["decay"].standard_error
    assert result.parameters["offset"].standard_error == pytest.approx(expected, rel=1e-5)


def test_ties_of_ties_are_computed_in_their_order():
    texts = {"twin": "2 * offset", "idle": "twin + amplitude", "offset": "decay / 2"}
    model = Decay(decay=3.0, amplitude=2.0)
    ties = resolved_ties(model, texts)
    after = tied(model, ties)
    assert [float(getattr(after, name)) for name in ("offset", "twin", "idle")] == [1.5, 3.0, 5.0]
    assert bool(within_bounds(after, ties))
    assert not bool(within_bounds(replace(after, {"twin": -1.0}), ties))


def test_an_element_that_its_own_tie_names_stays_free():
    """One mass for all links: an array is tied to one of its elements."""
    model = ArmModel(takeichi_20m(4))
    times = np.linspace(0.0, 2.0, 9)
    flat = Run.from_arrays(times, {"joint01_command": 0 * times, "link04_z": times})
    free = {"free": ["links.mass"], "nuisances": False}
    setup = set_up(model, flat, **free, ties={"links.mass": "links.mass[2]"})
    assert [parameter.path for parameter in setup.parameters] == ["links.mass[2]"]
    masses = setup.started_at({"links.mass[2]": 0.3}).model.arm.links.mass
    assert_allclose(masses, [0.3] * 4)
    setup = set_up(model, flat, **free, ties={"links.mass": "links.mass[0] * 2"})
    assert_allclose(setup.model.arm.links.mass, np.array([1, 2, 2, 2]) * 0.047)
    setup = set_up(model, flat, ties={"links.centre_of_mass": "links.length / 3"})
    assert_allclose(setup.model.arm.links.centre_of_mass, [0.33] * 4)


def test_a_step_that_leads_a_tied_parameter_beyond_its_bounds_is_rejected():
    """idle = 0.25 - offset must not be negative, but the best offset is 0.3."""
    result = fit(
        Decay(decay=0.7),
        run(),
        free=["offset", "amplitude"],
        start={"offset": 0.1},
        ties={"idle": "0.25 - offset"},
        max_iterations=20,
    )
    assert 0.1 < result.parameters["offset"].value < 0.25
    assert result.parameters["idle"].value >= 0
    assert not all(iteration.accepted for iteration in result.history)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"ties": {"decay": "2 * decoy"}}, "no parameter 'decoy': did you mean 'decay'?"),
        ({"ties": {"decoy": "2 * decay"}}, "no parameter 'decoy': did you mean 'decay'?"),
        ({"ties": {"decay": "2 *"}}, "ties is not valid for decay, because the expression"),
        ({"ties": {"decay": "2"}}, "contains no parameter: include a parameter"),
        ({"ties": {"decay": "decay"}}, "the ties of 'decay' are circular: tie"),
        ({"ties": {"decay": "twin", "twin": "decay"}}, "'decay' and 'twin' are circular"),
        (
            {"ties": {"decay": "twin"}, "free": ["decay"]},
            "'decay' is tied to other parameters and also free: ",
        ),
        (
            {"ties": {"decay": "twin"}, "fix": {"decay": 1}},
            "'decay' is tied to other parameters and also fixed",
        ),
        ({"ties": {"decay": "twin"}, "start": {"decay": 1}}, "'decay' is tied .* given an initial"),
        ({"ties": {"decay": "10 * twin"}}, "decay = 10 1/s is outside its bounds"),
        ({"ties": {"decay": "log(0 - twin)"}}, "decay = nan 1/s is outside its bounds"),
    ],
)
def test_a_tie_that_cannot_be_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        fit(Decay(), run(), **options)


def test_a_tie_of_another_number_of_values_is_refused():
    model = ArmModel(takeichi_20m(4))
    with pytest.raises(
        InputError, match=r"has 1 element, but .* has 4 values: tie it to one value"
    ):
        tied(model, resolved_ties(model, {"air.density": "links.mass"}))
    with pytest.raises(InputError, match=r"'links.mass\[1\]' is tied by both 'links.mass' and"):
        resolved_ties(model, {"links.mass": "links.mass[0]", "links.mass[1]": "air.density"})


@pytest.mark.slow
def test_one_common_mass_of_twenty_links_is_found():
    """Positions of a pitching arm of known stiffness determine the common mass of all links."""
    truth = replace(ArmModel(takeichi_20m(20)), {"links.mass": 0.06, "joints.damping": 0.1})
    times = np.linspace(0.0, 3.0, 31)
    commands = {"joint01_command": np.clip(times, 0, 1) * 0.4}
    blank = Run.from_arrays(times, {**commands, "link20_z": 0 * times, "link10_z": 0 * times})
    random = np.random.default_rng(1)
    clean = predict(truth, blank)
    noisy = {name: value + 0.01 * random.normal(size=31) for name, value in clean.items()}
    recorded = Run.from_arrays(times, {**commands, **noisy}, noise={"position": 0.01})
    result = fit(
        replace(truth, {"links.mass": 0.045, "air.drag_coefficient": 0.8}),
        recorded,
        free=["links.mass", "air.drag_coefficient"],
        ties={"links.mass": "links.mass[0]"},
        nuisances=False,
    )
    assert result.status == "converged"
    assert list(result.free) == ["links.mass[0]", "air.drag_coefficient"]
    mass = result.derived["links.mass"]
    assert abs(mass.value - 0.06) < 3.5 * mass.standard_error < 0.03
    assert_allclose(result.model.arm.links.mass, np.full(20, mass.value))
    assert result.gradient_check.relative_difference < 1e-4
