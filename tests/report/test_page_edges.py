"""Pages of unusual results: missing parts, non-finite values, or a single run."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from giajax.fitting import Correlation, GradientCheck, OwnEstimate, load_result
from giajax.models import ArmModel
from giajax.noise import Verdict
from giajax.recordings import Definition
from giajax.report import check_page, report_page
from giajax.report.page import _report, animation, correlation_cells, opening, some_of
from giajax.runtime.text import InputError
from giajax.simulation import SimulationError
from giajax.studies import with_fitted_states
from page_reader import Page

EARLIER = Path(__file__).resolve().parents[1] / "earlier"


def test_a_recording_without_a_sidecar(result, run, monkeypatch):
    monkeypatch.setattr(_report, "animation", lambda *_: None)
    alone = dataclasses.replace(result, task={"inputs": {"a.csv": "1f", "a.toml": None}})
    rows = Page(report_page(alone, [run])).rows
    assert ["a.csv", "1f"] in rows
    assert ["a.toml", "file did not exist"] in rows


def test_a_fitted_initial_state_is_where_the_page_begins(result, run, monkeypatch):
    """A page made after loading equals the page of the fit itself."""
    definition = Definition.parse({**run.definition.contents(), "initial": {"free": True}}, "")
    free = dataclasses.replace(run, definition=definition)
    state = {"initial.angle[0]": OwnEstimate(0.2, 0.01), "initial.rate[1]": OwnEstimate(-0.3, 0.1)}
    record = dataclasses.replace(result.runs[0], parameters=state)
    loaded = dataclasses.replace(result, runs=(record,), predictions=())
    (begun,) = with_fitted_states(loaded, [free])
    predicted = loaded.predict(begun)
    assert max(np.max(np.abs(predicted[n] - loaded.predict(free)[n])) for n in predicted) > 0.05

    drawn = []
    panel = _report.panel

    def watched(names, run, predicted, record, **more):
        drawn.append((predicted, more["bands"]))
        return panel(names, run, predicted, record, **more)

    monkeypatch.setattr(_report, "panel", watched)
    scenes = [
        Page(report_page(each, [free])).data("scene")
        for each in (dataclasses.replace(loaded, predictions=(predicted,)), loaded)
    ]
    assert scenes[0] == scenes[1]
    (after_the_fit, bands), (after_loading, again) = drawn[0], drawn[-1]
    for name in predicted:
        assert np.array_equal(after_the_fit[name], after_loading[name])
        assert np.array_equal(bands[name], again[name])
        # At the start, only the initial state has an effect, not the parameters.
        assert bands[name][0] < 1e-9 < bands[name].max()


def test_a_model_that_cannot_be_simulated_is_not_seen(result, run, monkeypatch):
    def fails(*_):
        raise SimulationError("the step size vanished")

    monkeypatch.setattr(ArmModel, "scene", fails)
    assert animation(result, run, {}) is None


def test_a_correlation_that_is_not_finite_is_not_known(result):
    nan = Correlation(("a", "b"), ((1.0, np.nan), (np.nan, 1.0)))
    odd = dataclasses.replace(result, correlation=nan)
    assert correlation_cells(odd)[1][0].text == "?"


def test_wrong_derivatives_are_no_reason_to_trust():
    result = dataclasses.replace(load_result(EARLIER / "muscle"), verdict=Verdict("adequate"))
    assert opening(result).grade == "good"
    wrong = dataclasses.replace(result, gradient_check=GradientCheck(0.3, {}, 1e-4))
    assert opening(wrong).grade == "doubtful"
    assert any("derivatives of the model disagree" in limit for limit in opening(wrong).limits)


def test_what_is_known_worst_is_in_the_units_of_the_columns():
    result = load_result(EARLIER / "hysteresis")
    free = {
        path: dataclasses.replace(one, standard_error=abs(one.value))
        for path, one in result.free.items()
    }
    vague = dataclasses.replace(result, parameters={**result.parameters, **free})
    (worst,) = [
        limit for limit in opening(vague).limits if "has the largest relative error" in limit
    ]
    assert "output" not in worst
    assert "input" not in worst


@pytest.mark.quick
def test_a_page_where_a_folder_is_is_refused_also_with_force(tmp_path):
    (tmp_path / "report.html").mkdir()
    for force in (False, True):
        with pytest.raises(InputError, match="is a folder"):
            check_page(tmp_path / "report.html", force=force)


@pytest.mark.quick
def test_a_title_has_few_names():
    assert some_of("abab") == ["a", "b"]
    assert some_of("abcde") == ["a", "b", "c", "and 2 more"]
