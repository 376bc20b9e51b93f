"""The wind of a resting arm: its response, its likelihood, and estimates of known winds."""

import functools
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import giajax
from giajax import ArmModel, InputError, Run, fit_wind, gusts, read_run
from giajax.apps.synthetic import gust_spectrum
from giajax.apps.wind import (
    TAPERS,
    Expected,
    Recorded,
    WindModel,
    bands,
    first_guess,
    gradient_and_information,
    joint_responses,
    log_likelihood,
    resting,
    slopes,
    tapered,
)
from giajax.cli import main
from giajax.recordings import write_run
from giajax.simulation import constant, logged

MODEL = ArmModel(giajax.takeichi_20m(2))
MEAN = np.array([0.0, 0.5, 0.2])
SPEED = float(np.linalg.norm(MEAN))
TIMES = np.arange(0.0, 420.01, 0.2)
NAMES = ("link02_y", "link02_z", "joint01_angle")
STILL = {"free_motion": True}
# One minute of this arm in gusts about this mean, simulated by an earlier version.
RESTING = Path(__file__).parents[1] / "earlier" / "written" / "wind" / "run.csv"
# Frequencies: a low one, and one near the resonance of the first joint.
WAVES = np.array([0.1, 0.7])


@functools.cache
def moved(kind, seed=0):
    """Return the joint angles in gusts, or in small waves along the mean wind."""
    places = np.asarray(giajax.mechanics.arm.link_centres(MODEL.arm, jnp.zeros(2)))
    if kind == "wave":
        wave = 0.005 * SPEED * np.sin(2 * np.pi * WAVES[:, None] * TIMES).sum(axis=0)
        rows = np.tile(MEAN + wave[:, None] * MEAN / SPEED, (1, 2))
    else:
        wind = gusts(
            MEAN,
            intensity=0.15,
            length_scale=2.0,
            duration=TIMES[-1],
            interval=0.2,
            seed=seed,
            places=places,
        )
        rows = np.stack([wind.values[f"link0{k}_wind_{a}"] for k in (1, 2) for a in "xyz"], axis=1)
    motion = giajax.simulate(
        MODEL.arm,
        constant(np.zeros(2)),
        TIMES,
        wind=logged(TIMES, rows, "linear"),
        solver="springs5",
        rtol=1e-8,
        atol=1e-8,
    )
    return np.asarray(motion.angles), motion


def recording(seed, noise=2e-4):
    angles, motion = moved("gusts", seed)
    places = np.asarray(motion.link_centres)
    random = np.random.default_rng(100 + seed)
    clean = dict(zip(NAMES, (places[:, 1, 1], places[:, 1, 2], angles[:, 0]), strict=True))
    values = {name: v + noise * random.normal(size=len(TIMES)) for name, v in clean.items()}
    return Run.from_arrays(
        TIMES, values, noise={"position": noise, "angle": noise}, definition=STILL
    )


@pytest.fixture(scope="module")
def found():
    """Fit the winds of recordings with two seeds, from other initial guesses."""
    return [
        fit_wind(
            MODEL,
            recording(seed),
            mean=0.75 * MEAN,
            intensity=0.3,
            length_scale=4.0,
            skip=20.0,
            highest=0.5,
        )
        for seed in range(2)
    ]


@pytest.mark.long
def test_known_winds_are_found_again(found):
    """The simulation includes the quadratic drag; pulls are those of logarithms."""
    truth = {"speed": SPEED, "deviation": 0.15 * SPEED, "length_scale": 2.0}
    assert all(one.converged and not one.left_out for one in found)
    pulls = np.array(
        [
            [
                np.log(one.numbers[name].value / value)
                * one.numbers[name].value
                / one.numbers[name].standard_error
                for name, value in truth.items()
            ]
            for one in found
        ]
    )
    assert np.max(np.abs(pulls)) < 3
    assert 0.1 < np.sqrt(np.mean(pulls**2)) < 2
    # The standard errors must be small enough to be useful.
    errors = [one.numbers["deviation"].standard_error / (0.15 * SPEED) for one in found]
    assert max(errors) < 0.2
    assert all(abs(one.misfit[0] - 1) < 0.2 for one in found)


@pytest.mark.long
def test_the_response_is_that_of_the_simulation_to_a_small_wave():
    record = resting(MODEL, recording(0), skip=20.0)
    here, _, _ = WindModel(MODEL, record, use_mean=False).about(first_guess(MEAN, 1e-5, 2.0, 12.0))
    kept = TIMES >= 20.0 - 1e-9
    kept[-1] = False  # exactly forty periods
    angles = moved("wave")[0][kept]
    np.testing.assert_allclose(angles.mean(axis=0), _rest(here), rtol=1e-3)
    turned = np.exp(-2j * np.pi * WAVES[:, None] * TIMES[kept])
    # Linear interpolation between the rows reduces the amplitude of a wave.
    taken = np.sinc(WAVES[:, None] * 0.2) ** 2
    seen = 2j / 0.005 * (turned @ angles) / len(angles) / taken
    expected = joint_responses(here, WAVES).sum(axis=2) @ MEAN
    assert np.min(np.abs(expected)) > 1e-4
    np.testing.assert_allclose(seen[0], expected[0], rtol=0.01)
    # The stiff joint follows the corners of the wind at the rows, where it is sampled.
    np.testing.assert_allclose(seen[1, 0], expected[1, 0], rtol=0.01)


def test_a_clock_that_is_late_is_a_phase_of_the_spectra_alone():
    run, guess = read_run(RESTING), first_guess(MEAN, 1e-5, 2.0, 12.0)
    late = giajax.replace(MODEL, {"encoder.delay": 0.1, "camera.delay": 0.2})
    records = [resting(model, run) for model in (MODEL, late)]
    assert not np.any(records[0].delays)
    assert np.all(records[1].delays)
    shown = [
        WindModel(model, record, use_mean=False).about(guess)[0].shows_rate
        for model, record in zip((MODEL, late), records, strict=True)
    ]
    np.testing.assert_array_equal(*shown)
    slow = giajax.replace(MODEL, {"encoder.clock_rate": 0.01})
    with pytest.raises(InputError, match=r"has a rate of 0.01, .* remove clock_rate"):
        resting(slow, run)


def _rest(here):
    """Return the angles at rest from the positions of the links: first pitch, then yaw."""
    pitch = np.arctan2(here.places[0, 2], here.places[0, 0])
    along = np.array([np.cos(pitch), 0.0, np.sin(pitch)])
    half = here.places[1] - 2 * here.places[0]
    return np.array([pitch, np.arctan2(half[1], half @ along)])


def test_the_likelihood_is_nearly_that_of_a_normal_vector():
    """The bands omit one bin in six, and the lowest frequencies."""
    samples, interval, noise = 256, 0.25, 0.02
    where = bands(samples, interval, 1 / (2 * interval))
    # The spectrum ends at the Nyquist frequency, so there is no aliasing.
    fine = np.linspace(0.0, 1 / (2 * interval), 8001)

    def spectrum(at, frequencies):
        wind = {"deviation": np.exp(at[0]), "length_scale": np.exp(at[1])}
        gust = gust_spectrum(frequencies, speed=0.5, along=True, **wind)
        return gust + 2 * noise**2 * interval

    cosines = np.cos(2 * np.pi * np.outer(np.arange(samples) * interval, fine))

    def exact(at):
        return toeplitz(np.trapezoid(cosines * spectrum(at, fine), fine, axis=1))

    def whittle(at):
        seen = spectrum(at, where.frequencies)[where.members].mean(axis=1)
        return Expected(seen[:, None, None], None, None)

    truth, other = np.log([0.1, 1.0]), np.log([0.1, 1.6])
    random = np.random.default_rng(5)
    both = [exact(truth), exact(other)]
    draws = np.linalg.cholesky(both[0]) @ random.normal(size=(samples, 60))
    squares = [np.sum(draws * np.linalg.solve(c, draws), axis=0) for c in both]
    levels = [np.linalg.slogdet(c)[1] for c in both]
    normal = -0.5 * (squares[0] + levels[0] - squares[1] - levels[1])
    expected, ours = [whittle(truth), whittle(other)], []
    for draw in draws.T:
        record = Recorded(tapered(draw[:, None], interval, where.middles), np.zeros(1))
        one, another = (log_likelihood(each, record) for each in expected)
        ours.append(one - another)
    ours = np.array(ours)
    assert np.corrcoef(ours, normal)[0, 1] > 0.8
    assert 0.6 < ours.mean() / normal.mean() < 1.05
    # The information matrix agrees, too.
    _, information = gradient_and_information(whittle(truth), slopes(whittle, truth), record)
    by = [(exact(truth + d) - exact(truth - d)) / 2e-3 for d in 1e-3 * np.eye(2)]
    parts = [np.linalg.solve(both[0], one) for one in by]
    bound = [[0.5 * np.trace(a @ b) for b in parts] for a in parts]
    share = np.diag(information) / np.diag(bound)
    assert np.all((share > 0.7) & (share < 1.02)), share


@pytest.mark.quick
def test_the_gradient_is_that_of_the_likelihood():
    random = np.random.default_rng(0)
    transforms = random.normal(size=(3, TAPERS, 2)) + 1j * random.normal(size=(3, TAPERS, 2))
    record = Recorded(transforms, np.array([0.3, -0.2]))
    level = np.array([1.0, 2.0, 3.0])[:, None, None]

    def model(at):
        both = np.array([[np.exp(at[0]), 0.3 * at[1]], [0.3 * at[1], 1.0 + at[1] ** 2]])
        return Expected(level * both + 0j, np.array([at[0], at[1]]), 0.1 * both)

    at = np.array([0.2, 0.5])
    gradient, information = gradient_and_information(model(at), slopes(model, at), record)
    for index, step in enumerate(1e-5 * np.eye(2)):
        up, down = (log_likelihood(model(at + s), record) for s in (step, -step))
        assert gradient[index] == pytest.approx((up - down) / 2e-5, rel=1e-5)
    assert np.all(np.linalg.eigvalsh(information) > 0)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"command": np.linspace(0, 0.1, 601)}, "moves by"),
        ({"lasts": 60.0}, "too short"),
        ({"mean": None}, "the initial mean wind"),
        ({"mean": [0.0, 0.0, 0.0]}, "the initial mean wind"),
        ({"free": ["colour"]}, "the free parameters are colour"),
        ({"jitter": 0.05}, "equal"),
        ({"gaps": 100}, "empty in"),
        ({"channel": "link05_z"}, "has link05_z, but"),
        ({"channel": "link02_inclination"}, "for which no spectrum can be computed"),
    ],
)
def test_what_is_no_record_of_rest_is_refused(change, words):
    rows = round(change.get("lasts", 120.0) / 0.2) + 1
    times = 0.2 * np.arange(rows)
    times[5] += change.get("jitter", 0.0)
    values = np.random.default_rng(0).normal(size=rows)
    values[10 : 10 + change.get("gaps", 0)] = np.nan
    table = {
        change.get("channel", "link02_z"): values,
        "joint01_command": change.get("command", np.zeros(rows)),
    }
    run = Run.from_arrays(times, table)
    with pytest.raises(InputError, match=words) as caught:
        fit_wind(
            MODEL,
            run,
            mean=change.get("mean", MEAN),
            free=change.get("free", ["speed"]),
            highest=0.5,
        )
    assert "\n" not in str(caught.value)


def test_friction_has_no_slope_at_rest():
    sticky = ArmModel(giajax.takeichi_20m(2, parameters={"joints.friction": 0.1}))
    with pytest.raises(InputError, match="friction"):
        fit_wind(sticky, read_run(RESTING), mean=MEAN)


def test_the_command_writes_what_it_found_and_not_over_it(tmp_path, capsys):
    out = tmp_path / "wind"
    wind = ",".join(f"{0.75 * part:.9g}" for part in MEAN)
    asked = ["wind", "--data", RESTING, "--wind", wind, "--gusts", "0.3:4", "--skip", "4"]
    asked += ["--highest", "1", "--hold", "deviation", "--hold", "length_scale", "--out", out]
    assert main([str(part) for part in asked]) == 0
    text = capsys.readouterr().out
    facts = json.loads((out / "wind.json").read_text())
    speed, held = facts["numbers"]["speed"], facts["numbers"]["deviation"]
    assert facts["free"] == ["speed"]
    assert held["value"] == pytest.approx(0.3 * 0.75 * SPEED)
    assert speed["value"] == pytest.approx(SPEED, rel=0.15)
    assert f" {speed['value']:.3f} " in text  # the error has two digits
    assert set(facts["channels"]) == set(NAMES)
    assert (out / "wind.png").stat().st_size > 10_000
    assert main([str(part) for part in asked]) == 2
    error = capsys.readouterr().err
    assert "--force" in error
    assert error.count("\n") == 1


@pytest.mark.quick
def test_a_beginning_that_is_unlike_the_rest_is_found():
    """Of records without a transient, at most a few are shortened."""
    times = np.arange(0.0, 600.0, 0.2)
    random = np.random.default_rng(0)
    # Gusts with a duration of several seconds.
    kernel = np.exp(-np.arange(0, 40, 0.2) / 5.0)

    def begun(amplitude, lasts, command=0.0):
        gusty = [np.convolve(random.normal(size=len(times) + 199), kernel, "valid") for _ in "yz"]
        beginning = amplitude * np.exp(-times / lasts) * np.cos(0.9 * times)
        columns = {f"link02_{axis}": g / np.std(g) for axis, g in zip("yz", gusty, strict=True)}
        columns["link02_z"] += beginning
        columns["joint01_command"] = np.where(times < 40, command, 0.0)
        return resting(MODEL, Run.from_arrays(times, columns), highest=0.5)

    assert sum(begun(0.0, 1.0).settled > 0 for _ in range(200)) <= 2
    found = [begun(15.0, 20.0).settled for _ in range(20)]
    assert 30 < min(found) <= max(found) < 120
    late = begun(0.0, 1.0, command=0.3)
    assert late.settled == pytest.approx(40.0)
    assert np.ptp(late.command) == 0
    # Short records: a few gusts long, and the gusts are longer than the blocks.
    short = 0
    for seed in range(200):
        walk = np.random.default_rng(seed).normal(size=(2 * len(times), 2))
        slow = lfilter([1.0], [1.0, -np.exp(-0.2 / 100)], walk, axis=0)[len(times) :]
        columns = {"link02_y": slow[:, 0], "link02_z": slow[:, 1]}
        run = Run.from_arrays(times, columns, definition=STILL)
        short += resting(MODEL, run, highest=0.5).settled > 0
    assert short <= 2


def test_an_arm_that_still_came_to_rest_and_the_channels_that_are_asked_for(tmp_path, capsys):
    run = read_run(RESTING)
    # Repeat the record to and fro, because one minute is too short to detect a transient.
    there = np.arange(len(run.times))
    to_and_fro = np.concatenate([there, there[-2::-1], there[1:], there[-2::-1]])
    values = {name: column[to_and_fro] for name, column in run.values.items()}
    since = np.linspace(0.0, 4 * np.ptp(run.times), len(to_and_fro))
    swing = 0.3 * np.exp(-since / 4) * np.cos(1.1 * since)
    path = tmp_path / "run.csv"
    about = {**run.definition.contents(), "sha256": None}
    values["joint01_angle"] += swing
    write_run(path, since, values, definition=about)
    words = ["wind", "--data", str(path), "--wind", ",".join(map(str, MEAN)), "--highest", "1.3"]
    words += ["--gusts", "0.15:2", "--hold", "deviation", "--hold", "length_scale", "--json"]
    speeds = []
    for more in ([], ["--skip", "0"]):
        assert main([*words, "--channels", "joint01_angle", *more]) == 0
        said = capsys.readouterr()
        assert "log-likelihood" in said.err
        facts = json.loads(said.out)
        assert facts["channels"] == ["joint01_angle"]
        speeds.append(facts["numbers"]["speed"])
        assert ("which differ from the rest" in said.out) == (not more)
    assert abs(speeds[0]["value"] - SPEED) < 3 * speeds[0]["standard_error"]
    assert abs(speeds[1]["value"] - SPEED) > 3 * speeds[1]["standard_error"]
    assert main([*words, "--channels", "link09_z"]) == 2
    assert "has no channel 'link09_z'" in capsys.readouterr().err
