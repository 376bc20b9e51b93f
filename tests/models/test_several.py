"""Several models in one fit, against closed forms; `test_whole_arm` fits an arm and a bench."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import Definition, FitTask, InputError, Run, fit, predict, replace
from giajax.fitting import set_up
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel, SeveralModels, capabilities, model_for
from giajax.recordings import read_runs, write_run
from giajax.report import summary
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import declared, parameter
from toy_model import Plain

SIGMA = 0.01
TRUTH = {"amplitude": 2.0, "offset": 0.3, "drift": -0.1}
TIMES, INPUTS = np.linspace(0, 4, 30), np.linspace(-1, 2, 20)


class Toy(Plain):
    def failure(self, inputs):
        return "never"

    def conditions(self, free, runs):
        return [f"{self.kind}: {', '.join(free)}"]


class Wave(Toy):
    """tip_z = amplitude exp(-t) + offset."""

    kind: ClassVar[str] = "arm"
    amplitude: Scalar = parameter(1.0, unit="m", doc="size", frozen=False)
    offset: Scalar = parameter(0.0, unit="m", doc="height", frozen=False)

    def prepare(self, run):
        return jnp.asarray(run.times)

    def predict(self, inputs, channels):
        height = self.amplitude * jnp.exp(-inputs) + self.offset
        return dict.fromkeys(channels, height), jnp.all(jnp.isfinite(height))


class Line(Toy):
    """output = amplitude input + drift."""

    kind: ClassVar[str] = "hysteresis"
    amplitude: Scalar = parameter(1.0, unit="m", doc="size", frozen=False)
    drift: Scalar = parameter(0.0, unit="m", doc="level", frozen=False)

    def prepare(self, run):
        return jnp.asarray(run.values["input"])

    def predict(self, inputs, channels):
        output = self.amplitude * inputs + self.drift
        return dict.fromkeys(channels, output), jnp.all(jnp.isfinite(output))


class Metres(Line):
    """A model with the same path but another unit."""

    amplitude: Scalar = parameter(1.0, unit="m/s", doc="size")


def recordings():
    noise = np.random.default_rng(4).normal(scale=0.8 * SIGMA, size=50)
    wave = TRUTH["amplitude"] * np.exp(-TIMES) + TRUTH["offset"] + noise[:30]
    line = TRUTH["amplitude"] * INPUTS + TRUTH["drift"] + noise[30:]
    known = {"noise": {"output": SIGMA}}
    free = {"noise": {"position_m": SIGMA}, "free_motion": True}
    return [
        Run.from_arrays(TIMES, {"tip_z": wave}, name="wave", definition=free),
        Run.from_arrays(None, {"input": INPUTS, "output": line}, name="line", definition=known),
    ]


def design():
    """Return the derivatives by amplitude, offset and drift, divided by the noise."""
    ones, zeros = np.ones_like, np.zeros_like
    wave = np.stack([np.exp(-TIMES), ones(TIMES), zeros(TIMES)], axis=1)
    line = np.stack([INPUTS, zeros(INPUTS), ones(INPUTS)], axis=1)
    return wave / SIGMA, line / SIGMA


class Own(Metres):
    """A user-defined kind, whose definition has keys with any names."""

    kind: ClassVar[str] = "own"

    def definition(self):
        return {"arm": "its own", "models": 3}


@pytest.mark.quick
def test_keys_of_an_own_kind_stand_by_themselves():
    arm = ArmModel(takeichi_20m(1))
    stated = SeveralModels((arm, Own())).definition()
    assert stated["arm"] == arm.definition()["arm"]
    assert stated["models"] == ["arm", "own"]
    assert stated["definitions"] == {"own": Own().definition()}


@pytest.fixture(scope="module")
def runs():
    return recordings()


@pytest.fixture(scope="module")
def fitted(runs):
    return fit(SeveralModels((Wave(), Line())), runs)


def test_a_path_in_two_models_is_one_parameter():
    both = SeveralModels((Wave(), Line()))
    assert both.kind == "arm+hysteresis"
    assert list(declared(both)) == ["amplitude", "offset", "drift"]
    moved = replace(both, {"amplitude": 3.0})
    assert [float(part.amplitude) for part in moved.parts] == [3.0, 3.0]


def test_a_path_of_two_meanings_is_refused():
    with pytest.raises(
        InputError, match="'amplitude' is a different quantity in the hysteresis model"
    ):
        SeveralModels((Wave(), Metres()))


def test_one_least_squares_is_the_closed_form(runs, fitted):
    rows = np.concatenate(design())
    data = np.concatenate([runs[0].values["tip_z"], runs[1].values["output"]]) / SIGMA
    best, *_ = np.linalg.lstsq(rows, data)
    errors = np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert fitted.reduced_chi_square < 1, "otherwise standard errors are scaled"
    found = [fitted.parameters[path] for path in TRUTH]
    assert_allclose([each.value for each in found], best, atol=1e-3 * np.min(errors))
    assert_allclose([each.standard_error for each in found], errors, rtol=1e-6)
    assert fitted.conditions == ("arm: amplitude, offset", "hysteresis: amplitude, drift")


def test_each_recording_is_worth_what_is_lost_without_it(fitted):
    wave, line = design()
    whole = np.linalg.inv(wave.T @ wave + line.T @ line)
    left = {"wave": (line[:, [0, 2]], 0), "line": (wave[:, :2], 0)}
    for name, (rows, column) in left.items():
        ratio = np.linalg.inv(rows.T @ rows)[column, column] / whole[0, 0]
        assert_allclose(fitted.parameters["amplitude"].sources[name], np.sqrt(ratio), rtol=1e-6)
    assert fitted.parameters["offset"].sources["wave"] is None
    assert fitted.parameters["drift"].sources["line"] is None
    said = summary(fitted)
    assert "wave: only source of information on offset" in said
    assert "line: only source of information on drift; factor by which errors" in said


def test_what_one_recording_determines_has_no_sources(runs):
    result = fit(Wave(), runs[0])
    assert result.parameters["amplitude"].sources == {}
    assert "determined by" not in summary(result)


def test_runs_without_a_common_parameter_are_refused(runs):
    with pytest.raises(InputError, match="share no free parameter"):
        set_up(SeveralModels((Wave(), Line())), runs, free=["offset", "drift"])
    set_up(SeveralModels((Wave(), Line())), runs, free=["drift"], ties={"offset": "2 * drift"})


# An arm with hysteresis, and the torque versus angle of one of its joints on a test bench.
TORQUE = {"joints.memory.strength": 0.08, "joints.memory.yield_angle": 0.02}
ARM = {**TORQUE, "joints.pitch_stiffness": 2.6, "air.drag_coefficient": 1.1}
TIES = {
    "elastic": "joints.pitch_stiffness",
    "alpha": "joints.memory.strength / joints.memory.yield_angle",
    "beta": "1 / joints.memory.yield_angle",
}


def bench_and_arm(folder):
    """Write files of a loop and of a motion, simulated with the same values."""
    random = np.random.default_rng(7)
    angle = np.concatenate([np.linspace(a, b, 40) for a, b in ((0, 0.3), (0.3, -0.3), (-0.3, 0.2))])
    about = {
        "model": "hysteresis",
        "hysteresis": {"operator": "bouc_wen", "previous_extremes": [0.0]},
        "noise": {"output_N_m": 0.004},
    }
    blank = {key: value for key, value in about.items() if key != "noise"}
    loop = Run.from_arrays(None, {"input": angle, "output": 0 * angle}, definition=blank)
    stiffness, way = TORQUE["joints.memory.strength"] / 0.02, 1 / 0.02
    true = {"elastic": 2.6, "alpha": stiffness, "beta": way, "gamma": 1.0, "delta": 0.0, "nu": 1.0}
    torque = predict(replace(model_for([loop]), true), loop)["output"]
    torque = torque + 0.004 * random.normal(size=len(angle))
    loops = write_run(
        folder / "loop.csv",
        None,
        {"input": angle, "output": torque},
        definition=about,
        units={"output": "N_m"},
    )
    times = np.linspace(0, 6, 121)
    command = np.interp(times, [0, 0.5, 1.5, 3, 4, 6], [0, 0, 0.5, 0.5, -0.2, -0.2])
    driven = {"joint01_command": command, "tip_z": 0 * times}
    about = {
        "arm": {"links": 2, "parameters": {"joints.memory.strength": 0.02}},
        "noise": {"position_m": 0.005},
    }
    arm = Run.from_arrays(times, driven, definition=about)
    driven["tip_z"] = predict(replace(model_for([arm]), ARM), arm)["tip_z"]
    driven["tip_z"] = driven["tip_z"] + 0.005 * random.normal(size=len(times))
    return [loops, write_run(folder / "arm.csv", times, driven, definition=about)]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return bench_and_arm(tmp_path_factory.mktemp("several"))


def task(files):
    start = {path: 1.4 * value for path, value in ARM.items()}
    fix = {"nu": 1.0, "gamma": 1.0, "delta": 0.0}
    return FitTask.of(files).on_top(free=list(ARM), start=start, fix=fix, ties=TIES)


def test_what_both_models_would_say_is_asked_of_each(files):
    runs = read_runs(files, Definition())
    model = model_for(runs)
    assert model.integration() == model.part("arm").integration()
    finer = model.with_integration(solver="tsit5", tolerance=1e-9)
    assert finer.integration() == ("tsit5", 1e-9)
    assert finer.parts[1] is model.parts[1]
    assert "arm.drag = strip" in model.variants()
    with pytest.raises(InputError, match="the combined model has no joint part"):
        model.part("joint")
    joint = dataclasses.replace(model, parts=model.parts[1:])
    with pytest.raises(InputError, match="neither a solver nor a tolerance"):
        capabilities.with_integration(joint, solver="tsit5", tolerance=None)


def test_a_definition_asks_each_run_for_its_own_channels(files):
    arm = {"fit": {"channels": ["tip_z", "joint01_angle"]}}
    with pytest.raises(InputError, match="has no channel 'joint01_angle'"):
        read_runs(files, Definition.parse(arm))
    runs = read_runs(files, Definition.parse({"fit": {"channels": ["tip_z"]}}))
    assert [list(run.observations) for run in runs] == [["output"], ["tip_z"]]


def test_a_channel_of_no_run_is_refused(files):
    for name in ("force", "nothing"):
        with pytest.raises(InputError, match=f"'{name}' is not a common channel of these runs"):
            read_runs(files, Definition.parse({"fit": {"channels": [name]}}))
    # A validation run may belong to only one of the models.
    asked = Definition.parse({"fit": {"channels": ["tip_z"], "window_s": 2.0}})
    both = read_runs(files, Definition())
    (loop,) = read_runs(files[:1], asked, beside=both)
    assert list(loop.observations) == ["output"]


def test_a_few_rows_beside_many_are_no_obstacle(runs):
    """One recording has fewer rows than parameters, and one shares no parameter with another."""
    wave, line = runs
    short = Run.from_arrays(
        None, {key: values[:1] for key, values in line.values.items()}, name="short",
        definition={"noise": {"output": SIGMA}},
    )  # fmt: skip
    result = fit(SeveralModels((Wave(), Line())), [wave, short], free=["amplitude", "drift"])
    assert result.parameters["drift"].sources == {"wave": None, "short": None}
    assert result.parameters["amplitude"].sources["short"] == pytest.approx(1.0, rel=1e-6)


def test_what_sidecars_state_of_a_shared_parameter_must_agree():
    def joint(length):
        section = {} if length is None else {"wire_length_m": length}
        values = {"angle": [0.1, 0.2], "side": ["inner", "inner"], "force": [1.0, 1.0]}
        return Run.from_arrays(None, values, definition={"joint": section})

    def arm(length):
        section = {"links": 2, "muscles": "pitch"}
        if length is not None:
            section["parameters"] = {"geometry.wire_length": length}
        values = {"joint01_command": [0.0, 0.0], "tip_z": [0.0, 0.0]}
        return Run.from_arrays([0.0, 1.0], values, definition={"arm": section})

    for lengths in ((0.35, None), (None, 0.35), (0.35, 0.35)):
        model = model_for([joint(lengths[0]), arm(lengths[1])])
        assert [float(part.definition() and value(model)) for part, value in zip(
            model.parts, declared(model)["geometry.wire_length"].getters, strict=True
        )] == [0.35, 0.35]  # fmt: skip
    with pytest.raises(InputError, match=r"different values of 'geometry\.wire_length'"):
        model_for([joint(0.35), arm(0.36)])


def test_values_for_single_runs_are_for_runs_of_one_model(files):
    with pytest.raises(
        InputError, match="has values for individual runs, but the runs use several"
    ):
        task(files).on_top(per_run=["camera.delay"]).prepare()


def test_all_runs_of_a_model_cannot_be_held_out(files):
    held = task(files).on_top(hold_out=["loop"])
    with pytest.raises(InputError, match="every run of the hysteresis model is held out"):
        held.prepare()
