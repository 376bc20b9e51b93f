"""Writing a run: whether the files may be written, and the same bytes for the same content."""

import hashlib
import os
import secrets
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..runtime.files import check_path
from ..runtime.text import InputError
from ._channels import Channel, infer_model, order
from ._definition import Definition
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


# Writing a run: CSV and sidecar, the same bytes for the same content.

DEFAULT_UNITS = {"angle": "deg", "angular_velocity": "deg_per_s", "pressure": "kPa"}


def write_run(
    path: str | Path,
    times: npt.ArrayLike | None,
    values: Mapping[str, npt.ArrayLike],
    *,
    units: Mapping[str, str] | None = None,
    definition: Definition | Mapping[str, Any] | None = None,
    digits: int = 9,
    force: bool = False,
) -> Path:
    """Write a run as a `.csv` file that `read_run` reads; returns its path.

    Each file appears whole or not at all.

    Arguments:
        path: of the run; its name ends in `.csv`.
        times: shape (sample,), s, or None for a static run.
        values: by channel name, SI, each of shape (sample,); NaN becomes an empty cell.
        units: suffix by channel name or quantity (`length`, `angle`, `angular_velocity`, ...).
            By default: deg, deg_per_s, kPa, and SI for the rest.
        definition: with it a sidecar is written too, and holds the model and the checksum.
        digits: significant digits of a value.
        force: write over a file that is there.

    Raises:
        InputError: a run that cannot be written; then nothing was written over.
    """
    path = check_run_name(path)
    sidecar = sidecar_path(path)
    if definition is not None and not isinstance(definition, Definition):
        definition = Definition.parse(definition, str(sidecar))
    if definition is None and os.path.lexists(sidecar):
        raise InputError(
            f"{sidecar} would become the sidecar of the new {path.name}, which it does not "
            "describe: move it away, or write the run elsewhere"
        )
    data = _csv(times, values, units or {}, digits).encode()
    contents = {path: data}
    if definition is not None:
        channels = [Channel.named(name) for name in values]
        facts = {"sha256": hashlib.sha256(data).hexdigest()}
        model = definition.model or infer_model(channels)
        if model is not None:
            facts["model"] = model
        definition = definition.merged_with(Definition.parse(facts))
        contents[sidecar] = definition.to_toml().encode()
    write_files(contents, force=force)
    return path


def write_files(contents: Mapping[Path, bytes], *, force: bool) -> None:
    """Write files, all of them or, where one is there and `force` is false, none.

    Each is written beside its place and then moved there. A link that stands there is replaced
    like a file, if `force` says so; what it points to stays as it is.

    Raises:
        InputError: a file is there, or its folder is not, or it cannot be written.
    """
    check_output_files(contents, force=force)
    temporary: dict[Path, Path] = {}
    try:
        for path, data in contents.items():
            # Not guessable, short where the name is long, and opened only if it is not there:
            # nobody can have put a link in its way.
            part = path.with_name(f".{secrets.token_hex(16)}.part")
            with part.open("xb") as file:
                temporary[path] = part
                file.write(data)
        for path, part in temporary.items():
            os.replace(part, path)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}): give another name"
        ) from None
    finally:
        for part in temporary.values():
            part.unlink(missing_ok=True)


def _csv(
    times: npt.ArrayLike | None,
    values: Mapping[str, npt.ArrayLike],
    units: Mapping[str, str],
    digits: int,
) -> str:
    columns: dict[str, list[str]] = {}
    if times is not None:
        channel = _recorded("time", units)
        # Neighbouring samples must not round to the same time in a long run.
        columns[channel.column] = _cells(channel.from_si(times), max(digits, 12))
    channels = sorted((_recorded(name, units) for name in values), key=order)
    for channel in channels:
        if channel.quantity == "text":
            texts = np.asarray(values[channel.name], dtype=object)
            columns[channel.column] = ["" if text is None else str(text) for text in texts]
        else:
            columns[channel.column] = _cells(channel.from_si(values[channel.name]), digits)
    lengths = {name: len(cells) for name, cells in columns.items()}
    if len(set(lengths.values())) > 1:
        raise InputError(
            f"columns have different numbers of samples ({lengths}), but must have the same: "
            "give every channel at every time"
        )
    lines = [",".join(columns), *map(",".join, zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n"


def _recorded(name: str, units: Mapping[str, str]) -> Channel:
    channel = Channel.named(name)
    unit = units.get(
        name, units.get(channel.quantity, DEFAULT_UNITS.get(channel.quantity, channel.unit))
    )
    return Channel.named(name, unit)


def _cells(values: npt.NDArray[np.float64], digits: int) -> list[str]:
    # Adding zero turns -0.0 into 0.0.
    return ["" if value != value else f"{value:.{digits}g}" for value in (values + 0.0).tolist()]
