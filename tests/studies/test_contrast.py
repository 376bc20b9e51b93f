"""Comparison of results: their data in any order, and their fitted parameters."""

import dataclasses
import re
from pathlib import Path

import pytest

from giajax.fitting import OwnEstimate, load_result
from giajax.report import compare_page
from giajax.studies import contrast

EARLIER = Path(__file__).resolve().parents[1] / "earlier" / "muscle"


@pytest.fixture
def of_two():
    """Return results of two recordings with different noise, in both orders."""
    result = load_result(EARLIER)
    state = {"initial.angle": OwnEstimate(0.0, None)}
    runs = [
        dataclasses.replace(result.runs[0], name=name, sha256=name, parameters=state)
        for name in ("a", "b")
    ]
    about = [{"noise": {"force_N": 0.3}}, {"noise": {"force_N": 0.5}}]
    return [
        dataclasses.replace(
            result,
            runs=tuple(runs[i] for i in order),
            config={**result.config, "runs": [about[i] for i in order]},
        )
        for order in ((0, 1), (1, 0))
    ]


@pytest.mark.quick
def test_recordings_are_the_same_in_another_order(of_two):
    found = contrast(of_two, ["ab", "ba"])
    assert not any("assume" in note or "different data" in note for note in found.notes)
    other = dataclasses.replace(of_two[1], config=of_two[0].config)
    assert any("assumed noise" in note for note in contrast([of_two[0], other], "xy").notes)


@pytest.mark.quick
def test_equal_states_of_two_runs_are_two(of_two):
    column = contrast(of_two, ["ab", "ba"]).columns[0]
    assert column.parameters == len(of_two[0].free) + 2


def test_the_picture_of_a_parameter_has_an_axis_and_no_dot_of_what_is_undetermined(of_two):
    first, second = of_two
    path, estimate = next(
        (path, one) for path, one in first.parameters.items() if one.free and one.standard_error
    )
    lost = dataclasses.replace(estimate, standard_error=None)
    third = dataclasses.replace(second, parameters={**second.parameters, path: lost})
    results, names = [first, second, third], ["a", "b", "c"]
    page = compare_page(contrast(results, names), results).decode()
    (picture,) = re.findall(
        rf'<svg [^>]*aria-label="{re.escape(path)}[,"].*?</svg>', page, re.DOTALL
    )
    assert picture.count("<circle") == 2
    assert picture.count("not determined") == 1
    ticks = [float(text) for text in re.findall(r'text-anchor="middle">([^<]*)<', picture)]
    assert len(ticks) > 1
    value = next(row for row in contrast(results, names).rows if row.path == path)
    reach = 2 * value.estimates[0].standard_error
    low, high = value.estimates[0].value - reach, value.estimates[0].value + reach
    assert all(low - 1e-9 * abs(low) <= tick <= high + 1e-9 * abs(high) for tick in ticks)
