"""Columns of words and numbers as CSV."""

from collections.abc import Iterable, Mapping
from typing import Any


def to_csv(columns: Mapping[str, Iterable[Any]]) -> bytes:
    """Columns of equal length as a CSV file, numbers with nine digits.

    Arguments:
        columns: words, numbers or truth values, by heading.

    Returns:
        The content of the file.
    """
    rows = zip(*columns.values(), strict=True)
    return (
        "\n".join([",".join(columns), *(",".join(map(_cell, row)) for row in rows)]) + "\n"
    ).encode()


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value else value
    # A truth value is a number to numpy, and so to float.
    return str(value).lower() if str(value) in ("True", "False") else f"{float(value) + 0.0:.9g}"
