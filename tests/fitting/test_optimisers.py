"""Solvers of optimistix as replacements of giajax's own."""

import concurrent.futures

import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest

import giajax
import small_loops
from giajax import InputError, fit
from giajax.fitting import Marquardt
from toy_model import Decay, run

FINE = {"rtol": 1e-10, "atol": 1e-10}
START = {"amplitude": 1.4, "decay": 1.1, "offset": 0.1}


@pytest.mark.parametrize(
    "options",
    [
        {},
        # Squares of the root of this loss have another curvature, so convergence is linear.
        {
            "loss": "soft_l1",
            "priors": {"offset": giajax.Prior(0.25, 0.01)},
            "max_iterations": 500,
        },
        {"noise_model": "correlated"},
    ],
    ids=["linear", "robust with a prior", "estimated noise"],
)
@pytest.mark.parametrize(
    "optimiser",
    [optx.LevenbergMarquardt(**FINE), optx.Dogleg(**FINE), Marquardt(distance=1e-5)],
    ids=lambda optimiser: type(optimiser).__name__,
)
def test_it_ends_at_the_optimum_of_giajax_with_its_statistics(optimiser, options):
    recording = run(state_noise="noise_model" not in options)
    by_giajax = fit(Decay(), recording, start=START, **options)
    found = fit(Decay(), recording, start=START, optimiser=optimiser, **options)
    assert (found.status, found.reason) == ("converged", "optimum")
    assert found.iterations > 1
    assert found.verdict.status == by_giajax.verdict.status
    for path, one in found.free.items():
        other = by_giajax.parameters[path]
        # giajax's own solver ends within 0.01 standard errors of the optimum.
        assert abs(one.value - other.value) < 1e-2 * other.standard_error, path
        assert one.standard_error == pytest.approx(other.standard_error, rel=1e-2)
    assert found.config["optimiser"].startswith(type(optimiser).__name__)
    assert "optimiser" not in by_giajax.config


def test_two_optimisers_end_at_the_same_point():
    ends = [
        fit(Decay(), run(), start=START, optimiser=optimiser, check=False).free
        for optimiser in (optx.LevenbergMarquardt(**FINE), optx.Dogleg(**FINE))
    ]
    for path, one in ends[0].items():
        assert abs(one.value - ends[1][path].value) < 1e-4 * one.standard_error


class Idle(Marquardt):
    """A solver that never moves."""

    def terminate(self, *args):
        return jnp.asarray(True), optx.RESULTS.successful


@pytest.mark.parametrize(
    ("options", "reason", "sentence"),
    [
        (
            {"max_iterations": 2},
            "iterations",
            "Marquardt found no optimum in 2 iterations",
        ),
        ({"optimiser": Idle()}, "crawl", "ended before convergence: give it smaller"),
    ],
    ids=["iterations", "idle"],
)
def test_where_it_ends_elsewhere_the_result_says_so(options, reason, sentence):
    options = {"optimiser": optx.LevenbergMarquardt(**FINE), **options}
    found = fit(Decay(), run(), start=START, **options)
    assert (found.status, found.reason) == ("not_converged", reason)
    assert sentence in found.message
    assert np.isfinite(found.cost)
    assert found.verdict.status in ("doubtful", "inadequate")
    assert found.verdict.reasons[-1].code == "end"


def test_rounds_of_noise_share_the_iterations():
    recording, optimiser = run(state_noise=False), optx.LevenbergMarquardt(**FINE)
    found = fit(Decay(), recording, start=START, optimiser=optimiser, max_iterations=23)
    assert found.iterations <= 23
    assert "no optimum in 23 iterations" in found.message
    whole = fit(Decay(), recording, start=START, optimiser=optimiser, max_iterations=200)
    assert whole.iterations > 23
    assert whole.status == "converged"


def test_a_failing_model_and_bounds_are_no_way_out():
    """The model fails for a decay above 8, but the bound is 9; one parameter is at its bound."""
    start = {"amplitude": 1.0, "decay": 7.9, "offset": 0.0}
    bounds = {"offset": (-0.5, 0.2)}
    by_giajax = fit(Decay(), run(), start=start, bounds=bounds, check=False)
    optimiser = optx.LevenbergMarquardt(**FINE)
    options = {"optimiser": optimiser, "max_iterations": 500}
    found = fit(Decay(), run(), start=start, bounds=bounds, check=False, **options)
    assert found.parameters["offset"].value == pytest.approx(0.2, abs=1e-12)
    for path, one in found.free.items():
        assert one.value == pytest.approx(by_giajax.parameters[path].value, rel=1e-4), path


@pytest.mark.quick
@pytest.mark.parametrize("optimiser", [optx.BFGS(**FINE), optx.Newton(**FINE), "dogleg", 3])
def test_what_is_no_least_squares_solver_is_refused(optimiser):
    with pytest.raises(InputError, match=r"fit.optimiser = .* must be a least-squares solver"):
        fit(Decay(), run(), optimiser=optimiser)


def test_what_cannot_be_journalled_or_sent_to_workers_says_so(tmp_path):
    recording, optimiser, steps = run(), optx.Dogleg(**FINE), []
    with (
        concurrent.futures.ThreadPoolExecutor(1) as executor,
        pytest.raises(InputError, match="support only giajax's own optimiser: omit"),
    ):
        giajax.multi_start(
            Decay(), recording, start=START, starts=3, optimiser=optimiser, executor=executor,
            progress=steps.append,
        )  # fmt: skip
    assert not steps
    before = fit(Decay(), recording, start=START, check=False)
    with pytest.raises(
        InputError, match="the result to which starts are added belongs to another fit"
    ):
        giajax.multi_start(
            Decay(), recording, start=START, starts=3, before=before, optimiser=optimiser
        )
    small_loops.write_task(tmp_path)
    task = giajax.FitTask.load(tmp_path / "loops_fit.toml").on_top(optimiser=optimiser)
    with pytest.raises(InputError, match=r"a fit with Dogleg\(rtol=1e-10, .*no steps to record"):
        task.on_top(max_iterations=60).run(journal=tmp_path / "kept")
    ready = task.on_top(noise_model="white", max_iterations=500).prepare()
    result = ready.run(check=False)
    assert result.status == "converged"
    giajax.write_result(result, ready.runs, tmp_path / "kept", figures=False)
    with pytest.raises(InputError, match=r"a fit with Dogleg.*repeat the fit from Python"):
        giajax.FitTask.again(tmp_path / "kept")
