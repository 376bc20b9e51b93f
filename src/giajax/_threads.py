"""Jobs in threads, told of as if they came one after the other."""

import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar

from ._blas import one_blas_thread
from ._cores import carried

Result = TypeVar("Result")


class Tell(Protocol):
    """What a job calls others with: callbacks that are not its own."""

    def __call__(self, function: Callable[..., object], *args: Any) -> None:
        """Have a function called.

        Raises:
            KeyboardInterrupt: the jobs are to stop.
        """


def side_by_side(
    jobs: Sequence[Callable[[Tell], Result]], most: int, *, until: Callable[[Result], bool]
) -> list[Result | None]:
    """Results of jobs, of which some run at once.

    What a job tells is called in the thread of the caller, and in the order of the jobs: of a later
    one it waits until the earlier ones have ended. After Ctrl-C, or where what is told raises
    `KeyboardInterrupt`, the jobs that run are stopped by the next thing that they tell, and the
    others do not begin.

    Arguments:
        jobs: functions of `tell`; what a job returns when it is stopped is its result, too.
        most: so many at once.
        until: of a result, whether it stops the others.

    Returns:
        The results in their order; None of a job that did not begin.
    """
    if most == 1:
        return _one_by_one(jobs, until)
    news: queue.SimpleQueue[tuple[int, Callable[[], object]] | None] = queue.SimpleQueue()
    stop = threading.Event()

    def begun(index: int) -> Result | None:
        def tell(function: Callable[..., object], *args: Any) -> None:
            if stop.is_set():
                raise KeyboardInterrupt
            news.put((index, lambda: function(*args)))

        if stop.is_set():
            return None
        try:
            result = jobs[index](tell)
        except BaseException:
            stop.set()
            raise
        if until(result):
            stop.set()
        return result

    with one_blas_thread(), ThreadPoolExecutor(most, "giajax") as pool:
        try:
            futures = [pool.submit(carried(begun, most), index) for index in range(len(jobs))]
            for future in futures:
                future.add_done_callback(lambda _: news.put(None))
            told: list[list[Callable[[], object]]] = [[] for _ in jobs]
            first = 0
            while first < len(jobs):
                try:
                    ended = futures[first].done()
                    _receive(news, told, wait=not ended)
                    while told[first]:
                        call = told[first].pop(0)
                        if not stop.is_set():
                            call()
                    first += ended
                except KeyboardInterrupt:
                    stop.set()
        except BaseException:
            stop.set()
            raise
    return [future.result() for future in futures]


def _one_by_one(
    jobs: Sequence[Callable[[Tell], Result]], until: Callable[[Result], bool]
) -> list[Result | None]:
    results: list[Result | None] = [None] * len(jobs)
    for index, job in enumerate(jobs):
        results[index] = result = job(directly)
        if until(result):
            break
    return results


def directly(function: Callable[..., object], *args: Any) -> None:
    """`Tell` of a job that runs in the thread of the caller."""
    function(*args)


def _receive(
    news: "queue.SimpleQueue[Any]", told: Sequence[list[Callable[[], object]]], *, wait: bool
) -> None:
    """Take what was told; where there is nothing, wait for something."""
    try:
        # Not for ever: what Ctrl-C has interrupted may have been the last.
        item = news.get(wait, timeout=1.0) if wait else news.get_nowait()
        while True:
            if item is not None:
                index, call = item
                told[index].append(call)
            item = news.get_nowait()
    except queue.Empty:
        return
