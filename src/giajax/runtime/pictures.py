"""Formats of the figures of a command, selected once for all of its figures."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from .text import InputError, shown

SIGNATURE = "giajax fit"
"""Mark in all giajax pictures and pages. A file of the same name without it is kept."""

FORMATS = ("png", "svg", "pdf")
"""Picture formats. A PNG file is always written, because pages and records refer to it."""

CAPTION = "caption.txt"
"""Extension of the caption that is written beside a picture in a further format."""

_CAPTION_END = b"\nDrawn by giajax.\n"


@dataclass(frozen=True)
class PictureFormats:
    """Formats of pictures.

    Attributes:
        beside: extensions of the files beside each PNG file: further formats and the caption.
        dpi: resolution of raster images, dots per inch.
    """

    beside: tuple[str, ...] = ()
    dpi: int = 130


_USUAL = PictureFormats()
_CHOSEN = ContextVar("picture formats", default=_USUAL)


def picture_formats() -> PictureFormats:
    """Return the formats selected by `pictures_as`."""
    return _CHOSEN.get()


@contextlib.contextmanager
def pictures_as(formats: Sequence[str], dpi: int | None = None) -> Iterator[None]:
    """Select further formats and the resolution of all figures within this context.

    If any format or a resolution is given, each figure has a file with its caption.

    Raises:
        InputError: there is no such format.
    """
    for each in formats:
        if each not in FORMATS:
            known = f"{', '.join(FORMATS[:-1])} or {FORMATS[-1]}"
            raise InputError(f"--format is {shown(each)}: give {known}")
    beside = tuple(each for each in FORMATS[1:] if each in formats)
    if formats or dpi is not None:
        beside = (*beside, CAPTION)
    before = _CHOSEN.set(PictureFormats(beside, _USUAL.dpi if dpi is None else dpi))
    try:
        yield
    finally:
        _CHOSEN.reset(before)


class Picture(bytes):
    """PNG file as bytes, with its other formats.

    Attributes:
        others: contents of the other formats and the caption, by file extension.
    """

    others: Mapping[str, bytes]

    def __new__(cls, png: bytes, others: Mapping[str, bytes]) -> "Picture":
        """Create a picture from the contents of its files."""
        made = super().__new__(cls, png)
        made.others = others
        return made


def caption_file(caption: str) -> bytes:
    """Return the file of a caption. Its last line marks it as written by giajax."""
    return caption.encode() + _CAPTION_END


def all_pictures(names: Iterable[str | Path]) -> list[str]:
    """Return file names, with the other selected formats and captions after each PNG file."""
    beside = picture_formats().beside
    found: dict[str, None] = {}
    for name in map(str, names):
        stem, dot, ending = name.rpartition(".")
        others = beside if dot and ending == FORMATS[0] else ()
        found |= dict.fromkeys([name, *(f"{stem}.{each}" for each in others)])
    return list(found)


def all_files(contents: Mapping[Path, bytes]) -> dict[Path, bytes]:
    """Return contents by path, with the other formats after each picture."""
    files: dict[Path, bytes] = {}
    for path, data in contents.items():
        files[path] = data
        if isinstance(data, Picture):
            files |= {path.with_suffix(f".{each}"): other for each, other in data.others.items()}
    return files


def remove_former_pictures(contents: Mapping[Path, bytes]) -> None:
    """Remove outdated files in other formats of pictures that have been overwritten."""
    for path, data in contents.items():
        if isinstance(data, Picture):
            for each in {*FORMATS[1:], CAPTION} - set(data.others):
                remove_own(path.with_suffix(f".{each}"))


def remove_own(path: Path, first: int | None = None) -> None:
    """Remove a file if it contains the signature, optionally within its first bytes only.

    A caption is removed if its last line is unchanged, because a user may have appended notes.
    """
    with contextlib.suppress(OSError):
        data = path.read_bytes()
        is_caption = path.name.endswith(f".{CAPTION}")
        if data.endswith(_CAPTION_END) if is_caption else SIGNATURE.encode() in data[:first]:
            path.unlink()
