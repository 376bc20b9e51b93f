"""The reference of Python's names: a page for each room, made of what the rooms export."""

import functools
import importlib
import inspect
import pkgutil
import re
from types import ModuleType

import giajax

_INTRODUCTION = """\
# Python

A name of giajax is imported from `giajax` or, where it says so, from a room of it. Units are SI,
and angles are in radians. What each argument is, with shape and unit, is said where it stands.
"""


@functools.cache
def rooms() -> list[str]:
    """The public modules: rooms, and the packages and modules in them, by their dotted names."""
    found = (module.name for module in pkgutil.walk_packages(giajax.__path__, "giajax."))
    names = (name.removeprefix("giajax.") for name in found)
    return sorted(
        name
        for name in names
        if not any(part.startswith("_") for part in name.split(".")) and not name.startswith("cli")
    )


def _exported(room: str) -> dict[str, object]:
    """Public names of a room, which others may import from it alone, and what they are."""
    module = importlib.import_module(f"giajax.{room}")
    names = getattr(module, "__all__", vars(module))
    found = {name: getattr(module, name) for name in names if not name.startswith("_")}
    # What a package imports, it exports; a module has what it defines, constants too.
    of_package = hasattr(module, "__path__")
    source = inspect.getsource(module)
    return {
        name: thing
        for name, thing in found.items()
        if not isinstance(thing, ModuleType)
        and _home(thing, room)
        and (
            of_package
            or (name.isupper() and re.search(rf"^{name}\b", source, re.MULTILINE))
            or getattr(thing, "__module__", "") == module.__name__
        )
    }


def _home(thing: object, room: str) -> bool:
    """Whether a room is where something comes from, and not one that passes it on."""
    origin = (getattr(thing, "__module__", None) or "").removeprefix("giajax.")
    homes = [name for name in rooms() if f"{origin}.".startswith(f"{name}.")]
    return not homes or max(homes, key=len) == room


def _directive(thing: object) -> str:
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, BaseException) else "autoclass"
    unwrapped = inspect.unwrap(thing) if callable(thing) else thing
    return "autofunction" if inspect.isroutine(unwrapped) else "autodata"


def _entry(name: str, thing: object) -> str:
    directive = _directive(thing)
    lines = [f".. {directive}:: {name}"]
    if directive == "autoclass":
        lines.append("   :members:")
    if directive == "autodata":
        lines.append("   :no-value:")
    return "\n".join(lines) + "\n"


def _room(room: str) -> str:
    """The page of a room."""
    module = importlib.import_module(f"giajax.{room}")
    things = _exported(room)
    names = {
        f"giajax.{name}" if name in dir(giajax) else f"giajax.{room}.{name}": thing
        for name, thing in things.items()
    }
    ordered = sorted(names, key=lambda name: (name.count("."), name.lower()))
    table = "".join(f"   {name}\n" for name in ordered)
    entries = "\n".join(_entry(name, names[name]) for name in ordered)
    first, _, rest = inspect.cleandoc(module.__doc__ or "").partition("\n")
    return (
        f"# giajax.{room}\n\n```{{eval-rst}}\n{first}\n{rest}\n\n"
        f".. autosummary::\n   :nosignatures:\n\n{table}\n{entries}```\n"
    )


def pages() -> dict[str, str]:
    """The text of each page by its name."""
    contents = "\n".join(rooms())
    index = f"{_INTRODUCTION}\n```{{toctree}}\n:maxdepth: 1\n\n{contents}\n```\n"
    return {"index": index, **{room: _room(room) for room in rooms()}}
