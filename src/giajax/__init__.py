"""A differentiable simulator of very long, very light, air-dominated robot arms.

The public names are listed once, in `__init__.pyi`, which editors and type checkers read too. Each
is imported from its room when it is first used (SPEC 1), so that what needs no JAX (reading runs,
the command line's help) starts without it.
"""

import importlib
from typing import Any

import lazy_loader

from .runtime.aliases import MOVED, install

_current, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
install()


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used."""
    return importlib.import_module(f"{__name__}.{name}") if name in MOVED else _current(name)
