"""What is added from outside: registered classes, and plug-ins, the files that register them.

A class is registered by its role, that of the abstract class which it is of: a law of drag, a
model. Files call it by its name. What is registered is what runs: no file that is only read brings
code with it, and a result says which code it was made with.
"""

import dataclasses
import functools
import hashlib
import importlib.util
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from .files import check_path, read_bytes
from .limits import TEXT_BYTES
from .text import InputError, one_of

Registered = TypeVar("Registered", bound=type)
F = TypeVar("F")
Made = TypeVar("Made")

_CLASSES: dict[str, dict[str, Any]] = {}
_PLUGINS: dict[Path, str] = {}  # with the SHA-256 of what was run

SUM = "sha256 "
"""Prefix that distinguishes the checksum of a file from a version."""


def register(cls: Registered) -> Registered:
    """Make a class of yours known by its name, to files and to the command line.

    A model is called as its `kind`, everything else as its class. A package may have an entry point
    of that name instead, of the group `giajax.models`, `giajax.drags`, `giajax.joints`,
    `giajax.losses`, `giajax.sensors` or `giajax.winds`.

    Raises:
        InputError: it is of no class that giajax knows, lacks a method, or has the name of another.
    """
    role, name = getattr(cls, "registered_as", None), name_of(cls)
    if role is None:
        raise InputError(
            f"{cls.__name__} is not derived from a class of giajax: derive it from one, such as "
            "giajax.AbstractModel or giajax.mechanics.arm.AbstractDragLaw"
        )
    if absent := getattr(cls, "__abstractmethods__", ()):
        raise InputError(f"{cls.__name__} lacks {one_of(sorted(absent))}: implement it")
    classes = _CLASSES.setdefault(role, {})
    known = classes.get(name, cls)
    # A notebook runs a cell again, which makes the class anew.
    again = (known.__module__, known.__qualname__) == (cls.__module__, cls.__qualname__)
    if not again or "+" in name or name in getattr(cls, "names_of_giajax", ()):
        raise InputError(f"a {role} named '{name}' already exists: choose another name")
    getattr(cls, "on_registration", lambda: None)()
    classes[name] = cls
    return cls


def name_of(cls: type) -> str:
    """What files call a class."""
    kind = getattr(cls, "kind", None)
    return kind if isinstance(kind, str) else cls.__name__


def registered(role: str, name: str) -> Any | None:
    """The class of a role and a name; None where there is none."""
    if (found := _CLASSES.get(role, {}).get(name)) is None:
        from importlib import metadata  # slow to import, and seldom asked

        for entry in metadata.entry_points(
            group=f"giajax.{role}{'e' * role.endswith('s')}s", name=name
        ):
            try:
                return register(entry.load())
            except ImportError as error:
                raise InputError(f"the {role} '{name}' cannot be imported: {error}") from error
    return found


def classes_of_others(role: str) -> dict[str, Any]:
    """The registered classes of a role that are not giajax's, by name."""
    known = _CLASSES.get(role, {}).items()
    return {name: cls for name, cls in known if not cls.__module__.startswith("giajax.")}


def law_named(role: str, name: str) -> Any | None:
    """What the registered class of a role and a name is by default; None where there is none."""
    found = registered(role, name)
    return None if found is None else made_by_default(found, f"the {role} law {name}")


def made_by_default(cls: Callable[[], Made], what: str) -> Made:
    """What a class makes from its defaults; `InputError` where it makes nothing from them."""
    try:
        return cls()
    except Exception as error:
        raise InputError(
            f"{what} cannot be made from defaults ({error}): give each field a default"
        ) from None


def load_plugin(path: Path, digest: str = "") -> None:
    """Run a file that registers something; what it needs must be installed, or in it.

    Raises:
        InputError: there is no such file, a module has its name, it raises an error, or it is not
            the one of this SHA-256, which another process has run.
    """
    check_path(path)
    path, name = path.resolve(), path.stem
    if path in _PLUGINS:
        return
    if path.suffix != ".py" or not name.isidentifier():
        raise InputError(f"{path} is not a plug-in: give a Python file, such as laws.py")
    other = importlib.util.find_spec(name)
    if name in sys.modules or (other is not None and other.origin != str(path)):
        raise InputError(f"{path} has the name of another module, '{name}': rename the file")
    try:
        data = read_bytes(path, TEXT_BYTES)
    except OSError:
        raise InputError(f"the plug-in {path} does not exist: correct the path") from None
    found = hashlib.sha256(data).hexdigest()
    if digest not in ("", found):
        raise InputError(f"{path} has changed while it was in use: start the command again")
    module = sys.modules[name] = ModuleType(name)
    module.__file__ = str(path)
    try:
        # What was read is run, and no older bytecode of it.
        exec(compile(data, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:  # a file that ends the program ends no command
        del sys.modules[name]
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"the plug-in {path} cannot be imported ({type(error).__name__}: {error}): correct it"
        ) from error
    _PLUGINS[path] = found


def plugins() -> Mapping[Path, str]:
    """The plug-ins of this process, which its workers need, too, with their SHA-256."""
    return dict(_PLUGINS)


@functools.cache
def source(module: str) -> tuple[str, str] | None:
    """Where a module is from that is neither giajax nor what it needs: a file or a package.

    With the sum of the file, or the version of the package.
    """
    package = module.partition(".")[0]
    path = getattr(sys.modules.get(module), "__file__", None)
    if path is None or package in OURS:
        return None
    path = Path(path).resolve()
    if any(path.is_relative_to(sysconfig.get_path(name)) for name in ("purelib", "platlib")):
        from importlib import metadata

        names = metadata.packages_distributions().get(package, ())
        return (names[0], metadata.version(names[0])) if names else None
    digest = _PLUGINS.get(path) or hashlib.sha256(path.read_bytes()).hexdigest()
    return path.name, SUM + digest


# Their versions are in every key, and in every result.
OURS = {"giajax", "jax", "jaxlib", "jaxtyping", "equinox", "diffrax", "optimistix", "lineax"}
OURS |= {"numpy", "scipy", "pydantic", "polars"} | sys.stdlib_module_names


def optional(method: F) -> F:
    """Mark what a class that others derive from does by default, and theirs may do otherwise."""
    method.__isoptional__ = True  # type: ignore[attr-defined]
    return method


def mark(value: Any) -> str:
    """Text that differs where the source of a class and its bases, or a function, does."""
    classes = value.__mro__ if isinstance(value, type) else (value,)
    modules = dict.fromkeys(each.__module__ for each in classes)
    return "".join(map(str, filter(None, map(source, modules))))


def _sources(classes: Iterable[type]) -> dict[str, str]:
    modules = dict.fromkeys(each.__module__ for cls in classes for each in cls.__mro__)
    return dict(filter(None, map(source, modules)))


def sources_named(text: str) -> dict[str, str]:
    """As `sources_of`, of the registered classes whose names are words of a text."""
    words = set(re.findall(r"[\w-]+", text))
    return _sources(
        cls for known in _CLASSES.values() for name, cls in known.items() if name in words
    )


def sources_of(tree: Any) -> dict[str, str]:
    """Files and packages of the classes in a tree that are not giajax's, as of `source`."""
    parts: list[Any] = [tree]
    classes: list[type] = []
    for part in parts:
        if dataclasses.is_dataclass(part):
            classes.append(type(part))
            parts += vars(part).values()
        elif isinstance(part, tuple | list):
            parts += part
        elif isinstance(part, Mapping):
            parts += part.values()
    return _sources(classes)


def check_sources(versions: Mapping[str, str], said: str = "") -> None:
    """Refuse to continue from what was made with other files than those of the registered classes.

    They are others of the same name, or others of the classes that `said` names.

    Raises:
        InputError: naming the file.
    """
    now = _sources(cls for known in _CLASSES.values() for cls in known.values())
    for name, text in versions.items():
        if text.startswith(SUM) and now.get(name, text) != text:
            raise InputError(
                f"{name} has changed since the fit: restore the former version, or fit again"
            )
    here = sources_named(said)
    lost = [file for file in versions.items() if file[1].startswith(SUM) and file[0] not in here]
    for name, found in here.items():
        if lost and found.startswith(SUM) and found not in versions.values():
            raise InputError(
                f"the fit was made with {lost[0][0]}, but here {name} defines its class: give "
                "the former version, or fit again"
            )


def hint(versions: Mapping[str, str]) -> str:
    """What to give or install where these are of a result that cannot be loaded; may be empty."""
    from importlib import metadata

    loaded = {Path(str(getattr(each, "__file__", ""))).name for each in sys.modules.values()}
    for name, text in versions.items():
        if text.startswith(SUM) and name not in loaded:
            return f" (the result was made with {name}: give --plugin {name})"
        if not text.startswith(SUM) and name != "python":
            try:
                metadata.version(name)
            except metadata.PackageNotFoundError:
                return f" (the result was made with {name} {text}: install this package)"
    return ""
