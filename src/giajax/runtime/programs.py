"""Compiled programs: XLA options, and a cache of traced programs between processes."""

import abc
import contextlib
import copyreg
import dataclasses
import enum
import functools
import gc
import hashlib
import inspect
import json
import logging
import operator
import os
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path, PurePath
from types import FunctionType
from typing import Any, ClassVar, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax import export

from .identities import fields_of, identity
from .plugins import OURS, mark, plugins

_PLAIN = (type(None), bool, int, float, complex, str, bytes)


class NoStructureError(Exception):
    """An object, such as a closure, has no description that is the same in every process."""


def structure(tree: Any) -> str:
    """Describe the parts of a tree that determine how it is traced.

    For an array these are its shape and type, for any other object its value.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_Traced().parts(tree))


def content(tree: Any) -> str:
    """Describe a tree, or any object that can be copied, including its numbers (by SHA-256).

    The text is the same in every process and every version. Classes and functions of giajax are
    represented by their identities, independent of their location. A field that was added to a
    giajax class is included only if it differs from its default.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_Kept().parts(tree))


class _Description:
    """Text of a tree, in pieces."""

    kept: ClassVar[bool]
    """Whether the text includes the values of all arrays, as for stored content."""

    def parts(self, value: Any, *, whole: bool = False) -> Iterator[str]:
        whole = whole or self.kept
        if isinstance(value, (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)):
            weak = "~" if getattr(value, "weak_type", False) else ""
            yield f"{value.dtype}{weak}{list(value.shape)}"
            if whole:
                yield hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
        elif isinstance(value, enum.Enum):
            yield f"{self.name(type(value))}.{value.name}"
        elif isinstance(value, _PLAIN):
            yield f"{type(value).__name__} {value!r}"
        elif isinstance(value, (type, FunctionType)):
            yield self.name(value)
        elif isinstance(value, functools.partial):
            parts = (value.func, value.args, value.keywords)
            yield from self.members("functools.partial", parts, whole=whole)
        elif dataclasses.is_dataclass(value):
            yield f"{self.name(type(value))}("
            yield from self.fields(value, whole=whole)
            yield ")"
        elif isinstance(value, Mapping):
            yield from self.members(self.name(type(value)), value.items(), whole=whole)
        elif isinstance(value, (tuple, list)):
            yield from self.members(self.name(type(value)), value, whole=whole)
        elif isinstance(value, (set, frozenset)):
            ordered = sorted(value, key=lambda item: "".join(self.parts(item)))
            yield from self.members(self.name(type(value)), ordered, whole=whole)
        else:
            yield from self.other(value)

    def members(self, name: str, values: Iterable[Any], *, whole: bool) -> Iterator[str]:
        yield f"{name}("
        for value in values:
            yield from self.parts(value, whole=whole)
            yield ","
        yield ")"

    @abc.abstractmethod
    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        """Yield the text of the fields of a dataclass."""

    @abc.abstractmethod
    def name(self, value: Any) -> str:
        """Return the text of a class or a function."""

    @abc.abstractmethod
    def other(self, value: Any) -> Iterator[str]:
        """Yield the text of any other object."""


def _is_ours(value: Any) -> bool:
    """Return whether a class or a function, and thus its source, does not belong to a plug-in."""
    return value.__module__.partition(".")[0] in OURS


class _Traced(_Description):
    """Description for tracing: only numbers that are part of the program are included."""

    kept = False

    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        for field in dataclasses.fields(value):
            static = whole or bool(field.metadata.get("static"))
            yield f"{field.name}="
            yield from self.parts(getattr(value, field.name), whole=static)
            yield ","

    def name(self, value: Any) -> str:
        text = f"{value.__module__}.{_qualified(value)}"
        if isinstance(value, FunctionType) and not _is_found(value):
            raise NoStructureError(f"{text} refers to a different function")
        return text if _is_ours(value) else text + mark(value)

    def other(self, value: Any) -> Iterator[str]:
        raise NoStructureError(f"there is no description of {type(value)}")


class _Kept(_Description):
    """Description for storage: all numbers are included, and names are permanent."""

    kept = True

    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        for name, item, default in fields_of(value):
            text = "".join(self.parts(item))
            if default is dataclasses.MISSING or text != "".join(self.parts(default)):
                yield f"{name}={text},"

    def name(self, value: Any) -> str:
        text = identity(f"{value.__module__}:{_qualified(value)}").replace(":", ".")
        # The source of a plug-in is included. For modules imported by Python itself, the name is
        # sufficient, as in earlier versions.
        if _is_ours(value) or value.__module__ not in {path.stem for path in plugins()}:
            return text
        return text + mark(value)

    def other(self, value: Any) -> Iterator[str]:
        if isinstance(value, PurePath):
            yield f"path {str(value)!r}"
            return
        name = self.name(type(value))
        # For a pydantic model, the fields that were set, in any order; the others have defaults.
        if isinstance(said := getattr(value, "model_fields_set", None), set):
            pairs = [(field, getattr(value, field)) for field in sorted(said)]
            yield from self.members(name, pairs, whole=True)
            return
        reduce: Callable[[Any], Any] | None = copyreg.dispatch_table.get(type(value))
        try:
            parts = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:
            raise NoStructureError(f"{type(value)} cannot be copied: {error}") from None
        if isinstance(parts, str):
            yield f"{name} {getattr(value, '__module__', None)}.{parts}"
            return
        made, arguments, *rest = parts
        # Members are returned as iterators.
        plain = [list(each) if isinstance(each, Iterator) else each for each in rest]
        yield from self.members(name, [made, arguments, *plain], whole=True)


def _is_found(function: FunctionType) -> bool:
    """Return whether a module has a function under its name; wrappers share the original's name."""
    found: Any = sys.modules.get(function.__module__)
    for name in function.__qualname__.split("."):
        found = getattr(found, name, None)
    return found is function or getattr(found, "__wrapped__", None) is function


def _qualified(value: Any) -> str:
    name: str = value.__qualname__
    if "<" in name:
        raise NoStructureError(f"no module has the name {name}")
    return name


SUFFIX = ".stablehlo"
"""Suffix of the file names."""

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")


def sources() -> str:
    """Return a digest of what tracing depends on besides the arguments: sources and versions."""
    digest = hashlib.sha256(sys.version.encode())
    for name in _LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    # The whole package is included, independent of the location of this module.
    root = Path(str(files(__name__.partition(".")[0])))
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def origin() -> str:
    """`sources` at the time when the process began to store programs."""
    return sources()


def read(path: Path) -> bytes:
    """Return a stored module.

    Raises:
        OSError: the file does not exist or cannot be read.
        ValueError: the file is incomplete or was changed.
    """
    content = path.read_bytes()
    digest, module = content[:32], content[32:]
    if hashlib.sha256(module).digest() != digest:
        raise ValueError(f"{path} has changed since it was written")
    return module


def write(path: Path, module: bytes) -> None:
    """Write a file atomically; another process may write the same file."""
    temporary = None
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=SUFFIX, delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.sha256(module).digest() + module)
        temporary.replace(path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


# Traced programs are stored between processes, so a later process does not trace them again.
#
# Tracing a fit takes longer than compiling small programs or running it. Programs are stored as
# StableHLO, JAX's own exchange format. Executables are stored by JAX's persistent compilation
# cache.
#
# A file is identified by all that tracing depends on: the source of this package, the versions of
# the libraries, their settings, and the structure of the arguments. If anything fails, the caller
# traces the program as without the cache.

_SETTINGS = ("JAX_", "XLA_", "EQX_")

# Calls whose form JAX may change between versions. A file is read by one version only.
_UNSTABLE = ("lapack_sormqr_ffi", "lapack_dormqr_ffi")

_folder: Path | None = None

_log = logging.getLogger(__name__)

Call = Callable[..., Any]

Given = tuple[tuple[Any, ...], dict[str, Any]]
"""Positional arguments and keyword arguments."""

_in_use: "weakref.WeakSet[CachedProgram]" = weakref.WeakSet()

# Each compiled program maps memory, and Linux limits a process to 65,530 maps. Beyond this number
# the compiler fails, and with it the process.
_MAPS = Path("/proc/self/maps")
_MOST_MAPS = 30_000
_left = 0  # number of maps when programs were last dropped


def forget_programs_if_many(most: int = _MOST_MAPS) -> None:
    """Drop the compiled programs of this process if it has more than `most` memory maps.

    Programs that are needed again are compiled again, or read from the cache. This function is for
    code that makes many different fits in one process, and is called between two of them. Memory
    maps that remain after the last call are taken into account.
    """
    global _left
    try:
        count = _MAPS.read_bytes().count(b"\n")
    except OSError:  # another operating system
        return
    if count <= max(most, _left + most // 10):
        return
    for kept in list(_in_use):
        kept.forget()
    jax.clear_caches()
    gc.collect()
    _left = _MAPS.read_bytes().count(b"\n")


def cache_programs(folder: Path) -> None:
    """Store programs in a folder from now on, and use those that are already there.

    This must only be called by a process whose code does not change while it runs. Changes by a
    test or a notebook are not visible in the source and must not be stored.
    """
    global _folder
    _folder = folder
    origin()


def caches_programs() -> bool:
    """Return whether programs are stored; they are not if JAX must inspect their operations."""
    looking = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs")
    return _folder is not None and not any(getattr(jax.config, name) for name in looking)


class CachedProgram:
    """Function whose programs are stored, with options of `jax.jit`."""

    def __init__(self, function: Call, options: dict[str, Any]) -> None:
        self._function, self._options = function, options
        self._signature = inspect.signature(function)
        self._calls: dict[str, Call | None] = {}
        self._alike: dict[Any, Call] = {}
        _in_use.add(self)

    def forget(self) -> None:
        """Drop the loaded programs; files on disk are kept."""
        self._calls.clear()
        self._alike.clear()

    def given(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Given:
        """Return the arguments in a canonical form, so equivalent calls share a program."""
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return bound.args, bound.kwargs

    def ready(self, args: Given) -> Call | None:
        """Return a compiled function for arguments like these; None if it cannot be stored."""
        leaves, tree = jax.tree.flatten(args)
        try:
            # Static parts are compared by equality, as in JAX, which is ten times as fast as by the
            # text.
            alike = tree, tuple(map(leaf_kind, leaves))
            return self._alike[alike]
        except KeyError:
            found = self._by_text(args)
            if found is not None:
                self._alike[alike] = found
            return found
        except (TypeError, ValueError):  # a part cannot be hashed or compared
            return self._by_text(args)

    def _by_text(self, args: Given) -> Call | None:
        try:
            key = structure(args)
            # Leaves that are not arrays are part of the program, including all their numbers.
            rest = (leaf for leaf in jax.tree.leaves(args) if not eqx.is_array(leaf))
            key += "".join(part for leaf in rest for part in _Traced().parts(leaf, whole=True))
        except NoStructureError:
            return None
        with contextlib.suppress(KeyError):
            return self._calls[key]
        try:
            found: Call | None = self._prepared(key, args)
        except Exception:
            # If the arguments are invalid, the function itself raises a better error.
            _log.debug("%s is not kept", self._function, exc_info=True)
            found = None
        self._calls[key] = found
        return found

    def _prepared(self, key: str, args: Given) -> Call:
        assert _folder is not None
        path = _folder / self._name(key)
        leaves = _arrays(args)
        traced: export.Exported | None = None
        try:
            text, module = read(path).split(b"\n", 1)
            result = restored(json.loads(text))
        except (OSError, ValueError, TypeError):
            # The file is missing or damaged, or has classes that this process has not imported.
            _log.debug("%s is traced", self._function)
            result, traced = self._traced(args, leaves)
            module = traced.mlir_module_serialized
        places, static = eqx.partition(result, _is_shaped)
        shapes, tree = jax.tree.flatten(places)
        blank = _blank(shapes, leaves)
        if traced is not None:
            if _calling(traced) != _calling(blank):
                raise ValueError("the function has side effects besides returning arrays")
            # If the source was edited meanwhile, it is unknown which version was traced.
            with contextlib.suppress(NoStructureError):
                text = json.dumps(described(result)).encode()
                if sources() == origin():
                    write(path, text + b"\n" + module)
        known = dataclasses.replace(blank, mlir_module_serialized=module)
        # The text is the same in every process, so the compilation cache recognises it.
        compiled = jax.jit(known.call, **self._options).lower(*leaves).compile()

        def call(args: Given) -> Any:
            found = compiled(*_arrays(args))
            return eqx.combine(jax.tree.unflatten(tree, found), static)

        return call

    def _traced(self, args: Given, leaves: Sequence[Any]) -> tuple[Any, export.Exported]:
        """Return the result of the function, with shapes instead of arrays, and its program."""
        dynamic, static = eqx.partition(args, eqx.is_array)
        tree = jax.tree.structure(dynamic)
        returned: list[Any] = []

        def flat(*leaves: Any) -> tuple[Any, ...]:
            given, named = eqx.combine(jax.tree.unflatten(tree, leaves), static)
            result = self._function(*given, **named)
            arrays, rest = eqx.partition(result, eqx.is_array)
            # The arrays are not weakly typed, so a function that uses them has one program rather
            # than two.
            arrays = jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), arrays)
            shaped = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), arrays)
            returned.append(eqx.combine(shaped, rest))
            return tuple(jax.tree.leaves(arrays))

        checks = [export.DisabledSafetyCheck.custom_call(name) for name in _UNSTABLE]
        whole = export.export(jax.jit(flat, keep_unused=True), disabled_checks=checks)(*leaves)
        return returned[-1], whole

    def _name(self, key: str) -> str:
        """Return the name of the file."""
        name = f"{self._function.__module__}.{_qualified(self._function)}"
        settings = sorted((k, v) for k, v in os.environ.items() if k.startswith(_SETTINGS))
        device = jax.devices()[0]
        of = (structure(self._function), key, settings, repr(self._options), origin())
        whole = repr((*of, str(device.platform), str(jax.numpy.result_type(float))))
        return f"{name}-{hashlib.sha256(whole.encode()).hexdigest()[:40]}{SUFFIX}"


def described(tree: Any) -> Any:
    """Describe a tree, with shapes instead of arrays, as JSON: names only, without code.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    if isinstance(tree, jax.ShapeDtypeStruct) and isinstance(tree.dtype, np.dtype):
        return {"shape": list(tree.shape), "dtype": str(tree.dtype)}
    if type(tree) in (type(None), bool, int, float, str):
        return {"value": tree}
    if isinstance(tree, type) or (isinstance(tree, FunctionType) and _is_found(tree)):
        return {"name": [tree.__module__, _qualified(tree)]}
    if type(tree) is dict and all(type(key) is str for key in tree):
        return {"items": {key: described(value) for key, value in tree.items()}}
    kind = {"class": [type(tree).__module__, _qualified(type(tree))]}
    if type(tree) is list or isinstance(tree, tuple):
        return kind | {"parts": [described(part) for part in tree]}
    if isinstance(tree, eqx.Module):
        fields = [field.name for field in dataclasses.fields(tree)]
        return kind | {"fields": {name: described(getattr(tree, name)) for name in fields}}
    raise NoStructureError(f"there is no description of {type(tree)}")


def restored(text: Any) -> Any:
    """Return the tree that a description of `described` represents.

    Raises:
        ValueError: it has a class that has changed or has not been imported.
    """
    match text:
        case {"shape": shape, "dtype": dtype}:
            return jax.ShapeDtypeStruct(tuple(shape), np.dtype(dtype))
        case {"value": value}:
            return value
        case {"name": name}:
            if isinstance(found := _named(*name), (type, FunctionType)):
                return found
        case {"items": items}:
            return {key: restored(value) for key, value in items.items()}
        case {"class": name, "parts": parts}:
            kind, parts = _named(*name), [restored(part) for part in parts]
            if kind in (tuple, list):
                return kind(parts)
            if isinstance(kind, type) and issubclass(kind, tuple):
                # This includes named tuples; no code of the class is executed.
                return tuple.__new__(kind, parts)
        case {"class": name, "fields": fields}:
            kind = _named(*name)
            known = isinstance(kind, type) and issubclass(kind, eqx.Module)
            if known and {field.name for field in dataclasses.fields(kind)} == set(fields):
                # JAX itself creates a module from its leaves in this way.
                made = object.__new__(kind)
                for field, value in fields.items():
                    object.__setattr__(made, field, restored(value))
                return made
    raise ValueError("this is not the description of a program result")


def _named(module: str, name: str) -> Any:
    try:
        return functools.reduce(getattr, name.split("."), sys.modules[module])
    except (KeyError, AttributeError):
        raise ValueError(f"nothing has imported {module}.{name}") from None


def _arrays(args: Given) -> list[Any]:
    return [leaf for leaf in jax.tree.leaves(args) if eqx.is_array(leaf)]


def leaf_kind(leaf: Any) -> Any:
    """Return the properties of a leaf that determine how it is traced."""
    if eqx.is_array(leaf):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)
    return type(leaf), leaf


def _is_shaped(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _blank(shapes: Sequence[Any], leaves: Sequence[Any]) -> export.Exported:
    """Return a program that returns zeros of the same shapes; it differs only in its module."""

    def zeros(*leaves: Any) -> tuple[Any, ...]:
        del leaves
        return tuple(jax.lax.full(each.shape, 0, each.dtype) for each in shapes)

    return export.export(jax.jit(zeros, keep_unused=True))(*leaves)


# Properties that define how an exported program is called.
_calling = operator.attrgetter(
    *("in_tree", "in_avals", "out_tree", "out_avals", "platforms", "nr_devices"),
    *("ordered_effects", "unordered_effects", "module_kept_var_idx", "uses_global_constants"),
    "calling_convention_version",
)


# Compiled programs, with XLA options that suit a long chain on a CPU.
#
# The default code generator of XLA for CPUs fuses the many small operations of a chain into large
# kernels. For the dynamics of an arm, it compiles twice as long as the older generator, and the
# result is a third slower. A schedule that minimises memory keeps the rows of a chain in the cache.

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}
"""Names and values of `jax.jit(compiler_options=...)`."""


def program(function: Function) -> Function:
    """Compile a function like `equinox.filter_jit`, on a CPU with `CPU_OPTIONS`.

    XLA accepts options for whole programs only. Within another program, or under a JAX
    transformation, the function becomes part of that program and has its options.

    If the process stores programs (`cache_programs`), the programs of a function at the top level
    of a module are stored between processes and are not traced again.

    Arguments:
        function: pure function of pytrees; leaves that are not arrays are static.
    """
    part = eqx.filter_jit(function)
    whole: Callable[..., Any] | None = None
    known: CachedProgram | None = None

    making = threading.Lock()

    def ready(args: tuple[Any, ...], kwargs: dict[str, Any]) -> Call | None:
        nonlocal known
        if not caches_programs():
            return None
        with making:
            known = known or CachedProgram(function, _options())
        given = known.given(args, kwargs)
        found = known.ready(given)
        return None if found is None else functools.partial(found, given)

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal whole
        if _is_traced((args, kwargs)):
            return part(*args, **kwargs)
        if (found := ready(args, kwargs)) is not None:
            return found()
        if whole is None:
            # This accesses the device, which must not happen during an import.
            whole = _filter_jit(function, **_options())
        return whole(*args, **kwargs)

    def ahead(*args: Any) -> bool:
        return ready(args, {}) is not None

    call.ahead = ahead  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def traced_once(function: Function) -> Function:
    """Trace a function once per structure of its arguments, however often it is called.

    Within a program, the traced operations are inserted at each call. Outside of a program, the
    function is compiled as a whole, where otherwise each of its operations would be.

    Arguments:
        function: pure function of pytrees. Leaves that are not arrays are static: it is traced
            again for each of their values, Python numbers included.
    """
    return _filter_jit(function, inline=True)


def _filter_jit(function: Function, **options: Any) -> Function:
    # Equinox passes unknown options to `jax.jit`, but its annotations omit them.
    compiled: Any = functools.partial(eqx.filter_jit, **options)
    result: Function = compiled(function)
    return result


def compiled_ahead(call: Callable[..., Any], *args: Any) -> bool:
    """Prepare a program for arguments like these without a run; return whether it succeeded."""
    ahead: Callable[..., bool] | None = getattr(call, "ahead", None)
    return ahead is not None and ahead(*args)


def _is_traced(arguments: Any) -> bool:
    """Return whether a program, in which even constants are traced, or an argument is traced."""
    leaves = [jax.device_put(np.float32(0)), *jax.tree.leaves(arguments)]
    return any(isinstance(leaf, jax.core.Tracer) for leaf in leaves)


@functools.cache
def _options() -> dict[str, Any]:
    """Return the arguments of `jax.jit`: the options if the device is a CPU that supports them."""
    if jax.default_backend() != "cpu":
        return {}
    try:
        # XLA rejects unknown names, and the names differ between its versions.
        jax.jit(lambda: np.float32(0), compiler_options=CPU_OPTIONS)()
    except Exception:
        return {}
    return {"compiler_options": CPU_OPTIONS}
