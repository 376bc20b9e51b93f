"""Writing a run: CSV and sidecar, the same bytes for the same content."""

import hashlib
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ._channels import Channel, order
from ._definition import Definition
from ._model import infer_model
from ._output import check_output_files, check_run_name
from ._read import sidecar_path

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
