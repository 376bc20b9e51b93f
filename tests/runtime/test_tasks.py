"""Tasks in this process: keys, seeds, files, failures, and continuation."""

import dataclasses
import errno
import itertools
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import small_jobs

from giajax import InputError
from giajax.runtime.execution import InProcess, Threads, prepared, run_tasks
from giajax.runtime.process import is_stopped
from giajax.runtime.tasks import Task, read_outcome

pytestmark = pytest.mark.quick


@dataclasses.dataclass(frozen=True)
class Content:
    numbers: np.ndarray
    name: str = "a"


def tasks_of(function, numbers, **shared):
    return [Task(function, {"number": number, **shared}) for number in numbers]


def test_a_key_is_of_the_content():
    """Equal content in any order gives the same key, and any difference gives another one."""
    same = Task("small_jobs:double", {"a": 1, "b": [2.0, None]}, seed=1)
    assert Task(small_jobs.double, {"b": (2.0, None), "a": 1}, seed=1).key == same.key
    others = [
        Task("small_jobs:divides", same.arguments, seed=1),
        Task("small_jobs:double", {"a": 2, "b": [2.0, None]}, seed=1),
        Task("small_jobs:double", same.arguments, seed=2),
        Task("small_jobs:double", same.arguments),
        Task("small_jobs:double", {"a": Content(np.arange(3.0))}),
        Task("small_jobs:double", {"a": Content(np.arange(3.0), "b")}),
        Task("small_jobs:double", {"a": Content(np.array([0.0, 1.0, 2.5]))}),
        Task("small_jobs:double", {"a": Path("here")}),
        Task("small_jobs:double", {"a": Path("there")}),
    ]
    assert len({task.key for task in [same, *others]}) == 1 + len(others)
    again = Task("small_jobs:double", {"a": Content(np.arange(3.0))})
    assert again.key in {task.key for task in others}


def test_a_seed_is_of_the_study_and_the_task():
    """The seed does not depend on other tasks; a function without random numbers has none."""
    tasks = [
        Task(small_jobs.draws, {"number": n}, seed=s) for n, s in itertools.product((1, 2), (3, 4))
    ]
    forwards, backwards = run_tasks(tasks), run_tasks(tasks[::-1])
    seeds = [outcome.value[0] for outcome in forwards]
    assert seeds == [outcome.value[0] for outcome in backwards[::-1]]
    assert len(set(seeds)) == 4
    assert all(0 <= seed < 2**63 for seed in seeds)
    assert run_tasks(tasks_of("small_jobs:double", [4]))[0].value == 8


def test_what_cannot_be_found_by_name_is_refused():
    for function in (lambda: None, "small_jobs", "small_jobs:double:x"):
        with pytest.raises(InputError, match="other processes cannot find"):
            Task(function)


def test_failures_are_outcomes_with_a_sentence():
    refused, done = run_tasks(tasks_of(small_jobs.refuses, [3, 4]))
    assert (refused.status, refused.message) == ("failed", "3 is odd: give an even number")
    assert (done.status, done.value, done.message) == ("done", 4, "")
    other = run_tasks(tasks_of(small_jobs.divides, [0]))[0]
    assert other.status == "failed"
    assert other.message.startswith("ZeroDivisionError (small_jobs.py, line")
    assert other.message.endswith(": division by zero")
    missing = run_tasks([Task("small_jobs:nothing")])[0]
    assert "has no attribute 'nothing'" in missing.message


def test_each_task_is_done_once_and_kept(tmp_path):
    calls, kept = tmp_path / "calls", tmp_path / "kept"
    calls.mkdir()
    tasks = tasks_of(small_jobs.notes, [1, 2, 1, 3], folder=calls)
    heard = []
    first = run_tasks(tasks[:3], folder=kept, progress=lambda *news: heard.append(news))
    assert [(done, most) for _, done, most in heard] == [(1, 2), (2, 2)]
    again = run_tasks(tasks, folder=kept, progress=lambda *news: heard.append(news))
    assert [(outcome.key, done, most) for outcome, done, most in heard[2:]] == [
        (tasks[3].key, 3, 3)
    ]
    assert again[:3] == first
    assert again[0] == again[2]
    assert {path.name for path in kept.iterdir()} == {f"{task.key}.json" for task in tasks}
    assert {path.read_text() for path in calls.iterdir()} == {"x"}


@pytest.mark.parametrize(
    "damage",
    [lambda text: text[: len(text) // 2], lambda text: "", lambda text: "[]",
     lambda text: text.replace('"status": "done"', '"status": "stopped"'),
     lambda text: text.replace('"giajax_task": 1', '"giajax_task": 2'),
     lambda text: text.replace('"key": "', '"key": "0')],
    ids=["half", "empty", "other", "status", "format", "key"],
)  # fmt: skip
def test_a_file_that_is_not_whole_counts_as_missing(tmp_path, damage):
    task = Task(small_jobs.double, {"number": 2})
    before = run_tasks([task], folder=tmp_path)[0]
    path = tmp_path / f"{task.key}.json"
    assert read_outcome(tmp_path, task.key) == before
    path.write_text(damage(path.read_text()))
    assert read_outcome(tmp_path, task.key) is None
    assert run_tasks([task], folder=tmp_path)[0].value == 4
    assert read_outcome(tmp_path, task.key).value == 4


def test_values_are_as_json_gives_them_back(tmp_path):
    """With and without files, arrays become lists, and non-finite values become None."""
    task = Task(small_jobs.mixed)
    assert run_tasks([task])[0].value == {"1": [[0, 1], 0.5], "path": "a", "nan": None}
    assert run_tasks([task], folder=tmp_path)[0].value == run_tasks([task])[0].value
    assert read_outcome(tmp_path, task.key).value == run_tasks([task])[0].value
    odd = run_tasks([Task("builtins:object")])[0]
    assert odd.message.endswith("object is a type that cannot be stored as JSON")


class Elsewhere(InProcess):
    """A worker that cannot access the folder."""

    def submit(self, function, task, folder, *words):
        return super().submit(function, task, None, *words)


def test_what_a_worker_cannot_write_is_written_here(tmp_path):
    (task,) = tasks_of(small_jobs.double, [3])
    outcomes = run_tasks([task], executor=Elsewhere(), folder=tmp_path / "new")
    assert read_outcome(tmp_path / "new", task.key) == outcomes[0]


def test_what_failed_is_begun_again(tmp_path):
    """The next call repeats it, because the missing file may exist by then."""
    task, kept = Task("os:listdir", {"path": str(tmp_path / "later")}), tmp_path / "kept"
    assert run_tasks([task], folder=kept)[0].message.startswith("FileNotFoundError")
    (tmp_path / "later").mkdir()
    assert run_tasks([task], folder=kept)[0].value == []


def test_a_full_disk_ends_the_study(tmp_path, monkeypatch):
    """It ends at the first file that cannot be written, and no task counts as failed."""

    def full(path, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("giajax.runtime.files.write_durably", full)
    kept, heard = tmp_path / "kept", []
    with pytest.raises(InputError, match=r"cannot be written \(No space left on device\): free"):
        run_tasks(
            tasks_of(small_jobs.notes, [1, 2], folder=tmp_path),
            folder=kept,
            progress=lambda *news: heard.append(news),
        )
    assert not heard
    assert [path.name for path in tmp_path.glob("*.calls")] == ["1.calls"]


class Breaks(InProcess):
    """A user's pool that breaks after its first task."""

    def submit(self, function, *words):
        if hasattr(self, "used"):
            raise BrokenExecutor("a child process ended")
        self.used = True
        return super().submit(function, *words)


def test_a_broken_pool_leaves_its_tasks_undone(tmp_path):
    tasks = tasks_of(small_jobs.double, [1, 2, 3])
    with pytest.raises(
        InputError, match=r"accepts no tasks \(a child process ended\): create a new"
    ):
        run_tasks(tasks, executor=Breaks(), folder=tmp_path)
    assert [path.stem for path in tmp_path.iterdir()] == [tasks[0].key]
    assert [outcome.value for outcome in run_tasks(tasks, folder=tmp_path)] == [2, 4, 6]


class Gone(InProcess):
    """The pool of a cluster whose scheduler has ended, so its tasks never finish."""

    _client = SimpleNamespace(status="running", scheduler=None)

    def submit(self, *words):
        self._client.status = "closed"
        return Future()


def test_a_scheduler_that_is_gone_is_told(monkeypatch):
    monkeypatch.setattr("giajax.runtime.execution._BETWEEN_S", 0.01)
    with pytest.raises(InputError, match="the scheduler no longer answers: start it again"):
        run_tasks(tasks_of(small_jobs.double, [1]), executor=Gone())


class Kills(InProcess):
    """A cluster of distributed, which has already retried the task."""

    tried = 0

    def submit(self, *words):
        self.tried += 1
        future = Future()
        future.set_exception(type("KilledWorker", (Exception,), {})("on 4 different workers"))
        return future


def test_what_a_cluster_gave_up_is_not_begun_again():
    executor = Kills()
    (outcome,) = run_tasks(tasks_of(small_jobs.double, [1]), executor=executor)
    assert (outcome.status, executor.tried) == ("failed", 1)
    assert outcome.message == "KilledWorker: on 4 different workers"


def test_ctrl_c_keeps_what_is_done(tmp_path):
    tasks = tasks_of(small_jobs.interrupts, [1, 2, 3], at=2)
    outcomes = run_tasks(tasks, folder=tmp_path)
    assert [outcome.status for outcome in outcomes] == ["done", "stopped", "stopped"]
    assert len(list(tmp_path.iterdir())) == 1


def test_a_stop_reaches_the_threads(monkeypatch):
    """Each thread checks for the stop regularly, like the chains of a posterior."""
    monkeypatch.setenv("GIAJAX_CORES", "3")

    def interrupt(outcome, done, total):
        raise KeyboardInterrupt

    tasks = tasks_of(small_jobs.waits_for_a_stop, [1, 0, 2])
    with Threads(3) as threads:
        outcomes = run_tasks(tasks, executor=threads, progress=interrupt)
    assert [outcome.status for outcome in outcomes] == ["stopped", "done", "stopped"]
    assert not is_stopped()


def test_a_worker_keeps_what_it_prepared():
    made = []
    for key in [*range(9), 8, 0, 8]:
        prepared(("kept", key), lambda key=key: made.append(key))
    assert made == [*range(9), 0]
