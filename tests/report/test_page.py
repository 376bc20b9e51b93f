"""The page of one result: complete, self-contained, small, and with the numbers of the result."""

import dataclasses
import json
import re

import numpy as np
import pytest

from giajax.fitting import Correlation, Finding, SystematicError
from giajax.recordings import Run
from giajax.report import report_page, sections
from giajax.report.page import (
    _report,
    autocorrelation,
    opening,
    thinned,
)
from giajax.runtime.text import InputError
from giajax.studies import Bootstrap, Influence, LeftOut, repeated
from page_reader import Page, loaded_from_elsewhere

SECTIONS = [
    *("h1", "verdict", "parameters", "suspects", "fitted", "arm", "correlations", "findings"),
    *("noise", "prediction", "course", "summary", "provenance", "again"),
]
HOSTILE = "</script><script>alert(1)</script>&<b>"
MOST_BYTES = 5_000_000


@pytest.fixture(scope="module")
def page(result, run):
    return report_page(result, [run])


def test_it_has_all_sections_and_needs_nothing_else(page):
    parsed = Page(page)
    assert parsed.headings == SECTIONS
    assert len(parsed.programs()) == 1
    assert loaded_from_elsewhere(page) == []
    assert len(page) < MOST_BYTES
    tags = [tag for tag, _ in parsed.tags]
    assert "link" not in tags
    assert "img" not in tags


def test_its_numbers_are_those_of_the_result(page, result):
    stored = json.loads(result.to_json())["parameters"]
    parsed = Page(page)
    exact = [a["data-exact"] for _, a in parsed.tags if "data-exact" in a]
    paths = [a["data-path"] for _, a in parsed.tags if "data-path" in a]
    assert paths == list(result.shown)
    assert [json.loads(number) for number in exact] == [stored[path]["value"] for path in paths]
    for path in result.free:
        (row,) = [row for row in parsed.rows if row[:1] == [path] and len(row) > 4]
        assert float(row[1]) == pytest.approx(stored[path]["value"], rel=0.05)
        assert float(row[2]) == pytest.approx(stored[path]["standard_error"], rel=0.05)
    assert result.verdict.status in parsed.text
    for finding in result.findings:
        assert finding.advice in parsed.text


def test_its_plots_and_its_arm_are_data(page, result, run):
    parsed = Page(page)
    places = [a["data-plot"] for _, a in parsed.tags if "data-plot" in a]
    assert len(places) == len(run.observations) + 1  # the additional plot is the cost
    for place in places:
        assert json.loads(parsed.data(place))["doc"]["roots"]
    scene = json.loads(parsed.data("scene"))
    assert len(scene["lines"]) == 4
    assert len(scene["frames"]) == len(scene["lines"][0]["points"]) == len(run.times)
    # Two links were recorded, except between the 15th and the 20th sample.
    assert len(scene["recorded"]) == 2
    assert scene["recorded"][0][17] == [None] * 3
    tip = np.array(scene["recorded"][1][30]) * scene["step"] + scene["low"]
    assert tip[2] == pytest.approx(run.observations["link04_z"][30], abs=2e-3)


def test_a_hostile_name_is_text(result, run):
    record = dataclasses.replace(result.runs[0], name=HOSTILE)
    finding = Finding("short_record", (), HOSTILE, HOSTILE)
    hostile = dataclasses.replace(
        result, runs=(record,), message=HOSTILE, findings=(finding,), status="not_converged"
    )
    page = report_page(hostile, [dataclasses.replace(run, name=HOSTILE)])
    parsed = Page(page)
    assert len(parsed.programs()) == 1
    assert "b" not in [tag for tag, _ in parsed.tags]
    assert parsed.text.count("alert(1)") > 3


def test_sixty_channels_of_ten_thousand_rows_stay_below_the_limit(result, monkeypatch):
    monkeypatch.setattr(_report, "animation", lambda *_: None)
    draw = np.random.default_rng(0)
    times = np.linspace(0, 100, 10_000)
    names = [f"link{link:02d}_{axis}" for link in range(1, 21) for axis in "xyz"]
    values = {name: draw.normal(size=len(times)) for name in names}
    values["link07_y"][4321] = 50.0
    command = {"joint01_command": np.zeros_like(times)}
    run = Run.from_arrays(times, {**command, **values}, definition={"arm": {"links": 20}})
    like = dataclasses.replace(next(iter(result.runs[0].channels.values())), n=len(times))
    record = dataclasses.replace(result.runs[0], channels=dict.fromkeys(names, like), sha256=None)
    large = dataclasses.replace(
        result,
        runs=(record,),
        correlation=Correlation(),
        predictions=({name: np.zeros(len(times)) for name in names},),
    )
    page = report_page(large, [run])
    assert len(page) < MOST_BYTES
    parsed = Page(page)
    assert "of 10000 samples" in parsed.text
    assert len([1 for _, a in parsed.tags if "data-plot" in a]) == 21


def test_what_limits_the_numbers_is_said_first(result):
    assert opening(result).grade in ("good", "doubtful")
    ended = opening(dataclasses.replace(result, status="not_converged", message="it was stopped"))
    assert ended.grade == "bad"
    assert "it was stopped" in ended.headline
    path = "air.drag_coefficient"
    lost = dataclasses.replace(result.parameters[path], standard_error=None)
    loose = dataclasses.replace(result, parameters={**result.parameters, path: lost})
    assert opening(loose).grade == "doubtful"
    assert any(path in limit and "do not determine" in limit for limit in opening(loose).limits)


def test_what_recordings_and_held_numbers_do_is_in_the_table(result, run):
    path = "air.drag_coefficient"
    known = dataclasses.replace(
        result.free[path], standard_error=0.03, sources={"a": 2.5, "b": None}
    )
    held = SystematicError("links.mass", "kg", 0.05, 0.01, True, dict.fromkeys(result.free, 0.04))
    more = dataclasses.replace(
        result, parameters={**result.parameters, path: known}, systematic=(held,)
    )
    parsed = Page(report_page(more, [run]))
    (row,) = [row for row in parsed.rows if row[:1] == [path] and len(row) > 8]
    assert row[2:5] == ["0.030", "0.04", "0.05"]
    assert "b (alone), a (x2.5)" in row


def test_other_runs_are_refused(result, run):
    with pytest.raises(InputError, match="not those of the result"):
        report_page(result, [run, run])


@pytest.mark.quick
def test_thinning_loses_no_outlier():
    values = np.random.default_rng(1).normal(size=100_000)
    values[[777, 54_321]] = [30.0, -30.0]
    values[2_000:3_000] = np.nan
    kept = thinned([values, -values], 1_000)
    assert len(kept) <= 1_001
    assert {777, 54_321} <= set(kept.tolist())
    assert np.array_equal(thinned([values], 200_000), np.arange(100_000))


@pytest.mark.quick
def test_autocorrelation_of_noise_with_gaps():
    draw = np.random.default_rng(2)
    white = draw.normal(size=4_000)
    white[100:400] = np.nan
    values, band = autocorrelation(white)
    assert band == pytest.approx(1.96 / np.sqrt(3_700))
    assert 0.8 < np.mean(np.abs(values) < band) < 1.0
    walk = np.zeros(4_000)
    for i in range(1, 4_000):
        walk[i] = 0.8 * walk[i - 1] + draw.normal()
    assert autocorrelation(walk)[0][:2] == pytest.approx([0.8, 0.64], abs=0.05)
    assert len(autocorrelation(np.zeros(100))[0]) == 0


def test_repetitions_are_on_the_page_of_their_fit_alone(result, run, tmp_path):
    path = "air.drag_coefficient"
    estimate = result.parameters[path]
    values = estimate.value + estimate.standard_error * np.linspace(-2, 2, 21)
    one = repeated(estimate.value, estimate.standard_error, "", values, [1.0] * 21)
    fitted = {path: estimate.value for path, estimate in result.free.items()}
    found = Bootstrap(
        method="parametric", seed=0, size=22, asked=22, whole=False, came_back=21,
        reasons={"wall": 1}, failures=(), at_bounds={}, parameters={path: one},
        block_lengths={}, noise_factor=1.0, notes=("a note",), fitted=fitted,
    )  # fmt: skip
    source = tmp_path / "result.json"
    source.write_text(result.to_json())
    (tmp_path / "bootstrap.json").write_text(found.to_json())
    shifts = {path: 0.5}
    part = LeftOut("marker", "link04", 72, {path: None}, {path: None}, shifts, {path: 1.25})
    asked = Influence({path: 0.1}, (part,), ("another note",), fitted)
    (tmp_path / "influence.json").write_text(asked.to_json())
    parsed = Page(report_page(result, [run], source=source))
    assert parsed.headings == [*SECTIONS[:7], "repetitions", "influence", *SECTIONS[7:]]
    assert ["link04", "marker", "72", "fit", "-", "+0.50 (1.25)"] in parsed.rows
    assert "21 of 22 fits converged (95.5 %); the others failed: wall 1" in parsed.text
    assert any(row[0] == path and "100.0 % (83.9 .. 100.0)" in row for row in parsed.rows if row)
    assert json.loads(parsed.data("repetitions-0"))["doc"]["roots"]
    # Records of another fit in the same folder are ignored.
    other = dataclasses.replace(found, fitted={**fitted, path: 7.0})
    (tmp_path / "bootstrap.json").write_text(other.to_json())
    assert [section.id for section in sections(result, source)] == ["influence"]
    # A damaged record is reported in its place.
    odd = dataclasses.replace(asked, parts=(dataclasses.replace(part, exact_widening={}),))
    for text, why in (
        (
            "{",
            r"this is not a valid influence\.json file of this version of giajax "
            r"\(it is not JSON\)",
        ),
        (odd.to_json(), "its numbers are inconsistent"),
    ):
        (tmp_path / "influence.json").write_text(text)
        (section,) = sections(result, source)
        assert (section.id, len(section.warnings)) == ("influence", 1)
        assert re.match(
            rf"influence\.json is damaged: {why}: run 'giajax influence'", section.warnings[0]
        )
    assert "influence.json is damaged" in Page(report_page(result, [run], source=source)).text
    (tmp_path / "influence.json").write_text(asked.to_json())
    assert sections(dataclasses.replace(result, parameters={}), source) == []
