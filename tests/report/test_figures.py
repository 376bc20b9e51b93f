"""Figures: their content, that they are not blank, and that no global state changes."""

import dataclasses
import pickle
import struct
import subprocess
import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import jax
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from giajax import InputError
from giajax.fitting import ChannelFit, Correlation, RunFit, parse_result
from giajax.models import model_for
from giajax.recordings import Run, write_files
from giajax.report import (
    correlation_figure,
    new_figure,
    plot,
    recorded_figure,
    residuals_figure,
    to_png,
)
from giajax.runtime.pictures import pictures_as

PNG = b"\x89PNG\r\n\x1a\n"


def ink(figure):
    """Return the fraction of pixels that are not white."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return float(np.mean(np.asarray(canvas.buffer_rgba())[..., :3].min(axis=-1) < 200))


def panels(figure):
    return [axes for axes in figure.axes if axes.get_visible()]


def many(links, components="xyz", samples=30):
    """Return a run with all components of many links, its prediction, and its record."""
    times = np.linspace(0, 3, samples)
    values = {"joint01_command": np.zeros(samples)}
    for link in range(1, links + 1):
        for component in components:
            values[f"link{link:02d}_{component}"] = np.sin(times + link)
    run = Run.from_arrays(times, values, definition={"arm": {"links": links}})
    predicted = {name: array * 0.9 for name, array in run.observations.items()}
    channels = {name: ChannelFit("m", rmse=0.1, n=samples, noise=0.05) for name in predicted}
    record = RunFit("many", None, None, channels)
    return run, predicted, record


def test_one_panel_a_channel_in_the_units_of_the_file(result, run):
    figure = recorded_figure(result, run, result.predictions[0], result.runs[0])
    titles = [axes.get_title(loc="left") for axes in panels(figure)]
    assert titles == ["link02_y (m)", "link04_y (m)", "link04_z (m)"]
    dots, line = panels(figure)[2].lines
    assert np.array_equal(dots.get_ydata(), run.observations["link04_z"], equal_nan=True)
    assert np.array_equal(line.get_ydata(), result.predictions[0]["link04_z"])
    assert np.isnan(dots.get_ydata()).sum() == 5  # a gap is not drawn
    assert ink(figure) > 0.01


def test_a_fit_is_drawn_from_its_result_and_its_run(result, run):
    for figure in (plot(result, run), result.plot(run), result.plot(), parsed(result).plot()):
        (_, _, panel) = panels(figure)
        np.testing.assert_allclose(panel.lines[1].get_ydata(), result.predictions[0]["link04_z"])
    with pytest.raises(InputError, match=r"its data have changed since the fit.*predict"):
        plot(result, dataclasses.replace(run, name="another"))
    twice = dataclasses.replace(result, runs=result.runs * 2)
    with pytest.raises(InputError, match="several fitted runs have this name"):
        plot(twice, run)
    with pytest.raises(InputError, match="2 runs were fitted: specify which"):
        twice.plot()
    unfiled = dataclasses.replace(result.runs[0], path=None, sha256=None)
    with pytest.raises(InputError, match=r"was made in memory .* result\.plot\(run\)"):
        dataclasses.replace(parsed(result), runs=(unfiled,)).plot()


def parsed(result):
    """Return the result as it is loaded, without predictions."""
    return parse_result(result.to_json(), result.model)


def test_a_prediction_is_drawn_over_what_was_recorded(result, run):
    """This includes a run that was not fitted, and a channel that was not recorded."""
    other = dataclasses.replace(run, name="another")
    figure = result.predict(other, ["link04_z", "tip_x"]).plot()
    both, alone = panels(figure)
    assert figure.get_suptitle() == "another: recorded and predicted"
    predicted = result.predict(other, ["link04_z", "tip_x"])
    assert np.array_equal(both.lines[0].get_ydata(), run.observations["link04_z"], equal_nan=True)
    assert np.array_equal(both.lines[1].get_ydata(), predicted["link04_z"])
    assert np.isnan(alone.lines[0].get_ydata()).all()
    assert np.array_equal(alone.lines[1].get_ydata(), predicted["tip_x"])
    # It is a JAX tree of arrays, like a dict.
    assert type(twice := jax.tree.map(lambda values: 2 * values, predicted)) is dict
    assert np.array_equal(twice["tip_x"], 2 * predicted["tip_x"])
    assert (both.get_title(loc="right")[:4], alone.get_title(loc="right")) == ("RMSE", "")

    plain = result.predict(other, ["tip_x", "tip_y", "tip_z"]).plot()
    assert plain.get_suptitle() == "another: predicted"
    assert [text.get_text() for text in plain.legends[0].get_texts()] == ["predicted"]
    with pytest.raises(InputError, match="no channel of the run another is predicted"):
        result.predict(other, []).plot()


def test_a_prediction_stays_one_between_processes(result, run):
    predicted = result.predict(run)
    again = pickle.loads(pickle.dumps(predicted))
    assert again.run.name == run.name
    assert again.keys() == predicted.keys() == run.observations.keys()


def test_a_result_is_a_frame(result):
    rows = {row["parameter"]: row for row in result.to_frame().iter_rows(named=True)}
    assert set(rows) >= set(result.free)
    for path, estimate in result.free.items():
        assert rows[path]["value"] == estimate.value
        assert rows[path]["unit"] == estimate.unit
        assert rows[path]["standard_error"] == estimate.standard_error
        assert (rows[path]["low"], rows[path]["high"]) == (estimate.interval or (None, None))


def test_units_of_the_file_are_those_of_the_axis(result):
    angles = {"joint01_command": np.zeros(3), "joint01_angle": np.array([0.0, 0.1, 0.2])}
    run = Run.from_arrays([0.0, 1.0, 2.0], angles)
    channel = dataclasses.replace(run.channels["joint01_angle"], unit="deg")
    run = dataclasses.replace(run, channels={**run.channels, "joint01_angle": channel})
    channels = {"joint01_angle": ChannelFit("deg", rmse=0.0, n=3, noise=1.0)}
    record = RunFit("angles", None, None, channels)
    figure = recorded_figure(result, run, {"joint01_angle": angles["joint01_angle"]}, record)
    (axes,) = panels(figure)
    assert axes.get_title(loc="left") == "joint01_angle (deg)"
    assert axes.lines[0].get_ydata()[1] == pytest.approx(np.rad2deg(0.1))


def drawn(run):
    """Return the panels of a run as its model draws it, with arbitrary values as the prediction."""
    model = model_for([run])
    channels = {
        name: ChannelFit(run.channels[name].unit, rmse=0.1, n=3, noise=1.0)
        for name in run.observations
    }
    record = RunFit(run.name, None, None, channels)
    result = SimpleNamespace(model=model, status="converged")
    predicted = {name: np.zeros_like(values) for name, values in run.observations.items()}
    return panels(recorded_figure(result, run, predicted, record))


def test_a_loop_is_drawn_over_its_input():
    command = np.deg2rad([0.0, 50.0, -50.0, 0.0])
    values = {"command": command, "angle": 0.8 * command}
    run = Run.from_arrays(np.arange(4.0), values, definition={"model": "hysteresis"})
    (axes,) = drawn(run)
    assert axes.get_xlabel() == "command (rad)"
    assert all(np.array_equal(line.get_xdata(), command) for line in axes.lines)
    oscillator = {"model": "oscillator"}
    (axes,) = drawn(Run.from_arrays(np.arange(4.0), values, definition=oscillator))
    assert axes.get_xlabel() == "time (s)"


def test_sweeps_of_a_joint_are_not_joined():
    """The angles go from 0 to 60 deg twice, and the return is not a motion."""
    angles = np.deg2rad(np.tile(np.linspace(0.0, 60.0, 61), 2))
    values = {"angle": angles, "side": np.repeat("inner", 122), "force": np.ones(122)}
    (axes,) = drawn(Run.from_arrays(None, values, definition={"model": "joint"}))
    assert axes.get_xlabel() == "angle (rad)"
    dots, line = axes.lines
    assert np.array_equal(dots.get_xdata(), angles)
    # There is a gap between the sweeps, and no sample is lost.
    assert list(np.flatnonzero(np.isnan(line.get_xdata()))) == [61]
    assert list(np.flatnonzero(np.isnan(line.get_ydata()))) == [61]
    assert len(line.get_xdata()) == 123


def test_what_does_not_vary_is_not_drawn_over():
    turn = np.linspace(0.1, 0.3, 5)
    values = {"angle": np.full(5, 0.4), "side": np.repeat("inner", 5), "torque": turn}
    still = Run.from_arrays(None, {**values, "force": np.ones(5)}, definition={"model": "joint"})
    (axes,) = drawn(still)
    assert axes.get_xlabel() == "sample"
    isometric = {"contraction": np.full(5, 0.1), "pressure": 1e6 * turn, "force": np.ones(5)}
    (axes,) = drawn(Run.from_arrays(None, isometric, definition={"model": "muscle"}))
    assert axes.get_xlabel() == "pressure (kPa)"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("links", "components", "count"), [(1, "z", 1), (8, "xyz", 24), (20, "xyz", 20), (60, "z", 24)]
)
def test_there_are_never_too_many_panels(result, links, components, count):
    run, predicted, record = many(links, components)
    figure = recorded_figure(result, run, predicted, record)
    assert len(panels(figure)) == count
    left_out = links * len(components) - sum(len(axes.lines) // 2 for axes in panels(figure))
    assert (f"{left_out} more channels" in figure.get_suptitle()) == (left_out > 0)
    # Every column of panels has a time axis at its bottom.
    columns = panels(figure)[0].get_gridspec().ncols
    assert sum(axes.get_xlabel() == "time (s)" for axes in panels(figure)) == columns
    assert ink(figure) > 0.01


def test_residuals_are_in_units_of_the_noise(result, run):
    figure = residuals_figure(result, [run], result.predictions)
    over_time, distribution, by_channel = figure.axes
    values = over_time.lines[0].get_ydata()
    assert 0.8 < np.nanstd(values) < 1.2
    assert distribution.patches
    assert [label.get_text() for label in by_channel.get_xticklabels()] == list(run.observations)
    assert ink(figure) > 0.01


def test_residuals_of_many_runs_and_of_a_bad_fit(result):
    run, predicted, record = many(20)
    quiet = {n: dataclasses.replace(c, noise=1e-3) for n, c in record.channels.items()}
    record = dataclasses.replace(record, channels=quiet)
    bad = dataclasses.replace(result, status="not_converged", runs=(record,) * 8)
    figure = residuals_figure(bad, [run] * 8, [predicted] * 8)
    assert "first 6 of 8 runs" in figure.get_suptitle()
    assert "not converged" in figure.get_suptitle()
    assert "beyond 8" in "".join(t.get_text() for axes in figure.axes for t in axes.texts)
    assert ink(figure) > 0.01


def test_the_correlations_are_written_into_the_cells(result):
    figure = correlation_figure(result)
    axes = figure.axes[0]
    matrix = np.array(result.correlation.matrix)
    assert len(axes.texts) == 6
    shown = float(axes.texts[0].get_text().replace("\N{MINUS SIGN}", "-"))
    assert shown == pytest.approx(matrix[1, 0], abs=0.006)
    assert ink(figure) > 0.01


@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_correlations_of_any_number_of_parameters(result, count):
    matrix = np.where(np.eye(count, dtype=bool), 1.0, -0.9985).tolist()
    paths = tuple(f"links.mass[{i}]" for i in range(count))
    correlation = Correlation(paths, tuple(map(tuple, matrix)))
    figure = correlation_figure(dataclasses.replace(result, correlation=correlation))
    text = [item.get_text() for item in figure.axes[0].texts]
    wanted = {0: ["no parameter is determined"], 2: ["\N{MINUS SIGN}0.999"]}
    assert text == wanted.get(count, [])
    assert to_png(figure).startswith(PNG)


def test_a_figure_is_the_same_file_each_time(result):
    first, second = to_png(correlation_figure(result)), to_png(correlation_figure(result))
    assert first == second
    assert b"giajax" in first[:200]


@pytest.mark.quick
@pytest.mark.parametrize("dpi", [65, 260])
def test_a_figure_is_the_same_file_each_time_in_all_formats(dpi):
    def drawn():
        figure = new_figure(4, 3, "A parabola", "The squares of 0 to 3.")
        figure.subplots().plot([0, 1, 4, 9])
        with pictures_as(["pdf", "svg", "png"], dpi):
            return to_png(figure), figure

    (first, figure), (second, _) = drawn(), drawn()
    assert (first, first.others) == (second, second.others)
    assert list(first.others) == ["svg", "pdf", "caption.txt"]
    caption = "A parabola. The squares of 0 to 3."
    assert first.others["caption.txt"].decode().splitlines()[0] == caption
    assert caption.encode() in first
    assert caption.encode() in first.others["svg"]
    assert b"/Subject (A parabola. The squares of 0 to 3.)" in first.others["pdf"]
    svg, pdf = first.others["svg"], first.others["pdf"]
    assert (b"date" in svg.lower(), b"CreationDate" in pdf) == (False, False)
    texts = [each.text for each in ElementTree.fromstring(svg).iterfind(".//{*}text")]
    assert "A parabola" in texts
    assert struct.unpack(">II", first[16:24]) == (4 * dpi, 3 * dpi)
    with pictures_as(["png"]):
        assert list(to_png(figure).others) == ["caption.txt"]
    with pictures_as([], dpi):
        assert list(to_png(figure).others) == ["caption.txt"]
    # The selection of formats has ended.
    assert to_png(figure).others == {}


@pytest.mark.quick
def test_a_picture_that_is_written_over_leaves_no_other_format_of_what_was(tmp_path):
    figure = new_figure(2, 2, "the first", "Nothing is drawn in it.")
    figure.subplots()
    path, own = tmp_path / "a.png", tmp_path / "b.svg"
    own.write_text("<svg>drawn by a person</svg>")
    notes = tmp_path / "c.caption.txt"
    notes.write_text("giajax fit --data run.csv: Drawn by giajax.\nnotes of a person\n")
    with pictures_as(["svg", "pdf"]):
        write_files({path: to_png(figure)}, force=False)
    assert path.with_suffix(".svg").exists()
    caption = path.with_suffix(".caption.txt")
    assert caption.exists()
    with pictures_as(["pdf"]):
        write_files({path: to_png(figure), tmp_path / "b.png": to_png(figure)}, force=True)
    assert not path.with_suffix(".svg").exists()
    assert path.with_suffix(".pdf").exists()
    assert caption.exists()
    assert own.exists()
    write_files({path: to_png(figure), tmp_path / "c.png": to_png(figure)}, force=True)
    assert not caption.exists()
    assert notes.exists()


@pytest.mark.quick
def test_a_figure_in_a_format_that_there_is_not():
    sentence = "--format is 'gif': give png, svg or pdf"
    with pytest.raises(InputError, match=sentence), pictures_as(["svg", "gif"]):
        pass


def test_a_fit_without_figures_does_not_import_matplotlib():
    code = (
        "import sys\n"
        "from giajax.report import PAGE, check_figures, check_folder, check_page, report_page\n"
        "from giajax.report import parameter_table, reached, summary, write_figures, write_result\n"
        "sys.exit('matplotlib' if 'matplotlib' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)


@pytest.mark.slow
def test_nothing_global_of_matplotlib_is_touched(result, run):
    before = dict(mpl.rcParams)
    to_png(residuals_figure(result, [run], result.predictions))
    assert dict(mpl.rcParams) == before
    code = (
        "import sys, giajax.report; sys.exit('pyplot' if 'matplotlib.pyplot' in sys.modules else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)
