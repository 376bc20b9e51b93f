"""Reading a run, and taking some of its channels or windows of time."""

import dataclasses
import itertools
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..runtime.files import check_path
from ..runtime.text import InputError
from ..schema import InitialSection
from ._channels import Channel, Naming, match_name
from ._definition import Definition, run_keys
from ._run import Run, build_run
from ._table import Table, read_table

_LINK_ANGLE = re.compile(r"link([0-9]{1,4})_angle")


def selected(
    runs: Sequence[Run],
    channels: Sequence[str] | None,
    window_s: float | None,
    beside: Sequence[Run] = (),
) -> list[Run]:
    """The runs of a fit with these channels, in windows.

    Of runs of several models each has those of the channels that are its model's, and those
    without an initial state stay whole.

    Arguments:
        runs: as they were read.
        channels: names without unit; None for all that were measured.
        window_s: length of a window, s; None for whole runs.
        beside: further runs that the same is asked of.

    Raises:
        InputError: as `observing` and `windows`, or a channel that none of them measures.
    """
    everything = [*runs, *beside]
    several = len({run.model for run in everything}) > 1
    for name in channels or () if several else ():
        if not any(_may_hold(run, name) for run in everything):
            raise InputError(
                f"'{name}' is no channel that these runs are compared in: choose among "
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
    """Whether a channel of this name is one that the run's model predicts."""
    row = match_name(name)
    return row is not None and row.kind in run.kind.outputs


def _has_state(run: Run) -> bool:
    return InitialSection in run.kind.run_sections.values()


def observing(run: Run, channels: Sequence[str]) -> Run:
    """The run with only these channels to be compared with a prediction.

    The other channels stay in the run, and may give its initial state.

    Arguments:
        run: the run.
        channels: names without unit. `linkNN_angle`, the absolute angle of a link in a plane, is
            made from the joint angles up to it where it is not recorded.

    Raises:
        InputError: a channel that the run does not have and that cannot be made, or one that the
            model does not predict.
    """
    values, known = dict(run.values), dict(run.channels)
    for name in channels:
        if name not in values:
            values[name], known[name] = _link_angle(run, name)
    selected = dataclasses.replace(run, values=values, channels=known, observed=tuple(channels))
    for name in channels:
        if name not in selected.observations:
            raise InputError(
                f"'{name}' of '{run.name}' drives the model, which does not predict it: "
                "name another channel"
            )
    return selected


def _link_angle(run: Run, name: str) -> tuple[np.ndarray, Channel]:
    match = _LINK_ANGLE.fullmatch(name)
    joints = [f"joint{joint:02d}_angle" for joint in range(1, int(match[1]) + 1)] if match else []
    if not joints or any(joint not in run.values for joint in joints):
        measured = ", ".join(run.observations) or "none"
        raise InputError(
            f"'{run.name}' has no channel '{name}': choose among its measured ones: {measured}"
        )
    total = np.sum([run.values[joint] for joint in joints], axis=0)
    total.setflags(write=False)
    return total, Channel.named(name, run.channels[joints[0]].unit)


def windows(run: Run, length: float) -> list[Run]:
    """The run cut into windows of a length (s), one after the other.

    Each starts at its own initial state, which makes one long or chaotic recording into several
    short ones (multiple shooting). A remainder shorter than half a window is left out.

    Raises:
        InputError: the run has no initial state, or its sidecar states one that would be that of
            every window, or a window would hold fewer than four samples or none of a channel.
    """
    if run.times is None or not _has_state(run):
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because a run of the {run.model} model has "
            "no initial state: leave out the windows"
        )
    if not run.definition.section(InitialSection).first_row:
        raise InputError(
            f"'{run.name}' cannot be cut into windows, because each needs its own initial state: "
            "say first_row = true in [initial]"
        )
    count = max(np.floor((run.times[-1] - run.times[0]) / length + 0.5), 1)
    if 4 * count > len(run.times):
        raise _too_short(run, length)
    edges = run.times[0] + length * np.arange(int(count) + 1)
    rows = np.searchsorted(run.times, edges - 1e-9 * length)
    if np.min(np.diff(rows)) < 4:
        raise _too_short(run, length)
    parts = [
        rows_of(run, slice(first, last), f"{run.name} {run.times[first] - run.times[0]:.4g} s")
        for first, last in itertools.pairwise(rows)
    ]
    for part in parts:
        for channel, values in part.observations.items():
            if np.all(np.isnan(values)):
                raise InputError(
                    f"the window '{part.name}' has no value of {channel}: make windows longer, or "
                    "leave the channel out"
                )
    return parts


def rows_of(run: Run, rows: slice, name: str) -> Run:
    """Some rows of a run with times, as a run of another name."""
    return dataclasses.replace(
        run,
        name=name,
        times=None if run.times is None else run.times[rows],
        values={channel: column[rows] for channel, column in run.values.items()},
    )


def _too_short(run: Run, length: float) -> InputError:
    return InputError(
        f"a window of {length:g} s of '{run.name}' holds fewer than 4 samples: make it longer"
    )


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
        naming=Naming(str(path), "row", table.first_row, columns=True),
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
