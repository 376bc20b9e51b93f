"""Formats of the pictures that a command writes, chosen once and not by each that draws one."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from .text import InputError, shown

SIGNATURE = "giajax fit"
"""In every picture and page of giajax, so that a person's own file of that name is left alone."""

FORMATS = ("png", "svg", "pdf")
"""Picture formats. A PNG file is always written, because pages and records refer to it."""


@dataclass(frozen=True)
class PictureFormats:
    """Formats beside PNG, and the resolution of what has pixels, dots per inch."""

    more: tuple[str, ...] = ()
    dpi: int = 130


_USUAL = PictureFormats()
_CHOSEN = ContextVar("picture formats", default=_USUAL)


def picture_formats() -> PictureFormats:
    """What was chosen by `pictures_as`."""
    return _CHOSEN.get()


@contextlib.contextmanager
def pictures_as(formats: Sequence[str], dpi: int | None = None) -> Iterator[None]:
    """Within this context, pictures are written in these formats, too, at this resolution.

    Raises:
        InputError: there is no such format.
    """
    for each in formats:
        if each not in FORMATS:
            known = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
            raise InputError(f"--format {shown(each)} must be {known}: correct it")
    more = tuple(each for each in FORMATS[1:] if each in formats)
    before = _CHOSEN.set(PictureFormats(more, _USUAL.dpi if dpi is None else dpi))
    try:
        yield
    finally:
        _CHOSEN.reset(before)


class Picture(bytes):
    """A PNG file as bytes.

    Attributes:
        others: the same picture in other formats, by their endings.
    """

    others: Mapping[str, bytes]

    def __new__(cls, png: bytes, others: Mapping[str, bytes]) -> "Picture":
        """Make a picture of the contents of its files."""
        made = super().__new__(cls, png)
        made.others = others
        return made


def all_pictures(names: Iterable[str | Path]) -> list[str]:
    """Names of files, and after each PNG file its names in the other formats that were chosen."""
    more = picture_formats().more
    found: dict[str, None] = {}
    for name in map(str, names):
        stem, dot, ending = name.rpartition(".")
        others = more if dot and ending == FORMATS[0] else ()
        found |= dict.fromkeys([name, *(f"{stem}.{each}" for each in others)])
    return list(found)


def all_files(contents: Mapping[Path, bytes]) -> dict[Path, bytes]:
    """Contents by path, and after each picture its other formats."""
    files: dict[Path, bytes] = {}
    for path, data in contents.items():
        files[path] = data
        if isinstance(data, Picture):
            files |= {path.with_suffix(f".{each}"): other for each, other in data.others.items()}
    return files


def remove_former_pictures(contents: Mapping[Path, bytes]) -> None:
    """Of pictures that were written over, remove the other formats that show what was before."""
    for path, data in contents.items():
        if isinstance(data, Picture):
            for each in set(FORMATS[1:]) - set(data.others):
                remove_own(path.with_suffix(f".{each}"))


def remove_own(path: Path, first: int | None = None) -> None:
    """Remove a file, if it carries the signature, which may have to be in its first bytes."""
    with contextlib.suppress(OSError):
        if SIGNATURE.encode() in path.read_bytes()[:first]:
            path.unlink()
