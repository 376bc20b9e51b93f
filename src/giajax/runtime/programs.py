"""Compiled programs: the options of XLA, and the cache of traced programs between processes."""

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
    """Something that no text describes in every process alike, such as a closure."""


def structure(tree: Any) -> str:
    """Describe what of a tree decides how it is traced.

    Of each array that is its shape and type, of everything else the value.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_Traced().parts(tree))


def content(tree: Any) -> str:
    """Describe a tree, or whatever else can be copied, with the numbers of its arrays (by SHA-256).

    The text is the same in every process and every version: classes and functions of giajax count
    by their identities, wherever they lie, and a field that was added to one of its classes only
    where it is not what it is by default.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_Kept().parts(tree))


class _Description:
    """The text of a tree in pieces."""

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
        """Of a dataclass."""

    @abc.abstractmethod
    def name(self, value: Any) -> str:
        """Of a class or a function."""

    @abc.abstractmethod
    def other(self, value: Any) -> Iterator[str]:
        """Of anything else."""


def _is_ours(value: Any) -> bool:
    """Whether a class or a function, and so what it is made from, is of no plug-in."""
    return value.__module__.partition(".")[0] in OURS


class _Traced(_Description):
    """Of what decides how a tree is traced: numbers only of what is a part of the program."""

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
            raise NoStructureError(f"{text} is another function")
        return text if _is_ours(value) else text + mark(value)

    def other(self, value: Any) -> Iterator[str]:
        raise NoStructureError(f"there is no description of {type(value)}")


class _Kept(_Description):
    """Of what is kept: with all numbers, and by names that stay."""

    kept = True

    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        for name, item, default in fields_of(value):
            text = "".join(self.parts(item))
            if default is dataclasses.MISSING or text != "".join(self.parts(default)):
                yield f"{name}={text},"

    def name(self, value: Any) -> str:
        text = identity(f"{value.__module__}:{_qualified(value)}").replace(":", ".")
        # Of a plug-in what it is, too; of what Python itself imported the name, as ever.
        if _is_ours(value) or value.__module__ not in {path.stem for path in plugins()}:
            return text
        return text + mark(value)

    def other(self, value: Any) -> Iterator[str]:
        if isinstance(value, PurePath):
            yield f"path {str(value)!r}"
            return
        name = self.name(type(value))
        # Of a model of pydantic what was said, in any order; the rest is by default.
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
        # Members come as iterators.
        plain = [list(each) if isinstance(each, Iterator) else each for each in rest]
        yield from self.members(name, [made, arguments, *plain], whole=True)


def _is_found(function: FunctionType) -> bool:
    """Whether its module has it under its name; a transformed one has the name of the original."""
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
"""Of the files' names."""

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")


def sources() -> str:
    """What tracing depends on beside the arguments: the source of this package, and versions."""
    digest = hashlib.sha256(sys.version.encode())
    for name in _LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    # Of the whole package, wherever in it this module lies.
    root = Path(str(files(__name__.partition(".")[0])))
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def origin() -> str:
    """`sources`, as they were when the process began to keep programs."""
    return sources()


def read(path: Path) -> bytes:
    """A module as it was written.

    Raises:
        OSError: there is no such file, or it cannot be read.
        ValueError: it is cut off, or was changed.
    """
    content = path.read_bytes()
    digest, module = content[:32], content[32:]
    if hashlib.sha256(module).digest() != digest:
        raise ValueError(f"{path} is not as it was written")
    return module


def write(path: Path, module: bytes) -> None:
    """Write a file whole, or not at all; another process may write the same one."""
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


# Programs kept between processes as they were traced: a later process does not trace them again.
#
# Tracing a fit takes longer than to compile small programs or to run it. What is kept is
# StableHLO, JAX's own exchange format, and no executable: JAX's persistent compilation cache has
# that.
#
# A file is found by all that tracing depends on: the source of this package, the versions of the
# libraries, their settings, and the structure of the arguments. Whatever goes wrong, the caller
# traces as without it.

_SETTINGS = ("JAX_", "XLA_", "EQX_")

# Calls whose form JAX may change between versions; a file is read by one version only.
_UNSTABLE = ("lapack_sormqr_ffi", "lapack_dormqr_ffi")

_folder: Path | None = None

_log = logging.getLogger(__name__)

Call = Callable[..., Any]

Given = tuple[tuple[Any, ...], dict[str, Any]]
"""Positional arguments, and those by name."""

_in_use: "weakref.WeakSet[CachedProgram]" = weakref.WeakSet()

# Each compiled program maps memory, and Linux lets a process have 65,530 maps: beyond them the
# compiler fails, and the process with it.
_MAPS = Path("/proc/self/maps")
_MOST_MAPS = 30_000
_left = 0  # when they were last forgotten


def forget_programs_if_many(most: int = _MOST_MAPS) -> None:
    """Drop this process's compiled programs where they have mapped more memory than so many times.

    What is needed again is compiled again, or read from the cache. For what makes many different
    fits in one process; to be called between two. What else maps memory is left out of it.
    """
    global _left
    try:
        count = _MAPS.read_bytes().count(b"\n")
    except OSError:  # of another system
        return
    if count <= max(most, _left + most // 10):
        return
    for kept in list(_in_use):
        kept.forget()
    jax.clear_caches()
    gc.collect()
    _left = _MAPS.read_bytes().count(b"\n")


def cache_programs(folder: Path) -> None:
    """From now on, keep programs in a folder, and use those that are there.

    To be called by a process whose code does not change while it runs: what a test or a notebook
    patches is not seen in the source, and must not be kept.
    """
    global _folder
    _folder = folder
    origin()


def caches_programs() -> bool:
    """Whether programs are kept; not where JAX is to look into them."""
    looking = ("jax_disable_jit", "jax_debug_nans", "jax_debug_infs")
    return _folder is not None and not any(getattr(jax.config, name) for name in looking)


class CachedProgram:
    """A function whose programs are kept, with options of `jax.jit`."""

    def __init__(self, function: Call, options: dict[str, Any]) -> None:
        self._function, self._options = function, options
        self._signature = inspect.signature(function)
        self._calls: dict[str, Call | None] = {}
        self._alike: dict[Any, Call] = {}
        _in_use.add(self)

    def forget(self) -> None:
        """Drop what is loaded; what is kept on disk stays."""
        self._calls.clear()
        self._alike.clear()

    def given(self, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Given:
        """The arguments in one form: however one is given, it is the same program."""
        bound = self._signature.bind(*args, **kwargs)
        bound.apply_defaults()
        return bound.args, bound.kwargs

    def ready(self, args: Given) -> Call | None:
        """What computes the function for arguments like these; None if it cannot be kept."""
        leaves, tree = jax.tree.flatten(args)
        try:
            # By equality of what is static, as JAX itself: ten times as fast as by the text.
            alike = tree, tuple(map(leaf_kind, leaves))
            return self._alike[alike]
        except KeyError:
            found = self._by_text(args)
            if found is not None:
                self._alike[alike] = found
            return found
        except (TypeError, ValueError):  # a part that has no hash, or cannot be compared
            return self._by_text(args)

    def _by_text(self, args: Given) -> Call | None:
        try:
            key = structure(args)
            # What is no array is a part of the program with all its numbers.
            rest = (leaf for leaf in jax.tree.leaves(args) if not eqx.is_array(leaf))
            key += "".join(part for leaf in rest for part in _Traced().parts(leaf, whole=True))
        except NoStructureError:
            return None
        with contextlib.suppress(KeyError):
            return self._calls[key]
        try:
            found: Call | None = self._prepared(key, args)
        except Exception:
            # Whatever is wrong with the arguments, the function itself says it better.
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
            # Not there, not as it was written, or of classes that this process does not know.
            _log.debug("%s is traced", self._function)
            result, traced = self._traced(args, leaves)
            module = traced.mlir_module_serialized
        places, static = eqx.partition(result, _is_shaped)
        shapes, tree = jax.tree.flatten(places)
        blank = _blank(shapes, leaves)
        if traced is not None:
            if _calling(traced) != _calling(blank):
                raise ValueError("the function has side effects besides returning arrays")
            # Where somebody edits meanwhile, nobody knows which source was traced.
            with contextlib.suppress(NoStructureError):
                text = json.dumps(described(result)).encode()
                if sources() == origin():
                    write(path, text + b"\n" + module)
        known = dataclasses.replace(blank, mlir_module_serialized=module)
        # The same text in every process: the compilation cache knows it.
        compiled = jax.jit(known.call, **self._options).lower(*leaves).compile()

        def call(args: Given) -> Any:
            found = compiled(*_arrays(args))
            return eqx.combine(jax.tree.unflatten(tree, found), static)

        return call

    def _traced(self, args: Given, leaves: Sequence[Any]) -> tuple[Any, export.Exported]:
        """What the function returns, with shapes for arrays, and its program."""
        dynamic, static = eqx.partition(args, eqx.is_array)
        tree = jax.tree.structure(dynamic)
        returned: list[Any] = []

        def flat(*leaves: Any) -> tuple[Any, ...]:
            given, named = eqx.combine(jax.tree.unflatten(tree, leaves), static)
            result = self._function(*given, **named)
            arrays, rest = eqx.partition(result, eqx.is_array)
            # Not of a weak type: what takes it next is then one program, not two.
            arrays = jax.tree.map(lambda x: jax.lax.convert_element_type(x, x.dtype), arrays)
            shaped = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), arrays)
            returned.append(eqx.combine(shaped, rest))
            return tuple(jax.tree.leaves(arrays))

        checks = [export.DisabledSafetyCheck.custom_call(name) for name in _UNSTABLE]
        whole = export.export(jax.jit(flat, keep_unused=True), disabled_checks=checks)(*leaves)
        return returned[-1], whole

    def _name(self, key: str) -> str:
        """The name of the file."""
        name = f"{self._function.__module__}.{_qualified(self._function)}"
        settings = sorted((k, v) for k, v in os.environ.items() if k.startswith(_SETTINGS))
        device = jax.devices()[0]
        of = (structure(self._function), key, settings, repr(self._options), origin())
        whole = repr((*of, str(device.platform), str(jax.numpy.result_type(float))))
        return f"{name}-{hashlib.sha256(whole.encode()).hexdigest()[:40]}{SUFFIX}"


def described(tree: Any) -> Any:
    """A tree, with shapes for arrays, as values of JSON: names, and nothing that could be run.

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
    """The tree that `described` describes.

    Raises:
        ValueError: it has a class that is not what it was, or that nothing has imported.
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
                # Also of a named one: no code of the class is run.
                return tuple.__new__(kind, parts)
        case {"class": name, "fields": fields}:
            kind = _named(*name)
            known = isinstance(kind, type) and issubclass(kind, eqx.Module)
            if known and {field.name for field in dataclasses.fields(kind)} == set(fields):
                # As JAX itself makes one of its leaves.
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
    """What of a leaf decides how it is traced."""
    if eqx.is_array(leaf):
        return leaf.shape, leaf.dtype, getattr(leaf, "weak_type", False)
    return type(leaf), leaf


def _is_shaped(leaf: Any) -> bool:
    return eqx.is_array(leaf) or isinstance(leaf, jax.ShapeDtypeStruct)


def _blank(shapes: Sequence[Any], leaves: Sequence[Any]) -> export.Exported:
    """A program of zeros that takes and returns the same: only its module is another."""

    def zeros(*leaves: Any) -> tuple[Any, ...]:
        del leaves
        return tuple(jax.lax.full(each.shape, 0, each.dtype) for each in shapes)

    return export.export(jax.jit(zeros, keep_unused=True))(*leaves)


# How an exported program is called.
_calling = operator.attrgetter(
    *("in_tree", "in_avals", "out_tree", "out_avals", "platforms", "nr_devices"),
    *("ordered_effects", "unordered_effects", "module_kept_var_idx", "uses_global_constants"),
    "calling_convention_version",
)


# Compiled programs, with the options of XLA that suit a long chain on a CPU.
#
# The default code generator of XLA for CPUs fuses the many small operations of a chain into large
# kernels. On the dynamics of an arm it compiles twice as long as the older one, and what it makes
# is a third slower; a schedule that minimises memory keeps the rows of a chain in the cache.

Function = TypeVar("Function", bound=Callable[..., Any])

CPU_OPTIONS = {
    "xla_cpu_use_fusion_emitters": False,
    "xla_cpu_scheduler_type": "CPU_SCHEDULER_TYPE_MEMORY_OPTIMIZED",
}
"""Names and values of `jax.jit(compiler_options=...)`."""


def program(function: Function) -> Function:
    """Compile a function as `equinox.filter_jit` does, on a CPU with `CPU_OPTIONS`.

    XLA takes options for whole programs only: within another program, and under a transformation
    of JAX, the function becomes a part of that one, and has its options.

    Where the process keeps programs (`cache_programs`), those of a function of a module are kept
    between processes, and are not traced again.

    Arguments:
        function: a pure function of pytrees; leaves that are not arrays are static.
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
            # Asks for the device, which an import must not do.
            options = _options()
            # Equinox passes what it does not know on to `jax.jit`; its annotations leave that out.
            compiled: Any = functools.partial(eqx.filter_jit, **options)
            whole = compiled(function)
        return whole(*args, **kwargs)

    def ahead(*args: Any) -> bool:
        return ready(args, {}) is not None

    call.ahead = ahead  # type: ignore[attr-defined]
    return call  # type: ignore[return-value]


def compiled_ahead(call: Callable[..., Any], *args: Any) -> bool:
    """Have a program for arguments like these at hand, without a run; whether that can be."""
    ahead: Callable[..., bool] | None = getattr(call, "ahead", None)
    return ahead is not None and ahead(*args)


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
