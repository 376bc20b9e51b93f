"""Several initial guesses find a minimum that one misses, and report how many found it."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from giajax import InputError, Prior, Run, fit, load_result
from giajax.fitting import Start, set_up
from giajax.report import summary
from giajax.report.page import optima_table
from giajax.runtime.execution import InProcess, open_executor
from giajax.studies import (
    SAME_END,
    _multi_start,
    distinct_optima,
    lost_starts,
    misfit,
    multi_start,
    solve_from_starts,
)
from toy_model import TRUTH, Decay, height, run


def test_the_best_of_several_starts_is_the_result():
    """The other initial guesses are within the spread of the first, and the best end is kept."""
    told = []
    result = multi_start(
        Decay(),
        run(),
        starts=4,
        spread=0.5,
        seed=1,
        start={"amplitude": 0.5, "decay": 3.0},
        announce=lambda number, start: told.append((number, dict(start))),
    )
    assert result.status == "converged"
    assert [number for number, _ in told] == [1, 2, 3, 4]
    assert told[0][1] == {"amplitude": 0.5, "decay": 3.0, "offset": 0.1}
    assert len({start["decay"] for _, start in told}) == 4
    for _, start in told:
        assert 3.0 / 1.5 <= start["decay"] <= 3.0 * 1.5
    for path in ("amplitude", "decay", "offset"):
        estimate = result.parameters[path]
        assert abs(estimate.value - TRUTH[path]) < 3.5 * estimate.standard_error
    assert misfit(result) == pytest.approx(min(s.misfit for s in result.starts), abs=1e-3)
    assert result.gradient_check is not None
    assert "of 4 ended at this optimum" in summary(result)
    assert result.config["start"] == {"amplitude": 0.5, "decay": 3.0}


def test_starts_are_added_to_a_result():
    """The previous ends are reported again, and only the new initial guesses are fitted."""
    data, told = run(), []
    options = {"spread": 0.5, "seed": 1, "start": {"amplitude": 0.5, "decay": 3.0}}
    whole = multi_start(Decay(), data, starts=4, **options)
    few = multi_start(Decay(), data, starts=2, **options)
    more = multi_start(
        Decay(),
        data,
        starts=4,
        before=few,
        announce=lambda number, start: told.append(number),
        **options,
    )
    assert told == [3, 4]
    assert more.starts[:2] == few.starts
    assert [start.start for start in more.starts] == [start.start for start in whole.starts]
    assert misfit(more) == pytest.approx(misfit(whole), abs=1e-4)
    assert more.config == whole.config
    one = fit(Decay(), data, start=options["start"])
    assert multi_start(Decay(), data, starts=2, before=one, **options).starts[1].misfit is not None
    with pytest.raises(
        InputError, match="has different initial guesses: give the same seed and spread"
    ):
        multi_start(Decay(), data, starts=4, before=few, **{**options, "seed": 2})
    with pytest.raises(InputError, match="belongs to another fit"):
        multi_start(Decay(), data, starts=4, before=few, loss="huber", **options)
    with pytest.raises(InputError, match="already has 4 starts"):
        multi_start(Decay(), data, starts=3, before=whole, **options)


def test_a_start_that_fails_is_passed_over():
    """The model fails for a decay above 8, where some of the initial guesses are."""
    result = multi_start(
        Decay(), run(), starts=6, spread=2.0, seed=0, start={"decay": 5.0}, check=False
    )
    failed = [start for start in result.starts if start.status == "failed"]
    assert failed
    assert result.status == "converged"
    (best,) = distinct_optima(result)
    assert best.reached == 6 - len(failed)
    assert best.values["decay"] == pytest.approx(result.parameters["decay"].value)
    (why,) = lost_starts(result)
    assert "the model cannot be evaluated at the initial values" in why
    assert f"{len(failed)} did not converge: {why}" in summary(result)
    assert [row[:2] for row in optima_table(result).rows] == [
        ["optimum 1", str(best.reached)], [why, str(len(failed))],
    ]  # fmt: skip


def test_ends_are_compared_by_likelihood_when_the_noise_is_estimated():
    times = np.linspace(0.0, 4.0, 60)
    noisy = height(times) + 0.01 * np.random.default_rng(0).normal(size=60)
    unknown = Run.from_arrays(times, {"tip_z": noisy}, definition={"free_motion": True})
    result = multi_start(Decay(), unknown, starts=2, start={"decay": 2.0}, check=False)
    (channel,) = result.runs[0].channels.values()
    assert channel.noise == pytest.approx(0.01, rel=0.3)
    assert channel.innovation <= channel.noise
    assert misfit(result) == pytest.approx(result.cost + 60 * np.log(channel.innovation))


def test_starts_fill_priors_and_bounds_and_more_have_the_same_first_ones():
    setup = set_up(
        Decay(),
        run(),
        priors={"offset": Prior(0.5, deviation=0.1), "amplitude": Prior(2.0, factor=1.5)},
        bounds={"decay": (1.0, 3.0)},
        start={"decay": 2.0},
        seed=4,
    )
    few, many = (
        _multi_start.start_values(dataclasses.replace(setup, settings=each))
        for each in (setup.settings.model_copy(update={"starts": count}) for count in (6, 65))
    )
    assert many[:6] == few
    assert few[0]["decay"] == 2.0
    decays, offsets, amplitudes = (
        np.array([each[path] for each in many[1:]]) for path in ("decay", "offset", "amplitude")
    )
    np.testing.assert_allclose(
        np.quantile(decays, [0.25, 0.5, 0.75]), 3 ** np.array([0.25, 0.5, 0.75]), atol=0.05
    )
    np.testing.assert_allclose([offsets.mean(), offsets.std()], [0.5, 0.1], atol=0.01)
    logarithms = np.log(amplitudes)
    expected = [np.log(2.0), np.log(1.5)]
    np.testing.assert_allclose([logarithms.mean(), logarithms.std()], expected, atol=0.03)


def test_ends_that_are_as_good_and_elsewhere_are_two_optima():
    """An end that is close but has a higher cost is a third one."""
    finished = load_result(FINISHED)
    best, count = misfit(finished), sum(c.n for r in finished.runs for c in r.channels.values())
    values = {path: estimate.value for path, estimate in finished.free.items()}
    path = next(p for p, one in finished.free.items() if one.standard_error is not None)
    far = {**values, path: values[path] + 5 * finished.free[path].standard_error}
    worse = best + 2 * SAME_END * count
    ends = [(best, values), (worse, values), (best, far), (best, values)]
    starts = [Start({}, "converged", *end) for end in ends]
    starts.append(Start({}, "not_converged", best, values, "it crawls"))
    found = distinct_optima(dataclasses.replace(finished, starts=tuple(starts)))
    assert sorted((v.reached, v.values[path] == values[path], v.worse > 0) for v in found) == [
        (1, False, False), (1, True, True), (2, True, False),
    ]  # fmt: skip
    assert lost_starts(dataclasses.replace(finished, starts=tuple(starts))) == {"it crawls": 1}


# Any finished fit can be used where none is run.
FINISHED = Path(__file__).parents[1] / "fitting" / "earlier"


@pytest.mark.parametrize("interrupted_at", [1, 2, 3, 4])
def test_an_interruption_keeps_the_best_start_so_far(monkeypatch, interrupted_at):
    """Before the second fit, or the last check, has evaluated anything."""
    finished = dataclasses.replace(load_result(FINISHED), starts=())
    calls = []

    def solve(setup, **_):
        calls.append(setup)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return finished

    # In sequence, because otherwise the third fit starts before the second is interrupted.
    monkeypatch.setenv("GIAJAX_CORES", "1")
    monkeypatch.setattr(_multi_start, "solve", solve)
    monkeypatch.setattr(_multi_start, "inside_bounds", lambda setup, values: {"decay": 2.0})
    if interrupted_at == 1:
        with pytest.raises(KeyboardInterrupt):
            multi_start(Decay(), run(), starts=3)
        return
    result = multi_start(Decay(), run(), starts=3)
    assert len(calls) == interrupted_at
    assert result.status == "interrupted"
    assert result.parameters == finished.parameters
    at = "before the result was checked" if interrupted_at == 4 else f"at start {interrupted_at}"
    assert f"; interrupted {at}" in result.message
    ends = [start.status for start in result.starts]
    assert ends == ["converged"] * min(interrupted_at - 1, 3) + ["interrupted"] * (
        interrupted_at < 4
    )


@pytest.mark.slow
def test_spawned_processes_end_where_threads_do(tmp_path):
    """The ends and a prediction are the same, and the files of the tasks are removed."""
    options = {
        "starts": 6, "spread": 2.0, "start": {"decay": 5.0}, "check": False,
    }  # fmt: skip
    here, told = multi_start(Decay(), run(), **options), []
    with open_executor(2, None) as executor:
        there = multi_start(
            Decay(),
            run(),
            **options,
            executor=executor,
            folder=tmp_path,
            announce=lambda number, start: told.append(number),
        )
    assert sorted(told) == [
        number for number, one in enumerate(here.starts, 1) if one.status != "failed"
    ]
    assert {start.status for start in here.starts} == {"converged", "failed"}
    for one, other in zip(here.starts, there.starts, strict=True):
        assert (one.start, one.status, one.message) == (other.start, other.status, other.message)
        for path, value in (one.parameters or {}).items():
            error = here.parameters[path].standard_error
            assert abs(other.parameters[path] - value) < 1e-6 * error
    assert len(there.predictions) == 1
    assert there.verdict == here.verdict
    files = {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert len(files) == sum(start.status == "converged" for start in here.starts) - 1
    again = multi_start(Decay(), run(), **options, executor=InProcess(), folder=tmp_path)
    assert again.starts == there.starts
    assert {path.name: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == files


def test_a_start_without_time_is_no_failure(tmp_path):
    """The budget ends before the other fits start, and none of them is stored as ended."""
    options = {"start": {"amplitude": 0.5, "decay": 3.0}}
    first = multi_start(Decay(), run(), starts=1, check=False, **options)
    result = solve_from_starts(
        set_up(Decay(), run(), starts=4, budget="0s", **options), before=first,
        executor=InProcess(), folder=tmp_path,
    )  # fmt: skip
    assert len(result.starts) == 1
    assert "after 1 of 4 starts" in result.message
    assert list(tmp_path.iterdir()) == []
