"""Files that version 0.1 wrote, before the kinds of models were registered, are read.

Each folder of `earlier/` holds a run with its sidecar and fit definition, and the files of the
fit: `giajax fit run_fit.toml --max-iterations 8`.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from giajax import Definition, FitTask, InputError, load_result, read_run
from giajax.report import summary

EARLIER = Path(__file__).parent / "earlier"
KINDS = ("arm", "hysteresis", "joint", "muscle", "oscillator")


@pytest.mark.parametrize("kind", KINDS)
def test_runs_with_their_sidecars_are_read(kind):
    for name in ("run.csv", "prediction.csv"):
        assert read_run(EARLIER / kind / name).model == kind


def test_what_a_sidecar_said_is_read():
    arm = read_run(EARLIER / "arm" / "run.csv")
    section = arm.definition.arm
    assert section.link_mass_kg == [0.06, 0.05]
    assert section.parameters == {"air.added_mass_coefficient": 0.9}
    (body,) = section.point_masses
    assert (body.link, body.mass_kg, body.position_m, body.up_m) == (2, 0.004, 0.9, 0.02)
    assert arm.definition.sensors.marker_up_m == 0.15
    assert arm.definition.initial.angle_deg == [1.0, -2.0]
    assert arm.noise("link02_z") == 0.02
    oscillator = read_run(EARLIER / "oscillator" / "run.csv").definition
    assert oscillator.oscillator.interpolation == "linear"
    assert oscillator.hysteresis.contents() == {}


@pytest.mark.parametrize("kind", KINDS)
def test_fit_definitions_are_read(kind):
    task = FitTask.load(EARLIER / kind / "run_fit.toml")
    ready = task.prepare()
    assert ready.setup.model.kind == kind
    record = json.loads((EARLIER / kind / "result.json").read_text())
    free = [path for path in ready.setup.config["free"] if path not in ready.setup.nuisances]
    assert free == record["config"]["free"]
    assert ready.setup.config["loss"] == record["config"]["loss"]
    assert ready.setup.config["start"] == pytest.approx(record["config"]["start"])


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_results_predict_as_they_did(kind):
    result = load_result(EARLIER / kind)
    assert result.model.kind == kind
    run = read_run(EARLIER / kind / "run.csv")
    (fitted,) = result.runs
    predicted = result.predict(run, list(fitted.channels))
    if fitted.parameters:
        # Its own initial state was fitted, too, and is no part of the model.
        own = [estimate.value for estimate in fitted.parameters.values()]
        angles, rates = np.rad2deg(own[:2]).tolist(), np.rad2deg(own[2:]).tolist()
        initial = {"angle_deg": angles, "rate_deg_per_s": rates}
        run = read_run(run.path, definition=Definition.parse({"initial": initial}))
        predicted = result.predict(run, list(fitted.channels))
    for name, channel in fitted.channels.items():
        difference = run.channels[name].from_si(predicted[name] - run.observations[name])
        assert np.sqrt(np.nanmean(difference**2)) == pytest.approx(channel.rmse, rel=1e-6), name
    assert "run" in summary(result)
    # And what is written of it now is read again.
    again = json.loads(result.to_json())
    assert again["model"] == kind
    values = {path: estimate["value"] for path, estimate in again["parameters"].items()}
    before = json.loads((EARLIER / kind / "result.json").read_text())["parameters"]
    assert values == {path: estimate["value"] for path, estimate in before.items()}


@pytest.fixture
def changed(tmp_path):
    """A function that changes a stored result, and reads it."""

    def read(change):
        record = json.loads((EARLIER / "muscle" / "result.json").read_text())
        change(record)
        (tmp_path / "result.json").write_text(json.dumps(record))
        return load_result(tmp_path)

    return read


def test_a_result_with_a_prior_by_a_factor_is_read(changed):
    (path, *_) = json.loads((EARLIER / "muscle" / "result.json").read_text())["parameters"]

    def change(record):
        record["config"]["priors"] = {path: {"value": 1.0, "factor": 1.5}}

    assert changed(change).config["priors"][path]["factor"] == 1.5


def test_a_parameter_that_follows_from_others_needs_no_start(changed):
    """It has a standard error, and starts have the free parameters alone."""

    def change(record):
        first, second = list(record["parameters"])[:2]
        for path, one in record["parameters"].items():
            one.update(free=path == first, standard_error=1e-3)
        values = {first: record["parameters"][first]["value"]}
        start = {"start": values, "parameters": values, "misfit": 1.0, "status": "converged"}
        record["starts"] = [start]
        assert second not in values

    assert changed(change).starts[0].misfit == 1.0


def test_another_version_is_named_before_what_differs(changed):
    with pytest.raises(InputError, match="written by another version of giajax"):
        changed(lambda record: record.update(schema_version=99, runs=3))
