"""What results side by side are compared by: their data in any order, and what they fitted."""

import dataclasses
from pathlib import Path

import pytest

from giajax.fitting import OwnEstimate, load_result
from giajax.studies import contrast

EARLIER = Path(__file__).resolve().parents[1] / "earlier" / "muscle"


@pytest.fixture
def of_two():
    """A result as of two recordings of other noise, in both orders."""
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
    assert any("another noise" in note for note in contrast([of_two[0], other], "xy").notes)


@pytest.mark.quick
def test_equal_states_of_two_runs_are_two(of_two):
    column = contrast(of_two, ["ab", "ba"]).columns[0]
    assert column.parameters == len(of_two[0].free) + 2
