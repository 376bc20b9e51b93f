"""Parameters that the data cannot determine, for models in which these are known."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq, least_squares, minimize_scalar
from test_blocks import OwnHeights, recording

from giajax import Prior, Run, fit, pendulum, predict
from giajax.fitting import (
    Finding,
    Statistics,
    _estimates as _findings,
    combinations,
    inverse_gram,
    undetermined_groups,
)
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel, model_for
from giajax.runtime.records import from_plain
from giajax.schema import parameters as _parameters
from small_arm import COMMANDS, DEFINITION, LINKS, NOISE, START, TIMES, TRUTH
from toy_model import Decay, height, run

ROOT = Path(__file__).parents[2]


def coded(result):
    return {finding.code: finding for finding in result.findings}


def test_a_good_fit_has_none():
    assert fit(Decay(), run(), noise_model="white").findings == ()


def test_outliers_of_a_window_are_named_by_time():
    """The rows of a window are not counted from the first row of the file."""
    whole = run(samples=200)
    values = whole.values["tip_z"].copy()
    values[[70, 150]] += 1.0
    whole = replace(whole, name="drop", path=Path("drop.csv"), values={"tip_z": values})
    part = replace(whole, name="drop 2 s", times=whole.times[60:], values={"tip_z": values[60:]})
    for recorded, where in (whole, "tip_z in row 72, 152"), (part, "tip_z at 1.407035, 3.015075 s"):
        finding = coded(fit(Decay(), recorded, noise_model="white"))["outliers"]
        assert finding.sentence.endswith(where)


def test_what_has_no_response_is_named():
    free = ["amplitude", "decay", "offset", "idle"]
    finding = coded(fit(Decay(), run(), free=free, noise_model="white"))
    assert list(finding) == ["no_response"]
    assert finding["no_response"].paths == ("idle",)


def test_a_model_that_describes_nothing_is_asked_first_whatever_passes_for_noise():
    """A prior is not advised if the estimated noise is due to missing physics."""
    recorded = run(samples=200, state_noise=False)
    waves = 2 * np.sin(3 * recorded.times) + np.random.default_rng(0).normal(scale=0.01, size=200)
    wrong = replace(recorded, values={"tip_z": waves})
    free = ["amplitude", "decay", "offset", "idle"]
    result = fit(Decay(), wrong, free=free, max_iterations=20)
    assert result.reduced_chi_square < 5
    finding = coded(result)["no_response"]
    assert finding.advice.startswith("first find out why the model does not describe the data")
    early = fit(Decay(), wrong, free=free, max_iterations=5)
    assert early.reason == "iterations"
    assert "the model does not describe the data" in early.message
    assert "allow more iterations" not in early.message
    advised = coded(fit(Decay(), recorded, free=free))["no_response"].advice
    assert "give it a prior" in advised


def test_where_most_cells_are_far_off_they_are_no_outliers():
    """A loss that tolerates outliers must not tolerate a whole recording."""
    recorded = run(samples=200)
    waves = 2 * np.sin(3 * recorded.times) + np.random.default_rng(0).normal(scale=0.01, size=200)
    free = ["amplitude", "decay", "offset", "idle"]
    for values, said in (
        (waves, "first find out why"),
        (recorded.values["tip_z"], "hold it fixed, give it a prior"),
    ):
        again = replace(recorded, values={"tip_z": values})
        result = fit(Decay(), again, free=free, loss="student_t", max_iterations=20)
        assert coded(result)["no_response"].advice.startswith(said)


def test_of_columns_without_any_response_each_is_a_group():
    jacobian = np.random.default_rng(0).normal(size=(9, 4)) * [1.0, 0.0, 2.0, 0.0]
    assert sorted(undetermined_groups(jacobian)) == [[1], [3]]


def test_a_product_is_named_with_its_error():
    """amplitude twin is as accurate as the amplitude in a fit that holds the twin."""
    result = fit(Decay(), run(), free=["amplitude", "decay", "offset", "twin"], start={"twin": 1.4})
    alone = fit(Decay(), run()).parameters["amplitude"]
    finding = coded(result)["only_combinations"]
    assert finding.paths == ("amplitude", "twin")
    shown = re.search(r"only amplitude \* twin = ([\d.]+) \+- ([\d.]+)$", finding.sentence)
    assert float(shown[1]) == pytest.approx(alone.value, abs=6e-4)
    assert float(shown[2]) == pytest.approx(alone.standard_error, rel=0.05)
    assert from_plain(Finding, {**vars(finding), "paths": list(finding.paths)}) == finding


def test_the_error_of_a_combination_of_powers_is_that_of_the_fit():
    """A direction of three positive parameters with different powers, and one of a sum."""
    logs = np.random.default_rng(3).normal(size=(60, 2))
    # The identifiable combinations are p^2 / q and r q: (1, 2, -2) in logarithms is not observable.
    values = np.array([2.0, 3.0, 5.0])
    design = logs @ np.array([[2.0, -1.0, 0.0], [0.0, 1.0, 1.0]])
    known = _statistics(design / values, values)
    groups = combinations(known, [True] * 3, [False, True, False])
    ((members, parts),) = groups
    assert members == (0, 1, 2)
    assert [part.text for part in parts] == ["p0 / p1^(1/2)", "p2 * p1"]
    covariance = np.linalg.inv(logs.T @ logs)
    assert parts[1].value == pytest.approx(15.0)
    assert parts[1].standard_error == pytest.approx(15.0 * np.sqrt(covariance[1, 1]))
    assert parts[0].value == pytest.approx(2 / np.sqrt(3))
    assert parts[0].standard_error == pytest.approx(2 / np.sqrt(3) / 2 * np.sqrt(covariance[0, 0]))
    # As a sum: of p0 and p1, only p0 + 2 p1 is identifiable.
    line = np.outer(np.arange(60.0), [1.0, 2.0, 0.0]) + np.outer(np.ones(60), [0.0, 0.0, 1.0])
    ((members, parts),) = combinations(_statistics(line, values), [True, False, True], [False] * 3)
    assert members == (0, 1)
    assert [part.text for part in parts] == ["p1 + 0.5 p0"]
    assert parts[0].value == pytest.approx(4.0)


def _statistics(jacobian, values):
    count = jacobian.shape[1]
    return Statistics(
        labels=tuple(f"p{i}" for i in range(count)),
        values=values,
        alive=np.arange(count),
        together=(),
        determined=(),
        standard_errors={},
        degrees_of_freedom={},
        sandwich={},
        widening={},
        correlation=np.eye(0),
        root=np.linalg.qr(jacobian, mode="r"),
        covariance=inverse_gram(jacobian),
        reduced_chi_square=1.0,
        prior_degrees_of_freedom=0.0,
        scale=1.0,
        bounds={},
    )


def test_pairs_and_priors_are_named():
    priors = {"twin": Prior(1.1, factor=1.2), "offset": Prior(0.5, deviation=0.01)}
    result = fit(Decay(), run(), free=["amplitude", "decay", "offset", "twin"], priors=priors)
    found = coded(result)
    assert found["correlated"].paths == ("amplitude", "twin")
    assert "-0.9" in found["correlated"].sentence
    assert found["against_its_prior"].paths == ("offset",)
    assert found["mostly_its_prior"].paths == ("twin",)
    assert "only_combinations" not in found


def test_the_one_sided_interval_is_where_the_cost_says():
    """Bounds just below the best decay, compared with scipy for fixed decays."""
    recorded = run()
    bounds = {"decay": (0.2, 0.7)}
    result = fit(Decay(), recorded, start={"decay": 0.5}, bounds=bounds, noise_model="white")
    finding = coded(result)["at_a_bound"]
    sigma = 0.01 * np.sqrt(max(result.reduced_chi_square, 1.0))

    def cost(decay):
        def rows(free):
            predicted = height(recorded.times, amplitude=free[0], decay=decay, offset=free[1])
            return (predicted - recorded.observations["tip_z"]) / sigma

        return least_squares(rows, [2.0, 0.3]).cost

    reach = brentq(lambda decay: cost(decay) - cost(0.7) - 1.645**2 / 2, 0.6, 0.7)
    shown = re.search(
        r"upper bound 0.7, and its value is at least ([\d.]+) \(one-sided", finding.sentence
    )
    assert float(shown[1]) == pytest.approx(reach, abs=6e-4)
    assert 0.68 < reach < 0.7


def test_curvature_is_that_of_the_cost():
    """Compare with both sides of the cost profile; the model is linear except in the decay."""
    recorded = run(sigma=0.8)
    start = {"amplitude": 1.5, "decay": 0.9}
    result = fit(Decay(), recorded, start=start, noise_model="white")
    finding = coded(result)["curved"]
    assert finding.paths == ("decay",)
    error = result.parameters["decay"].standard_error

    def cost(decay):
        wave = np.stack([np.exp(-decay * recorded.times), np.ones(60)], axis=1)
        data = recorded.observations["tip_z"]
        left = wave @ np.linalg.lstsq(wave, data, rcond=None)[0] - data
        return np.sum(left**2) / 2 / 0.8**2

    step = 0.2
    best = minimize_scalar(cost, bounds=(1, 3), method="bounded", options={"xatol": 1e-8}).x
    sides = [cost(best + sign * step * error) - cost(best) for sign in (1, -1)]
    skew = (sides[0] - sides[1]) / (sides[0] + sides[1]) / step
    shown = re.search(r"two sides differ by ([-+]\d+)%", finding.sentence)
    # The third derivative of the residuals is neglected, which matters for large noise.
    assert float(shown[1]) / 100 == pytest.approx(skew, abs=0.15)
    assert skew < -0.25


def test_short_records_are_named():
    (finding,) = _findings._short([("a", 8.0), ("b", 25.0)])
    assert finding.code == "short_record"
    assert finding.sentence == "the recording 'a' lasts only 8 correlation times of its noise"


def test_states_of_single_runs_take_part():
    """With a decay near zero, height and drift of a run have the same effect."""
    runs = [recording(index)[0] for index in (0, 1)]
    assert not {"no_response", "only_combinations"} & set(coded(fit(OwnHeights(), runs)))


@pytest.mark.quick
def test_every_finding_has_its_section_and_ends_with_advice():
    source = Path(_findings.__file__).read_text(encoding="utf-8")
    codes = re.findall(r'Finding\(\s*"(\w+)"', source)
    sections = re.findall(r"^## (\w+)$", (ROOT / "docs/findings.md").read_text(), re.MULTILINE)
    assert sorted(codes) == sorted(sections)
    assert len(codes) == 10
    assert Finding("curved", (), "", "").page == "docs/findings.md#curved"


@pytest.mark.slow
def test_a_pendulum_shows_ratios_and_no_mass():
    """With angles alone, in gravity, mass, inertia and damping have no intervals."""
    about = {"arm": {"preset": "pendulum", "links": 1}, "initial": {"angle_deg": 40.0}}
    truth = ArmModel(pendulum(1, parameters={"joints.damping": 0.05}))
    times = np.linspace(0.0, 6.0, 121)
    clean = predict(truth, Run.from_arrays(times, {"joint01_angle": 0 * times}, definition=about))
    random = np.random.default_rng(0)
    noisy = {name: value + 0.01 * random.normal(size=121) for name, value in clean.items()}
    recorded = Run.from_arrays(times, noisy, noise={"angle": 0.01}, definition=about)
    start = {"links.mass": 1.3, "joints.damping": 0.03}
    free = ["joints.damping", "links.inertia_transverse", "links.mass"]
    result = fit(truth, recorded, free=free, start=start)
    assert result.status == "converged"
    assert [estimate.standard_error for estimate in result.free.values()] == [None] * 3
    finding = coded(result)["only_combinations"]
    assert set(finding.paths) == set(result.free)
    shown = re.findall(r"([\w.\[\]]+) / ([\w.\[\]]+) = ([\d.]+) \+- ([\d.]+)", finding.sentence)
    inertia = float(truth.arm.links.inertia_transverse[0] / truth.arm.links.mass[0])
    size = {"links.inertia_transverse[0]": inertia, "links.mass[0]": 1.0, "joints.damping": 0.05}
    assert len(shown) == 2
    for above, below, value, error in shown:
        assert abs(float(value) - size[above] / size[below]) < 3.5 * float(error)
        assert float(error) < 0.03 * float(value)


def test_joints_that_do_not_answer_their_commands_make_a_fit_doubtful():
    """The estimated stiffness of a drive without effect is 0, and the residuals are white noise."""
    channels = ("link02_y", "link04_y", "link04_z")
    moved = Run.from_arrays(
        TIMES,
        {**COMMANDS, "joint02_command": 0 * TIMES, channels[0]: 0 * TIMES},
        definition=DEFINITION,
    )
    model = _parameters.replace(ArmModel(takeichi_20m(LINKS)), TRUTH)
    random = np.random.default_rng(0)
    recorded = {
        name: values + NOISE * random.normal(size=len(TIMES))
        for name, values in predict(model, moved, channels).items()
    }
    told = Run.from_arrays(TIMES, {**COMMANDS, **recorded}, definition=DEFINITION)
    result = fit(model_for([told]), told, free=list(TRUTH), start=START, check=False)
    assert result.parameters["joints.yaw_stiffness"].value < 1e-2
    assert result.verdict.status == "doubtful"
    assert result.verdict.reasons[0].code == "vanished"
    assert "which is 0 to within its standard error" in result.headline
    # This also holds for a fit that starts at the optimum, as after several initial guesses.
    again = fit(
        model_for([told]),
        told,
        free=list(TRUTH),
        start={path: float(one.value) + 1e-6 for path, one in result.free.items()},
        check=False,
    )
    assert again.verdict.reasons[0].code == "vanished"
    # Only this parameter is named, not one that may well be 0.
    free = ["joints.yaw_stiffness", "joints.damping"]
    right = {**START, "joints.pitch_stiffness": 2.5, "air.drag_coefficient": 1.1}
    undamped = _parameters.replace(model, {"joints.damping": 0.0})
    still = Run.from_arrays(TIMES, {**COMMANDS, channels[0]: 0 * TIMES}, definition=DEFINITION)
    seen = {
        name: values + 1e-4 * random.normal(size=len(TIMES))
        for name, values in predict(undamped, still, channels).items()
    }
    stated = {**DEFINITION, "noise": {"position_m": 1e-4}}
    told = Run.from_arrays(TIMES, {**COMMANDS, **seen}, definition=stated)
    result = fit(model_for([told]), told, free=free, start=right, check=False)
    assert result.parameters["joints.damping"].value < 1e-3
    assert result.verdict.status == "adequate"
