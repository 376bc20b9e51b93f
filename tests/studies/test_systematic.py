"""Systematic errors compared with refits for a changed fixed value."""

import json

import numpy as np
import pytest
from curves import curve, recorded
from test_suspects import fitted

from giajax import InputError, fit, systematic_errors
from giajax.studies import deciding_conditions, together, with_suspects, with_systematic_errors


def moved(recording, path, change, **options):
    """Return the shift of each fitted parameter due to a change of a fixed one, by refits."""
    values = {path: np.asarray(getattr(curve(), path.partition("[")[0]), dtype=float)}
    ends = []
    for sign in (-1, 1):
        fix = {path: (values[path] + sign * change).tolist()}
        result = fit(
            curve(), recording, free=["amplitude", "decay"],
            start={"amplitude": 1.5, "decay": 0.9}, fix=fix,
            check=False, noise_model="white", **options,
        )  # fmt: skip
        ends.append({name: one.value for name, one in result.free.items()})
    return {name: (ends[1][name] - ends[0][name]) / 2 for name in ends[0]}


@pytest.mark.parametrize(
    ("loss", "paths"),
    # For 1 % of `twin`, two deviations of the noise, a robust loss is not quadratic.
    [("linear", ["offset", "twin"]), ("soft_l1", ["offset"])],
)
def test_one_percent_of_a_held_number_against_refits(loss, paths):
    recording = recorded()
    errors = {one.path: one for one in systematic_errors(fitted(recording, loss=loss), recording)}
    for path in paths:
        one = errors[path]
        assert one.uncertainty == pytest.approx(0.01 * one.value)
        assert not one.stated
        for name, shift in moved(recording, path, one.uncertainty, loss=loss).items():
            assert one.shifts[name] == pytest.approx(shift, rel=0.05), (path, name)


def test_a_stated_uncertainty_adds_in_quadrature():
    recording = recorded()
    result = fitted(recording)
    errors = systematic_errors(result, recording, {"offset": 0.02, "shift": [0.01, 0.02, 0.03]})
    stated = [one for one in errors if one.stated]
    assert [one.path for one in errors[: len(stated)]] == [one.path for one in stated]
    by_path = {one.path: one for one in stated}
    assert set(by_path) == {"offset", "shift[0]", "shift[1]", "shift[2]"}
    for name, shift in moved(recording, "offset", 0.02).items():
        assert by_path["offset"].shifts[name] == pytest.approx(shift, rel=0.05)
    # The offset acts on z, like the third element of the shift.
    decay = {path: one.shifts["decay"] for path, one in by_path.items()}
    assert decay["shift[2]"] == pytest.approx(1.5 * decay["offset"], rel=1e-6)
    total = np.sqrt(sum(shift**2 for shift in decay.values()))
    assert together(errors)["decay"] == pytest.approx(total, rel=1e-9)
    assert "offset" not in {one.path for one in errors if not one.stated}


def test_a_number_for_an_array_moves_its_elements_together():
    recording = recorded()
    (one, *_) = systematic_errors(fitted(recording), recording, {"weights": 0.02})
    assert (one.path, one.uncertainty, one.value) == ("weights", 0.02, 1.0)
    assert one.shifts == pytest.approx({"amplitude": 0, "decay": 0}, abs=1e-9)


def test_what_decides_is_a_condition():
    recording = recorded(noise=True)
    result = fitted(recording)
    asked = with_systematic_errors(result, recording, {"offset": 0.05})
    sentence = (
        "offset: is held fixed, and a change of this value by 0.05 m shifts "
        "amplitude, decay by more than one standard error"
    )
    assert sentence in asked.conditions
    assert sentence in deciding_conditions(asked.systematic)
    assert asked.config["uncertainty"] == {"offset": 0.05}
    # If it is tested again with the same uncertainty, no sentence is repeated.
    again = with_suspects(asked, recording)
    assert again.conditions == asked.conditions
    assert json.loads(again.to_json())["systematic"][0]["decides"] == ["amplitude", "decay"]


@pytest.mark.parametrize(
    ("uncertainty", "words"),
    [
        ({"decay": 0.1}, r"decay is fitted.*: hold decay fixed, or omit the uncertainty given"),
        ({"offset": -1.0}, r"the uncertainty of offset is not positive: give"),
        ({"offset": [1.0, 2.0]}, r"has 2 values, but the parameter has 1 element: give"),
        ({"offsat": 1.0}, r"there is no parameter 'offsat': did you mean 'offset'"),
    ],
)
def test_bad_input(uncertainty, words):
    recording = recorded()
    with pytest.raises(InputError, match=words):
        systematic_errors(fitted(recording), recording, uncertainty)
