"""`giajax predict`: errors of a model on runs that were not used in its fit."""

import csv
import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_fit_command import giajax

import small_loops
from giajax.fitting import fit, load_result, predict
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel, as_stated
from giajax.recordings import Definition, read_run, read_runs, write_run
from giajax.report import write_result
from giajax.schema.parameters import as_in, get, left_out, parameter, replace
from giajax.tasks import FitTask
from small_arm import LINKS, NOISE, TRUTH, make_run


def test_errors_of_two_models_and_their_ratio(arm_fit, tmp_path):
    data, fitted, _ = arm_fit
    wrong = tmp_path / "wrong.toml"
    wrong.write_text('[arm]\nlinks = 4\n[arm.parameters]\n"air.drag_coefficient" = 0.3\n')
    table = tmp_path / "errors.csv"
    asked = ("predict", fitted, "--against", wrong, "--data", data)
    status, out, error = giajax(*asked, "--to", table)
    assert (status, error) == (0, "")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    keys = ["run", "channel", "unit", "n", "rmse", "largest", "reference_rmse", "ratio"]
    assert list(rows[0]) == keys
    assert len(rows) == len(out.splitlines()) - 1
    assert all(float(row["ratio"]) < 1 for row in rows)
    assert {row["unit"] for row in rows} == {"m"}
    # No file is overwritten without --force.
    status, out, error = giajax(*asked, "--to", table)
    assert status == 2
    assert "--force" in error
    assert error.count("\n") == 1


def test_one_channel_of_one_model(arm_fit):
    data, fitted, _ = arm_fit
    status, out, _ = giajax("predict", fitted, "--data", data, "--channels", "link04_z")
    assert status == 0
    heading, row = out.splitlines()
    assert "ratio" not in heading
    assert row.split()[1] == "link04_z"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """Return the fit of a rotated, late camera, and a run recorded by an exact camera."""
    folder = tmp_path_factory.mktemp("filmed")
    model = replace(ArmModel(takeichi_20m(LINKS)), TRUTH)
    turned = replace(model, {"camera.rotation": [0.0, 0.3, 0.0], "camera.delay": 0.1})
    data = make_run(folder)
    exact, noise = read_run(data), np.random.default_rng(1)
    rows = {
        name: row + NOISE * noise.normal(size=41) for name, row in predict(turned, exact).items()
    }
    written = {**exact.values, **rows}
    path = folder / "seen.csv"
    seen = read_run(write_run(path, exact.times, written, definition=exact.definition))
    free = ["camera.rotation[1]", "camera.delay"]
    fixed = {**TRUTH, "camera.rotation[0]": 0.0, "camera.rotation[2]": 0.0}
    result = fit(model, seen, free=free, fix=fixed, check=False)
    assert result.status == "converged"
    write_result(result, [seen], folder / "fit", figures=False)
    return data, folder / "fit"


def test_another_camera_and_wind_are_those_of_the_run(filmed):
    data, fitted = filmed
    result, recorded = load_result(fitted), read_run(data)

    def error(**options):
        rest = [
            predicted - recorded.observations[name]
            for name, predicted in result.predict(recorded, **options).items()
        ]
        return np.sqrt(np.nanmean(np.square(rest)))

    assert error() > 2 * NOISE
    assert error(without=["camera"]) < 1.2 * NOISE
    # Settings in the sidecar apply to the run, also for single parts of a group.
    stated = {**recorded.definition.contents(), "sensors": {"camera_delay_s": 0.05}}
    late = dataclasses.replace(recorded, definition=Definition.parse(stated, "late"))
    windy = replace(result.model, {"air.wind": [0.0, 0.5, 0.0]})
    kept = {"camera.rotation", "camera.delay", "air.wind"}
    for names, gone, delay in (
        (["camera"], {"camera.rotation"}, 0.05),
        (["camera.rotation", "wind"], {"camera.rotation", "air.wind"}, 0.1),
        (["air", "delay"], {"air.wind"}, 0.05),
    ):
        model = as_stated(windy, late, names)
        assert kept & set(left_out(model)) == gone
        assert float(get(model, "camera.delay")) == pytest.approx(delay, abs=0.01)
        assert float(get(model, "joints.damping")) == TRUTH["joints.damping"]


def test_what_the_run_alone_states_and_a_law_of_ones_own():
    class Own(eqx.Module):
        stiffness: jax.Array = parameter(2.0, unit="N m/rad", doc="of a joint")

        def __init__(self, by):
            self.stiffness = jnp.asarray(2.0 * by)

    class Whole(eqx.Module):
        law: Own
        camera: dict[str, Own]
        lift: Own | None = None

    fitted, stated = Own(1.0), Own(3.0)
    model = Whole(fitted, {"top": fitted})
    other = Whole(stated, {"top": stated}, stated)
    lifted = as_in(model, other, ["lift"])
    assert (lifted.law, lifted.lift) == (fitted, stated)
    turned = as_in(model, other, ["camera.top"])
    assert (turned.law, turned.camera, turned.lift) == (fitted, {"top": stated}, None)


def test_without_on_the_command_line(filmed):
    data, fitted = filmed
    asked = ("predict", fitted, "--data", data, "--without")
    status, out, _ = giajax(*asked, "camera,air.density")
    assert status == 0
    assert all(float(row.split()[4]) < 1.5 * NOISE for row in out.splitlines()[1:])
    status, _, error = giajax(*asked, "cam")
    assert status == 2
    assert "no parameter or group called 'cam': give air, base_rotation, camera" in error
    assert error.count("\n") == 1


def test_names_of_the_fit_are_no_others_of_another_recording(tmp_path):
    """Input and output are exchanged only in the fitted file."""
    task = FitTask.load(small_loops.write_task(tmp_path))
    file, other = tmp_path / "loops.csv", tmp_path / "other.csv"
    file.write_text(file.read_text().replace("input,output", "output,input"))
    exchanged = {"input": "output", "output": "input"}
    task = task.on_top(data=[file], validation=[], rename=exchanged)
    runs = read_runs(task.data, task.definition, rename=task.rename)
    write_result(task.run(check=False), runs, tmp_path / "fit", figures=False)
    for path, said in (other, ""), (file, "as in the fit: input as output, output as input\n"):
        _, out, error = giajax("predict", tmp_path / "fit", "--data", path)
        assert float(out.splitlines()[1].split()[3]) < 0.01
        assert error.endswith(said)
        assert bool(error) == bool(said)
