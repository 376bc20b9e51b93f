"""Programs kept between processes as they were traced: a later process does not trace them again.

Tracing a fit takes longer than to compile small programs or to run it. What is kept is StableHLO,
JAX's own exchange format, and no executable: JAX's persistent compilation cache has that.

A file is found by all that tracing depends on: the source of this package, the versions of the
libraries, their settings, and the structure of the arguments. Whatever goes wrong, the caller
traces as without it.
"""

import dataclasses
import hashlib
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax import export

from ._kept_files import SUFFIX, origin, read, sources, write
from ._structure import NoStructureError, structure

_SETTINGS = ("JAX_", "XLA_", "EQX_")

# Calls whose form JAX may change between versions; a file is read by one version only.
_UNSTABLE = ("lapack_sormqr_ffi", "lapack_dormqr_ffi")

_folder: Path | None = None

Call = Callable[..., Any]


def keep_programs(folder: Path) -> None:
    """From now on, keep programs in a folder, and use those that are there.

    To be called by a process that nobody changes while it runs: what a test or a notebook patches
    is not seen in the source, and must not be kept.

    Arguments:
        folder: is made where it is missing.
    """
    global _folder
    _folder = folder
    origin()


def keeps_programs() -> bool:
    """Whether programs are kept; not where JAX is to look into them."""
    looking = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs")
    return _folder is not None and not any(getattr(jax.config, name) for name in looking)


class KeptProgram:
    """A function whose programs are kept; see `giajax._program.program`.

    Arguments:
        function: a pure function of pytrees.
        like: from the same arguments, a tree as the function returns.
        options: arguments of `jax.jit`.
    """

    def __init__(self, function: Call, like: Call, options: dict[str, Any]) -> None:
        self._function = function
        self._like = like
        self._options = options
        self._calls: dict[str, Call | None] = {}

    def ready(self, args: tuple[Any, ...]) -> Call | None:
        """What computes the function for arguments of this structure.

        Arguments:
            args: of the function.

        Returns:
            Is called with the arguments; None where the program cannot be kept.
        """
        try:
            key = structure(args)
        except NoStructureError:
            return None
        if key not in self._calls:
            try:
                self._calls[key] = self._prepared(key, args)
            except Exception:
                # Whatever is wrong with the arguments, the function itself says it better.
                self._calls[key] = None
        return self._calls[key]

    def _prepared(self, key: str, args: tuple[Any, ...]) -> Call:
        assert _folder is not None
        like = self._like(*args)
        path = _folder / self._name(key, structure(like))
        leaves = jax.tree.leaves(eqx.filter(args, eqx.is_array))
        places, static = eqx.partition(like, _is_shaped)
        shapes, tree = jax.tree.flatten(places)
        blank = _blank(shapes, leaves)
        try:
            module = read(path)
        except (OSError, ValueError):
            # Not there, or not as it was written.
            module = self._traced(args, leaves, like, blank)
            # Where somebody edits meanwhile, nobody knows which source was traced.
            if sources() == origin():
                write(path, module)
        known = dataclasses.replace(blank, mlir_module_serialized=module)
        # The same text in every process: the compilation cache knows it.
        compiled = jax.jit(known.call, **self._options).lower(*leaves).compile()

        def call(*args: Any) -> Any:
            found = compiled(*jax.tree.leaves(eqx.filter(args, eqx.is_array)))
            return eqx.combine(jax.tree.unflatten(tree, found), static)

        return call

    def _traced(
        self, args: tuple[Any, ...], leaves: Sequence[Any], like: Any, blank: export.Exported
    ) -> bytes:
        """The module of the function."""
        dynamic, static = eqx.partition(args, eqx.is_array)
        tree = jax.tree.structure(dynamic)
        returned: list[str] = []

        def flat(*leaves: Any) -> tuple[Any, ...]:
            result = self._function(*eqx.combine(jax.tree.unflatten(tree, leaves), static))
            arrays, rest = eqx.partition(result, eqx.is_array)
            returned.append(structure(rest))
            return tuple(jax.tree.leaves(arrays))

        checks = [export.DisabledSafetyCheck.custom_call(name) for name in _UNSTABLE]
        whole = export.export(jax.jit(flat, keep_unused=True), disabled_checks=checks)(*leaves)
        promised = structure(eqx.partition(like, _is_shaped)[1])
        if returned[0] != promised or _calling(whole) != _calling(blank):
            raise ValueError("the function does not return what it is said to")
        return whole.mlir_module_serialized

    def _name(self, key: str, result: str) -> str:
        """The name of the file."""
        name = f"{self._function.__module__}.{self._function.__qualname__}"
        settings = sorted((k, v) for k, v in os.environ.items() if k.startswith(_SETTINGS))
        device = jax.devices()[0]
        parts = (name, key, result, settings, repr(self._options), origin(), str(device.platform))
        whole = repr((*parts, str(jax.numpy.result_type(float))))
        return f"{name}-{hashlib.sha256(whole.encode()).hexdigest()[:40]}{SUFFIX}"


def _is_shaped(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _blank(shapes: Sequence[Any], leaves: Sequence[Any]) -> export.Exported:
    """A program of zeros that takes and returns the same: only its module is another."""

    def zeros(*leaves: Any) -> tuple[Any, ...]:
        del leaves
        return tuple(jax.lax.full(each.shape, 0, each.dtype) for each in shapes)

    return export.export(jax.jit(zeros, keep_unused=True))(*leaves)


def _calling(program: export.Exported) -> tuple[Any, ...]:
    """How an exported program is called."""
    return (
        program.in_tree,
        program.in_avals,
        program.out_tree,
        program.out_avals,
        program.platforms,
        program.nr_devices,
        program.ordered_effects,
        program.unordered_effects,
        program.module_kept_var_idx,
        program.uses_global_constants,
        program.calling_convention_version,
    )
