"""Held-out parts of runs: by name of the run or channel, and the last part of each run."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from giajax import InputError, Run
from giajax.recordings import SplitRun, hold_out, observing, split_run, windows

pytestmark = pytest.mark.quick


def swing(name="swing", *, samples=41, free=False):
    """Return a run of two joints with a gap, and with a file as its origin."""
    times = np.linspace(0.0, 4.0, samples)
    values = {f"joint{i:02d}_{what}": np.cos(times) for i in (1, 2) for what in ("angle", "rate")}
    values["joint01_angle"][3] = np.nan
    definition = {"arm": {"links": 2}, "free_motion": True, "initial": {"first_row": True}}
    run = Run.from_arrays(times, values, name=name, definition=definition)
    return dataclasses.replace(run, path=Path(f"{name}.csv"))


def loop(name="loop", count=20):
    values = {"input": np.sin(np.arange(count)), "output": np.sin(np.arange(count))}
    return Run.from_arrays(None, values, name=name)


def cells(run):
    """Return the samples with values by channel, or None for no run."""
    if run is None:
        return None
    return {name: np.flatnonzero(~np.isnan(v)).tolist() for name, v in run.observations.items()}


def test_a_run():
    one, other = hold_out([swing("a"), swing("b")], ["b"])
    assert one.held is None
    assert cells(one.fitted) == cells(one.whole)
    assert other.fitted is None
    assert cells(other.held) == cells(other.whole)


def test_a_channel():
    parts = hold_out([swing("a"), observing(swing("b"), ["joint02_rate"])], ["joint01_angle"])
    assert list(parts[0].held.observations) == ["joint01_angle"]
    rest = ["joint01_rate", "joint02_angle", "joint02_rate"]
    assert sorted(parts[0].fitted.observations) == rest
    # The initial state may depend on these samples.
    assert np.array_equal(parts[0].fitted.values["joint01_angle"][:3], np.cos([0, 0.1, 0.2]))
    assert parts[1].held is None
    assert parts[1].fitted.observed == ("joint02_rate",)


@pytest.mark.parametrize(
    ("name", "first"),
    [("last", 33), ("LAST", 33), (" Last ", 33), ("last:0.5", 21), ("last:.3", 29)],
)
def test_the_last_part_of_a_run_by_time(name, first):
    (part,) = hold_out([swing()], [name])
    assert part.fitted.observed is None
    assert cells(part.fitted)["joint02_rate"] == list(range(first))
    assert cells(part.held)["joint02_rate"] == list(range(first, 41))
    assert cells(part.fitted)["joint01_angle"] == [i for i in range(first) if i != 3]
    for run in (part.fitted, part.held):
        assert np.array_equal(run.times, part.whole.times)
        assert not run.values["joint01_angle"].flags.writeable


def test_samples_that_are_uneven_count_by_their_time():
    run = swing()
    times = np.where(np.arange(41) < 38, np.linspace(0, 1, 41), np.linspace(7, 10, 41))
    (part,) = hold_out([dataclasses.replace(run, times=times)], ["last"])
    assert cells(part.held)["joint02_rate"] == [38, 39, 40]


def test_the_last_of_samples_without_time():
    (part,) = hold_out([loop()], ["last"])
    assert cells(part.held) == {"output": [16, 17, 18, 19]}
    assert np.array_equal(part.fitted.values["input"], part.whole.values["input"])


def test_the_last_part_is_that_of_the_recording_not_of_each_window():
    several = windows(swing(samples=81), 0.5)
    parts = hold_out(several, ["last"])
    assert [part.fitted is None for part in parts] == [False] * 7 + [True]
    assert [part.held is None for part in parts] == [True] * 6 + [False] * 2
    assert len(cells(parts[6].held)["joint02_rate"]) == 6
    # The name of a recording holds out all of its windows; the name of a window holds out one.
    other = swing("other")
    parts = hold_out([*several, other], ["swing"])
    assert [part.fitted is None for part in parts] == [True] * 8 + [False]
    parts = hold_out([*several, other], [several[2].name])
    assert [part.fitted is None for part in parts] == [i == 2 for i in range(9)]


def test_several_names_add_up():
    (part,) = hold_out([swing()], ["last:0.1", "joint02_rate", "last"])
    assert "joint02_rate" not in part.fitted.observations
    assert len(cells(part.held)["joint02_rate"]) == 41
    assert cells(part.held)["joint01_rate"] == list(range(33, 41))


def test_the_parts_are_found_again_by_the_first_cell_that_is_held():
    (part,) = hold_out([swing()], ["last", "joint02_rate"])
    again = split_run(
        part.whole, {"joint02_rate": 0, **dict.fromkeys(part.fitted.observations, 33)}
    )
    assert isinstance(again, SplitRun)
    assert cells(again.fitted) == cells(part.fitted)
    assert cells(again.held) == cells(part.held)


def named_last():
    return dataclasses.replace(swing("last"), path=Path("last.csv"))


def elsewhere():
    return dataclasses.replace(swing("swing"), path=Path("other") / "swing.csv")


def without_end():
    """Return a run whose last two seconds were not recorded."""
    run = swing()
    return dataclasses.replace(
        run, values={n: np.where(run.times < 2, v, np.nan) for n, v in run.values.items()}
    )


@pytest.mark.parametrize(
    ("runs", "names", "words"),
    [
        (
            [swing()],
            ["joint03_angle"],
            ["neither a run nor a channel", "(swing)", "joint02_rate", "last"],
        ),
        ([swing()], ["joint01_angle_deg"], ["neither a run nor a channel"]),
        ([swing()], [""], ["neither a run nor a channel"]),
        (
            [swing("joint01_angle"), swing()],
            ["joint01_angle"],
            ["more than one of a run, a channel", "rename"],
        ),
        ([named_last(), swing()], ["last"], ["more than one of a run, a channel"]),
        ([swing(), elsewhere(), swing("b")], ["swing"], ["two recordings have this name"]),
        ([swing()], ["last:1.5"], ["does not give a valid fraction", "last:0.3"]),
        ([swing()], ["last:0"], ["does not give a valid fraction"]),
        ([swing()], ["last:1_0"], ["does not give a valid fraction"]),
        ([swing()], ["last:"], ["does not give a valid fraction"]),
        ([swing()], ["swing"], ["none is left to fit"]),
        ([swing("a"), swing("b")], ["a", "b"], ["(a, b) contain all measured values"]),
        ([without_end()], ["last"], ["holds out no measured value"]),
    ],
)
def test_what_is_refused(runs, names, words):
    with pytest.raises(InputError) as caught:
        hold_out(runs, names)
    for word in words:
        assert word in str(caught.value)
    assert str(caught.value).count(":") >= 1
