"""What is added from outside: registered classes, and plug-ins, the files that register them.

A class is registered by its role, that of the abstract class which it is of: a law of drag, a
model. Files call it by its name. What is registered is what runs: no file that is only read brings
code with it, and a result says which code it was made with.
"""

import functools
import hashlib
import importlib.util
import sys
import sysconfig
from collections.abc import Mapping
from importlib.metadata import entry_points, packages_distributions, version
from pathlib import Path
from typing import Any, TypeVar

from .text import InputError

Registered = TypeVar("Registered", bound=type)

_CLASSES: dict[str, dict[str, Any]] = {}
_PLUGINS: list[Path] = []


def register(cls: Registered) -> Registered:
    """Make a class of yours known by its name, to files and to the command line.

    A model is called as its `kind`, everything else as its class. A package may have an entry point
    of that name instead, of the group `giajax.models` or `giajax.drags`.

    Raises:
        InputError: it is of no class that giajax knows, or another one has its name.
    """
    role = getattr(cls, "registered_as", None)
    if role is None:
        raise InputError(
            f"{cls.__name__} is of no class that giajax takes: derive it from one, such as "
            "giajax.AbstractModel or giajax.mechanics.arm.AbstractDragLaw"
        )
    name = name_of(cls)
    known = _CLASSES.setdefault(role, {}).setdefault(name, cls)
    # A notebook runs a cell again, which makes the class anew.
    if (known.__module__, known.__qualname__) != (cls.__module__, cls.__qualname__):
        raise InputError(
            f"there is a {role} '{name}' of {known.__module__} already: give {cls.__module__}'s "
            "another name"
        )
    _CLASSES[role][name] = cls
    return cls


def name_of(cls: type) -> str:
    """What files call a class."""
    kind = getattr(cls, "kind", None)
    return kind if isinstance(kind, str) else cls.__name__


def registered(role: str, name: str) -> Any | None:
    """The class of a role and a name; None where there is none."""
    if (found := _CLASSES.get(role, {}).get(name)) is None:
        for entry in entry_points(group=f"giajax.{role}s", name=name):
            return register(entry.load())
    return found


def load_plugin(path: Path) -> None:
    """Import a file that registers something; what it needs must be installed, or in it.

    Raises:
        InputError: there is no such file, a module has its name, or it raises an error.
    """
    path = path.resolve()
    if path in _PLUGINS:
        return
    name = path.stem
    if path.suffix != ".py" or not name.isidentifier():
        raise InputError(f"{path} is no plug-in: give a Python file, such as laws.py")
    if not path.is_file():
        raise InputError(f"there is no plug-in {path}: correct the path")
    other = importlib.util.find_spec(name)
    if name in sys.modules or (other is not None and other.origin != str(path)):
        raise InputError(f"{path} is called as the module '{name}': give it another name")
    spec: Any = importlib.util.spec_from_file_location(name, path)
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"the plug-in {path} cannot be imported ({type(error).__name__}: {error}): correct it"
        ) from error
    _PLUGINS.append(path)
    checksum(name)


def plugins() -> tuple[Path, ...]:
    """The plug-ins of this process, which its workers need, too."""
    return tuple(_PLUGINS)


@functools.cache
def checksum(module: str) -> str:
    """SHA-256 of the file of a module that is neither giajax nor installed; empty for others.

    An installed package is known by its version, and is not edited.
    """
    path = getattr(sys.modules.get(module), "__file__", None)
    if path is None or module.partition(".")[0] == __name__.partition(".")[0]:
        return ""
    path = Path(path).resolve()
    installed = map(sysconfig.get_path, ("stdlib", "platstdlib", "purelib", "platlib"))
    if any(path.is_relative_to(Path(root).resolve()) for root in installed):
        return ""
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def sources_of(*classes: type) -> dict[str, str]:
    """Where classes that are not giajax's come from: version of a package, or sum of a file."""
    found = {}
    for module in {cls.__module__ for cls in classes}:
        package = module.partition(".")[0]
        if package == __name__.partition(".")[0]:
            continue
        if digest := checksum(module):
            found[Path(str(sys.modules[module].__file__)).name] = f"sha256 {digest}"
        else:
            for distribution in packages_distributions().get(package, ())[:1]:
                found[distribution] = version(distribution)
    return found


def hint(versions: Mapping[str, str]) -> str:
    """What to do where a result of these sources names what is not registered; may be empty."""
    loaded = {path.name for path in _PLUGINS}
    files = (name for name, text in versions.items() if text.startswith("sha256 "))
    absent = [name for name in files if name not in loaded]
    return f" (it was made with {absent[0]}: give --plugin {absent[0]})" if absent else ""
