"""The few turns of phrase that errors share."""

from collections.abc import Iterable
from typing import Any


def one_of(names: Iterable[Any]) -> str:
    """`a`, `a or b`, `a, b or c`."""
    listed = [str(name) for name in names]
    if len(listed) < 2:
        return "".join(listed)
    return f"{', '.join(listed[:-1])} or {listed[-1]}"


def shown(value: Any, longest: int = 60) -> str:
    """A value much as its author wrote it, on one line and not longer than a line."""
    text = repr(value) if not isinstance(value, bool) else str(value).lower()
    return text if len(text) <= longest else f"{text[: longest - 3]}..."
