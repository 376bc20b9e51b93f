"""How many cores a process computes on, and what its threads have to know.

Without JAX until it is asked: the command line has the variable's name in its help.
"""

import contextvars
import functools
import importlib
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from ._errors import InputError

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

CORES_VARIABLE = "GIAJAX_CORES"
"""Environment variable: on how many cores to compute at most."""

# Of a thread that computes beside others: its part of the cores.
_part: contextvars.ContextVar[int | None] = contextvars.ContextVar("giajax_cores", default=None)


def cores() -> int:
    """On how many cores to compute: those that this process may use, or as many as so told.

    Raises:
        InputError: the environment variable is no positive number.
    """
    import jax

    if jax.default_backend() != "cpu":
        return 1
    if (part := _part.get()) is not None:
        return part
    told = os.environ.get(CORES_VARIABLE)
    if not told:
        # Not every system lets a process ask.
        allowed = getattr(os, "sched_getaffinity", None)
        there = len(allowed(0)) if allowed else os.cpu_count() or 1
        return min(there, _quota() or there)
    if not told.isdecimal() or int(told) == 0:
        raise InputError(f"{CORES_VARIABLE} is {told!r}: give the number of cores, or leave it out")
    return int(told)


@functools.cache
def _quota(root: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Cores whose time a container may use (cgroups, version 2 or 1); None where that is no less.

    A container sees all cores of its machine, and is stopped for the rest of each period when its
    time is used up: more threads than that make a step slower.
    """
    try:
        try:
            quota, period = (root / "cpu.max").read_text().split()
        except FileNotFoundError:
            quota, period = (
                (root / "cpu" / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
            )
        return max(1, math.ceil(int(quota) / int(period))) if int(quota) > 0 else None
    except (OSError, ValueError):  # No container, or "max"
        return None


def carried(function: Callable[Parameters, Result], among: int) -> Callable[Parameters, Result]:
    """A function for other threads, which computes with as many bits as the present one.

    What else a `with` of JAX sets (looking for NaN, say) counts in the caller's thread alone.

    Arguments:
        function: any.
        among: how many threads the cores are shared by.
    """
    import jax

    part = max(1, cores() // among)
    wide = bool(jax.config.read("jax_enable_x64"))

    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        _part.set(part)
        with enable_x64(wide):
            return function(*args, **kwargs)

    return call


def enable_x64(wide: bool) -> Any:
    """JAX's context of 64-bit numbers, in the present thread; it was in another place once."""
    import jax

    home: Any = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    return home.enable_x64(wide)
