"""Read a run, select channels or windows of time, and write a run."""

import contextlib
import dataclasses
import hashlib
import itertools
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..runtime.files import check_path, check_replaced, part_of, written_to
from ..runtime.pictures import FORMATS, all_files, all_pictures, remove_former_pictures
from ..runtime.text import InputError
from ..schema import InitialSection
from ._channels import Channel, Naming, infer_model, match_name, order
from ._definition import Definition, run_keys
from ._run import Run, build_run
from ._table import Table, read_table, table_of_lines

_LINK_ANGLE = re.compile(r"link([0-9]{1,4})_angle")


def selected(
    runs: Sequence[Run],
    channels: Sequence[str] | None,
    window_s: float | None,
    beside: Sequence[Run] = (),
) -> list[Run]:
    """Return the runs of a fit with the given channels, cut into windows of `window_s` seconds.

    If the runs belong to several models, each run has the channels that its model predicts, and
    runs without an initial state are not cut. None selects all measured channels. `beside` contains
    further runs of the fit, which may be the only ones with some of the channels.

    Raises:
        InputError: as in `observing` and `windows`, or a channel is not measured in any run.
    """
    everything = [*runs, *beside]
    several = len({run.model for run in everything}) > 1
    for name in channels or () if several else ():
        if not any(_may_hold(run, name) for run in everything):
            raise InputError(
                f"'{name}' is not a common channel of these runs: choose among "
                f"{', '.join(dict.fromkeys(c for run in everything for c in run.observations))}"
            )
    chosen = list(runs)
    for index, run in enumerate(runs if channels is not None else ()):
        names = [name for name in channels or () if not several or _may_hold(run, name)]
        chosen[index] = observing(run, names) if names else run
    if window_s is None:
        return chosen
    parts = [[run] if several and not _has_state(run) else windows(run, window_s) for run in chosen]
    return list(itertools.chain.from_iterable(parts))


def _may_hold(run: Run, name: str) -> bool:
    """Return whether the model of the run predicts channels of this name."""
    row = match_name(name)
    return row is not None and row.kind in run.kind.outputs


def _has_state(run: Run) -> bool:
    return InitialSection in run.kind.run_sections.values()


def observing(run: Run, channels: Sequence[str]) -> Run:
    """Return the run with only the given channels to be compared with a prediction.

    The other channels stay in the run, and may determine its initial state. `linkNN_angle`, the
    absolute angle of a link in a plane, is the sum of the joint angles up to this link if it is not
    recorded.

    Raises:
        InputError: a channel is neither recorded nor computable, or the model does not predict it.
    """
    values, known = dict(run.values), dict(run.channels)
    for name in channels:
        if name not in values:
            values[name], known[name] = _link_angle(run, name)
    selected = dataclasses.replace(run, values=values, channels=known, observed=tuple(channels))
    for name in channels:
        if name not in selected.observations:
            raise InputError(
                f"'{name}' of '{run.name}' is an input of the model and is not predicted: choose "
                "another channel"
            )
    return selected


def _link_angle(run: Run, name: str) -> tuple[np.ndarray, Channel]:
    match = _LINK_ANGLE.fullmatch(name)
    joints = [f"joint{joint:02d}_angle" for joint in range(1, int(match[1]) + 1)] if match else []
    if not joints or any(joint not in run.values for joint in joints):
        measured = ", ".join(run.observations) or "none"
        raise InputError(
            f"'{run.name}' has no channel '{name}': choose among its measured channels: {measured}"
        )
    total = np.sum([run.values[joint] for joint in joints], axis=0)
    total.setflags(write=False)
    return total, Channel.named(name, run.channels[joints[0]].unit)


def windows(run: Run, length: float) -> list[Run]:
    """Cut the run into consecutive windows of a given length (s).

    Each window has its own initial state, which divides a long or chaotic recording into several
    short ones (multiple shooting). A remainder shorter than half a window is left out.

    Raises:
        InputError: the run has no initial state, its sidecar gives one fixed state that would apply
            to every window, or a window has fewer than four samples or no value of a channel.
    """
    if run.times is None or not _has_state(run):
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because a run of the {run.model} model has "
            "no initial state: omit the windows"
        )
    if not run.definition.section(InitialSection).first_row:
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because each window needs its own initial "
            "state: set first_row = true in [initial], and also free = true if angles are not "
            "recorded"
        )
    count = max(np.floor((run.times[-1] - run.times[0]) / length + 0.5), 1)
    rows = np.zeros(2, dtype=int)
    if 4 * count <= len(run.times):  # limits the number of edges before they are computed
        edges = run.times[0] + length * np.arange(int(count) + 1)
        rows = np.searchsorted(run.times, edges - 1e-9 * length)
    if np.min(np.diff(rows)) < 4:
        raise InputError(
            f"a window of {length:g} s of '{run.name}' holds fewer than 4 samples: make the "
            f"window longer"
        )
    parts = [
        rows_of(run, slice(first, last), f"{run.name} {run.times[first] - run.times[0]:.4g} s")
        for first, last in itertools.pairwise(rows)
    ]
    for part in parts:
        for channel, values in part.observations.items():
            if np.all(np.isnan(values)):
                raise InputError(
                    f"the window '{part.name}' has no value of {channel}: use longer windows, or "
                    f"exclude the channel"
                )
    return parts


def rows_of(run: Run, rows: slice, name: str) -> Run:
    """Return some rows of a run as a run with another name."""
    return dataclasses.replace(
        run,
        name=name,
        times=None if run.times is None else run.times[rows],
        values={channel: column[rows] for channel, column in run.values.items()},
    )


def read_run(
    path: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    definition: Definition | None = None,
) -> Run:
    """Read one run and its sidecar, `<stem>.toml` in the same folder, if it exists.

    Arguments:
        path: a `.csv` file (UTF-8, commas, one header line; an empty cell, `NaN` or `NA` means not
            measured) or a `.parquet` file.
        rename: column name in the file -> name in the column table.
        definition: a fit definition. Its keys about the run and its model override those of the
            sidecar.

    Raises:
        InputError: the file is not a valid run; the message names the file, the column and the row
            (in a CSV file, its line).
    """
    path = Path(path)
    # The sidecar is read first, because it may name a model of a package that declares columns.
    sidecar = read_sidecar(path)
    table = read_table(path, rename)
    if sidecar.sha256 is not None and sidecar.sha256 != table.sha256:
        raise InputError(
            f"{path} has the SHA-256 {table.sha256[:12]}..., but {sidecar_path(path)} gives "
            f"{sidecar.sha256[:12]}...: get the file again, or correct sha256 in the sidecar"
        )
    return run_of(table, path, _with_definition(sidecar, definition))


class LineReader:
    """Read runs like `read_run` from lines of a file that may still grow.

    The sidecar is read once. A checksum in the sidecar is ignored, because it refers to the
    complete file.
    """

    def __init__(
        self,
        path: Path,
        *,
        rename: Mapping[str, str] | None = None,
        definition: Definition | None = None,
    ) -> None:
        self._path, self._rename = path, rename
        self._definition = _with_definition(read_sidecar(path), definition)

    def check_names(self, header: bytes) -> None:
        """Raise `InputError` unless a line contains the column names of a run with times."""
        if table_of_lines(header, self._path, self._rename).times is None:
            raise InputError(
                f"{self._path} has no column time_s, which is required to follow the file: add "
                "this column"
            )

    def read(self, data: bytes, first_row: int = 2, *, partial: bool = False) -> Run:
        """Return the run in some lines, the first of which contains the column names.

        Arguments:
            data: the lines.
            first_row: row number of the line after the first, for error messages.
            partial: True if the run continues; then one row suffices, and channels may be empty.

        Raises:
            InputError: as in `read_run`.
        """
        table = table_of_lines(data, self._path, self._rename, first_row)
        return run_of(table, self._path, self._definition, partial=partial)


def _with_definition(sidecar: Definition, definition: Definition | None) -> Definition:
    if definition is None:
        return sidecar
    keys = run_keys(model=True)
    contents = {key: item for key, item in definition.contents().items() if key in keys}
    return sidecar.merged_with(Definition.parse(contents))


def read_runs(
    paths: Sequence[str | Path],
    definition: Definition,
    *,
    rename: Mapping[str, str] | None = None,
    beside: Sequence[Run] = (),
) -> list[Run]:
    """Read the runs of a fit, with the channels and windows that its definition specifies.

    `beside` contains the fitted runs if the runs for a validation are read.

    Raises:
        InputError: as in `read_run`, `observing` and `windows`.
    """
    runs = [read_run(path, rename=rename, definition=definition) for path in paths]
    return selected(runs, definition.fit.channels, definition.fit.window_s, beside)


def run_of(table: Table, path: Path, definition: Definition, *, partial: bool = False) -> Run:
    """Return the checked run of a table and a definition; see `build_run`."""
    return build_run(
        name=path.stem,
        times=table.times,
        values=dict(table.values),
        channels=dict(table.channels),
        definition=definition,
        naming=Naming(str(path), "row", table.first_row, columns=True),
        path=path,
        sha256=table.sha256,
        partial=partial,
    )


def sidecar_path(path: str | Path) -> Path:
    """Return the path of the sidecar of a run, which need not exist."""
    path = Path(path)
    return path.parent / f"{path.stem}.toml"  # unlike with_suffix, this accepts the path "."


def read_sidecar(path: str | Path) -> Definition:
    """Return the sidecar of the run at `path`; an empty definition if there is none.

    Raises:
        InputError: the sidecar is not legal, or contains `[fit]`, `[figures]`, `[filling]` or
            `[unrolling]`, which a fit of the run would silently ignore.
    """
    sidecar = sidecar_path(path)
    check_path(sidecar)
    if not os.path.lexists(sidecar):
        return Definition()
    if not sidecar.exists():
        raise InputError(
            f"{sidecar} is a link to a file that does not exist, but must be the sidecar of "
            f"{path}: correct or remove the link"
        )
    definition = Definition.load(sidecar)
    for section in ("fit", "figures", "filling", "unrolling"):
        if section in definition.model_fields_set:
            raise InputError(
                f"{sidecar} is the sidecar of {path} and must not contain [{section}]: move this "
                "section to a fit definition, a TOML file with another name"
            )
    return definition


def parse_rename(pairs: list[str], option: str = "--rename") -> dict[str, str]:
    """Convert `["OLD=NEW", ...]` from the command line to a mapping.

    Raises:
        InputError: a pair has another form, or an old name occurs twice.
    """
    rename: dict[str, str] = {}
    for pair in pairs:
        # Split at the last equals sign: names in a file may contain one, names in the table do not.
        old, equals, new = pair.rpartition("=")
        if not equals or not old or not new:
            raise InputError(
                f"{option} {pair!r} must be OLD=NEW: give the name of the column in the file and "
                f"its name in the column table"
            )
        if old in rename:
            raise InputError(f"{option} gives {old!r} twice, but must give it once: remove one")
        rename[old] = new
    return rename


# Suffixes of files of this toolkit. A folder with such a name is probably a mistake.
_FILES = (".csv", ".parquet", ".toml", ".json", *(f".{each}" for each in FORMATS), ".txt", ".html")


def check_output_files(paths: Iterable[str | Path], *, force: bool) -> None:
    """Refuse files that cannot be written, or that exist already (without `force`).

    Raises:
        InputError: a file is refused; the message names the file and the remedy.
    """
    for path in map(Path, all_pictures(paths)):
        check_path(path)
        if path.is_dir():
            raise InputError(f"{path} is a folder: give the name of a file")
        check_replaced(path)
        # A broken link counts as an existing file.
        if os.path.lexists(path) and not force:
            raise InputError(f"{path} exists and is not overwritten: give another name or --force")
        if not path.parent.is_dir():
            raise InputError(
                f"{path} cannot be written, because the folder {path.parent} does not exist: "
                "create it or give another name"
            )
        if not os.access(path.parent, os.W_OK | os.X_OK):
            raise InputError(
                f"{path} cannot be written, because there is no permission to write to "
                f"{path.parent}: give another name"
            )


def check_run_name(path: str | Path) -> Path:
    """Return the path if its name ends in `.csv`; runs are written only to such files."""
    path = Path(path)
    if path.suffix != ".csv":
        raise InputError(
            f"{path} must end in .csv to be written as a run: give a name that ends in .csv"
        )
    return path


def check_output_run(path: str | Path, *, force: bool) -> None:
    """Refuse a run that cannot be written with its sidecar, as in `check_output_files`."""
    path = check_run_name(path)
    check_output_files((path, sidecar_path(path)), force=force)


def check_output_folder(
    folder: str | Path, names: Iterable[str] = (), *, force: bool = False
) -> None:
    """Refuse a folder that cannot be made or written to, or that contains files of these names.

    The folder need not exist, and names may include folders (`fits/a.toml`).

    Raises:
        InputError: the folder is refused; the message names the file or folder and the remedy.
    """
    folder = existing = Path(folder)
    check_path(folder)
    if folder.suffix in _FILES and not folder.exists():
        raise InputError(
            f"{folder} is a file, but the output must be a folder: give the name of a folder"
        )
    # A broken link exists for mkdir, but not for `exists`.
    while not existing.exists() and not existing.is_symlink() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        what = "is a file" if existing.exists() else "is a broken link"
        raise InputError(f"{existing} {what}, but the output must be a folder: give another name")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(f"{existing} cannot be written: give another folder")
    for name in all_pictures(names):
        check_path(folder / name)
        check_replaced(folder / name)
        if os.path.lexists(folder / name) and not force:
            raise InputError(
                f"{folder / name} exists and is not overwritten: give another folder or --force"
            )


def make_folder(folder: str | Path) -> Path:
    """Make a folder and its parents, unless they exist; return its path.

    Raises:
        InputError: the folder cannot be made.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"the folder {folder} cannot be created ({error.strerror}): give another folder"
        ) from None
    return folder


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
    """Write a run as a `.csv` file that `read_run` can read; return its path.

    Each file is written completely or not at all.

    Arguments:
        path: path of the run; its name must end in `.csv`.
        times: times, s, shape (sample,), or None for a static run.
        values: values by channel name, SI, each of shape (sample,); NaN becomes an empty cell.
        units: unit suffix by channel name or quantity (`length`, `angle`, `angular_velocity`, ...).
            The defaults are deg, deg_per_s, kPa, and SI for all others.
        definition: contents of a sidecar, which is written with the model and the checksum; None
            for no sidecar.
        digits: number of significant digits.
        force: replace existing files.

    Raises:
        InputError: the run cannot be written; then no file was replaced.
    """
    path = check_run_name(path)
    sidecar = sidecar_path(path)
    if definition is not None and not isinstance(definition, Definition):
        definition = Definition.parse(definition, str(sidecar))
    if definition is None and os.path.lexists(sidecar):
        raise InputError(
            f"{sidecar} would become the sidecar of the new {path.name}, which it does not "
            "describe: move this sidecar, or write the run to another folder"
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
    """Write all files, or none of them if one exists and `force` is false.

    The other formats of a picture are written with it.

    Each file is written next to its destination and then moved there. With `force`, an existing
    link is replaced like a file, and its target stays as it is.

    Raises:
        InputError: a file exists, its folder does not exist, or it cannot be written.
    """
    given, contents = contents, all_files(contents)
    check_output_files(contents, force=force)
    temporary: dict[Path, Path] = {}
    with contextlib.ExitStack() as folders:
        for folder in {path.parent for path in contents}:
            folders.enter_context(written_to(folder))
        try:
            for path, data in contents.items():
                part = part_of(path)
                with part.open("xb") as file:
                    temporary[path] = part
                    file.write(data)
            for path, part in temporary.items():
                os.replace(part, path)
            if force:
                remove_former_pictures(given)
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
        # Consecutive samples of a long run must not be rounded to the same time.
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
            f"columns have different numbers of samples ({lengths}), but must have the same "
            f"number: give every channel a value at every time"
        )
    lines = [",".join(columns), *map(",".join, zip(*columns.values(), strict=True))]
    return "\n".join(lines) + "\n"


def _recorded(name: str, units: Mapping[str, str]) -> Channel:
    channel = Channel.named(name)
    usual = DEFAULT_UNITS.get(channel.quantity, channel.unit)
    return Channel.named(name, units.get(name, units.get(channel.quantity, usual)))


def _cells(values: npt.NDArray[np.float64], digits: int) -> list[str]:
    # Adding zero turns -0.0 into 0.0.
    return ["" if value != value else f"{value:.{digits}g}" for value in (values + 0.0).tolist()]
