"""Table 3 and fig. 19 computed from known predictions, and the runs that they need."""

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest

from giajax import InputError, Run
from giajax.apps.paper import (
    CONTENDERS,
    HEIGHTS,
    PRINTED,
    Fits,
    _contenders,
    fig19,
    reproduced_files,
    stand_in,
    table3,
)

pytestmark = pytest.mark.quick

TIMES = np.linspace(0.0, 25.0, 251)
# Relative error of each contender (all are too large).
OFF = {"with_air": 0.25, "without_air": 3.0, "refitted": 1.0, "own": 0.0}


class KnownFits(Fits):
    """Each contender has a relative error that is proportional to the number of the run."""

    def predicted(self, name, run):
        number = int(run.name[-1])
        # The error of the last link is twice as large, so no two cells of a row are equal.
        off = dict.fromkeys(HEIGHTS, OFF[name] * number) | {HEIGHTS[-1]: 2 * OFF[name] * number}
        return {z: (1 + off[z]) * run.values[z] for z in HEIGHTS}


@pytest.fixture
def fits():
    heights = {z: np.cos(TIMES + place) + 2 for place, z in enumerate(HEIGHTS)}
    command = {"joint01_command": np.minimum(TIMES, 0.5)}
    runs = [Run.from_arrays(TIMES, {**command, **heights}, name=f"run{n}") for n in (1, 2, 3, 4)]
    return KnownFits(runs, print)


def test_the_table_has_medians_and_ranges(fits):
    shown = table3(fits)
    assert shown.headings == (
        "model", "measure, %", "link 2", "link 6", "link 12", "link 20", "average",
    )  # fmt: skip
    printed, without, *rows = shown.rows
    assert printed[2:] == ("77", "94", "51", "62", "71")
    assert without[2:] == ("78", "32", "-99", "-190", "-45")
    cells = {(row[0], row[1]): row[2:] for row in rows}
    labels = {name: contender.label for name, contender in CONTENDERS.items()}
    shown = (*("50 (25 .. 75)",) * 3, "0 (-50 .. 50)", "38 (6 .. 69)")
    assert cells[labels["with_air"], "concordance"] == shown
    shown = (*("-500 (-800 .. -200)",) * 3, "-1100 (-1700 .. -500)", "-650 (-1025 .. -275)")
    assert cells[labels["without_air"], "concordance"] == shown
    assert cells[labels["own"], "concordance"] == ("100 (100 .. 100)",) * 5
    shown = (*("200 (100 .. 300)",) * 3, "400 (200 .. 600)", "250 (125 .. 375)")
    assert cells[labels["refitted"], "RMS error"] == shown


def test_the_paper_s_averages_are_those_of_its_cells():
    for *cells, average in PRINTED.values():
        assert round(np.mean(cells) + 1e-9) == average


def test_its_numbers_are_written(fits):
    files = reproduced_files("table3", table3(fits))
    rows = list(csv.DictReader(io.StringIO(files["table3.csv"].decode())))
    assert len(rows) == 3 * 4 * len(CONTENDERS)
    own = [row for row in rows if row["model"] == "own"]
    assert {(row["concordance"], row["rms_error"]) for row in own} == {("1", "0")}


def test_fig_19_shows_the_first_run(fits):
    shown = fig19(fits)
    assert [row[0] for row in shown.rows] == [2, 6, 12, 20]
    assert [row[1:3] for row in shown.rows] == [("75", "25")] * 3 + [("50", "50")]
    np.testing.assert_array_equal(
        shown.columns["link06_z_recorded_m"], fits.runs[0].values["link06_z"]
    )


@pytest.fixture
def faked(monkeypatch):
    """Replace the fits by known values, and record which model is fitted to which run."""

    def fake(**names):
        model = {"takeichi_20m": lambda *_, **__: None, "ArmModel": lambda _: None}
        for name, value in {**model, **names}.items():
            monkeypatch.setattr(_contenders, name, value)

    return fake


def test_a_model_is_fitted_to_another_run_than_it_is_compared_with(fits, faked):
    used, done = [], SimpleNamespace(status="converged")
    faked(fit=lambda model, run, **_: used.append(run.name) or done)
    for name in ("own", "with_air", "without_air", "own"):
        for run in fits.runs[:2]:
            Fits.result(fits, name, run)
    # The paper's model is used once for each run, with air and without it.
    assert used == ["run4", "run1", "run2"]


def test_without_air_is_the_fitted_model_without_its_drag(fits, faked):
    run, asked = fits.runs[0], []
    done = SimpleNamespace(model="fitted", status="converged")
    faked(
        fit=lambda *_, **__: done,
        replace=lambda model, values: (model, dict(values)),
        predict=lambda model, _: asked.append(model) or run.values,
    )
    for name in ("with_air", "without_air"):
        Fits.predicted(fits, name, run)
    assert asked == [("fitted", {}), ("fitted", {"air.drag_coefficient": 0.0})]


def test_no_table_is_made_of_a_fit_that_was_stopped(fits, faked):
    stopped = SimpleNamespace(status="interrupted")
    faked(fit=lambda *_, **__: stopped)
    with pytest.raises(KeyboardInterrupt):
        Fits.result(fits, "with_air", fits.runs[0])


def test_a_folder_without_the_runs_is_refused(tmp_path):
    with pytest.raises(InputError, match="does not contain the runs"):
        stand_in(tmp_path)
