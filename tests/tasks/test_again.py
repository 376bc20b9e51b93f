"""A fit is repeated, continued, and used as the initial guess of another one."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import giajax
from giajax import FitTask, InputError, Run, fit, read_run, read_runs, write_result
from giajax.fitting import WarmStart, load_result, set_up, solve
from giajax.tasks import JOURNAL, compared, read_journal, stored_result, version_note
from small_arm import START, TRUTH, make_run
from small_loops import write_task
from toy_model import Decay, run


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_task(tmp_path)
    return "loops_fit.toml"


def numbers(result):
    """Return the content of a result without times and paths."""
    record = json.loads(result.to_json())
    del record["seconds"], record["task"]["out"]
    return record


def written(task, **options):
    """Run a task and write its result where it belongs."""
    result = task.run(**options)
    runs = read_runs(task.data, task.definition, rename=task.rename)
    write_result(result, runs, task.out, figures=False)
    return result


def test_the_same_fit_again_has_the_same_numbers(path):
    task = FitTask.load(path).on_top(starts=2, seed=3, max_iterations=40)
    first = written(task)
    assert first.config["starts"] == 2
    again = FitTask.again("giajax-out/loops_fit")
    assert str(again.out) == "giajax-out/loops_fit-again"
    second = again.run()
    before = numbers(first)
    after = numbers(second)
    # The settings of one fit are in a definition, those of the other in its result.
    assert after.pop("task")["inputs"] == before.pop("task")["inputs"]
    assert after == before
    stored = stored_result("giajax-out/loops_fit/result.json")[1]
    assert compared(second, stored) == "all numbers are identical, bit for bit"
    stored["parameters"]["elastic"]["value"] *= 1 + 1e-9
    assert "the relative difference in elastic is 1.0e-09" in compared(second, stored)


def test_more_starts_are_added_to_those_of_a_result(path):
    first = written(FitTask.load(path).on_top(starts=2, seed=3, max_iterations=40))
    told = []
    more = FitTask.again("giajax-out/loops_fit").on_top(starts=3)
    result = more.run(announce=lambda number, start: told.append(number))
    assert told == [3]
    assert result.starts[:2] == first.starts
    assert result.config["starts"] == len(result.starts) == 3
    # With any further change, it is another fit.
    assert more.on_top(loss="huber").earlier is None


def test_it_is_found_beside_its_result(path, tmp_path, monkeypatch):
    """The whole folder may be moved, and the current folder may differ."""
    first = written(FitTask.load(path), check=False)
    here = tmp_path.rename(tmp_path.with_name("moved"))
    monkeypatch.chdir("/")
    try:
        again = FitTask.again(here / "giajax-out" / "loops_fit")
        assert [file.exists() for file in again.data] == [True]
        second = again.run(check=False)
        assert second.parameters == first.parameters
        stored = stored_result(here / "giajax-out" / "loops_fit")[1]
        assert compared(second, stored).endswith("bit for bit")
        # Another file of that name in the current folder is not used.
        other = here / "other"
        other.mkdir()
        for file in here.glob("*.*"):
            (other / file.name).write_text("input,output\n0,0\n1,1\n")
        monkeypatch.chdir(other)
        assert FitTask.again(here / "giajax-out" / "loops_fit").data == again.data
        monkeypatch.chdir("/")
    finally:
        here.rename(tmp_path)


def test_what_was_recorded_of_no_checksum_stays_where_its_name_says(path, tmp_path):
    written(FitTask.load(path), check=False)
    folder = tmp_path / "giajax-out" / "loops_fit"
    stored = json.loads((folder / "result.json").read_text())
    del stored["task"]["inputs"][path]
    (folder / "result.json").write_text(json.dumps(stored))
    for file in tmp_path.glob("*.csv"):
        file.rename(folder / file.name)
    again = FitTask.again(folder)
    assert str(again.source) == path
    assert [file.parent for file in again.data] == [folder]


@pytest.fixture(scope="module")
def unfinished(tmp_path_factory):
    """A folder with the data of a fit, and in `out` a fit that ended early, with its journal."""
    folder = tmp_path_factory.mktemp("unfinished")
    with pytest.MonkeyPatch.context() as patched:
        patched.chdir(folder)
        task = FitTask.load(write_task(folder).name).on_top(out="out", max_iterations=1)
        assert written(task, check=False, journal="out").status == "not_converged"
    return folder


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            lambda: os.rename("loops.csv", "gone.csv"),
            "loops.csv, which the fit in .* does not exist",
        ),
        (lambda: append("loops.csv", "0.5,0.4\n"), "loops.csv has changed"),
        (lambda: append("other.csv", "0.5,0.4\n"), "other.csv has changed"),
        (lambda: append("loops_fit.toml", "# more\n"), "loops_fit.toml has changed"),
        (lambda: append("loops.toml", "[noise]\noutput = 0.01\n"), "loops.toml is new"),
    ],
)
def test_a_file_that_has_changed_is_named(unfinished, tmp_path, monkeypatch, change, sentence):
    monkeypatch.chdir(shutil.copytree(unfinished, tmp_path / "here"))
    change()
    for door in (FitTask.again, FitTask.resumed):
        with pytest.raises(InputError, match=sentence):
            door("out")


def test_another_file_of_a_registered_class_is_refused(unfinished, tmp_path, monkeypatch):
    """This holds if a fit is repeated, and if it is continued from Python."""

    @giajax.register
    class Sliding(giajax.mechanics.arm.AbstractDragLaw):
        points = 0

        def force(self, stream):
            return -stream.velocity

    monkeypatch.chdir(shutil.copytree(unfinished, tmp_path / "here"))
    # The first line of a journal and the text of a result name the files that they used.
    for name, parts in (("result.json", 0), ("journal.jsonl", 1)):
        path = Path("out", name)
        text, *lines = path.read_text().split("\n", 1) if parts else [path.read_text()]
        record = json.loads(text)
        record["versions"][Path(__file__).name] = "sha256 of another one"
        path.write_text("\n".join([json.dumps(record), *lines]))
    sentence = "test_again.py has changed since the fit: restore the former version, or fit again"
    with pytest.raises(InputError, match=sentence):
        FitTask.again("out")
    with pytest.raises(InputError, match=sentence):
        FitTask.resumed("out").run(journal="out")


def append(name, text):
    with open(name, "a") as file:
        file.write(text)


def test_what_cannot_be_fitted_again_says_so(path):
    task = FitTask.load(path)
    written(task.on_top(budget="0s", out="short"), check=False)
    with pytest.raises(InputError, match=r"that was stopped.*--resume short"):
        FitTask.again("short")
    earlier = Path(__file__).parents[1] / "fitting" / "earlier"
    with pytest.raises(InputError, match="written by an earlier version"):
        FitTask.again(earlier)
    with pytest.raises(InputError, match="does not exist"):
        FitTask.again("nowhere")
    written(task.on_top(out="changed"), check=False)
    stored = Path("changed/result.json")
    record = json.loads(stored.read_text())
    record["config"]["loss"] = "linear"
    stored.write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"differently \(in loss\)"):
        FitTask.again("changed").prepare()
    # A changed setting makes another fit, which need not reproduce the result.
    assert FitTask.again("changed").on_top(loss="huber").prepare().setup.settings.loss == "huber"


def test_a_result_without_what_is_new_is_read(path):
    """Files of earlier versions have neither a task nor a budget."""
    written(FitTask.load(path), check=False)
    stored = Path("giajax-out/loops_fit/result.json")
    record = json.loads(stored.read_text())
    del record["task"]
    stored.write_text(json.dumps(record))
    assert load_result("giajax-out/loops_fit").task == {}


def test_from_python_a_journal_is_gone_on_with(path):
    task = FitTask.load(path)
    plain = numbers(task.run(check=False))
    told = []
    short = task.on_top(max_iterations=3)
    assert short.run(check=False, journal="kept").status == "not_converged"
    assert os.listdir("kept") == [JOURNAL]
    result = (
        FitTask.resumed("kept")
        .on_top(max_iterations=50)
        .run(told.append, check=False, journal="kept")
    )
    assert told[0].number == 4
    after = numbers(result)
    assert {key: after[key] for key in after if key != "task"} == {
        key: plain[key] for key in plain if key != "task"
    }
    with pytest.raises(InputError, match=r"different settings \(loss, start\)"):
        task.on_top(loss="huber", start={"elastic": 0.4}).run(journal="kept")
    # Other names of the same files do not matter.
    named = task.on_top(data=os.path.abspath("loops.csv"))
    assert named.run(check=False, journal="kept").parameters == result.parameters


def test_a_journal_of_a_fit_that_was_cut_off_is_not_written_over(path):
    ready = FitTask.load(path).prepare()

    class CrashError(Exception):
        pass

    def crash(iteration):
        if iteration.number == 2:
            raise CrashError

    with pytest.raises(CrashError), ready.open_journal(_folder(ready)) as journal:
        ready.run(crash, journal=journal.of)
    assert len(read_journal(_folder(ready)).of(1).lines) == 3
    with (
        pytest.raises(InputError, match="interrupted fit: continue with giajax fit --resume"),
        ready.open_journal(_folder(ready)),
    ):
        pass
    with ready.open_journal(_folder(ready), force=True) as journal:
        assert not journal.is_begun
    # Nothing was written, so the previous journal still exists.
    with ready.open_journal(_folder(ready), resume=True) as journal:
        assert journal.is_begun


def _folder(ready):
    return Path(ready.record["out"])


def test_one_fit_at_a_time_in_a_folder(path):
    ready = FitTask.load(path).prepare()
    folder = _folder(ready)
    with ready.open_journal(folder):
        assert os.listdir(folder) == ["fit.lock"]
        words = f"process {os.getpid()} on "
        with pytest.raises(InputError, match=rf"another fit is writing .*\({words}"):
            ready.open_journal(folder).__enter__()
        assert os.listdir(folder) == ["fit.lock"]
    # The folder is removed, because nothing was computed.
    assert not folder.exists()
    assert not folder.parent.exists()
    # The lock file of a killed process is ignored, even if its process number is reused.
    folder.mkdir(parents=True)
    (folder / "fit.lock").write_text(f"process {os.getppid()} on elsewhere\n")
    with ready.open_journal(folder):
        assert "elsewhere" not in (folder / "fit.lock").read_text()
    assert os.listdir(folder) == []


def test_nothing_is_written_through_a_planted_link(path, tmp_path):
    ready = FitTask.load(path).prepare()
    folder = _folder(ready)
    folder.mkdir(parents=True)
    target = tmp_path / "precious"
    target.write_text("precious")
    (folder / "fit.lock").symlink_to(target)
    with pytest.raises(InputError, match=r"fit.lock cannot be written"):
        ready.open_journal(folder).__enter__()
    (folder / "fit.lock").unlink()
    (folder / JOURNAL).symlink_to(tmp_path / "other")
    with ready.open_journal(folder) as journal:
        ready.run(check=False, journal=journal.of)
    assert target.read_text() == "precious"
    assert not (tmp_path / "other").exists()
    assert not (folder / JOURNAL).is_symlink()


def test_versions_that_differ_are_said():
    from giajax.fitting import versions

    assert version_note(versions()) == ""
    note = version_note({**versions(), "jax": "0.1"})
    assert "jax 0.1 before" in note
    assert "last digits" in note


START_OF_DECAY = {"amplitude": 0.5, "decay": 3.0}


def test_a_fit_begins_where_another_one_ended(path):
    task = FitTask.load(path)
    first = written(task, check=False)
    # That fit is converged, and the initial guess of the definition is not used.
    same = task.on_top(begin="giajax-out/loops_fit").prepare().setup
    assert float(same.model.operator.weights[0]) == first.parameters["weights[0]"].value
    assert same.config["begin"]["values"]["elastic"] == first.parameters["elastic"].value
    assert task.on_top(begin=first).begin == task.on_top(begin="giajax-out/loops_fit").begin
    # With other free parameters, a fixed one keeps its value from the other fit.
    held = task.on_top(begin=first, free=["elastic"]).run(check=False)
    assert held.parameters["weights"].value == [first.parameters["weights[0]"].value]
    assert held.parameters["elastic"].value == pytest.approx(
        first.parameters["elastic"].value, rel=1e-3
    )
    # Values given at the same time or later take precedence.
    setup = task.on_top(begin=first, start={"weights": 0.6}).prepare().setup
    assert float(setup.model.operator.weights[0]) == 0.6
    setup = task.on_top(begin=first).on_top(fix={"elastic": 0.3}).prepare().setup
    assert float(setup.model.operator.elastic) == 0.3
    # The fit can be repeated even if the other fit no longer exists.
    os.rename("giajax-out/loops_fit", "elsewhere")
    held_task = task.on_top(begin=first, free=["elastic"], out="held")
    written(held_task, check=False)
    assert FitTask.again("held").run(check=False).parameters == held.parameters


def test_a_fit_of_another_kind_is_no_beginning():
    earlier = Path(__file__).parents[1] / "fitting" / "earlier"
    begin = FitTask.of("any.csv").on_top(begin=earlier).begin
    with pytest.raises(InputError, match="uses the hysteresis model, but the runs use the dec"):
        set_up(Decay(), [run()], begin=WarmStart(**begin))


def test_an_end_on_a_bound_can_be_begun_from():
    times = np.linspace(0.0, 4.0, 60)
    rising = 2.0 + 0.01 * times
    recording = Run.from_arrays(
        times, {"tip_z": rising}, noise={"position": 0.01}, definition={"free_motion": True}
    )
    values = {"amplitude": 2.0, "decay": 0.0, "offset": 0.1}
    setup = set_up(Decay(), recording, begin=WarmStart("decay", values))
    assert 0 < float(setup.model.decay) < 1e-6
    assert float(setup.model.amplitude) == 2.0
    assert solve(setup, check=False).cost is not None
    # A fixed parameter stays at its bound.
    held = set_up(Decay(), recording, free=["amplitude"], begin=WarmStart("decay", values))
    assert float(held.model.decay) == 0.0
    with pytest.raises(InputError, match="different parameters: there is no parameter 'mass'"):
        set_up(Decay(), recording, begin=WarmStart("decay", {"mass": 1.0}))


def test_a_fit_from_an_end_is_sooner_there():
    first = fit(Decay(), run(), start=START_OF_DECAY, check=False)
    values = {path: estimate.value for path, estimate in first.free.items()}
    again = solve(set_up(Decay(), run(), begin=WarmStart("decay", values)), check=False)
    assert again.history[0].parameters == pytest.approx(values, rel=1e-12)
    assert again.iterations < first.iterations


@pytest.mark.long
def test_initial_states_of_runs_are_begun_from_by_name(tmp_path):
    """Windows of a run, each with its own initial state, in another order and with a new one."""
    channels = ("link02_y", "link02_z", "link04_y", "link04_z")
    make_run(tmp_path, channels=channels)
    task = FitTask.of(tmp_path / "run.csv").on_top(start=START)
    whole = task.definition.contents()
    whole["initial"] = {"free": True}
    task = FitTask(type(task.definition).parse(whole), data=task.data)
    first = task.run(check=False)
    assert first.runs[0].parameters
    again = task.on_top(begin=first)
    setup = again.prepare().setup
    assert setup.own == {
        "run": {path: item.value for path, item in first.runs[0].parameters.items()}
    }
    second = again.run(check=False)
    assert second.history[0].cost == pytest.approx(first.cost, rel=0.05)
    for path in TRUTH:
        before, after = first.parameters[path], second.parameters[path]
        assert abs(after.value - before.value) < 0.1 * before.standard_error
    path = make_run(tmp_path, "other", seed=3, channels=channels)
    other = read_run(path, definition=task.definition)
    fresh = set_up(setup.model, [other], begin=WarmStart(**again.begin))
    # A new run has its own initial state, because the other fit has none for it.
    assert "other" not in fresh.own
    assert solve(fresh, check=False, max_iterations=1).cost is not None


def test_starts_are_added_to_a_fit_that_held_something_out(path):
    """The best previous end is evaluated again to predict the held-out data."""
    first = written(FitTask.load(path).on_top(max_iterations=40, hold_out=["last"]))
    (held,) = first.held_out
    more = FitTask.again("giajax-out/loops_fit").on_top(starts=2, spread=0.1)
    assert more.earlier is None  # another spread gives other initial guesses
    result = FitTask.again("giajax-out/loops_fit").on_top(starts=2).run()
    assert [each.channels.keys() for each in result.held_out] == [held.channels.keys()]
    codes = [reason.code for reason in result.verdict.reasons]
    assert len(codes) == len(set(codes))
    assert result.predictions
