"""Reading a run: CSV or Parquet, with its sidecar."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from .._errors import InputError
from .._files import check_path
from ._definition import Definition, run_keys
from ._run import Run, build_run
from ._select import selected
from ._table import Table, read_table
from ._wording import Wording


def read_run(
    path: str | Path,
    *,
    rename: Mapping[str, str] | None = None,
    definition: Definition | None = None,
) -> Run:
    """Read one run and the sidecar beside it, `<stem>.toml`, if there is one.

    Arguments:
        path: a `.csv` file (UTF-8, commas, one header line; an empty cell, `NaN` or `NA` is not
            measured) or a `.parquet` file.
        rename: the file's column name -> the name it has in the column table.
        definition: a fit definition. What it says of the run and of its model, key by key, goes
            before the sidecar.

    Raises:
        InputError: whatever keeps the file from being a run, in one sentence that names the
            file, the column and the row (in a CSV file, its line).
    """
    path = Path(path)
    table = read_table(path, rename)
    sidecar = read_sidecar(path)
    if sidecar.sha256 is not None and sidecar.sha256 != table.sha256:
        raise InputError(
            f"{path} has the SHA-256 {table.sha256[:12]}..., but {sidecar_path(path)} says "
            f"{sidecar.sha256[:12]}...: get the file again, or correct sha256 there"
        )
    if definition is not None:
        keys = run_keys(model=True)
        contents = {key: item for key, item in definition.contents().items() if key in keys}
        sidecar = sidecar.merged_with(Definition.parse(contents))
    return run_of(table, path, sidecar)


def read_runs(
    paths: Sequence[str | Path],
    definition: Definition,
    *,
    rename: Mapping[str, str] | None = None,
    beside: Sequence[Run] = (),
) -> list[Run]:
    """Read the runs of a fit, with the channels and the windows that its definition asks for.

    Arguments:
        paths: as of `read_run`.
        definition: the fit definition.
        rename: as of `read_run`.
        beside: runs that the definition is about, too: those that are fitted, of a validation.

    Raises:
        InputError: as `read_run`, `observing` and `windows`.
    """
    runs = [read_run(path, rename=rename, definition=definition) for path in paths]
    return selected(runs, definition.fit.channels, definition.fit.window_s, beside)


def run_of(table: Table, path: Path, definition: Definition) -> Run:
    """The run that a table and a definition make together, checked."""
    return build_run(
        name=path.stem,
        times=table.times,
        values=dict(table.values),
        channels=dict(table.channels),
        definition=definition,
        wording=Wording(str(path), "row", table.first_row, columns=True),
        path=path,
        sha256=table.sha256,
    )


def sidecar_path(path: str | Path) -> Path:
    """Where the sidecar of a run lies, whether or not there is one."""
    return Path(path).with_suffix(".toml")


def read_sidecar(path: str | Path) -> Definition:
    """The sidecar of the run at `path`; an empty definition if there is none.

    Raises:
        InputError: it is not legal, or holds `[fit]`, `[figures]` or `[filling]`, which a fit of
            the run would silently ignore.
    """
    sidecar = sidecar_path(path)
    check_path(sidecar)
    if not os.path.lexists(sidecar):
        return Definition()
    if not sidecar.exists():
        raise InputError(
            f"{sidecar} is a link to a file that does not exist, but must be the sidecar of "
            f"{path}: mend or remove the link"
        )
    definition = Definition.load(sidecar)
    for section in ("fit", "figures", "filling"):
        if section in definition.model_fields_set:
            raise InputError(
                f"{sidecar} is the sidecar of {path}, where [{section}] must not be: move it to "
                "a fit definition, a TOML file of another name"
            )
    return definition


def parse_rename(pairs: list[str], option: str = "--rename") -> dict[str, str]:
    """`["OLD=NEW", ...]` of the command line as a mapping.

    Raises:
        InputError: a pair of another form, or an old name twice.
    """
    rename: dict[str, str] = {}
    for pair in pairs:
        # No name of the column table holds an equals sign; a foreign one may.
        old, equals, new = pair.rpartition("=")
        if not equals or not old or not new:
            raise InputError(
                f"{option} {pair!r} must be OLD=NEW: give the file's name of the column and its "
                "name in the column table"
            )
        if old in rename:
            raise InputError(f"{option} gives {old!r} twice, but must give it once: remove one")
        rename[old] = new
    return rename
