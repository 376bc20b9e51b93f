"""Many items by compiled programs on all cores of a machine.

Each core takes shares of the items, in a thread of its own: XLA lets go of Python's lock while it
computes. All shares of a batch are equally long, so that one program does for them; what a share
lacks is filled up with an item that it has, and left out again.
"""

import contextvars
import dataclasses
import importlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, ParamSpec, TypeVar

import jax
import numpy as np

from ._errors import InputError
from ._typing import Float

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

VARIABLE = "GIAJAX_CORES"
"""Environment variable: on how many cores to compute at most."""

# Where JAX had it before it was public.
_home: Any = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
_enable_x64 = _home.enable_x64

# Of a thread that computes beside others: its part of the cores.
_part: contextvars.ContextVar[int | None] = contextvars.ContextVar("giajax_cores", default=None)

# Keys of the shares whose programs are compiled.
_compiled: set[int] = set()


def cores() -> int:
    """On how many cores to compute: those that this process may use, or fewer if so told.

    Raises:
        InputError: the environment variable is no positive number.
    """
    if jax.default_backend() != "cpu":
        return 1
    if (part := _part.get()) is not None:
        return part
    told = os.environ.get(VARIABLE)
    if told is None:
        # Not every system lets a process ask.
        allowed = getattr(os, "sched_getaffinity", None)
        return len(allowed(0)) if allowed else os.cpu_count() or 1
    if not told.isdecimal() or int(told) == 0:
        raise InputError(f"{VARIABLE} is {told!r}: give the number of cores, or leave it out")
    return int(told)


def carried(function: Callable[Parameters, Result], among: int) -> Callable[Parameters, Result]:
    """A function for other threads, with the settings of JAX that the present one has.

    Arguments:
        function: any.
        among: how many threads the cores are shared by.
    """
    part = max(1, cores() // among)
    # What a `with` of JAX sets counts in its own thread only.
    wide = bool(jax.config.read("jax_enable_x64"))

    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        _part.set(part)
        with _enable_x64(wide):
            return function(*args, **kwargs)

    return call


@dataclasses.dataclass(frozen=True)
class Batch:
    """Items that share a program.

    Attributes:
        call: a compiled program of some of the items and of `shared`; the leaves of its result have
            a leading axis of these items.
        items: a pytree of arrays with a leading axis of all of them.
        shared: further arguments.
        sizes: how much work each item is, in any unit, shape (item,).
    """

    call: Callable[..., Any]
    items: Any
    shared: tuple[Any, ...]
    sizes: Float[np.ndarray, " item"]


def on_all_cores(batches: Sequence[Batch], most: int | None = None) -> list[Any]:
    """What programs make of batches of items.

    Arguments:
        batches: each with a program of its own.
        most: cores to use at most; by default `cores()`.

    Returns:
        Of each batch what `call` would return of all of its items, in NumPy's arrays.
    """
    most = most or cores()
    shared_out = [_shares_of(batch, most) for batch in batches]
    tasks = [share for each in shared_out for share in each]
    # Two threads that need the same program for the first time would both compile it.
    new = {share.key: share for share in tasks if share.key not in _compiled}
    results = _run(list(new.values()), most)
    _compiled.update(new)
    results |= _run([share for share in tasks if id(share) not in results], most)
    return [_whole(each, [results[id(share)] for share in each]) for each in shared_out]


def dealt(sizes: Float[np.ndarray, " item"], count: int) -> list[np.ndarray]:
    """Positions of items in shares of equal length, and of about equal work.

    Arguments:
        sizes: how much work each item is, shape (item,).
        count: of the shares; fewer, where there are fewer items.

    Returns:
        The shares; an item may stand in one of them twice, to make it as long as the others.
    """
    order = np.argsort(-np.asarray(sizes), kind="stable").tolist()
    count = min(count, len(order))
    length = -(-len(order) // count)
    hands: list[list[int]] = [[] for _ in range(count)]
    for place, item in enumerate(order):
        # There and back again: who gets the largest of a round gets the smallest of the next one.
        number, seat = divmod(place, count)
        hands[count - 1 - seat if number % 2 else seat].append(item)
    return [np.asarray(hand + hand[-1:] * (length - len(hand))) for hand in hands]


@dataclasses.dataclass(frozen=True)
class _Share:
    """Some items of a batch: which, themselves, how much work they are, and their program's key."""

    batch: Batch
    rows: np.ndarray
    items: Any
    size: float
    key: int

    def compute(self) -> Any:
        return jax.tree.map(np.asarray, self.batch.call(self.items, *self.batch.shared))


def _shares_of(batch: Batch, most: int) -> list[_Share]:
    # A view, where the device is the CPU: to take a share is then NumPy's work, not JAX's.
    items = jax.tree.map(np.asarray, batch.items)
    shares = []
    for rows in dealt(batch.sizes, most):
        own = jax.tree.map(lambda leaf, rows=rows: leaf[rows], items)
        leaves, tree = jax.tree.flatten((own, batch.shared))
        key = hash((id(batch.call), tree, tuple(map(_kind, leaves))))
        shares.append(_Share(batch, rows, own, float(np.sum(batch.sizes[rows])), key))
    return shares


def _kind(leaf: Any) -> Any:
    """What a program is compiled for: the form of an array, and the value of anything else."""
    return (leaf.shape, str(leaf.dtype)) if hasattr(leaf, "dtype") else leaf


def _whole(shares: Sequence[_Share], parts: Sequence[Any]) -> Any:
    """Results of the items in their order, each once."""
    place = np.unique(np.concatenate([share.rows for share in shares]), return_index=True)[1]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[place], *parts)


def _run(shares: Sequence[_Share], most: int) -> dict[int, Any]:
    """Results by the identity of the share; the largest ones are begun first."""
    ordered = sorted(shares, key=lambda share: -share.size)
    if most == 1 or len(ordered) < 2:
        return {id(share): share.compute() for share in ordered}
    # Beginning threads takes a tenth of a millisecond; none is left when nothing is to be done.
    with ThreadPoolExecutor(min(most, len(ordered)), "giajax") as pool:
        results = list(pool.map(carried(_Share.compute, most), ordered))
    return {id(share): result for share, result in zip(ordered, results, strict=True)}
