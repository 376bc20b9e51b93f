"""Whether files and folders may be written: asked before anything is computed for them."""

import os
from collections.abc import Iterable
from pathlib import Path

from .._errors import InputError
from .._files import check_path
from ._read import sidecar_path

# What files of this toolkit end in: a folder of such a name is a slip.
_FILES = (".csv", ".parquet", ".toml", ".json", ".png", ".txt", ".html")


def check_output_files(paths: Iterable[str | Path], *, force: bool) -> None:
    """Refuse files that could not be written, or (without `force`) are there.

    Raises:
        InputError: naming the file and what to do.
    """
    for path in map(Path, paths):
        check_path(path)
        if path.is_dir():
            raise InputError(f"{path} is a folder: give the name of a file")
        # A broken link is there as well, for whoever made it.
        if os.path.lexists(path) and not force:
            raise InputError(f"{path} exists and is not written over: give another name or --force")
        if not path.parent.is_dir():
            raise InputError(
                f"{path} cannot be written, because the folder {path.parent} does not exist: "
                "create it or give another name"
            )
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise InputError(
                f"{path} cannot be written, because nothing may be written to {path.parent}: "
                "give another name"
            )


def check_run_name(path: str | Path) -> Path:
    """Refuse a name that no run can be written to; `.csv` is its only form.

    Returns:
        The path.

    Raises:
        InputError: the name does not end in `.csv`.
    """
    path = Path(path)
    if path.suffix != ".csv":
        raise InputError(f"{path} must end in .csv to be written as a run: give such a name")
    return path


def check_output_run(path: str | Path, *, force: bool) -> None:
    """Refuse a run that could not be written with its sidecar.

    Raises:
        InputError: naming the file and what to do.
    """
    path = check_run_name(path)
    check_output_files((path, sidecar_path(path)), force=force)


def check_output_folder(
    folder: str | Path, names: Iterable[str] = (), *, force: bool = False
) -> None:
    """Refuse a folder that could not be made or written to, or holds files of these names.

    Arguments:
        folder: need not exist.
        names: what is to be written there; may be in folders of their own (`fits/a.toml`).
        force: write over files that are there.

    Raises:
        InputError: naming the file or folder and what to do.
    """
    folder = existing = Path(folder)
    check_path(folder)
    if folder.suffix in _FILES and not folder.exists():
        raise InputError(
            f"{folder} is the name of a file, but a folder is written: give the name of one"
        )
    # A name that is a broken link exists for mkdir, but not for `exists`.
    while not existing.exists() and not existing.is_symlink() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        what = "is a file" if existing.exists() else "is a broken link"
        raise InputError(f"{existing} {what}, but a folder is written: give another one")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"{existing} cannot be written: give another folder")
    for name in names:
        check_path(folder / name)
        if os.path.lexists(folder / name) and not force:
            raise InputError(
                f"{folder / name} exists and is not written over: give another folder or --force"
            )


def make_folder(folder: str | Path) -> Path:
    """Make a folder with all above it, unless it is there.

    Returns:
        Its path.

    Raises:
        InputError: it cannot be made.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"the folder {folder} cannot be made ({error.strerror}): give another one"
        ) from None
    return folder
