"""Runs of an oscillator: requirements, interpolation between rows, and files of version 0.1."""

import numpy as np
import pytest

from giajax import Definition, InputError, Run, fit, model_for, read_run, replace
from giajax.apps.synthetic import synthesise
from giajax.fitting import predict
from giajax.models import OscillatorModel, build_model, parameter_values

STILL = {"input": [0.0, 1.0, 0.0], "output": [0.0, 0.0, 0.0]}


def test_times_and_even_samples_are_needed():
    with pytest.raises(InputError, match="an oscillator run must have them"):
        Run.from_arrays(None, STILL, definition={"model": "oscillator"})
    model = OscillatorModel(interpolation="band_limited")
    uneven = Run.from_arrays([0.0, 1.0, 1.5], STILL, definition={"model": "oscillator"})
    with pytest.raises(InputError, match=r"not sampled evenly.*= \"linear\" in \[oscillator\]"):
        model.prepare(uneven)
    with pytest.raises(InputError, match="hysteresis model: give a run of the oscillator model"):
        model.prepare(Run.from_arrays([0.0, 1.0, 2.0], STILL))
    other = Run.from_arrays(
        [0.0, 1.0, 2.0],
        STILL,
        definition={"model": "oscillator", "oscillator": {"interpolation": "band_limited"}},
    )
    with pytest.raises(InputError, match=r"disagree in \[oscillator\]"):
        model_for([uneven, other])


def driven(samples, interpolation):
    """Return the response to two sines with a common period of 0.4 s, at several rows."""
    times = np.arange(samples) * 0.4 / samples
    force = 60 * np.cos(2 * np.pi * 35 * times) + 20 * np.sin(2 * np.pi * 80 * times)
    values = {"input": force, "output": np.zeros(samples)}
    run = Run.from_arrays(times, values, definition={"model": "oscillator"})
    model = OscillatorModel(interpolation=interpolation).refined(1e-3)
    return predict(model, run, ["output"])["output"]


@pytest.mark.slow
def test_a_band_limited_force_is_followed_between_the_rows():
    """A few rows of one period give the same response as many."""
    fine = driven(3200, "linear")[::16]
    coarse = driven(200, "band_limited")
    assert np.max(np.abs(coarse - fine)) < 2e-3 * np.max(np.abs(fine))
    # Linear interpolation between so few rows is inaccurate.
    assert np.max(np.abs(driven(200, "linear") - fine)) > 1e-2 * np.max(np.abs(fine))


OLD = {
    "model": "hysteresis",
    "hysteresis": {
        "operator": "bouc_wen_oscillator",
        "input_range": [-200.0, 200.0],
        "interpolation": "band_limited",
    },
}


def test_a_sidecar_of_version_0_1_is_read(tmp_path):
    """In that version, the oscillator was a hysteresis operator, and only the fit named a model."""
    path = tmp_path / "run.csv"
    path.write_text("time_s,input_N,output_m\n0,0,0\n1,1,0\n2,0,0\n")
    Definition.parse(OLD)
    path.with_suffix(".toml").write_text(
        'model = "hysteresis"\n[hysteresis]\noperator = "bouc_wen_oscillator"\n'
        'input_range = [-200.0, 200.0]\ninterpolation = "band_limited"\n'
    )
    beside = Definition.parse({"model": "hysteresis", "fit": {"free": ["mass"]}})
    for definition in (None, beside):
        run = read_run(path, definition=definition)
        model = model_for([run])
        assert isinstance(model, OscillatorModel)
        assert model.interpolation == "band_limited"


def test_a_result_of_version_0_1_is_read():
    values = {**parameter_values(OscillatorModel()), "mass": 3.0, "previous_extremes": [0.0]}
    definition = {"hysteresis": OLD["hysteresis"], "output_column": "output_mm"}
    model = build_model("hysteresis", definition, values)
    assert isinstance(model, OscillatorModel)
    assert model.oscillator.mass == 3.0
    assert model.columns.output == "output_mm"
    again = build_model(model.kind, model.definition(), parameter_values(model))
    assert again.definition() == model.definition()
    assert parameter_values(again) == parameter_values(model)


@pytest.mark.slow
def test_a_mass_is_found():
    """The initial guess is wrong, and the offset is free, too."""
    times = np.arange(300) / 750
    force = 50 * np.sin(2 * np.pi * (15 + 30 * times) * times)
    truth = replace(OscillatorModel(), {"mass": 2.3, "offset": 1e-4})
    run = synthesise(truth, times, {"input": force}, ["output"], noise={"output": 8e-6}, seed=1)
    result = fit(OscillatorModel(), run, free=["mass", "offset"])
    for path, value in (("mass", 2.3), ("offset", 1e-4)):
        estimate = result.parameters[path]
        assert estimate.standard_error is not None
        assert estimate.value == pytest.approx(value, abs=4 * estimate.standard_error)
    assert result.parameters["mass"].standard_error < 0.05
