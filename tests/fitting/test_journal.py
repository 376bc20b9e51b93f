"""A fit continues from any line of its journal to the same result, bit for bit; and budgets."""

import dataclasses
import json
import os
import time

import numpy as np
import pytest

from damage import damages
from giajax import InputError
from giajax.fitting import Budget, _fit, _loop, fit, set_up, solve
from giajax.studies import _multi_start, multi_start, solve_from_starts
from giajax.tasks import JOURNAL, Journal, read_journal
from toy_model import Decay, run

START = {"amplitude": 0.5, "decay": 3.0}
HEAD = {
    "versions": {},
    "task": {
        "definition": {},
        "data": [],
        "validation": [],
        "rename": {},
        "source": None,
        "out": "",
        "begin": None,
        "inputs": {},
    },
    "config": {
        "definition": {},
        "runs": [],
        "free": [],
        "start": {},
        "fix": {},
        "loss": "linear",
        "max_iterations": 1,
    },
}

# Situations in a fit: noise estimated in several rounds, an initial guess moved off a bound, a
# robust loss, a parameter that is held because the data do not depend on it.
FITS = {
    "stated noise": (run(), {"start": START}),
    "estimated noise": (run(state_noise=False), {"start": START}),
    "off its bound": (run(), {"start": {"decay": 1e-10}}),
    "robust": (run(state_noise=False, seed=3), {"start": START, "loss": "huber"}),
    "held": (run(), {"start": START, "free": ["amplitude", "idle", "decay"]}),
}


def numbers(result):
    """Return the content of a result without the times."""
    record = json.loads(result.to_json())
    del record["seconds"]
    return record


def journalled(folder, setup, **options):
    """Return the result of a fit that keeps a journal."""
    journal = read_journal(folder) or Journal(folder / JOURNAL, HEAD)
    try:
        return solve(setup, journal=journal.of(1), **options)
    finally:
        journal.close()


@pytest.mark.slow
@pytest.mark.parametrize("case", FITS)
def test_from_any_line_to_the_same_end(tmp_path, case):
    """Continue after the first line, in the middle, and after the last line without a result."""
    recorded, asked = FITS[case]
    setup = set_up(Decay(), recorded, **asked)
    plain = numbers(solve(setup, check=False))
    assert numbers(journalled(tmp_path, setup, check=False)) == plain
    path = tmp_path / JOURNAL
    whole = path.read_bytes().splitlines(keepends=True)
    states = [json.loads(line) for line in whole[1:]]
    assert len(states) > plain["iterations"]
    assert states[-1]["ending"][0] == plain["status"]
    for count in (1, len(whole) // 2, len(whole)):
        torn = whole[count][:30] if count < len(whole) else b""
        path.write_bytes(b"".join(whole[:count]) + torn)
        assert numbers(journalled(tmp_path, setup, check=False)) == plain, count
        # The journal contains the same states as that of an uninterrupted fit.
        again = [json.loads(line) for line in path.read_bytes().splitlines()[1:]]
        assert [line["coordinate"] for line in again] == [line["coordinate"] for line in states]


def test_the_cases_are_what_they_say():
    """The cases include several rounds of noise estimation, and an initial guess at a bound."""
    kept = {}
    for case in ("estimated noise", "off its bound"):
        written = kept[case] = []

        class Kept:
            lines = ()
            append = written.append

        recorded, asked = FITS[case]
        solve(set_up(Decay(), recorded, **asked), journal=Kept())
    assert any(line["rounds_left"] < 3 for line in kept["estimated noise"])
    assert len({line["round_began"] for line in kept["estimated noise"]}) > 1
    decays = [
        step["parameters"]["decay"] for line in kept["off its bound"] for step in line["history"]
    ]
    assert decays[0] < 1e-9
    np.testing.assert_allclose(decays[-1], 0.7, atol=0.1)


def test_a_journal_is_readable_after_any_byte(tmp_path):
    journalled(tmp_path, set_up(Decay(), run(), start=START), max_iterations=2)
    path = tmp_path / JOURNAL
    data = path.read_bytes()
    first = data.index(b"\n", data.index(b"\n") + 1) + 1
    edges = {0, first - 1, first, first + 1, len(data) - 1, len(data)}
    for size in sorted({*range(0, len(data), 101), *edges}):
        path.write_bytes(data[:size])
        journal = read_journal(tmp_path)
        assert (journal is not None) == (size >= first)
        # After a crash, a disk may have zeros in place of the content.
        path.write_bytes(data[:size] + bytes(7))
        assert (read_journal(tmp_path) is not None) == (size >= first)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda lines: [lines[0], b"{]", *lines[2:]], "damaged at line 2"),
        (lambda lines: [b"[" * 100_000, *lines[1:]], "damaged at line 1"),
        (lambda lines: [b'{"a": 1}', *lines[1:]], "damaged at line 1"),
        (lambda lines: [lines[0].replace(b": 2", b": 1", 1), *lines[1:]], "another version"),
    ],
)
def test_a_damaged_journal_is_one_sentence(tmp_path, change, sentence):
    journalled(tmp_path, set_up(Decay(), run(), start=START), max_iterations=2)
    path = tmp_path / JOURNAL
    path.write_bytes(b"\n".join(change(path.read_bytes().splitlines())) + b"\n")
    with pytest.raises(InputError, match=sentence) as raised:
        read_journal(tmp_path)
    assert ": " in str(raised.value)


def test_the_journal_of_another_fit_is_one_sentence(tmp_path):
    journalled(tmp_path, set_up(Decay(), run(), start=START), max_iterations=2)
    with pytest.raises(InputError, match="belongs to another fit"):
        journalled(tmp_path, set_up(Decay(), run(), start=START, free=["decay"]))


def disk_with(state):
    """Return `os.write` for a disk with limited space, which it fills before it refuses more."""
    write = os.write

    def limited(descriptor, data):
        part = state["room"] - os.lseek(descriptor, 0, os.SEEK_CUR)
        if part <= 0:
            raise OSError(28, "No space left on device")
        return write(descriptor, data[:part])

    return limited


@pytest.mark.parametrize("room", [0, 900, 1_500])
def test_a_full_disk_ends_no_fit_and_loses_no_line(tmp_path, monkeypatch, room):
    """The system accepts some bytes and then no more, until there is space again."""
    setup = set_up(Decay(), run(), start=START)
    plain = numbers(solve(setup))
    state = {"room": room}
    monkeypatch.setattr(os, "write", disk_with(state))
    complaints = []
    journal = Journal(tmp_path / JOURNAL, HEAD, complain=complaints.append)

    def make_room(iteration):
        if iteration.number == 3:
            state["room"] = 1 << 30

    result = solve(setup, journal=journal.of(1), progress=make_room)
    journal.close()
    assert numbers(result) == plain
    assert len(complaints) == 1
    assert "No space left" in complaints[0]
    kept = read_journal(tmp_path).of(1).lines
    assert [item["number"] for line in kept for item in line["history"]] == list(
        range(plain["iterations"] + 1)
    )


def test_a_disk_that_stays_full_leaves_what_it_took(tmp_path, monkeypatch):
    setup = set_up(Decay(), run(), start=START)
    with monkeypatch.context() as patched:
        patched.setattr(os, "write", disk_with({"room": 2_000}))
        plain = numbers(journalled(tmp_path, setup))
    assert (tmp_path / JOURNAL).stat().st_size <= 2_000
    assert len(read_journal(tmp_path).of(1).lines) >= 1
    assert numbers(journalled(tmp_path, setup)) == plain


def test_other_bits_are_said(tmp_path):
    setup = set_up(Decay(), run(), start=START)
    journalled(tmp_path, setup, max_iterations=2)
    path = tmp_path / JOURNAL
    *lines, last = path.read_text().splitlines()
    record = json.loads(last)
    record["cost"] *= 1 + 1e-15
    path.write_text("\n".join([*lines, json.dumps(record), ""]))
    journal, complaints = read_journal(tmp_path), []
    journal.complain = complaints.append
    assert solve(setup, journal=journal.of(1)).status == "converged"
    journal.close()
    assert len(complaints) == 1
    assert "last digits" in complaints[0]


def test_a_budget_ends_a_fit_with_the_best_so_far(tmp_path):
    setup = set_up(Decay(), run(), start=START)
    plain = numbers(solve(setup))
    result = journalled(tmp_path, setup, budget=Budget(1e-9))
    assert result.status == "not_converged"
    assert result.message.startswith("the time budget of 1e-09 s was exhausted after 0 iterations")
    assert result.gradient_check is None
    assert result.config["budget_s"] == 1e-9
    # With more time, the fit continues to the same result.
    assert numbers(journalled(tmp_path, setup)) == plain
    assert fit(Decay(), run(), start=START, budget=60.0).status == "converged"


def test_a_budget_ends_before_a_step_that_it_has_no_time_for(monkeypatch):
    """A simulated clock: steps take 2 s, and 7 s allow three steps after the compiling one."""
    clock = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    trial = _loop.trial

    def timed(state):
        clock[0] += 2.0
        after = trial(state)
        return dataclasses.replace(after, step_seconds=(*state.step_seconds, 2.0))

    monkeypatch.setattr(_loop, "trial", timed)
    result = solve(set_up(Decay(), run(), start=START), budget=Budget(7.0))
    assert result.iterations == 3
    assert "the time budget of 7 s was exhausted after 3 iterations" in result.message


@pytest.mark.parametrize("ended_at", [2, 3])
def test_a_budget_ends_several_starts(monkeypatch, ended_at):
    """The result is the best fit so far, and reports that some initial guesses are missing."""
    clock, begun = [0.0], []
    monkeypatch.setenv("GIAJAX_CORES", "1")
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])

    def announce(number, start):
        begun.append(number)
        clock[0] = 10.0 * (number == ended_at)

    result = multi_start(Decay(), run(), starts=4, start=START, budget=5.0, announce=announce)
    assert begun == list(range(1, ended_at + 1))
    assert result.status == "not_converged"
    assert f"the time budget of 5 s was exhausted after {ended_at} of 4 starts" in result.message
    assert [start.status for start in result.starts] == ["converged"] * (ended_at - 1) + [
        "not_converged"
    ]
    assert result.parameters["decay"].value == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize("cores", ["1", "2"])
def test_a_start_that_the_budget_ends_is_the_last(monkeypatch, cores):
    """The remaining budget is too short for a step, but no fit counts as interrupted."""
    limit, begun = _loop._limit, []
    monkeypatch.setenv("GIAJAX_CORES", cores)

    def limited(state, most, budget):
        if len(begun) >= 2 and state.evaluated and not state.done:
            return f"{budget.ended_it} after {state.trials} iterations", "budget"
        return limit(state, most, budget)

    monkeypatch.setattr(_loop, "_limit", limited)
    result = multi_start(
        Decay(),
        run(),
        starts=6,
        start=START,
        budget=1e6,
        announce=lambda number, start: begun.append(number),
    )
    assert result.reason == "budget"
    assert result.status == "not_converged"
    assert 2 <= len(result.starts) < 6
    assert {start.status for start in result.starts} <= {"converged", "not_converged"}


def test_starts_that_have_ended_are_not_run_again(tmp_path, monkeypatch):
    monkeypatch.setenv("GIAJAX_CORES", "1")
    setup = set_up(Decay(), run(), start=START, starts=3, seed=1)

    def several(**options):
        journal = read_journal(tmp_path) or Journal(tmp_path / JOURNAL, HEAD)
        result = solve_from_starts(setup, journal=journal.of, **options)
        journal.close()
        return result

    plain = numbers(solve_from_starts(setup))
    assert numbers(several()) == plain
    path = tmp_path / JOURNAL
    whole = path.read_text().splitlines(keepends=True)
    third = next(i for i, line in enumerate(whole) if json.loads(line).get("fit") == 3)
    # The journal ends in the third fit after two steps, then in the check of the best fit.
    fourth = next(i for i, line in enumerate(whole) if json.loads(line).get("fit") == 4)
    for count, next_one in ((third + 3, 3), (fourth + 1, 1)):
        path.write_text("".join(whole[:count]))
        told = []
        assert numbers(several(progress=told.append)) == plain
        assert told[0].number == next_one
        assert len(told) <= len(whole) - count


def test_from_any_line_of_starts_side_by_side_to_the_same_end(tmp_path, monkeypatch):
    """The lines of parallel fits alternate."""
    setup = set_up(Decay(), run(), start=START, starts=3, seed=1)

    def several(cores):
        monkeypatch.setenv("GIAJAX_CORES", cores)
        journal = read_journal(tmp_path) or Journal(tmp_path / JOURNAL, HEAD)
        result = solve_from_starts(setup, journal=journal.of)
        journal.close()
        return numbers(result)

    plain = several("2")
    path = tmp_path / JOURNAL
    whole = path.read_text().splitlines(keepends=True)
    path.unlink()
    assert several("1") == plain
    fits = [json.loads(line).get("fit") for line in whole]
    for count in (fits.index(2) + 1, len(whole) // 2, len(whole) - 1):
        path.write_text("".join(whole[:count]))
        assert several("2") == plain


def test_ctrl_c_while_the_result_is_made_keeps_the_fit(monkeypatch):
    conclude, calls = _fit.conclude, []

    def interrupted(state, **options):
        calls.append(options["check"])
        if len(calls) == 1:
            raise KeyboardInterrupt
        return conclude(state, **options)

    monkeypatch.setattr(_fit, "conclude", interrupted)
    result = fit(Decay(), run(), start=START)
    assert calls == [True, False]
    assert result.status == "interrupted"
    assert "then interrupted before the result was checked" in result.message
    values = {path: estimate.value for path, estimate in result.free.items()}
    monkeypatch.undo()
    plain = fit(Decay(), run(), start=START).free
    assert values == {path: estimate.value for path, estimate in plain.items()}


def test_a_signal_between_the_best_start_and_its_check_is_kept(tmp_path, monkeypatch):
    """The journal contains all fits, so only the check remains."""
    setup = set_up(Decay(), run(), start=START, starts=2, seed=1)
    plain = numbers(solve_from_starts(setup))

    def stopped(*_):
        raise KeyboardInterrupt

    journal = Journal(tmp_path / JOURNAL, HEAD)
    with monkeypatch.context() as patched:
        patched.setattr(_multi_start, "inside_bounds", stopped)
        result = solve_from_starts(setup, journal=journal.of)
    journal.settle(result)
    journal.close()
    assert result.status == "interrupted"
    journal = read_journal(tmp_path)
    assert journal.is_written
    told = []
    again = solve_from_starts(setup, journal=journal.of, progress=told.append)
    assert numbers(again) == plain
    assert told
    journal.settle(again)
    assert not (tmp_path / JOURNAL).exists()


def test_kept_numbers_are_exact():
    """JSON preserves every float exactly."""
    values = np.random.default_rng(0).normal(size=600) * 10.0 ** np.arange(-300.0, 300.0)
    assert json.loads(json.dumps(values.tolist())) == values.tolist()


def test_a_damaged_journal_goes_on_or_is_refused_in_a_sentence(tmp_path):
    setup = set_up(Decay(), run(state_noise=False), start=START)
    journalled(tmp_path, setup, check=False, max_iterations=3)
    path = tmp_path / JOURNAL
    lines = path.read_text().splitlines()
    refused = 0
    for number in (0, -1):
        for what, damaged in damages(json.loads(lines[number]), seed=30):
            changed = [*lines]
            changed[number] = json.dumps(damaged)
            path.write_text("\n".join(changed) + "\n")
            try:
                journalled(tmp_path, setup, check=False, max_iterations=4)
            except InputError:
                refused += 1
            except Exception as error:
                raise AssertionError(f"line {number}: {what}") from error
    assert refused > 50
