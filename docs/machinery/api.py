"""Generate the Python reference: the public names by topic, and a page for each module.

Each name has its signature, its docstring and an example. The example comes from the docstring or
from `docs/python_examples.md`, which the tests run.
"""

import functools
import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import giajax

from .files import cell

EXAMPLES = Path(__file__).resolve().parents[1] / "python_examples.md"

_INTRODUCTION = """\
# Python

`import giajax` offers the names below, by topic. The modules, which are listed after them, offer
more: parts of an arm, equations and the types that functions return. Each name below has its
signature, its arguments with shape and unit, and an example. Units are SI, and angles are in
radians.
"""
_TOPICS = {
    "Arms and motion": ("mechanics", "simulation"),
    "Recordings and files": ("recordings", "apps.synthetic"),
    "Models and parameters": ("models", "schema"),
    "Fits": ("fitting", "tasks", "report"),
    "Studies": ("studies",),
    "Applications": ("apps",),
    "Errors, plugins and cores": ("runtime",),
}


@functools.cache
def rooms() -> list[str]:
    """Return the dotted names of all public modules and packages."""
    found = (module.name for module in pkgutil.walk_packages(giajax.__path__, "giajax."))
    names = (name.removeprefix("giajax.") for name in found)
    return sorted(
        name
        for name in names
        if not any(part.startswith("_") for part in name.split(".")) and not name.startswith("cli")
    )


def _exported(room: str) -> dict[str, object]:
    """Return the objects that others may import only from this module, by name."""
    module = importlib.import_module(f"giajax.{room}")
    names = getattr(module, "__all__", vars(module))
    found = {name: getattr(module, name) for name in names if not name.startswith("_")}
    # A package exports what it imports. A module exports what it defines, including constants.
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
    """Return whether a module is the origin of an object, and not one that re-exports it."""
    origin = (getattr(thing, "__module__", None) or "").removeprefix("giajax.")
    homes = [name for name in rooms() if f"{origin}.".startswith(f"{name}.")]
    return not homes or max(homes, key=len) == room


def _directive(thing: object) -> str:
    if inspect.isclass(thing):
        return "autoexception" if issubclass(thing, BaseException) else "autoclass"
    unwrapped = inspect.unwrap(thing) if callable(thing) else thing
    return "autofunction" if inspect.isroutine(unwrapped) else "autodata"


@functools.cache
def examples() -> dict[str, str]:
    """Return the examples of `docs/python_examples.md`, by the public name in their headings."""
    text = EXAMPLES.read_text(encoding="utf-8")
    found = re.findall(
        r"^### `giajax\.(\w+)`\n\n```python\n(.*?)```", text, re.DOTALL | re.MULTILINE
    )
    return dict(found)


def _entry(name: str, thing: object) -> str:
    directive = _directive(thing)
    lines = [f".. {directive}:: {name}"]
    if directive == "autoclass":
        lines.append("   :members:")
    if directive == "autodata":
        lines.append("   :no-value:")
    short = name.removeprefix("giajax.")
    if short in examples():
        lines += ["", "   .. rubric:: Example", "", "   .. code-block:: python", ""]
        lines += [f"      {line}".rstrip() for line in examples()[short].splitlines()]
    return "\n".join(lines) + "\n"


def _table(names: Iterable[str], options: str = "") -> str:
    """Return a table of names with summaries, and with signatures unless the options omit them."""
    return f".. autosummary::\n{options}\n" + "".join(f"   {name}\n" for name in names)


def _doc(room: str) -> tuple[str, str]:
    """Return the first line of a module's docstring, and the rest."""
    module = importlib.import_module(f"giajax.{room}")
    first, _, rest = inspect.cleandoc(module.__doc__ or "").partition("\n")
    return first, rest


def _room(room: str) -> str:
    """Return the page of a module."""
    names = {_public(room, name): thing for name, thing in _exported(room).items()}
    ordered = sorted(names, key=lambda name: (name.count("."), name.lower()))
    entries = "\n".join(_entry(name, names[name]) for name in ordered)
    first, rest = _doc(room)
    # The signatures follow on the same page.
    table = _table(ordered, "   :nosignatures:\n")
    return f"# giajax.{room}\n\n```{{eval-rst}}\n{first}\n{rest}\n\n{table}\n{entries}```\n"


def _public(room: str, name: str) -> str:
    """Return the name under which an object of a module is imported."""
    return f"giajax.{name}" if name in dir(giajax) else f"giajax.{room}.{name}"


def topics() -> dict[str, list[str]]:
    """Return the public names that are not modules, by topic."""
    left = {
        f"giajax.{name}": room
        for room in rooms()
        for name in _exported(room)
        if name in dir(giajax)
    }
    found = {}
    for title, of in _TOPICS.items():
        found[title] = [
            name
            for name, room in left.items()
            if any(f"{room}.".startswith(f"{one}.") for one in of)
        ]
        left = {name: room for name, room in left.items() if name not in found[title]}
    assert not left, f"name their rooms in _TOPICS: {left}"
    return found


def _index() -> str:
    """Return the first page: public names by topic, and a table of the modules."""
    parts = [_INTRODUCTION]
    for title, names in topics().items():
        table = _table(sorted(names, key=str.lower))
        parts.append(f"## {title}\n\n```{{eval-rst}}\n{table}```\n")
    rows = "".join(
        f"| [`giajax.{room}`]({room}.md) | {cell(_doc(room)[0])} |\n" for room in rooms()
    )
    parts.append(f"## Modules\n\n| module | what it has |\n| --- | --- |\n{rows}")
    contents = "\n".join(rooms())
    parts.append(f"```{{toctree}}\n:hidden:\n\n{contents}\n```\n")
    return "\n".join(parts)


def pages() -> dict[str, str]:
    """Return the text of each page, by page name."""
    return {"index": _index(), **{room: _room(room) for room in rooms()}}
