"""Files of version 0.1.0 can be read, and its unfinished work is completed with equal numbers.

`earlier/make.py` describes how the files were made with the code of that version. On that machine,
the numbers were equal bit for bit. Other processors, libraries and compiler settings (including
those of these tests) change the last digits, and a fit of an arm may end a step earlier. Therefore,
numbers may differ by `NEAR` times their value or standard error, those of arms by `NEAR_OF_ARM`.
Numbers that are kept in a file must be equal. `earlier/make.py again` repeats all fits without the
settings of the tests, and reports whether any bit differs.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import giajax
from giajax import FitTask, load_result, read_run
from giajax.cli import main
from giajax.report import summary
from giajax.runtime.execution import InProcess
from giajax.runtime.tasks import Task
from giajax.studies import Bootstrap, Fitted, Influence, PosteriorSummary, load_profiles
from page_reader import Page

EARLIER = Path(__file__).parent / "earlier"
RESULTS = sorted(path.name for path in (EARLIER / "results").iterdir())
KEYS = json.loads((EARLIER / "keys.json").read_text())
NEAR = 1e-6
NEAR_OF_ARM = 1e-2
# Keys with sentences, whose wording may have improved.
SENTENCES = {"advice", "conditions", "message", "notes", "remark", "sentence", "warnings"}


def record(path):
    return json.loads(Path(path).read_text())


def assert_near(now, before, near=NEAR, at="", size=None):
    """Check that data are equal, apart from the last digits of numbers.

    Arguments:
        now, before: data read from JSON.
        near: allowed difference of numbers, relative to their value or standard error.
        at: path within the whole data.
        size: standard error of the estimates, if there is one.
    """
    if isinstance(before, dict):
        assert isinstance(now, dict), at
        assert before.keys() <= now.keys(), at
        size = before.get("standard_error") or size
        for key in before:
            assert_near(now[key], before[key], near, f"{at}/{key}", size)
    elif isinstance(before, list):
        assert len(now) == len(before), at
        for index, (one, other) in enumerate(zip(now, before, strict=True)):
            assert_near(one, other, near, f"{at}/{index}", size)
    elif isinstance(before, float) and isinstance(now, float):
        of_itself = NEAR if size and "value" in at else near
        assert now == pytest.approx(before, rel=of_itself, abs=near * (size or 1e-6)), at
    elif not (isinstance(before, str) and SENTENCES & {*at.split("/")}):
        assert now == before, at
    else:
        assert isinstance(now, str), at


def near_of(name):
    """Return the allowed relative difference for a study."""
    return NEAR_OF_ARM if name.endswith("_of_arm") else NEAR


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Return a function that copies a study to a temporary folder."""
    monkeypatch.chdir(tmp_path)

    def begin(name):
        shutil.copytree(EARLIER / "studies" / name, tmp_path, dirs_exist_ok=True)

    return begin


class Counting(InProcess):
    """An executor that counts its tasks."""

    def __init__(self):
        self.keys = []

    def submit(self, function, task, *words):
        self.keys.append(task.key)
        return super().submit(function, task, *words)


class Watched:
    """The task files in a folder: existing ones are kept, and those of `tasks.json` are added.

    A file contains the time that its task took, so an unchanged file shows that the task was not
    repeated.
    """

    def __init__(self, folder):
        self.folder = Path(folder)
        self.before = self.contents()
        self.executor = Counting()

    def contents(self):
        return {path.name: path.read_bytes() for path in self.folder.glob("*.json")}

    def check(self):
        after, names = self.contents(), record("tasks.json")
        assert {name: after[name] for name in self.before} == self.before
        assert sorted(after) == names
        done = sorted(f"{key}.json" for key in self.executor.keys)
        assert done == sorted(set(names) - set(self.before))
        assert done


# Finished results.


@pytest.mark.parametrize("name", RESULTS)
def test_results_are_read(name):
    folder = EARLIER / "results" / name / "fit"
    before, result = record(folder / "result.json"), load_result(folder)
    again = json.loads(result.to_json())
    assert_near(again, before)
    # Facts that version 0.1.0 did not store.
    for estimate in again["parameters"].values():
        assert estimate.pop("noise_error") is None
    for run in again["runs"]:
        assert {channel.pop("white") for channel in run["channels"].values()} == {None}
    for step in again["history"]:
        assert step.pop("part") == 1
    for key in ("parameters", "config", "runs", "cost", "history"):
        assert again[key] == before[key], key
    assert result.headline in summary(result)


@pytest.mark.parametrize("name", RESULTS)
def test_keys_and_seeds_are_those_of_then(name):
    """They do not depend on the modules of the classes: for a model, and for a fit with its run."""
    folder = EARLIER / "results" / name
    result = load_result(folder / "fit")
    about = {"model": result.model}
    if f"fitted of {name}" in KEYS:
        about["fitted"] = Fitted.of(result, read_run(folder / "run.csv"))
    for what, argument in about.items():
        task = Task("math:hypot", {what: argument}, seed=1)
        assert [task.key, task.own_seed] == KEYS[f"{what} of {name}"]


# These take longest and run only before a release. Other results contain the same parts.
LONG = ("several", "contact")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name in LONG else pytest.mark.slow)
        for name in RESULTS
    ],
)
def test_results_are_repeated(name, tmp_path, monkeypatch):
    """`giajax fit --again`."""
    shutil.copytree(EARLIER / "results" / name, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    words = ["fit", "--again", "fit", "--out", "again", "--no-figures", "--no-suspects", "--quiet"]
    before = record("fit/result.json")
    assert main(words) == (0 if before["status"] == "converged" else 1)
    after = record("again/result.json")
    assert after["status"] == before["status"]
    # The key is now `link_pressure_kPa`, whose default equals the 1.0 in that file.
    before["config"]["definition"].get("arm", {}).pop("contact_pressure_kPa", None)
    assert after["config"] == before["config"]
    before["parameters"].pop("contact.pressure", None)  # fixed, like `links.pressure` now
    assert_near(after["parameters"], before["parameters"], NEAR_OF_ARM)
    for one, other in zip(after["runs"], before["runs"], strict=True):
        assert_near(one["channels"], other["channels"], NEAR_OF_ARM)


def test_what_lies_beside_a_result_is_read(tmp_path, monkeypatch):
    shutil.copytree(EARLIER / "written" / "beside", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    result = load_result("fit")
    for name, kind in (
        ("bootstrap", Bootstrap),
        ("influence", Influence),
    ):
        text = Path(f"fit/{name}.json").read_text()
        assert json.loads(kind.of_json(text).to_json()) == json.loads(text)
    assert json.loads(load_profiles("fit").to_json()) == record("fit/profiles.json")
    drawn = PosteriorSummary.of_json(Path("fit/posterior.json").read_text())
    assert drawn.is_of(result)
    assert json.loads(drawn.to_json()) == record("fit/posterior.json")
    suspected = load_result("suspected.json")
    new = {"moves": {}, "together": [], "explained_by": "", "begun": False}
    rows = [{**row, **new} for row in record("suspected.json")["suspects"]]
    assert json.loads(suspected.to_json())["suspects"] == rows
    assert suspected.suspects
    assert main(["report", "fit", "--page", "page.html", "--quiet"]) == 0
    headings = Page(Path("page.html").read_bytes()).headings
    assert {"profiles", "suspects", "repetitions", "influence", "posterior"} <= set(headings)


def test_runs_that_commands_wrote_are_read():
    for name in ("design/design/command.csv", "drive/drive.csv", "wind/run.csv"):
        run = read_run(EARLIER / "written" / name)
        assert run.model == "arm"
        assert len(run.times) > 5


@pytest.mark.slow
def test_other_commands_write_the_same_again(tmp_path, monkeypatch):
    """The design is omitted, because the path of its search depends on the last digits."""
    written = EARLIER / "written"
    monkeypatch.chdir(tmp_path)
    shutil.copytree(written, tmp_path, dirs_exist_ok=True)
    commands = {
        "wind/wind/wind.json": "wind --data wind/run.csv --wind 0,0.5,0.2 --out again",
        "fill/filling/filling.json": "fill fill/filling.toml --no-curve --out again",
    }
    for path, command in commands.items():
        assert main([*command.split(), "--force"]) == 0
        # The compiler optimises less in tests than in commands, so rounding differs.
        assert_near(record(f"again/{Path(path).name}"), record(path), near=1e-5)
    words = "drive drive/arm.toml --replay drive/pad.csv --noise position_m=0.01 --to again.csv"
    assert main(words.split()) == 0
    before = read_run("drive/drive.csv")
    for name, values in read_run("again.csv").values.items():
        np.testing.assert_allclose(values, before.values[name], rtol=NEAR, atol=1e-8)


# Unfinished work.


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("journal", ()),
        ("journal_of_starts", ("--starts", "3")),
        pytest.param("journal_of_arm", (), marks=pytest.mark.slow),
    ],
)
def test_a_journal_is_gone_on_with(home, capsys, name, words):
    home(name)
    Path("half").rename("fit")
    lines = Path("fit/journal.jsonl").read_text().splitlines()[1:-1]
    last = json.loads(lines[-1])
    assert main(["fit", "--resume", "fit", "--no-figures", "--no-suspects"]) in (0, 1)
    said = capsys.readouterr().err
    assert "continuing from the end of fit/journal.jsonl" in said
    # Only steps that were taken now are shown.
    words = [line.split() for line in said.splitlines()]
    steps = [int(each[0]) for each in words if each and each[0].isdigit()]
    if name == "journal_of_starts":
        assert last["fit"] == 2
        assert steps.count(0) == 2, "of the third start, and of the check of the best"
    else:
        assert steps[0] == last["trials"] + 1
    before, after = record("whole/result.json"), record("fit/result.json")
    for each in (before, after):
        del each["seconds"], each["task"], each["versions"]
    if name.endswith("_of_arm"):
        # The number of steps to the same end depends on the last digits.
        for each in (before, after):
            for key in ("history", "iterations", "message", "gradient_check", "tolerance_effect"):
                del each[key]
        # Its sidecar names no preset, which version 0.1.0 did not report.
        assert "names no preset" in after["conditions"].pop()
    assert_near(after, before, near_of(name))


@pytest.mark.parametrize("name", ["starts", pytest.param("starts_of_arm", marks=pytest.mark.slow)])
def test_starts_are_gone_on_with(home, name):
    home(name)
    watched = Watched("half/starts")
    before = record("whole/result.json")
    # Version 0.1.0 had no nuisance parameters.
    task = FitTask.load("run_fit.toml").on_top(starts=5, seed=2, nuisances=False)
    ready = task.prepare()
    result = ready.run(executor=watched.executor, folder="half/starts")
    watched.check()
    after = json.loads(result.to_json())
    for key in ("parameters", "starts", "config", "correlation"):
        assert_near(after[key], before[key], near_of(name), key)


def test_a_sweep_is_gone_on_with(home):
    home("sweep")
    watched = Watched("half/fits")
    table = giajax.sweep("plan.toml", out="half", executor=watched.executor)
    watched.check()
    before, after = record("whole/table.json"), table.to_dict(as_series=False)
    kept = [f"{key}.json" in watched.before for key in before["key"]]
    assert sum(kept) == 2
    for name, column in before.items():
        exact = [value for value, is_kept in zip(column, kept, strict=True) if is_kept]
        assert [v for v, is_kept in zip(after[name], kept, strict=True) if is_kept] == exact, name
        if name not in ("seconds", "worker"):
            assert_near(after[name], column, at=name)
    # The previous table belongs to this plan; otherwise it would not be overwritten.
    shutil.copytree("half/fits", "whole/fits")
    executor = Counting()
    assert giajax.sweep("plan.toml", out="whole", executor=executor).equals(table)
    assert executor.keys == []


def study(name, result, runs, **how):
    """Run a study as `earlier/make.py` did."""
    match name:
        case "profile":
            return giajax.profile(result, runs, **how)
        case "profile_of_arm":
            return giajax.profile(result, runs, ["joints.pitch_stiffness"], **how)
        case "bootstrap":
            return giajax.bootstrap(result, runs, size=40, seed=3, **how)
        case "blocks":
            return giajax.bootstrap(result, runs, size=20, method="block", **how)
        case "influence":
            return giajax.influence(result, runs, exact=True, spans=17, **how)
        case "posterior":
            return giajax.posterior(result, runs, chains=3, draws=12, warmup=20, **how).summary


@pytest.mark.parametrize(
    "name",
    [
        "profile",
        pytest.param("profile_of_arm", marks=pytest.mark.slow),
        "bootstrap",
        "blocks",
        "influence",
        "posterior",
    ],
)
def test_a_study_of_a_fit_is_gone_on_with(home, name):
    home(name)
    watched = Watched("half/posterior_chains" if name == "posterior" else "half/tasks")
    about = load_result("fit"), [read_run("run.csv")]
    found = study(name, *about, executor=watched.executor, folder=watched.folder)
    watched.check()
    (path,) = Path("whole").glob("*.json")
    assert_near(json.loads(found.to_json()), record(path), near_of(name))
