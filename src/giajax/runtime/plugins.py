"""Extensions: registered classes, and plug-ins, which are files that register classes.

A class is registered under the role of its abstract base class, such as a drag law or a model.
Files refer to it by its name. Only registered classes are executed: reading a file never imports
code, and a result records the code with which it was made.
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
_PLUGINS: dict[Path, str] = {}  # with the SHA-256 of the executed code

SUM = "sha256 "
"""Prefix that distinguishes the checksum of a file from a version."""


def register(cls: Registered) -> Registered:
    """Register a class of your own, so that files and the command line can use it by name.

    The name of a model is its `kind`. The name of any other class is the name of the class.
    Instead, a package may have an entry point of that name in the group `giajax.models`,
    `giajax.drags`, `giajax.joints`, `giajax.losses`, `giajax.sensors` or `giajax.winds`.

    Raises:
        InputError: the class is not derived from a giajax class, lacks a method, or has the name of
            another class.
    """
    role, name = getattr(cls, "registered_as", None), name_of(cls)
    if role is None:
        raise InputError(
            f"{cls.__name__} is not derived from a giajax class: derive it from one, such as "
            "giajax.AbstractModel or giajax.mechanics.arm.AbstractDragLaw"
        )
    if absent := getattr(cls, "__abstractmethods__", ()):
        raise InputError(f"{cls.__name__} lacks {one_of(sorted(absent))}: implement it")
    classes = _CLASSES.setdefault(role, {})
    known = classes.get(name, cls)
    # Running a cell of a notebook again creates the class again.
    again = (known.__module__, known.__qualname__) == (cls.__module__, cls.__qualname__)
    if not again or "+" in name or name in getattr(cls, "names_of_giajax", ()):
        raise InputError(f"a {role} named '{name}' already exists: choose another name")
    getattr(cls, "on_registration", lambda: None)()
    classes[name] = cls
    return cls


def name_of(cls: type) -> str:
    """Return the name of a class in files."""
    kind = getattr(cls, "kind", None)
    return kind if isinstance(kind, str) else cls.__name__


def registered(role: str, name: str) -> Any | None:
    """Return the class with a role and a name; None if there is none."""
    if (found := _CLASSES.get(role, {}).get(name)) is None:
        from importlib import metadata  # slow to import, and rarely needed

        for entry in metadata.entry_points(
            group=f"giajax.{role}{'e' * role.endswith('s')}s", name=name
        ):
            try:
                return register(entry.load())
            except ImportError as error:
                raise InputError(f"the {role} '{name}' cannot be imported: {error}") from error
    return found


def classes_of_others(role: str) -> dict[str, Any]:
    """Return the registered classes of a role that are not part of giajax, by name."""
    known = _CLASSES.get(role, {}).items()
    return {name: cls for name, cls in known if not cls.__module__.startswith("giajax.")}


def law_named(role: str, name: str) -> Any | None:
    """Return the default object of the registered class with a role and a name, or None."""
    found = registered(role, name)
    return None if found is None else made_by_default(found, f"the {role} law {name}")


def made_by_default(cls: Callable[[], Made], what: str) -> Made:
    """Return an object of a class with default fields; `InputError` if this is impossible."""
    try:
        return cls()
    except Exception as error:
        raise InputError(
            f"{what} cannot be created from defaults ({error}): give each field a default"
        ) from None


def load_plugin(path: Path, digest: str = "") -> None:
    """Execute a file that registers classes. The modules that it imports must be installed.

    Raises:
        InputError: the file does not exist, has the name of a module, raises an error, or does not
            have the given SHA-256, which another process computed from the file that it executed.
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
        # The text that was read is executed, rather than older bytecode.
        exec(compile(data, str(path), "exec"), vars(module))
    except (Exception, SystemExit) as error:  # a file must not end the command
        del sys.modules[name]
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"the plug-in {path} cannot be imported ({type(error).__name__}: {error}): correct the "
            "file"
        ) from error
    _PLUGINS[path] = found


def plugins() -> Mapping[Path, str]:
    """Return the plug-ins of this process, which its workers also need, with their SHA-256."""
    return dict(_PLUGINS)


@functools.cache
def source(module: str) -> tuple[str, str] | None:
    """Return the origin of a module that belongs neither to giajax nor to its dependencies.

    It is the name of a file with its checksum, or the name of a package with its version.
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


# The versions of these packages are included in each key and in each result.
OURS = {"giajax", "jax", "jaxlib", "jaxtyping", "equinox", "diffrax", "optimistix", "lineax"}
OURS |= {"numpy", "scipy", "pydantic", "polars"} | sys.stdlib_module_names


def optional(method: F) -> F:
    """Mark a method with a default implementation that derived classes may override."""
    method.__isoptional__ = True  # type: ignore[attr-defined]
    return method


def mark(value: Any) -> str:
    """Return a text that depends on the source of a class and its bases, or of a function."""
    classes = value.__mro__ if isinstance(value, type) else (value,)
    modules = dict.fromkeys(each.__module__ for each in classes)
    return "".join(map(str, filter(None, map(source, modules))))


def _sources(classes: Iterable[type]) -> dict[str, str]:
    modules = dict.fromkeys(each.__module__ for cls in classes for each in cls.__mro__)
    return dict(filter(None, map(source, modules)))


def sources_named(text: str) -> dict[str, str]:
    """Return the `sources_of` the registered classes whose names are words of a text."""
    words = set(re.findall(r"[\w-]+", text))
    return _sources(
        cls for known in _CLASSES.values() for name, cls in known.items() if name in words
    )


def sources_of(tree: Any) -> dict[str, str]:
    """Return the origins, as from `source`, of the classes in a tree that are not in giajax."""
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
    """Reject results that were made with files other than the current ones.

    Such a file has the same name as a registered one but other contents, or other files define the
    classes that `said` names.

    Raises:
        InputError: the message names the file.
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
                f"the fit used a class of {lost[0][0]}, which {name} now defines: "
                "restore the former version, or fit again"
            )


def hint(versions: Mapping[str, str]) -> str:
    """Suggest what to give or install if a result with these versions cannot be loaded, or ""."""
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
