"""Display of fits and models: tables, pictures and files.

The public names are listed in `__init__.pyi`. Each is imported when it is first used, because the
pictures of one command need libraries whose import takes longer than the run of another command.
"""

from typing import Any

import lazy_loader

from ..runtime.aliases import RENAMED, earlier

_current, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
_earlier = earlier(__name__, 4)


def __getattr__(name: str) -> Any:
    """Import and return a public name when it is first used."""
    return _earlier(name) if name in RENAMED["report"] else _current(name)
