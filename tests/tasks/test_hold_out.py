"""Fits of a part of the data, which are judged by the rest."""

import dataclasses
import json

import numpy as np
import pytest

from giajax import FitTask, InputError, ladder, load_result, write_result
from giajax.cli import main
from giajax.fitting import HoldOut, predict
from giajax.models import ArmModel
from giajax.recordings import Run, write_run
from giajax.report import recorded_figure, summary
from giajax.schema.parameters import replace, switched_on
from giajax.tasks import JOURNAL, compared, fitted_runs, held_out_runs, stored_result
from small_arm import LINKS, START, TRUTH
from small_loops import write_task


@pytest.fixture
def task(tmp_path, monkeypatch):
    """A fit of two runs of a play in parallel with a spring."""
    monkeypatch.chdir(tmp_path)
    path = write_task(tmp_path)
    path.write_text(path.read_text().replace("other.csv", "").replace('[""]', "[]"))
    return FitTask.load("loops_fit.toml").on_top(data=["loops.csv", "other.csv"], loss="linear")


def written(task, **options):
    ready = task.prepare()
    result = ready.run(**options)
    write_result(result, ready.runs, task.out, figures=False)
    return result


def test_a_run_that_is_held_out_is_predicted(task):
    alone = task.on_top(data="loops.csv").run(check=False)
    result = written(task.on_top(hold_out=["other"]), check=False)
    assert result.free == alone.free
    assert [record.name for record in result.runs] == ["loops"]
    (record,) = result.held_out
    assert record.name == "other"
    assert record.channels["output"].rmse == pytest.approx(0.005, rel=0.3)
    assert record.channels["output"].size == pytest.approx(1, abs=0.3)
    assert result.verdict.status == "adequate"
    (row,) = [row for row in summary(result).splitlines() if row.startswith("held out ")]
    assert "other: RMSE output 0.00" in row
    expected = "times the error expected from noise and parameter uncertainty"
    assert f"{expected}; 1 channel, 44 values" in row
    stored = load_result(task.out)
    assert stored.held_out == result.held_out
    assert summary(stored) == summary(result)


def test_the_last_cells_are_not_fitted(task):
    last = task.on_top(hold_out=["last"])
    ready = last.prepare()
    assert [int(np.sum(~np.isnan(run.values["output"]))) for run in ready.runs] == [44, 35]
    assert [int(np.sum(~np.isnan(r.values["output"]))) for r in ready.held_out_runs] == [11, 9]
    result = written(last, check=False)
    assert [record.channels["output"].n for record in result.runs] == [44, 35]
    assert [record.channels["output"].n for record in result.held_out] == [11, 9]
    # In the figure, held-out cells are open markers, and all others are dots.
    for run, held, record, predicted in zip(
        ready.runs, ready.held_out_runs, result.runs, result.predictions, strict=True
    ):
        (axes,) = recorded_figure(result, run, predicted, record, held).axes
        dots, hollow = (
            sum(
                int(np.sum(~np.isnan(line.get_ydata())))
                for line in axes.lines
                if line.get_marker() == "o" and (line.get_markerfacecolor() == "none") == empty
            )
            for empty in (False, True)
        )
        assert (dots, hollow) == (record.channels["output"].n, len(run.values["output"]) - dots)
    # A stored result gives the same parts again.
    stored = load_result(last.out)
    for again, before in (
        (fitted_runs(stored), ready.runs),
        (held_out_runs(stored), ready.held_out_runs),
    ):
        for one, other in zip(again, before, strict=True):
            np.testing.assert_array_equal(one.values["output"], other.values["output"])
    steps = ladder(stored, fitted_runs(stored), held_out=held_out_runs(stored), most=0)
    sizes = [record.channels["output"] for record in result.held_out]
    rms = np.sqrt(np.average([c.rmse**2 for c in sizes], weights=[c.n for c in sizes]))
    assert steps.steps[0].held_out == pytest.approx(rms / 0.005, rel=0.5)


def test_the_same_fit_again_has_the_same_numbers(task):
    task = task.on_top(hold_out=["last", "other"])
    first = written(task, check=False)
    assert first.task["definition"]["fit"]["hold_out"] == ["last", "other"]
    again = FitTask.again(task.out).run(check=False)
    before = stored_result(task.out)[1]
    assert again.held_out == first.held_out
    assert again.verdict == first.verdict
    assert compared(again, before) == "all numbers are identical, bit for bit"
    before["held_out"][0]["channels"]["output"]["rmse"] *= 1 + 1e-9
    assert "quantities derived from them differ" in compared(again, before)
    # This does not concern the initial guess of the new fit.
    whole = FitTask.again(task.out).on_top(hold_out=[])
    assert len(whole.prepare().runs) == 2


def test_a_journal_is_of_one_hold_out(task):
    folder = task.out
    task = task.on_top(hold_out=["other"])
    stopped = task.on_top(max_iterations=2).run(journal=folder)
    assert (folder / JOURNAL).exists()
    with pytest.raises(InputError, match=r"different settings \(hold_out\)"):
        task.on_top(hold_out=["last"]).run(journal=folder)
    resumed = FitTask.resumed(folder).on_top(max_iterations=50).run(journal=folder)
    assert stopped.status == "not_converged"
    assert resumed.status == "converged"
    assert resumed.held_out == task.run().held_out


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["others"], "but is neither a run nor a channel: name a run (loops, other), a channel"),
        (["loops", "other"], "none is left to fit"),
        (["output"], "none is left to fit"),
        (["last:2"], "a number between 0 and 1"),
        (["last:0.99"], "cannot determine"),
    ],
)
def test_what_is_refused(task, names, words):
    with pytest.raises(InputError) as caught:
        task.on_top(hold_out=names).prepare()
    assert words in str(caught.value)


def test_a_run_of_another_model_is_no_hold_out(task):
    text = '[hysteresis]\noperator = "prandtl_ishlinskii"\nthresholds = [0.3]\n'
    (task.data[1].parent / "other.toml").write_text(text)
    task.source.write_text(task.source.read_text().replace("thresholds = [0.2]", ""))
    (task.data[0].parent / "loops.toml").write_text(text.replace("0.3", "0.2"))
    other = FitTask.load(task.source).on_top(data=task.data, hold_out=["other"])
    with pytest.raises(InputError, match=r"disagree in \[hysteresis\]"):
        other.prepare()


def test_groups_lose_what_is_held_out(task):
    groups = {"offset": [["loops"], ["other"]]}
    ready = task.on_top(fix={}, groups=groups, hold_out=["other"]).prepare()
    assert ready.setup.config["groups"] == {"offset": [["loops"]]}
    assert len(ready.held_out.whole.layout.places) == len(ready.setup.layout.places)
    assert ready.held_out.whole.layout.size == ready.setup.layout.size + 1
    result = ready.run(check=False)
    # An offset that only the held-out run determines is not a prediction error.
    (record,) = result.held_out
    assert record.channels["output"].size == pytest.approx(1, abs=0.3)


@pytest.mark.slow
def test_the_command_line(task, capsys):
    command = ["fit", "loops_fit.toml", "--data", "loops.csv", "--data", "other.csv"]
    held = ["--hold-out", "other", "--hold-out", "LAST:0.1", "--out", "out"]
    assert main([*command, *held]) == 0
    out = capsys.readouterr().out
    assert "held out            loops: RMSE output 0.00" in out
    assert "other: RMSE output 0.00" in out
    assert "held_out_other.png" in out
    record = json.loads((task.out.parent.parent / "out" / "result.json").read_text())
    assert record["config"]["hold_out"][1]["held_from"] == {"output": 0}
    assert [item["name"] for item in record["held_out"]] == ["loops", "other"]
    # Other held-out data make another fit, which does not overwrite this one.
    assert main([*command, "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert "contains a result computed from other data" in said
    assert main([*command, *held[:2], *held[4:], "--no-figures"]) == 2
    assert "the held-out data" in capsys.readouterr().err
    assert (
        main(["suspects", "out", "--ladder", "--max-steps", "1", "--out", "asked", "--quiet"]) == 0
    )
    assert main(["suspects", "out", "--ladder", "--max-steps", "1", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out.partition("{")[2].join(["{", ""]))
    assert facts["ladder"]["rungs"][0]["held_out"] == pytest.approx(1, abs=0.4)


def stiff_run(folder, name, **changed):
    """Record a run of the short arm with a command that returns, with a noise of 3 mm."""
    times = np.linspace(0.0, 4.0, 41)
    commands = {
        "joint01_command": 0.6 * np.interp(times, [0, 0.5, 2.4, 2.9], [0, 1, 1, -1]),
        "joint02_command": -0.5 * np.interp(times, [0, 0.5, 2.4, 2.9], [0, 1, 1, 0]),
    }
    definition = {"arm": {"links": LINKS}, "noise": {"position_m": 0.003}}
    channels = ("link02_y", "link04_y", "link04_z")
    dummy = {channels[0]: np.zeros_like(times)}
    clean = Run.from_arrays(times, {**commands, **dummy}, definition=definition)
    model = replace(switched_on(ArmModel.for_runs([clean]), changed), {**TRUTH, **changed})
    noise = np.random.default_rng(0)
    predicted = predict(model, clean, channels)
    values = {key: value + 0.003 * noise.normal(size=41) for key, value in predicted.items()}
    path = folder / f"{name}.csv"
    return write_run(path, times, {**commands, **values}, definition=definition)


@pytest.mark.long
def test_what_an_arm_lacks_shows_where_it_was_not_fitted(tmp_path):
    """The joints have friction, which the first half of the run does not reveal.

    Added mass would not serve as an example. On a short arm, it is confounded with the scale of the
    fitted parameters, and its effect on the held-out data is predicted, too.
    """

    def ended(name, **changed):
        path = stiff_run(tmp_path, name, **changed)
        task = FitTask.of(path).on_top(start=START, hold_out=["last:0.6"], nuisances=False)
        return task.run(check=False)

    right, wrong = ended("right"), ended("wrong", **{"joints.friction": 0.06})
    assert right.verdict.status == "adequate"
    assert [reason.code for reason in wrong.verdict.reasons] == ["prediction"]
    (record,) = wrong.held_out
    assert record.channels["link04_y"].size > 2
    assert max(channel.size for channel in right.held_out[0].channels.values()) < 1.3


@pytest.mark.parametrize(
    ("read", "damage"),
    [
        (held_out_runs, {"hold_out": []}),
        (fitted_runs, {"runs": []}),
    ],
)
def test_a_result_that_does_not_say_what_was_held_out(task, read, damage):
    result = task.on_top(hold_out=["other"]).run(check=False)
    damaged = dataclasses.replace(result, config={**result.config, **damage})
    with pytest.raises(InputError, match="fit the data again"):
        read(damaged)


def test_a_file_that_says_it_wrongly_is_refused(task, tmp_path):
    result = json.loads(task.on_top(hold_out=["other"]).run(check=False).to_json())
    for runs in ([{"held_from": "x"}], [{"held_from": {"output": "x"}}], [3], 3):
        damaged = {**result, "config": {**result["config"], "runs": runs}}
        (tmp_path / "result.json").write_text(json.dumps(damaged))
        with pytest.raises(InputError, match="is not a giajax result"):
            load_result(tmp_path)


def test_an_interruption_of_the_judgement_keeps_what_was_held_out(task, monkeypatch):
    """A result contains the fitted part of all its runs, even if no errors are known."""

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(HoldOut, "judge", interrupt)
    last = task.on_top(hold_out=["last"])
    ready, result = last.prepare(), written(last, check=False)
    assert result.status == "interrupted"
    assert result.message.endswith("; interrupted before the validation was complete")
    channels = [record.channels["output"] for record in result.held_out]
    assert [(one.rmse, one.n, one.size) for one in channels] == [(None, 11, None), (None, 9, None)]
    stored = load_result(task.out)
    assert stored.held_out == result.held_out
    assert summary(stored) == summary(result)
    for again, run in zip(held_out_runs(stored), ready.held_out_runs, strict=True):
        assert np.array_equal(again.values["output"], run.values["output"], equal_nan=True)


def test_another_number_of_runs_is_another_fit(task):
    result = written(task.on_top(hold_out=["other"]), check=False)
    before = stored_result(task.out)[1]
    assert compared(result, before) == "all numbers are identical, bit for bit"
    before["held_out"] *= 2
    assert compared(result, before) == (
        "the fits differ: the number of runs with a part held out is 1 now, but was 2 before"
    )
