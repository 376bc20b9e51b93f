"""Held-out data are judged at the end of a fit, with priors, ties and parameters per run."""

import dataclasses
import json
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from giajax import Prior, Run
from giajax.fitting import HeldOut, HoldOut, set_up, solve
from giajax.noise import Reason, Verdict
from giajax.recordings import hold_out
from giajax.runtime.records import from_plain
from giajax.schema.parameters import parameter
from toy_model import Decay, height, run

START = {"amplitude": 1.5, "decay": 1.0}
SIGMA = 0.01


def judged(runs, names, **settings):
    """Fit some runs without the held-out data, and judge the result by these."""
    parts = hold_out(runs, names)
    fitted = [part.fitted for part in parts if part.fitted is not None]
    settings = {"start": START, **settings}
    result = solve(set_up(Decay(), fitted, **settings), check=False)
    assert result.status == "converged"
    whole = set_up(Decay(), runs, **settings)
    return HoldOut(parts, whole).judge(result), whole


def several(**changed):
    return [run(seed=seed, sigma=SIGMA, **changed) for seed in range(3)]


PRIOR = {"priors": {"offset": Prior(0.25, deviation=0.02)}}
TIE = {"free": ["amplitude", "decay"], "ties": {"offset": "0.15 * amplitude"}}

# Number of runs, held-out part, fit settings, and number of parameters only the held-out data know.
CASES = {
    "the end, with a prior": (1, "last", PRIOR, 0),
    "the end, with a tie": (1, "last:0.4", TIE, 0),
    "a run with an offset of its own": (3, "run2", {"per_run": ("offset",)}, 1),
}
SLOW = "a run with an offset of its own"


@pytest.mark.parametrize(
    "case", [pytest.param(n, marks=[pytest.mark.slow] * (n == SLOW)) for n in CASES]
)
def test_it_is_what_chi_square_rises_by_in_a_fit_of_all(case):
    """The model is non-linear, but the noise is small."""
    count, name, settings, unknown = CASES[case]
    result, whole = judged(several()[:count], [name], noise_model="white", **settings)
    everything = solve(whole, check=False)
    (record,) = result.held_out
    channel = record.channels["tip_z"]
    rise = 2 * (everything.cost - result.cost)
    assert channel.size == pytest.approx(np.sqrt(rise / (channel.n - unknown)), rel=1e-3)
    assert result.verdict.status == "adequate"


def bent(seed):
    """Return a decay that ends sooner than the model's after two seconds."""
    recording = run(seed=seed, sigma=SIGMA)
    late = np.clip(recording.times - 2, 0, None)
    values = recording.values["tip_z"] - 0.05 * late**2
    return dataclasses.replace(recording, values={"tip_z": values})


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_model_that_is_right_only_at_first(loss):
    right, _ = judged([run(sigma=SIGMA)], ["last:0.5"], loss=loss)
    wrong, _ = judged([bent(0)], ["last:0.5"], loss=loss)
    assert right.verdict.status == "adequate"
    # The fitted data are described well, so only the held-out data speak against the model.
    assert wrong.verdict.status == "inadequate"
    assert [reason.code for reason in wrong.verdict.reasons] == ["prediction"]
    (reason,) = wrong.verdict.reasons
    assert reason.size == wrong.held_out[0].channels["tip_z"].size > 1.5
    assert "INADEQUATE MODEL: the prediction errors of the held-out data are " in wrong.headline
    (record,) = right.held_out
    channel = record.channels["tip_z"]
    assert (record.name, channel.unit, channel.n) == ("run0", "m", 30)
    truth = height(np.linspace(0.0, 4.0, 60))[30:]
    assert right.held_predictions[0]["tip_z"][30:] == pytest.approx(truth, abs=0.05)


def test_noise_that_is_not_stated_is_that_of_neighbouring_cells():
    def recorded(change):
        first, second, third = several(state_noise=False)
        third = dataclasses.replace(third, values={"tip_z": third.values["tip_z"] + change})
        return judged([first, second, third], ["run2"])[0]

    assert recorded(0.0).verdict.status == "adequate"
    assert recorded(0.02).verdict.reasons[0].code == "prediction"


class Swinging(Decay):
    """A model with tip_z of the decay and tip_y, which depends only on the amplitude."""

    def predict(self, inputs, channels):
        rows, fine = super().predict(inputs, channels)
        return {**rows, "tip_y": self.amplitude * jnp.sin(inputs)}, fine


def test_what_only_a_held_channel_knows_is_no_error_of_prediction():
    """This holds even if the fit left the parameter at a distant initial guess."""
    times = np.linspace(0.0, 4.0, 60)
    noise = SIGMA * np.random.default_rng(0).normal(size=(2, 60))
    values = {"tip_y": 2.0 * np.sin(times) + noise[0], "tip_z": height(times) + noise[1]}
    definition = {"free_motion": True}
    both = Run.from_arrays(times, values, noise={"position": SIGMA}, definition=definition)
    (part,) = hold_out([both], ["tip_z"])
    settings = {"start": {"amplitude": 1.5, "decay": 1.5}}
    result = solve(set_up(Swinging(), [part.fitted], **settings), check=False)
    assert result.parameters["decay"].value == 1.5
    judged = HoldOut((part,), set_up(Swinging(), [both], **settings)).judge(result)
    assert judged.verdict.status == "adequate"
    channel = judged.held_out[0].channels["tip_z"]
    assert channel.rmse == pytest.approx(SIGMA, rel=0.3)
    assert channel.size == pytest.approx(1, abs=0.2)


class Inputs(eqx.Module):
    times: Any
    lift: Any = parameter(0.0, unit="m", doc="height of this run above the others")


class Lifted(Decay):
    """A decay whose height is offset in each run."""

    def free_inputs(self, run):
        return ("lift",)

    def prepare(self, run):
        return Inputs(jnp.asarray(run.times), 0.0)

    def predict(self, inputs, channels):
        rows, fine = super().predict(inputs.times, channels)
        return {name: row + inputs.lift for name, row in rows.items()}, fine


def test_runs_of_one_name_keep_what_each_has_for_itself():
    """Two folders may contain files of the same name."""
    lifts = (0.4, -0.3)
    runs = [
        dataclasses.replace(each, name="run", values={"tip_z": each.values["tip_z"] + lift})
        for each, lift in zip(several(), lifts, strict=False)
    ]
    parts = hold_out(runs, ["last"])
    settings = {"free": ["amplitude", "decay"], "start": START}
    result = solve(set_up(Lifted(), [part.fitted for part in parts], **settings), check=False)
    judged = HoldOut(parts, set_up(Lifted(), runs, **settings)).judge(result)
    assert judged.verdict.status == "adequate"
    for record in judged.held_out:
        assert record.channels["tip_z"].rmse == pytest.approx(SIGMA, rel=0.5)


def test_a_perfect_description_is_no_reason():
    times = np.linspace(0.0, 4.0, 60)
    runs = [
        Run.from_arrays(
            times, {"tip_z": height(times)}, name=f"run{i}", definition={"free_motion": True}
        )
        for i in range(2)
    ]
    result, _ = judged(runs, ["run1"], start={"amplitude": 1.9})
    assert result.held_out[0].channels["tip_z"].size == 0.0
    assert result.verdict.status == "adequate"


def test_a_model_that_fails_for_what_was_held_out():
    """The parameters are those of the fit, but with this decay the model cannot be evaluated."""
    runs = several()
    parts = hold_out(runs, ["run2"])
    result = solve(set_up(Decay(), runs[:2], start=START), check=False)
    whole = set_up(Decay(), runs, start=START)
    decay = dataclasses.replace(result.parameters["decay"], value=8.5)
    far = dataclasses.replace(result, parameters={**result.parameters, "decay": decay})
    failed = HoldOut(parts, whole).judge(far)
    (record,) = failed.held_out
    assert record.channels["tip_z"].rmse == np.inf
    assert failed.verdict.reasons[0].code == "prediction"
    stored = json.loads(failed.to_json())
    assert stored["verdict"]["reasons"][0]["size"] is None
    assert from_plain(Reason, stored["verdict"]["reasons"][0]).size == np.inf


def test_a_fit_that_did_not_converge_is_not_judged():
    runs = [run(sigma=SIGMA), bent(1)]
    parts = hold_out(runs, ["run1"])
    result = solve(set_up(Decay(), runs[:1], start=START), check=False, max_iterations=1)
    # Its own residuals are judged where it ended; the held-out data are not judged.
    assert result.verdict.status == "inadequate"
    assert "not an optimum" in result.verdict.reasons[-1].sentence
    after = HoldOut(parts, set_up(Decay(), runs, start=START)).judge(result)
    assert after.verdict == result.verdict
    assert after.held_out[0].channels["tip_z"].rmse > SIGMA


def test_it_is_stored_and_read_again():
    result, _ = judged(several(), ["run2", "last"])
    stored = json.loads(result.to_json())
    assert [record["name"] for record in stored["held_out"]] == ["run0", "run1", "run2"]
    assert "held_predictions" not in stored
    assert len(result.predictions) == 2
    assert tuple(from_plain(HeldOut, record) for record in stored["held_out"]) == result.held_out
    assert from_plain(Verdict, stored["verdict"]) == result.verdict
