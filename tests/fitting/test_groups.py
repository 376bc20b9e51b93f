"""A parameter value for each run or each group of runs; and bounds of one fit."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import InputError, Prior, fit
from giajax.fitting import Layout, RunFit, members, set_up, sharing
from giajax.runtime.records import from_plain
from giajax.studies import refit
from toy_model import TRUTH, Decay, height, run

DECAY, SIGMA = TRUTH["decay"], 0.01


def raised(offset, seed, *, noise=2 * SIGMA):
    """Return a run with another offset; the stated noise is too large, so no error is scaled."""
    one = run(seed=seed)
    return type(one).from_arrays(
        one.times,
        {"tip_z": one.observations["tip_z"] + offset},
        name=one.name,
        noise={"position": noise},
        definition={"free_motion": True},
    )


RUNS = [raised(0.0, 0), raised(0.2, 1), raised(0.0, 2)]


def joint_fit(owners):
    """Solve the linear model with one amplitude and an offset per owner in closed form."""
    rows, data = [], []
    for one, owner in zip(RUNS, owners, strict=True):
        offsets = np.eye(max(owners) + 1)[owner]
        wave = np.exp(-DECAY * one.times)[:, None]
        rows.append(np.hstack([wave, np.broadcast_to(offsets, (60, len(offsets)))]))
        data.append(one.observations["tip_z"])
    design = np.concatenate(rows) / (2 * SIGMA)
    covariance = np.linalg.inv(design.T @ design)
    return covariance @ design.T @ np.concatenate(data) / (2 * SIGMA), covariance


@pytest.mark.parametrize(
    ("options", "owners"),
    [
        ({"per_run": ["offset"]}, (0, 1, 2)),
        ({"groups": {"offset": [["run0", "run2"], ["run1"]]}}, (0, 1, 0)),
    ],
)
def test_a_group_of_runs_has_a_value_of_its_own(options, owners):
    values, covariance = joint_fit(owners)
    errors = np.sqrt(np.diag(covariance))
    result = fit(
        Decay(decay=DECAY),
        RUNS,
        free=["amplitude"],
        start={"amplitude": 1.0},
        noise_model="white",
        **options,
    )
    assert result.status == "converged"
    assert result.gradient_check.relative_difference < 1e-6
    amplitude = result.parameters["amplitude"]
    assert_allclose(amplitude.value, values[0], atol=0.02 * errors[0])
    assert_allclose(amplitude.standard_error, errors[0], rtol=1e-6)
    for record, owner in zip(result.runs, owners, strict=True):
        own = record.parameters["offset"]
        assert_allclose(own.value, values[1 + owner], atol=0.02 * errors[1 + owner])
        assert_allclose(own.standard_error, errors[1 + owner], rtol=1e-6)
    mean, weights = result.parameters["offset"], np.r_[0, np.ones(max(owners) + 1)]
    weights /= weights.sum()
    assert mean.value == pytest.approx(np.mean(values[1:]), abs=1e-3)
    assert mean.standard_error == pytest.approx(np.sqrt(weights @ covariance @ weights), rel=1e-6)
    assert mean.remark.startswith(f"mean of {max(owners) + 1} values, one for each ")
    assert list(result.shown)[:3] == [
        "amplitude",
        "offset",
        "offset of run0" + ", run2" * (owners[2] == 0),
    ]


def test_all_values_by_run_are_fits_of_single_runs():
    together = fit(
        Decay(), RUNS, free=[], per_run=["amplitude", "decay", "offset"], noise_model="white"
    )
    for one, record in zip(RUNS, together.runs, strict=True):
        alone = fit(Decay(), one, noise_model="white")
        for path, own in record.parameters.items():
            estimate = alone.parameters[path]
            assert own.value == pytest.approx(estimate.value, abs=0.02 * estimate.standard_error)
            assert own.standard_error == pytest.approx(estimate.standard_error, rel=1e-3)


def test_a_run_is_predicted_with_its_own_values():
    result = fit(Decay(), RUNS, per_run=["offset"], ties={"twin": "1 + 0 * offset"})
    for one, expected in zip(RUNS, result.predictions, strict=True):
        assert_allclose(result.predict(one)["tip_z"], expected["tip_z"], rtol=1e-12)
    other = dataclasses.replace(RUNS[0], name="another")
    assert_allclose(result.predict(other)["tip_z"], height(other.times, offset=0.367), atol=0.02)
    stored = json.loads(result.to_json())
    assert tuple(from_plain(RunFit, item) for item in stored["runs"]) == result.runs
    assert stored["config"]["groups"] == {"offset": [["run0"], ["run1"], ["run2"]]}


def test_the_configuration_makes_the_same_fit_again():
    options = {
        "free": ["amplitude", "decay"],
        "start": {"decay": 0.5},
        "priors": {"offset": Prior(0.3, deviation=0.1), "decay": Prior(0.8, factor=1.5)},
        "bounds": {"decay": (0.1, 2.0)},
        "ties": {"twin": "1 + 0.1 * decay"},
        "per_run": ["offset"],
    }
    first = fit(Decay(), RUNS, **options)
    names = ("free", "start", "fix", "loss", "priors", "bounds", "ties", "groups")
    again = fit(Decay(), RUNS, **{name: first.config[name] for name in names})
    assert {path: e.value for path, e in again.parameters.items()} == {
        path: e.value for path, e in first.parameters.items()
    }
    assert "bounds" not in fit(Decay(), RUNS[0]).config


def test_windows_of_a_recording_share_the_value_of_a_run():
    windows = [
        dataclasses.replace(RUNS[0], name=f"{stem} {second} s", path=Path(f"data/{stem}.csv"))
        for stem in ("a", "b")
        for second in (0, 5)
    ]
    each = sharing(windows, ["offset"], {})
    assert each == {"offset": [["a"], ["b"]]}
    assert members("offset", windows, each["offset"]) == ((0, 1), (2, 3))
    layout = Layout.of(["decay", "offset", "idle"], {"offset": ((0, 1), (2, 3))}, 4)
    assert layout.places == ((0,), (1, 2), (3,))
    assert layout.of_runs == ((0, 1, 3), (0, 1, 3), (0, 2, 3), (0, 2, 3))
    assert layout.size == 4


def test_two_recordings_of_one_name_are_refused():
    """Two folders may each hold a run.csv, so a group could mean either."""
    runs = [dataclasses.replace(RUNS[0], path=Path(f"{folder}/run.csv")) for folder in "ab"]
    with pytest.raises(InputError, match=r"two runs are called 'run'.*: rename one"):
        sharing(runs, ["offset"], {})
    with pytest.raises(InputError, match="two runs are called 'run0'"):
        set_up(Decay(), [RUNS[0], dataclasses.replace(RUNS[0])], per_run=["offset"])
    assert sharing(runs, [], {}) == {}


def test_a_prior_and_bounds_hold_for_each_value():
    result = fit(
        Decay(decay=DECAY),
        RUNS,
        free=["amplitude"],
        per_run=["offset"],
        priors={"offset": Prior(0.35, deviation=1e-4)},
        bounds={"offset": (0.2, 0.45)},
    )
    assert (result.parameters["offset"].lower, result.parameters["offset"].upper) == (0.2, 0.45)
    for record in result.runs:
        own = record.parameters["offset"]
        assert own.value == pytest.approx(0.35, abs=1e-3)
        assert own.remark.startswith("its value comes mainly from its prior")


def test_bounds_of_a_fit_hold():
    """The true value is 0.7, so the fit ends at its own bound and reports it."""
    result = fit(Decay(), run(), start={"decay": 0.3}, bounds={"decay": (0.2, 0.6)})
    decay = result.parameters["decay"]
    assert (decay.lower, decay.upper) == (0.2, 0.6)
    assert decay.value == pytest.approx(0.6, abs=1e-3)
    assert decay.remark.startswith("at its upper bound")
    wide = fit(Decay(), run(), start={"decay": 0.3}, bounds={"decay": (0.2, 5.0)})
    free = fit(Decay(), run())
    for path in ("amplitude", "decay", "offset"):
        one, other = wide.parameters[path], free.parameters[path]
        assert one.value == pytest.approx(other.value, abs=0.02 * other.standard_error)
        assert one.standard_error == pytest.approx(other.standard_error, rel=1e-3)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"bounds": {"decay": (0.0, 10.0)}}, "the bounds 0 and 10 of 'decay' exceed its permitted"),
        ({"bounds": {"decay": (2.0, 1.0)}}, "must be two numbers, the lower one first"),
        ({"bounds": {"decay": (1.0,)}}, "must be a list of two numbers"),
        ({"bounds": {"decay": (2.0, 3.0)}}, "decay = 1 1/s is outside its bounds: choose"),
        ({"bounds": {"idle": (2.0, 3.0)}}, "'idle' has bounds but is not free: free it"),
        ({"bounds": {"ilde": (2.0, 3.0)}}, "no parameter 'ilde': did you mean 'idle'?"),
        ({"per_run": ["ilde"]}, "no parameter 'ilde': did you mean 'idle'?"),
        (
            {"per_run": ["offset"], "groups": {"offset": []}},
            "'offset' is estimated both per run and per group",
        ),
        (
            {"groups": {"offset": [["run0", "run1"]]}},
            "run 'run2' is in no group of 'offset': assign",
        ),
        ({"groups": {"offset": [["run0", "run1"], ["run2", "run0"]]}}, "'run0' is in several"),
        ({"groups": {"offset": [["run0", "runn1"], ["run2"]]}}, "'runn1', which is not a run: did"),
        ({"per_run": ["offset"], "fix": {"offset": 0.1}}, "'offset' is both free and fixed"),
        (
            {"per_run": ["offset"], "ties": {"offset": "twin"}},
            "'offset' is tied to other parameters and also free",
        ),
    ],
)
def test_what_cannot_be_is_refused(options, sentence):
    with pytest.raises(InputError, match=sentence.replace("?", r"\?")):
        set_up(Decay(), RUNS, **options)


def test_a_fit_again_keeps_what_was_known():
    """A refit of a tied, grouped fit with a prior and bounds ends where it started."""
    options = {
        "free": ["amplitude", "decay"],
        "priors": {"decay": Prior(0.8, deviation=0.01)},
        "bounds": {"amplitude": (0.1, 1.9)},
        "ties": {"twin": "1 + 0.1 * decay"},
        "per_run": ["offset"],
    }
    first = fit(Decay(), RUNS, **options)
    again = refit(first, RUNS)
    assert again.config["groups"] == first.config["groups"]
    for path, estimate in first.free.items():
        error = estimate.standard_error
        assert again.parameters[path].value == pytest.approx(estimate.value, abs=0.05 * error)
    assert again.parameters["amplitude"].upper == 1.9


def test_a_prior_of_each_group_of_runs_counts_as_often_as_there_are_groups():
    """Four values and two priors determine five parameters; without the priors, they do not."""
    short = [
        dataclasses.replace(one, times=one.times[:2], values={"tip_z": one.values["tip_z"][:2]})
        for one in RUNS[:2]
    ]
    options = {"free": ["amplitude", "decay", "offset"], "per_run": ["idle"]}
    setup = set_up(Decay(), short, priors={"idle": Prior(3.0, deviation=0.5)}, **options)
    assert setup.layout.size == 5
    with pytest.raises(InputError, match=r"4 measured values cannot determine 5 parameters"):
        set_up(Decay(), short, **options)
