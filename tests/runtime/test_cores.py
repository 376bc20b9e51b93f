"""Work on all cores gives the same results in the same order as on one core."""

import os
import subprocess
import sys
import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

from giajax import InputError, fit, map_on_cores
from giajax.fitting import begin, chunk_size, evaluate, residuals, set_up
from giajax.runtime.parallel import (
    Batch,
    all_in_threads,
    run_in_threads,
    run_on_all_cores,
    split_evenly,
)
from giajax.runtime.process import cgroup_quota, cores, enable_x64, one_blas_thread
from toy_model import Decay, run


def test_shares_are_of_equal_length_and_the_most_work_comes_first():
    sizes = np.asarray([1.0, 9.0, 2.0, 8.0, 3.0, 7.0, 4.0])
    assert [each.tolist() for each in split_evenly(sizes, 3)] == [[1, 3, 5], [6, 4, 2], [0, 0, 0]]
    assert [each.tolist() for each in split_evenly(sizes[:2], 1)] == [[1], [0]]
    assert [each.tolist() for each in split_evenly(sizes[:2], 5)] == [[1, 0, 0, 0, 0]]


@pytest.mark.parametrize("count", [1, 2, 7, 16, 22, 31, 32, 33, 48, 64, 101, 102])
def test_no_run_is_left_over_where_a_fit_deals_them_out(count):
    length = chunk_size(count)
    assert length == {32: 2, 48: 3, 64: 4, 102: 3}.get(count, 1)
    assert count % length == 0
    assert length == 1 or count // length >= 16


@pytest.mark.quick
@pytest.mark.parametrize(
    ("files", "count"),
    [
        ({"cpu.max": "150000 100000\n"}, 2),
        ({"cpu.max": "5000 100000\n"}, 1),
        ({"cpu.max": "max 100000\n"}, None),
        ({"cpu/cpu.cfs_quota_us": "300000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 3),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ({}, None),
    ],
)
def test_a_container_has_the_cores_that_it_may_use(tmp_path, files, count):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert cgroup_quota(tmp_path) == count


@pytest.mark.parametrize("most", [1, 2, 3, 8])
def test_items_come_back_in_their_order_and_once(most):
    """The order does not depend on the share of an item or the number of its repetitions."""
    seen = []

    def call(items, factor):
        seen.append((threading.current_thread().name, len(items["x"])))
        return {"y": factor * items["x"], "z": items["x"][:, None] + np.zeros((1, 2))}

    random = np.random.default_rng(most)
    batches = [
        Batch(call, {"x": np.arange(7.0)}, (2.0,), random.uniform(size=7), 2),
        Batch(call, {"x": np.arange(3.0)}, (5.0,), random.uniform(size=3), 1),
    ]
    first, second = run_on_all_cores(batches, most)
    np.testing.assert_array_equal(first["y"], 2 * np.arange(7.0))
    np.testing.assert_array_equal(first["z"], np.stack([np.arange(7.0)] * 2, axis=1))
    np.testing.assert_array_equal(second["y"], 5 * np.arange(3.0))
    assert {length for _, length in seen} == {2, 1}
    assert any(name != "MainThread" for name, _ in seen) == (most > 1)


def test_blas_has_one_thread_until_the_last_of_those_who_ask_is_done():
    """Neither the first nor the last to finish may restore the wrong number of threads."""

    def threads():
        found = ThreadpoolController().select(user_api="blas").info()
        return {each["filepath"]: each["num_threads"] for each in found}

    with one_blas_thread():
        pass  # loads its library before the count
    before = threads()
    assert before
    first, second = one_blas_thread(), one_blas_thread()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert set(threads().values()) == {1}
    second.__exit__(None, None, None)
    assert threads() == before


def test_threads_compute_with_the_precision_of_the_caller():
    """A `with` block of JAX affects only its own thread."""

    @jax.jit
    def call(items):
        return items / 3

    for wide in (True, False):
        with enable_x64(wide):
            (thirds,) = run_on_all_cores([Batch(call, jnp.ones(4), (), np.ones(4), 1)], 2)
        assert thirds.dtype == (np.float64 if wide else np.float32)


def test_the_number_of_cores_can_be_told(monkeypatch):
    monkeypatch.delenv("GIAJAX_CORES", raising=False)
    assert 1 <= cores() <= (os.cpu_count() or 1)
    monkeypatch.setenv("GIAJAX_CORES", "3")
    assert cores() == 3
    for wrong in ("0", "many", "-1"):
        monkeypatch.setenv("GIAJAX_CORES", wrong)
        with pytest.raises(InputError, match="give the number of cores"):
            cores()


def test_what_jobs_tell_comes_in_their_order_and_in_one_thread():
    """The second job ends before the first has reported anything."""
    told, done = [], threading.Event()

    def slow(tell):
        assert done.wait(10)
        tell(lambda: told.append(("slow", threading.current_thread().name)))
        return cores()

    def quick(tell):
        tell(lambda: told.append(("quick", threading.current_thread().name)))
        done.set()
        return cores()

    results = run_in_threads([slow, quick], 2, until=lambda result: False)
    here = threading.current_thread().name
    assert told == [("slow", here), ("quick", here)]
    # Each job has its share of the cores.
    assert results == [max(1, cores() // 2)] * 2


def test_an_interruption_stops_the_jobs_that_run_and_begins_no_other():
    """The interruption comes from the report of a job, or from Ctrl-C in the waiting thread."""
    begun, together = [], threading.Barrier(2, timeout=10)

    def job(index):
        def run(tell):
            begun.append(index)
            together.wait()
            try:
                while True:
                    tell(interrupt if index == 0 else lambda: None)
            except KeyboardInterrupt:
                return "stopped"

        return run

    def interrupt():
        raise KeyboardInterrupt

    results = run_in_threads([job(0), job(1), job(2)], 2, until=lambda result: False)
    assert sorted(begun) == [0, 1]
    assert results == ["stopped", "stopped", None]


def test_a_result_may_end_the_others_and_an_error_does():
    ended = []

    def fails(tell):
        raise ValueError("of the job")

    def runs_on(tell):
        try:
            while True:
                tell(lambda: None)
        except KeyboardInterrupt:
            ended.append("stopped")

    for jobs in ([runs_on, fails], [fails, runs_on]):
        with pytest.raises(ValueError, match="of the job"):
            run_in_threads(jobs, 2, until=lambda result: False)
    assert set(ended) <= {"stopped"}
    for most in (1, 2):
        results = run_in_threads([lambda tell: "end"] * 9, most, until=lambda result: True)
        assert results[0] == "end"
        assert results[-1] is None


def test_an_error_of_a_later_job_is_not_the_interruption_of_an_earlier_one():
    failed = threading.Event()

    def patient(tell):
        failed.wait(10)
        for _ in range(1000):
            tell(lambda: None)
            time.sleep(0.01)

    def wrong(tell):
        failed.set()
        raise InputError("a job that cannot be done")

    with pytest.raises(InputError, match="cannot be done"):
        run_in_threads([patient, wrong], 2, until=lambda _: False)


def scaled(item, factor):
    return {"sum": factor * item.sum(), "item": item}


@pytest.mark.parametrize("batch_size", [None, 2])
def test_a_function_is_mapped_as_by_lax_map(batch_size):
    items = np.random.default_rng(0).normal(size=(5, 3))
    there = map_on_cores(scaled, items, 2.0, batch_size=batch_size)
    np.testing.assert_allclose(there["sum"], 2 * items.sum(axis=1), rtol=1e-12)
    np.testing.assert_array_equal(there["item"], items)


@pytest.mark.parametrize("items", [{"a": np.ones(3), "b": np.ones(2)}, np.ones((0, 3)), {}, 1.0])
def test_items_without_a_common_axis_are_refused(items):
    with pytest.raises(InputError, match="leading axis"):
        map_on_cores(scaled, items, 2.0)


def test_a_fit_of_several_runs_has_the_same_numbers_on_any_number_of_cores(monkeypatch):
    """The runs have different lengths, and residuals are also evaluated alone."""
    monkeypatch.setattr("giajax.fitting._steps._LONG_STEP", 0.0)
    runs = [run(seed=seed, samples=count) for seed, count in enumerate((20, 31, 24))]
    ends = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("GIAJAX_CORES", count)
        result = fit(Decay(), runs, start={"amplitude": 1.0, "decay": 1.5})
        assert result.status == "converged"
        ends.append({path: (e.value, e.standard_error) for path, e in result.free.items()})
    for other in ends[1:]:
        for path, (value, error) in ends[0].items():
            assert other[path][0] == pytest.approx(value, abs=1e-6 * error)
            assert other[path][1] == pytest.approx(error, rel=1e-6)


@pytest.mark.parametrize(("count", "looked_at"), [(5, 1), (24, 3), (48, 4)])
def test_a_sample_of_runs_has_their_rows_and_zeros_for_the_others(count, looked_at):
    longest = set(np.random.default_rng(0).permutation(count)[:looked_at].tolist())
    runs = [run(seed=seed, samples=20 if seed in longest else 15) for seed in range(count)]
    state = begin(set_up(Decay(), runs, start={"decay": 1.5}))
    whole = evaluate(state, state.coordinate)
    part = evaluate(state, state.coordinate, sample=True)
    rows, some = (np.asarray(each.residual).reshape(count, 20) for each in (whole, part))
    evaluated = np.any(some != 0, axis=1)
    assert set(np.flatnonzero(evaluated).tolist()) == longest
    np.testing.assert_array_equal(some[evaluated], rows[evaluated])
    (block,), (piece,) = whole.jacobian[:-1], part.jacobian[:-1]
    np.testing.assert_array_equal(np.asarray(piece)[evaluated], np.asarray(block)[evaluated])
    assert not np.any(np.asarray(piece)[~evaluated])
    alone = residuals(state.coordinate, state.problem, sample=True)
    np.testing.assert_allclose(alone, some.ravel(), rtol=1e-12, atol=1e-12)


ON_TWO_DEVICES = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from giajax.runtime import parallel as _shares
from giajax import map_on_cores
from giajax.runtime.parallel import map_over_devices

used = []
_shares.map_over_devices = lambda *words: used.append(words) or map_over_devices(*words)

def steps(item, factor, name):
    # Each item as many steps as it says, which those of other devices do not wait for.
    counted = jax.lax.while_loop(lambda n: n < item["n"], lambda n: n + 1, 0)
    return {name: factor * item["x"], "n": counted}

items = {"x": np.arange(10.0).reshape(5, 2), "n": np.arange(5)}
lying = map_over_devices(steps, items, (jnp.float64(3), "y"), None)
assert lying["y"].shape == (6, 2)
assert {shard.data.shape for shard in lying["y"].addressable_shards} == {(3, 2)}
assert len(lying["y"].sharding.device_set) == len(jax.devices()) == 2
for batch_size in (None, 2):
    found = map_on_cores(steps, items, jnp.float64(3), "y", batch_size=batch_size)
    np.testing.assert_array_equal(found["y"], 3 * items["x"])
    np.testing.assert_array_equal(found["n"], items["n"])
assert len(used) == 2
"""


def test_a_batch_is_shared_out_over_devices():
    """With two devices, which a process must request before it starts JAX."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    environment = {**os.environ, "XLA_FLAGS": flags}
    subprocess.run([sys.executable, "-c", ON_TWO_DEVICES], env=environment, check=True)


@pytest.mark.parametrize("count", ["1", "3"])
def test_all_jobs_give_their_results_in_order_or_stop(count, monkeypatch):
    monkeypatch.setenv("GIAJAX_CORES", count)
    assert all_in_threads([]) == []
    assert all_in_threads([lambda tell, k=k: k for k in range(5)]) == list(range(5))

    def interrupted():
        raise KeyboardInterrupt

    # Ctrl-C while a message is shown, after which the job would have ended by itself.
    def asked(tell):
        tell(interrupted)
        return 1

    with pytest.raises(KeyboardInterrupt):
        all_in_threads([asked])

    def slow(tell):
        time.sleep(0.3)
        return 2

    with pytest.raises(KeyboardInterrupt):
        all_in_threads([asked, slow, slow])
