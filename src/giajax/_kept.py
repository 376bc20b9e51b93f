"""Programs kept between processes as they were traced: a later process does not trace them again.

Tracing a fit takes longer than to compile small programs or to run it. What is kept is StableHLO,
JAX's own exchange format, and no executable: JAX's persistent compilation cache has that.

A file is found by all that tracing depends on: the source of this package, the versions of the
libraries, their settings, and the structure of the arguments. Whatever goes wrong, the caller
traces as without it.
"""

import dataclasses
import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
from jax import export

from ._structure import NoStructureError, structure

SUFFIX = ".stablehlo"
"""Of the files' names."""

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
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


def keeps_programs() -> bool:
    """Whether programs are kept."""
    return _folder is not None


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
            module = _verified(path.read_bytes())
        except (OSError, ValueError):
            module = self._traced(args, leaves, like, blank)
            _write(path, module)
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
        parts = (name, key, result, settings, repr(self._options), _origin(), str(device.platform))
        whole = repr((*parts, jax.config.read("jax_enable_x64")))
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


@functools.cache
def _origin() -> str:
    """What tracing depends on beside the arguments: the source of this package, and versions."""
    digest = hashlib.sha256(sys.version.encode())
    for name in _LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    root = Path(__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _verified(content: bytes) -> bytes:
    """A module as it was written.

    Raises:
        ValueError: a file that is cut off, or was changed.
    """
    digest, module = content[:32], content[32:]
    if hashlib.sha256(module).digest() != digest:
        raise ValueError("the program is not as it was written")
    return module


def _write(path: Path, module: bytes) -> None:
    """Write a file whole, or not at all; another process may write the same one."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.sha256(module).digest() + module)
        temporary.replace(path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
