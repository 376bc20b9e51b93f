"""Compiled programs, with the options of XLA that suit a long chain on a CPU.

The default code generator of XLA for CPUs fuses the many small operations of a chain into large
kernels. On the dynamics of an arm it compiles twice as long as the older one, and what it makes is
a third slower; a schedule that minimises memory keeps the rows of a chain in the cache.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np

from ._kept import KeptProgram, keeps_programs

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}
"""Names and values of `jax.jit(compiler_options=...)`."""


def program(function: Function, *, like: Callable[..., Any] | None = None) -> Function:
    """Compile a function as `equinox.filter_jit` does, on a CPU with `CPU_OPTIONS`.

    XLA takes options for whole programs only: within another program, and under a transformation
    of JAX, the function becomes a part of that one, and has its options.

    Arguments:
        function: a pure function of pytrees; what is no array is static.
        like: from the same arguments, a tree as the function returns (`jax.ShapeDtypeStruct` will
            do for an array). Its programs are then kept between processes, where the process
            keeps any (`giajax._kept`), and are not traced again.
    """
    part = eqx.filter_jit(function)
    whole: Callable[..., Any] | None = None
    kept: KeptProgram | None = None

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal whole, kept
        if _is_traced((args, kwargs)):
            return part(*args, **kwargs)
        if like is not None and keeps_programs() and not kwargs:
            if kept is None:
                kept = KeptProgram(function, like, _options())
            if (known := kept.ready(args)) is not None:
                return known(*args)
        if whole is None:
            # Asks for the device, which an import must not do.
            options = _options()
            # Equinox passes what it does not know on to `jax.jit`; its annotations leave that out.
            compiled: Any = functools.partial(eqx.filter_jit, **options)
            whole = compiled(function)
        return whole(*args, **kwargs)

    return call  # type: ignore[return-value]


def _is_traced(arguments: Any) -> bool:
    """Whether a program is being traced (then even a constant is a part of it), or an argument."""
    leaves = [jax.device_put(np.float32(0)), *jax.tree.leaves(arguments)]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)


@functools.cache
def _options() -> dict[str, Any]:
    """Arguments of `jax.jit`: the options, where the device is a CPU and its XLA knows them."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        # XLA refuses a name that it does not know, and names come and go with its versions.
        jax.jit(lambda: np.float32(0), compiler_options=CPU_OPTIONS)()
    except Exception:
        return {}
    return {"compiler_options": CPU_OPTIONS}
