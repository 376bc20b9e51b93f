"""Many evaluations at once on two cores: processes of giajax and threads of MuJoCo."""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import jax
import numpy as np

from benchmarks.batch import arranged, evaluate, evaluations, waited
from benchmarks.measuring import in_turns
from peers.arms import driven_arm, random_states
from peers.mujoco_c import MujocoInC

ITEMS, CORES = 256, 2
# The layout is fixed, because the least of several would favour giajax by having more samples.
LAYOUT = "chunks of 64"

# Numbers of items on a GPU, which needs many of them to be occupied.
GPU_ITEMS = (ITEMS, 16 * ITEMS, 256 * ITEMS)


def batch(
    links: int,
    repeats: int,
    loop: int,
    engine: MujocoInC | None,
) -> dict[str, Any]:
    """Measure the seconds per evaluation of one item, by program and layout."""
    calls: dict[str, Callable[[], object]] = {}
    if engine is not None:
        states = _states(links, 0, 1)
        numbers = [np.asarray(states[name]) for name in ("angles", "rates", "command")]
        calls["MuJoCo, drag in C"] = lambda: engine.batch(*numbers, threads=CORES, loop=loop)
    with ExitStack() as processes:
        calls[f"giajax, {LAYOUT}"] = processes.enter_context(_workers(links, LAYOUT, loop))
        found = in_turns(calls, repeats)
    return {
        name: {key: value / ITEMS / loop for key, value in each.items()}
        for name, each in found.items()
    }


def on_gpu(links: int, repeats: int, loop: int) -> dict[str, Any]:
    """Measure the seconds per evaluation of one item on the first GPU, by number of items.

    Empty if JAX finds none, for example because JAX_PLATFORMS is set to "cpu". The measurement
    takes place in another process, because this one may be restricted to the CPU.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(_first_gpu, links, repeats, loop).result()


def _first_gpu(links: int, repeats: int, loop: int) -> dict[str, Any]:
    jax.config.update("jax_enable_x64", True)
    gpus = [device for device in jax.devices() if device.platform in ("gpu", "cuda", "rocm")]
    return on_device(links, repeats, loop, gpus[0], GPU_ITEMS) if gpus else {}


def on_device(
    links: int, repeats: int, loop: int, device: jax.Device, sizes: Sequence[int]
) -> dict[str, Any]:
    """Measure the seconds per evaluation of one item in one process on a device, by size."""
    arm, _ = driven_arm(links)
    loop = max(loop, 2)
    # The XLA options of giajax are for a CPU.
    compiled = jax.jit(evaluate, static_argnames="layout")
    calls = {}
    for items in sizes:
        given = jax.device_put((arm, _states(links, 0, 1, items)), device)
        call = partial(compiled, *given, "items first", np.asarray(loop, np.int32))
        calls[f"{device.device_kind}, {items} items"] = partial(waited, call)
    found = in_turns(calls, repeats)
    return {
        name: {key: value / items / loop for key, value in each.items()}
        for items, (name, each) in zip(sizes, found.items(), strict=True)
    }


def _states(links: int, share: int, shares: int, items: int = ITEMS) -> dict[str, Any]:
    """Return one of `shares` equal parts of the states."""
    states = random_states(links, items)
    states.pop("wind")
    return {name: value[share::shares] for name, value in states.items()}


@contextmanager
def _workers(links: int, layout: str, loop: int) -> Iterator[Callable[[], object]]:
    """Start a process for each core; the yielded function makes each compute its share once."""
    context = multiprocessing.get_context("spawn")
    ours, processes = [], []
    for share in range(CORES):
        here, there = context.Pipe()
        process = context.Process(
            target=_work, args=(there, links, share, layout, loop), daemon=True
        )
        process.start()
        # Close this copy, so the end of the process closes the last copy of its end of the pipe.
        there.close()
        ours.append(here)
        processes.append(process)

    def call() -> None:
        for connection in ours:
            connection.send(True)
        for connection in ours:
            connection.recv()

    try:
        yield call
    finally:
        for connection, process in zip(ours, processes, strict=True):
            with suppress(OSError):
                connection.send(False)
            process.join()


def _work(asked: Connection, links: int, share: int, layout: str, loop: int) -> None:
    # Bind each process to one core. XLA and BLAS then use one thread in each, like MuJoCo.
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[share % len(cores)]})
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    jax.config.update("jax_platforms", "cpu")
    jax.config.update("jax_enable_x64", True)
    arm, _ = driven_arm(links)
    states = arranged(_states(links, share, CORES), layout)
    while asked.recv():
        jax.block_until_ready(evaluations(arm, states, layout, np.asarray(loop, np.int32)))
        asked.send(True)
