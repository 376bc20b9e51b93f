"""What a person sees of fits and models: tables, pictures and files.

The public names are listed in `__init__.pyi`. Each is imported when it is first used: the pictures
of one command need libraries that take others longer to import than they run.
"""

from typing import Any

import lazy_loader

from ..runtime.aliases import RENAMED, earlier

_current, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_earlier = earlier(__name__, 4)


def __getattr__(name: str) -> Any:
    """A public name, imported when it is first used."""
    return _earlier(name) if name in RENAMED["report"] else _current(name)
