"""The folder of a result: complete, readable, and never written over other files."""

import dataclasses
import json
import os
import shutil

import numpy as np
import pytest

from giajax.fitting import fit, load_result, set_up
from giajax.models import model_for
from giajax.recordings import Run, read_run
from giajax.report import _files, check_folder, write_figures, write_result
from giajax.runtime.pictures import pictures_as
from giajax.runtime.text import InputError
from giajax.schema import InitialSection
from small_arm import START, make_run, small_run

NAMES = [
    "result.json",
    "prediction.csv",
    "prediction.toml",
    "recorded.png",
    "residuals.png",
    "correlation.png",
]


@pytest.fixture(scope="module")
def whole(result, run, tmp_path_factory):
    """Write the folder of a result with its figures, and return the reported file names."""
    folder = tmp_path_factory.mktemp("whole") / "some" / "where"
    return folder, write_result(result, run, folder)


@pytest.fixture(scope="module")
def config(run):
    return set_up(model_for([run]), [run], start=START).config


def test_what_is_written(result, whole):
    folder, files = whole
    assert [path.name for path in files] == NAMES
    assert sorted(os.listdir(folder)) == sorted(NAMES)  # without temporary files
    assert (folder / "result.json").read_text() == result.to_json()
    for name in NAMES[3:]:
        assert (folder / name).stat().st_size > 5_000


def test_the_prediction_is_a_run_with_the_columns_of_the_recording(result, run, tmp_path):
    write_result(result, run, tmp_path, figures=False)
    predicted = read_run(tmp_path / "prediction.csv")
    recorded = (run.path.read_text(), (tmp_path / "prediction.csv").read_text())
    assert recorded[0].splitlines()[0] == recorded[1].splitlines()[0]
    assert np.array_equal(predicted.times, run.times)
    assert np.allclose(predicted.commands["joint01_command"], run.commands["joint01_command"])
    for name, values in load_result(tmp_path).predict(run).items():
        assert np.allclose(predicted.observations[name], values, rtol=1e-8, atol=1e-12)
    # The prediction also has values where nothing was measured.
    assert not np.isnan(predicted.observations["link04_z"]).any()
    assert predicted.definition.arm.links == 4


@pytest.mark.slow
def test_a_free_motion_and_its_initial_state_are_in_the_prediction(result, tmp_path):
    times = np.linspace(0, 1, 5)
    definition = {"arm": {"links": 4}, "initial": {"angle_deg": [10.0, 0, 0, 0]}}
    swing = Run.from_arrays(times, {"link04_z": np.zeros(5)}, definition=definition)
    free = fit(model_for([swing]), swing, free=["joints.damping"], max_iterations=1, check=False)
    write_result(free, swing, tmp_path, figures=False)
    predicted = read_run(tmp_path / "prediction.csv")
    assert predicted.definition.section(InitialSection).angle_deg == [10.0, 0, 0, 0]
    again = load_result(tmp_path).predict(predicted)["link04_z"]
    assert np.allclose(again, predicted.observations["link04_z"], rtol=1e-8, atol=1e-12)


@pytest.mark.slow
def test_several_runs_are_in_one_file_and_have_a_figure_each(tmp_path):
    (tmp_path / "a").mkdir()
    first = small_run(tmp_path, channels=("link02_y", "link04_z"))
    other = small_run(tmp_path / "a", seed=1, channels=("link04_z",), units={"length": "cm"})
    runs = [first, other]
    both = fit(model_for(runs), runs, start=START, max_iterations=1, check=False)
    folder = tmp_path / "out"
    files = [path.name for path in write_result(both, runs, folder)]
    # Two runs of the same name get different file names.
    assert files == [
        "result.json", "prediction.csv", "recorded_run.png", "recorded_run_2.png",
        "residuals.png", "correlation.png",
    ]  # fmt: skip
    lines = (folder / "prediction.csv").read_text().splitlines()
    head = "run,time_s,joint01_command_deg,joint02_command_deg,link02_y_m,link04_z_m,link04_z_cm"
    assert lines[0] == head
    assert len(lines) == 1 + 41 + 41
    assert lines[-1].split(",")[0] == "run_2"
    assert lines[-1].split(",")[4:6] == ["", ""]
    assert float(lines[-1].split(",")[6]) == pytest.approx(
        both.predictions[1]["link04_z"][-1] * 100
    )


def test_stale_figures_go_and_a_persons_own_stay(result, run, whole, tmp_path):
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    (tmp_path / "recorded.png").rename(tmp_path / "recorded_old.png")
    (tmp_path / "recorded_mine.png").write_bytes(b"\x89PNG mine")
    (tmp_path / "recorded_mine.svg").write_text("<svg>mine</svg>")
    (tmp_path / "notes.txt").write_text("mine")
    with pictures_as(["svg", "pdf"]):
        write_figures(result, run, tmp_path)
    assert {path.name for path in tmp_path.glob("r*.[sp][vd][gf]")} == {
        *(f"{name}.{each}" for name in ("recorded", "residuals") for each in ("svg", "pdf")),
        "recorded_mine.svg",
    }
    write_result(result, run, tmp_path)
    (tmp_path / "recorded_mine.svg").unlink()
    assert sorted(os.listdir(tmp_path)) == sorted([*NAMES, "recorded_mine.png", "notes.txt"])


def test_figures_are_drawn_later_or_not_at_all(result, run, whole, tmp_path):
    files = write_result(result, run, tmp_path / "parts", figures=False)
    assert [path.name for path in files] == ["result.json", "prediction.csv", "prediction.toml"]
    assert sorted(os.listdir(tmp_path / "parts")) == sorted(path.name for path in files)
    write_figures(result, run, tmp_path / "parts")
    for name in NAMES:
        assert (tmp_path / "parts" / name).read_bytes() == (whole[0] / name).read_bytes()


def test_a_disk_that_fills_up_keeps_the_result(result, run, tmp_path, monkeypatch):
    """The numbers are written first, so a full disk loses only large files and figures."""
    write = _files.write_files

    def fill_up(contents, *, force):
        if any(path.suffix == ".csv" for path in contents):
            raise InputError("no space left")
        write(contents, force=force)

    monkeypatch.setattr(_files, "write_files", fill_up)
    with pytest.raises(InputError, match="no space left"):
        write_result(result, run, tmp_path)
    assert load_result(tmp_path).to_json() == result.to_json()


def test_a_loaded_result_writes_the_same_files(result, run, tmp_path):
    write_result(result, run, tmp_path / "a", figures=False)
    write_result(load_result(tmp_path / "a"), run, tmp_path / "b", figures=False)
    for name in ("result.json", "prediction.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_an_interruption_of_the_drawing_keeps_the_result(result, run, tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("giajax.report._pictures.residuals_figure", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_result(result, run, tmp_path)
    assert sorted(os.listdir(tmp_path)) == ["prediction.csv", "prediction.toml", "result.json"]


def test_a_failed_write_leaves_what_was_there(result, run, whole, tmp_path, monkeypatch):
    shutil.copytree(whole[0], tmp_path, dirs_exist_ok=True)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(InputError, match="No space left"):
        write_result(result, run, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_other_runs_than_those_of_the_result_are_refused(result, tmp_path):
    other = small_run(tmp_path, seed=5)
    with pytest.raises(InputError, match="not those of the result"):
        write_result(result, other, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_same_fit_may_be_written_again(result, run, config, tmp_path):
    check_folder(tmp_path / "new" / "folder", [run], config)
    (tmp_path / "notes.txt").write_text("mine")
    check_folder(tmp_path, [run], config)
    write_result(result, run, tmp_path, figures=False)
    check_folder(tmp_path, [run], config)
    assert not (tmp_path / "new").exists()


CHANGES = {
    "definition": {"fix": {"links.mass": 0.05}},
    "free": {"free": ["air.drag_coefficient"], "start": {"air.drag_coefficient": 0.9}},
    "start": {"start": {**START, "air.drag_coefficient": 0.91}},
    "loss": {"loss": "huber"},
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_another_configuration_is_refused(run, whole, change):
    arguments = {"start": START, **CHANGES[change]}
    other = set_up(model_for([run]), [run], **arguments).config
    words = {"definition": "constants of the model"}
    with pytest.raises(InputError, match=rf"another configuration.*{words.get(change, change)}"):
        check_folder(whole[0], [run], other)
    check_folder(whole[0], [run], other, force=True)


def test_another_noise_in_the_sidecar_is_another_configuration(run, whole, tmp_path):
    sidecar = (
        run.path.with_suffix(".toml").read_text().replace("position_m = 0.01", "position_m = 0.02")
    )
    (tmp_path / "run.csv").write_bytes(run.path.read_bytes())
    (tmp_path / "run.toml").write_text(sidecar)
    louder = read_run(tmp_path / "run.csv")
    other = set_up(model_for([louder]), [louder], start=START).config
    with pytest.raises(InputError, match="the content of the sidecar"):
        check_folder(whole[0], [louder], other)


def test_other_data_are_refused(whole, tmp_path):
    other = read_run(make_run(tmp_path, seed=3))
    config = set_up(model_for([other]), [other], start=START).config
    with pytest.raises(InputError, match=r"other data \(run\).*--force"):
        check_folder(whole[0], [other], config)
    check_folder(whole[0], [other], config, force=True)


@pytest.mark.parametrize("content", ["", "{}", "[1]", "3", '{"runs": 3, "config": 1}', "\x00"])
def test_a_result_of_another_program_is_refused(run, config, tmp_path, content):
    (tmp_path / "result.json").write_text(content)
    with pytest.raises(InputError, match="not a giajax result"):
        check_folder(tmp_path, [run], config)
    check_folder(tmp_path, [run], config, force=True)


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_that_cannot_be_is_refused(run, config, tmp_path, force):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    for folder in ("file", "file/below", "link"):
        with pytest.raises(InputError, match="give another name"):
            check_folder(tmp_path / folder, [run], config, force=force)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_refused(run, config, tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="cannot be written"):
        check_folder(tmp_path / "out", [run], config)


def test_what_is_not_finite_is_null(result, run, tmp_path):
    odd = dataclasses.replace(result, cost=float("nan"), reduced_chi_square=float("inf"))
    write_result(odd, run, tmp_path, figures=False)
    record = json.loads((tmp_path / "result.json").read_text())
    assert record["cost"] is None
    assert record["reduced_chi_square"] is None
