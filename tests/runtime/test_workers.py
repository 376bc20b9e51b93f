"""Tasks in other processes: one pool of two, killed and used again; and a cluster."""

import functools
import os
import signal
import threading
import time

import pytest
import small_jobs

from giajax import InputError
from giajax.runtime.execution import open_executor, run_tasks
from giajax.runtime.tasks import Task


@pytest.mark.slow
def test_processes(tmp_path, monkeypatch, request):
    """Workers have the settings of the command line; a killed one fails alone; Ctrl-C works."""
    monkeypatch.delenv("GIAJAX_CORES", raising=False)
    # A background process of a shell ignores the signal.
    request.addfinalizer(
        functools.partial(signal.signal, signal.SIGINT, signal.getsignal(signal.SIGINT))
    )
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with open_executor(workers=2) as executor:
        wide = run_tasks([Task(small_jobs.settings)], executor=executor)[0]
        assert wide.value["wide"] is True
        assert wide.value["cores"] == "1"
        assert not wide.value["minds_ctrl_c"]
        assert wide.value["cache"] == os.environ["JAX_COMPILATION_CACHE_DIR"]
        assert "GIAJAX_CORES" not in os.environ

        calls, kept = tmp_path / "calls", tmp_path / "kept"
        calls.mkdir()
        tasks = [
            Task(small_jobs.dies_at, {"number": number, "bad": 3, "folder": str(calls)})
            for number in range(8)
        ]
        outcomes = run_tasks(tasks, executor=executor, folder=kept)
        assert [outcome.status for outcome in outcomes].count("done") == 7
        assert outcomes[3].status == "failed"
        assert outcomes[3].message.startswith("the worker ended 3 times during the task")
        assert {path.stem for path in kept.iterdir()} == {
            task.key for number, task in enumerate(tasks) if number != 3
        }

        # The signal arrives when the first task is done, while other workers sleep for a minute.
        timer = threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT))
        tasks = [Task(small_jobs.double, {"number": 1})]
        tasks += [Task(small_jobs.sleeps, {"seconds": 60 + more}) for more in range(4)]
        began = time.monotonic()
        outcomes = run_tasks(
            tasks, executor=executor, folder=kept, progress=lambda *_: timer.start()
        )
        assert time.monotonic() - began < 50
        assert [outcome.status for outcome in outcomes] == ["done"] + 4 * ["stopped"]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_a_cluster(tmp_path):
    """An address, as for `--scheduler`; the workers are threads of this process."""
    distributed = pytest.importorskip(
        "distributed", reason="the extra 'cluster' is not installed: dask is not tried"
    )
    quiet = {"dashboard_address": None, "processes": False, "n_workers": 2}
    with distributed.LocalCluster(threads_per_worker=1, **quiet) as cluster:
        tasks = [Task(small_jobs.refuses, {"number": number}) for number in range(6)]
        with open_executor(scheduler=cluster.scheduler_address) as executor:
            outcomes = run_tasks(tasks, executor=executor, folder=tmp_path)
    here = run_tasks(tasks)
    assert [(o.key, o.status, o.value, o.message) for o in outcomes] == [
        (o.key, o.status, o.value, o.message) for o in here
    ]
    assert {path.stem for path in tmp_path.iterdir()} == {o.key for o in here if not o.message}


@pytest.mark.quick
def test_what_no_executor_can_be():
    for options, words in [
        ({"workers": 0}, "the number of workers is 0: give at least 1"),
        ({"workers": 2, "scheduler": "tcp://a:1"}, "both workers on this machine and a scheduler"),
    ]:
        with pytest.raises(InputError, match=words), open_executor(**options):
            pass
