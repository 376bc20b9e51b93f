"""Differentiable simulator of very long, very light, air-dominated robot arms.

This package contains the names that a notebook needs between a recording or an arm and a fit, its
studies and its files. Parts of an arm, equations, and classes that are only returned are in the
subpackages.

The public names are listed once, in `__init__.pyi`, which editors and type checkers read too. Each
name is imported from its subpackage when it is first used (SPEC 1), so code that does not need JAX
(reading runs, help of the command line) starts without it.
"""

import importlib
from typing import Any

import lazy_loader

from .runtime.aliases import MOVED, RENAMED, earlier, install

_current, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_earlier = earlier(__name__, 4)
install(__path__)


def __getattr__(name: str) -> Any:
    """Return a public name, which is imported when it is first used."""
    if name in MOVED:
        return importlib.import_module(f"{__name__}.{name}")
    return _earlier(name) if name in RENAMED[""] else _current(name)
