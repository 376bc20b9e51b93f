"""Parallel computation by compiled programs on all cores of a machine, or on several devices."""

import dataclasses
import functools
import queue
import threading
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol, TypeVar, cast

import equinox as eqx
import jax
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from .arrays import Float
from .process import carried, cores, one_blas_thread, stop_if_asked
from .programs import compiled_ahead, leaf_kind, program
from .text import InputError

Result = TypeVar("Result")


class Tell(Protocol):
    """Function with which a job calls callbacks that are not its own."""

    def __call__(self, function: Callable[..., object], *args: Any) -> None:
        """Request the call of a function (`KeyboardInterrupt`: the jobs must stop)."""


def run_in_threads(
    jobs: Sequence[Callable[[Tell], Result]], most: int, *, until: Callable[[Result], bool]
) -> list[Result | None]:
    """Run jobs in parallel and return their results.

    At most `most` jobs run at once. The callbacks of a job are called in the calling thread and in
    the order of the jobs: the callbacks of a later job wait until the earlier jobs have ended.
    After Ctrl-C, or if a callback raises `KeyboardInterrupt`, running jobs stop at their next
    callback, and jobs that have not started have the result None. The value that a stopped job
    returns is its result. A result for which `until` is true also stops the other jobs.
    """
    if most == 1:
        results: list[Result | None] = [None] * len(jobs)
        for index, job in enumerate(jobs):
            results[index] = result = job(directly)
            if until(result):
                break
        return results
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
    # The error that stopped the other jobs takes precedence.
    for future in futures:
        error = future.exception()
        if error is not None and not isinstance(error, KeyboardInterrupt):
            raise error
    return [future.result() for future in futures]


def all_in_threads(jobs: Sequence[Callable[[Tell], Result]]) -> list[Result]:
    """Run jobs in parallel on all cores and return all of their results, in order.

    Raises:
        KeyboardInterrupt: after Ctrl-C. Running jobs stop at their next callback or end first.
    """

    def watched(job: Callable[[Tell], Result], tell: Tell) -> Result:
        tell(stop_if_asked)
        result = job(tell)
        tell(stop_if_asked)
        return result

    watching = [functools.partial(watched, job) for job in jobs]
    most = max(1, min(cores(), len(jobs)))
    found = run_in_threads(watching, most, until=lambda _: False)
    if any(each is None for each in found):
        raise KeyboardInterrupt
    return cast("list[Result]", found)


def directly(function: Callable[..., object], *args: Any) -> None:
    """`Tell` for a job that runs in the calling thread."""
    function(*args)


def _receive(
    news: "queue.SimpleQueue[Any]", told: Sequence[list[Callable[[], object]]], *, wait: bool
) -> None:
    """Receive the requested callbacks; if there are none, optionally wait for one."""
    try:
        # The wait is limited, because Ctrl-C may have interrupted the last callback.
        item = news.get(wait, timeout=1.0) if wait else news.get_nowait()
        while True:
            if item is not None:
                index, call = item
                told[index].append(call)
            item = news.get_nowait()
    except queue.Empty:
        return


# Many items, by one compiled program, on several devices with an equal share for each.
#
# Each device computes its share independently, so an item with more steps does not delay the
# others.

_AXIS = "item"


def map_over_devices(
    function: Callable[..., Any], items: Any, shared: tuple[Any, ...], batch_size: int | None
) -> Any:
    """Compute `giajax.map_on_cores` with arrays that are distributed over all devices.

    The last item is repeated as often as necessary to make all shares equally long.
    """
    mesh = Mesh(np.asarray(jax.local_devices()), (_AXIS,))
    count = len(jax.tree.leaves(items)[0])
    rows = np.minimum(np.arange(count + -count % mesh.size), count - 1)
    items = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], items)
    items = jax.device_put(items, NamedSharding(mesh, PartitionSpec(_AXIS)))
    numbers, rest = eqx.partition((function, shared), eqx.is_array)
    numbers = jax.device_put(numbers, NamedSharding(mesh, PartitionSpec()))
    return _shared_out(items, numbers, rest, batch_size, mesh)


@program
def _shared_out(items: Any, numbers: Any, rest: Any, batch_size: int | None, mesh: Mesh) -> Any:
    def part(items: Any, numbers: Any) -> Any:
        function, shared = eqx.combine(numbers, rest)
        return jax.lax.map(lambda item: function(item, *shared), items, batch_size=batch_size)

    specs = (PartitionSpec(_AXIS), PartitionSpec())
    return jax.shard_map(
        part, mesh=mesh, in_specs=specs, out_specs=PartitionSpec(_AXIS), check_vma=False
    )(items, numbers)


# Many items, by compiled programs, on all cores of a machine.
#
# Each core computes one share of the items after the other, in a thread of its own, because XLA
# releases Python's lock while it computes. All shares of a batch are equally long, so they use the
# same program. The last share is filled with repeated items, whose results are removed again.

# Keys of the shares whose programs are compiled.
_compiled: set[Hashable] = set()


@dataclasses.dataclass(frozen=True)
class Batch:
    """Items that use the same program.

    Attributes:
        call: compiled program of some of the items and of `shared`; the leaves of its result have a
            leading axis with these items.
        items: pytree of arrays with a leading axis of all items.
        shared: further arguments.
        sizes: relative amount of work for each item, shape (item,).
        length: number of items in a share.
    """

    call: Callable[..., Any]
    items: Any
    shared: tuple[Any, ...]
    sizes: Float[np.ndarray, " item"]
    length: int


def run_on_all_cores(batches: Sequence[Batch], most: int | None = None) -> list[Any]:
    """Return, for each batch, the result of `call` for all of its items, as NumPy arrays.

    At most `most` cores are used, by default `cores()`.
    """
    most = most or cores()
    shared_out = [_shares_of(batch) for batch in batches]
    tasks = [share for each in shared_out for share in each]
    # Two threads that need the same new program would both compile it.
    new = {share.key: share for share in tasks if share.key not in _compiled}
    at_hand = _run(list(new.values()), most, _Share.compiled_ahead)
    results = _run([share for share in new.values() if not at_hand[id(share)]], most)
    _compiled.update(new)
    results |= _run([share for share in tasks if id(share) not in results], most)
    return [_whole(each, [results[id(share)] for share in each]) for each in shared_out]


def map_on_cores(
    function: Callable[..., Any], items: Any, *shared: Any, batch_size: int | None = None
) -> Any:
    """Apply `jax.lax.map` on all cores of the machine, or on all devices if JAX has several.

    Each core or device computes shares of the items, one after the other. The items, such as arms,
    commands or states, may differ only in numbers, so one program is sufficient for all of them.
    The function is called with concrete numbers and cannot be traced or differentiated by JAX. The
    given function itself may differentiate.

    Arguments:
        function: function of one item and `shared`, at the top level of a module, because a
            function that is defined again is compiled again.
        items: pytree of arrays with a leading axis of the items.
        shared: further arguments, the same for all items.
        batch_size: number of items that are vectorised within a share, by `jax.vmap`.

    Returns:
        The result of the function, in which each leaf is a NumPy array with a leading axis of the
        items.

    Raises:
        InputError: there are no items, or the environment variable GIAJAX_CORES is not a number.

    Example:
        >>> import giajax
        >>> import jax.numpy as jnp
        >>> giajax.map_on_cores(jnp.square, jnp.arange(3)).tolist()
        [0, 1, 4]
    """
    counts = {np.shape(leaf)[:1] for leaf in jax.tree.leaves(items)}
    if len(counts) != 1 or not next(iter(counts), ()) or not (count := counts.pop()[0]):
        raise InputError(
            "the items have no common leading axis, or there are no items: give arrays whose "
            "first axis has one entry for each item"
        )
    if len(jax.local_devices()) > 1:
        several = map_over_devices(function, items, shared, batch_size)
        return jax.tree.map(lambda leaf: np.asarray(leaf)[:count], several)
    # Each core receives several shares, so a core that is also used by other processes computes
    # fewer.
    least, together = -(-count // (4 * cores())), batch_size or 1
    length = max(1, -(-least // together) * together)
    batch = Batch(_mapped, items, (function, batch_size, shared), np.ones(count), length)
    return run_on_all_cores([batch])[0]


@program
def _mapped(
    items: Any, function: Callable[..., Any], batch_size: int | None, shared: tuple[Any, ...]
) -> Any:
    return jax.lax.map(lambda item: function(item, *shared), items, batch_size=batch_size)


def stacked_items(items: Sequence[Any]) -> Any:
    """Stack pytrees of the same structure and shapes along a new first axis, as NumPy arrays.

    With JAX, each array would be a program.
    """
    return jax.tree.map(lambda *leaves: np.stack(leaves), *items)


def split_evenly(sizes: Float[np.ndarray, " item"], length: int) -> list[np.ndarray]:
    """Return indices of items in shares of equal length, with the largest items first.

    An item may be repeated in the last share, to make it as long as the others.
    """
    order = np.argsort(-np.asarray(sizes), kind="stable")
    whole = np.append(order, np.repeat(order[-1:], -len(order) % length))
    return list(whole.reshape(-1, length))


def tangents_in_parts(count: int, parts: int) -> Float[np.ndarray, "part tangent quantity"]:
    """Return the tangents of some quantities in equal parts that are differentiated together.

    The last part may end with zeros.
    """
    each = -(-count // parts)
    whole = np.eye(parts * each, count, dtype=jax.numpy.result_type(float))
    return whole.reshape(parts, each, count)


@dataclasses.dataclass(frozen=True)
class _Share:
    """Some items of a batch: indices, data, amount of work, and the key of their program."""

    batch: Batch
    rows: np.ndarray
    items: Any
    size: float
    key: Hashable

    def compute(self) -> Any:
        return jax.tree.map(np.asarray, self.batch.call(self.items, *self.batch.shared))

    def compiled_ahead(self) -> bool:
        return compiled_ahead(self.batch.call, self.items, *self.batch.shared)


def _shares_of(batch: Batch) -> list[_Share]:
    # On the CPU this is a view, so NumPy rather than JAX selects the items of a share.
    items = jax.tree.map(np.asarray, batch.items)
    shares = []
    for rows in split_evenly(batch.sizes, batch.length):
        own = jax.tree.map(lambda leaf, rows=rows: leaf[rows], items)
        leaves, tree = jax.tree.flatten((own, batch.shared))
        key = (id(batch.call), tree, tuple(map(leaf_kind, leaves)))
        shares.append(_Share(batch, rows, own, float(np.sum(batch.sizes[rows])), key))
    return shares


def _whole(shares: Sequence[_Share], parts: Sequence[Any]) -> Any:
    """Return the results of all items in their order, without repetitions."""
    place = np.unique(np.concatenate([share.rows for share in shares]), return_index=True)[1]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[place], *parts)


def _run(
    shares: Sequence[_Share], most: int, of: Callable[[_Share], Any] = _Share.compute
) -> dict[int, Any]:
    """Return the results by the identity of the share; the largest shares start first."""
    ordered = sorted(shares, key=lambda share: -share.size)
    if most == 1 or len(ordered) < 2:
        return {id(share): of(share) for share in ordered}
    # Starting threads takes a tenth of a millisecond. No idle thread remains afterwards.
    with one_blas_thread(), ThreadPoolExecutor(min(most, len(ordered)), "giajax") as pool:
        results = list(pool.map(carried(of, most), ordered))
    return {id(share): result for share, result in zip(ordered, results, strict=True)}
