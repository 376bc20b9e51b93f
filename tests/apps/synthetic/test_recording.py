"""Errors of a recording: each has its documented statistics, for runs of any model."""

import numpy as np
import pytest

import giajax
from giajax import ArmModel, InputError, Run, model_for
from giajax.apps.synthetic import RecordingErrors, drifting, recorded_again, with_errors

TIMES = np.linspace(0.0, 400.0, 4001)
CHANNELS = ("link01_x", "link01_z", "link02_x", "link02_z", "joint01_angle")
EXACT = Run.from_arrays(
    TIMES,
    {"joint01_command": 0 * TIMES, **{name: np.sin(TIMES) for name in CHANNELS}},
    definition={"arm": {"links": 2}},
)


def errors_of(seed=3, **errors):
    run = with_errors(EXACT, RecordingErrors(**errors), seed=seed)
    return run, {name: run.values[name] - EXACT.values[name] for name in CHANNELS}


def test_no_errors_change_nothing():
    run, errors = errors_of()
    assert all(np.all(error == 0) for error in errors.values())
    assert run.definition.contents() == EXACT.definition.contents()


def test_white_noise_is_white_and_stated():
    run, errors = errors_of(white={"position": 0.02, "joint01_angle": 0.1})
    assert run.noise("link01_x") == pytest.approx(0.02)
    assert run.noise("joint01_angle") == pytest.approx(0.1)
    for name in CHANNELS:
        error = errors[name] / (0.1 if name == "joint01_angle" else 0.02)
        assert np.std(error) == pytest.approx(1, abs=0.05)
        assert abs(np.mean(error[1:] * error[:-1])) < 0.05
    assert abs(np.corrcoef(errors["link01_x"], errors["link01_z"])[0, 1]) < 0.05


def test_drift_forgets_itself_as_an_ornstein_uhlenbeck_process_does():
    """Unit variance and correlation exp(-dt / tau), also for unevenly spaced samples."""
    random = np.random.default_rng(1)
    times = np.cumsum(np.tile([0.1, 0.3], 100_000))
    values = drifting(times, 0.5, random)
    assert np.mean(values**2) == pytest.approx(1, abs=0.02)
    for lag, apart in ((slice(0, None, 2), 0.3), (slice(1, None, 2), 0.1)):
        pairs = (values[:-1] * values[1:])[lag]
        assert np.mean(pairs) == pytest.approx(np.exp(-apart / 0.5), abs=0.02)
    run, errors = errors_of(correlated={"position": 0.03}, white={"position": 0.04})
    assert np.std(errors["link01_x"]) == pytest.approx(0.05, rel=0.1)
    assert run.noise("link01_x") == pytest.approx(0.05)


def test_cells_are_lost_here_and_there():
    run, _ = errors_of(missing=0.1)
    lost = {name: np.isnan(run.values[name]) for name in CHANNELS}
    assert all(cells.sum() == 400 for cells in lost.values())
    assert not np.array_equal(lost["link01_x"], lost["link01_z"])


def test_bursts_take_all_components_of_a_link():
    run, _ = errors_of(bursts=0.2, burst_duration=5.0)
    lost = {name: np.isnan(run.values[name]) for name in CHANNELS}
    np.testing.assert_array_equal(lost["link01_x"], lost["link01_z"])
    assert not np.array_equal(lost["link01_x"], lost["link02_x"])
    for cells in lost.values():
        assert cells.sum() == 800
        stretches = np.sum(np.diff(cells.astype(int)) == 1)
        # About 16 bursts of 50 rows, fewer if they overlap. Independent gaps would give hundreds.
        assert 5 <= stretches <= 25


def test_outliers_are_few_and_far():
    _, errors = errors_of(outliers=0.01, outlier_size={"position": 0.5})
    far = errors["link02_z"][errors["link02_z"] != 0]
    np.testing.assert_allclose(np.abs(far), 0.5)
    assert len(far) == 40
    assert 5 < np.sum(far > 0) < 35
    assert np.all(errors["joint01_angle"] == 0)


def test_kinds_of_errors_do_not_change_each_other():
    _, alone = errors_of(white={"position": 0.02})
    _, both = errors_of(white={"position": 0.02}, missing=0.1, bursts=0.1)
    left = ~np.isnan(both["link01_x"])
    np.testing.assert_array_equal(both["link01_x"][left], alone["link01_x"][left])
    _, other = errors_of(seed=4, white={"position": 0.02})
    assert not np.array_equal(alone["link01_x"], other["link01_x"])


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ({"missing": 1.0}, "fraction missing is 1"),
        ({"bursts": -0.1}, "fraction bursts is -0.1"),
        ({"outliers": 0.1}, "fraction and a size"),
        ({"correlation_time": 0.0}, "positive time"),
        ({"white": {"position": -1.0}}, "negative"),
        ({"white": {"height": 1.0}}, "height"),
    ],
)
def test_errors_that_make_no_sense_are_one_sentence(errors, words):
    with pytest.raises(InputError, match=words):
        errors_of(**errors)


def test_a_run_without_times_has_white_noise_only():
    still = Run.from_arrays(
        None,
        {"side": ["inner"] * 3, "angle": [0.1, 0.2, 0.3], "force": [1.0, 2.0, 3.0]},
        definition={"model": "joint"},
    )
    noisy = with_errors(still, RecordingErrors(white={"force": 0.1}))
    assert 0 < np.abs(noisy.values["force"] - still.values["force"]).max() < 1
    assert list(noisy.values["side"]) == ["inner"] * 3
    with pytest.raises(InputError, match="has no times"):
        with_errors(still, RecordingErrors(bursts=0.1))


@pytest.mark.slow
def test_a_run_is_recorded_again_as_a_model_predicts_it():
    """The sidecar does not change, because a fit must find the rotated camera."""
    times = np.linspace(0.0, 2.0, 21)
    first = Run.from_arrays(
        times,
        {"joint01_command": np.interp(times, [0.5, 1.0], [0, 0.5]), "link02_z": 0 * times},
        definition={"arm": {"links": 2, "link_mass_kg": 0.06}, "origin": "by hand"},
        noise={"position": 0.5},
    )
    truth = giajax.replace(
        model_for([first]), {"camera.rotation": [0.0, 0.1, 0.0], "air.drag_coefficient": 0.8}
    )
    again = recorded_again(
        truth, first, RecordingErrors(white={"position": 0.01}), truth=["camera.rotation"]
    )
    assert again.definition.arm == first.definition.arm
    assert again.definition.sensors.contents() == {}
    assert again.definition.origin is None
    assert again.definition.truth["camera.rotation"] == [0.0, 0.1, 0.0]
    assert again.definition.truth["air.drag_coefficient"] == 0.8
    assert again.definition.truth["recording"]["white"] == {"position": 0.01}
    assert again.noise("link02_z") == pytest.approx(0.01)
    error = again.values["link02_z"] - giajax.predict(truth, first)["link02_z"]
    assert 0.005 < np.std(error) < 0.02
    wrong = again.values["link02_z"] - giajax.predict(model_for([first]), first)["link02_z"]
    assert np.std(wrong) > 0.02
    more = recorded_again(truth, first, channels=["tip_x", "joint02_angle"])
    assert list(more.observations) == ["tip_x", "joint02_angle"]
    assert isinstance(truth, ArmModel)
