"""A differentiable simulator of very long, very light, air-dominated robot arms.

A name stands here where a notebook writes it on the way from a recording or an arm to a fit, its
studies and its files; parts of an arm, equations, and what is only returned are in their rooms.

The public names are listed once, in `__init__.pyi`, which editors and type checkers read too. Each
is imported from its room when it is first used (SPEC 1), so that what needs no JAX (reading runs,
the command line's help) starts without it.
"""

import importlib
from typing import Any

import lazy_loader

from .runtime.aliases import MOVED, RENAMED, earlier, install

_current, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_earlier = earlier(__name__, 4)
install(__path__)


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used."""
    if name in MOVED:
        return importlib.import_module(f"{__name__}.{name}")
    return _earlier(name) if name in RENAMED[""] else _current(name)
