"""`giajax check`, `init`, `import`, `examples` and `cache`: recordings and files."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from ..runtime.text import InputError
from ._commands import (
    Force,
    Json,
    Quiet,
    Renamed,
    Texts,
    ToRun,
    argument,
    check_quiet,
    command,
    command_after,
    print_table,
)
from ._values import numbers

_ODD = 3  # Exit status with --strict.


@command(
    """\b
Examples:
  giajax check --data run.csv
                            list channels, samples and implausible values
  giajax check --data camera.csv --rename t=time_s --rename "z 6"=link06_z_m
                            rename columns before the check
  giajax check --data run.csv --strict --json
                            print JSON for a script

\b
Notes on implausible units, signs, labels and constants, and on missing values
and glitches, precede the other notes. The checks are based on the magnitude
of the values. No file is changed.
Exit status: 0 success; 2 bad input or usage; 3 with --strict, if a value is
implausible.""",
    group="first",
    old_words="--data",
)
def check(
    data: Annotated[Path, "RUN.csv", "The run, a .csv or .parquet file."],
    rename: Renamed = None,
    as_json: Json = False,
    strict: Annotated[bool, "Exit with status 3 if any value is implausible."] = False,
) -> None:
    """Summarise a run and report implausible values.

    Shows the model, samples, commands, channels with their range and noise, values that are
    unlikely in a correct recording, and the assumptions made where the sidecar has no entry.
    """
    from ..recordings import describe, parse_rename, read_run

    facts = describe(read_run(data, rename=parse_rename(rename or [])))
    if as_json:
        typer.echo(json.dumps(facts, indent=2))
    else:
        print_table(["", ""], _summary(facts), left=2)
        print()
        headings = ["channel", "part", "unit", "values", "missing %", "min", "max", "noise"]
        print_table(headings, [_row(channel) for channel in facts["channels"]], left=3)
        if facts["notes"]:
            print("", *(f"note: {note}" for note in facts["notes"]), sep="\n")
        following = "init" if facts["sidecar"] is None else "fit"
        print(f"\n{command_after(following, *_named(data, rename))}")
    if strict and facts["oddities"]:
        raise typer.Exit(_ODD)


def _summary(facts: dict[str, Any]) -> list[tuple[str, str]]:
    from ..schema import KINDS

    rows = {"run": facts["path"], "model": facts["model"], "rows": str(facts["rows"])}
    if facts["time"] is not None:
        rows["time"] = _time(facts["time"])
    command, wind, sidecar = facts["command"], facts["wind"], facts["sidecar"]
    if command is not None:
        names, corners = ", ".join(command["channels"]), command["corners"]
        rows["command"] = f"{names}; {command['interpolation']}, {corners} corners"
    elif KINDS[facts["model"]].uncommanded:
        rows["command"] = KINDS[facts["model"]].uncommanded
    if wind is not None and wind["source"] == "constant":
        rows["wind"] = f"constant, {wind['velocity_m_per_s']} m/s"
    elif wind is not None:
        rows["wind"] = f"{', '.join(wind['channels'])}; {wind['interpolation']}"
    if sidecar is None:
        rows["sidecar"] = "none"
    else:
        sections = dict.fromkeys(key.partition(".")[0] for key in sidecar["keys"])
        rows["sidecar"] = f"{sidecar['path']}, checksum {sidecar['checksum']}"
        rows["stated"] = ", ".join(sections)
    return list(rows.items())


def _time(time: dict[str, float]) -> str:
    median, least, most = (time[f"interval_{which}_s"] for which in ("median", "min", "max"))
    even = most - least <= 1e-6 * median
    between = "" if even else f" (median; from {least:.6g} to {most:.6g} s)"
    return f"{time['start_s']:.6g} to {time['end_s']:.6g} s, every {median:.6g} s{between}"


def _row(channel: dict[str, Any]) -> list[Any]:
    texts = channel.get("texts")
    if texts is not None:
        counts = ", ".join(f"{count} {text}" for text, count in texts.items())
        return [channel["name"], channel["part"], "text", counts, "0", None, None, None]
    missing = f"{channel['missing_percent']:.3g}"
    measured = [channel[key] for key in ("min", "max", "noise")]
    unit = channel["unit"] or None
    return [channel["name"], channel["part"], unit, channel["count"], missing, *measured]


@command(
    """\b
Example:
  giajax init --data run.csv
                            write the sidecar run.toml; edit it, then run
                            giajax check --data run.csv""",
    group="data",
    old_words="--data",
)
def init(
    data: Annotated[Path, "RUN.csv", "The run, a .csv or .parquet file."],
    rename: Renamed = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write a sidecar template for a run.

    The template contains the values that follow from the run file. All other applicable keys are
    listed as comments, with their units and meanings.
    """
    from ..recordings import parse_rename, sidecar_path, sidecar_template, write_files

    sidecar = sidecar_path(data)
    text = sidecar_template(data, parse_rename(rename or []))
    write_files({sidecar: text.encode()}, force=force)
    if not quiet:
        typer.echo(f"wrote {sidecar}: fill it in; {command_after('check', *_named(data, rename))}")


def _named(data: Path, rename: list[str] | None) -> list[str]:
    """Return the options with which another command reads this run."""
    return ["--data", str(data), *(word for pair in rename or [] for word in ("--rename", pair))]


@command(
    """\b
Examples:
  giajax import filmDLC_resnet50.csv --frame-rate 60 --camera side \\
      --point elbow=link03 --point tip=tip --command log.csv --to run.csv
                            points from DeepLabCut, with commands from a log
  giajax import tracker.txt --unit m --point mass_A=tip --to run.csv
                            a point from Tracker, in metres
  giajax import trajectories.csv --origin 0,1079 --camera side \\
      --point "Marker 1"=link03 --to run.csv
                            a point from Kinovea, in px
  giajax import take.csv --point Arm:tip=tip --from-time 2 --until 20 \\
      --to run.csv          part of an OptiTrack Motive take
  giajax import RawData.csv --point Gyroscope=imu01 --to run.csv
                            the gyroscope of a phone
  giajax import bag --point /joint_states/shoulder=joint01 --to run.csv \\
      --point "/commands/shoulder position=joint01_command"
                            a ROS 2 bag
  giajax import spreadsheet.csv --rename t=time_s --ignore "note*" \\
      --to run.csv          a table with known column names

\b
After the import, `giajax init --data run.csv` writes a sidecar with a section
for each camera, and `giajax fit --data run.csv` fits the run.""",
    group="data",
    old={
        "--out": "--to",
        "--commands": "--command",
        "--rate": "--frame-rate",
        "--kinovea-origin": "--origin",
    },
)
def import_(
    file: Annotated[
        Path,
        argument(
            "FILE",
            "A text file from DeepLabCut, SLEAP, anipose, Kinovea, Tracker, OptiTrack Motive or "
            "phyphox; a table with giajax column names and with columns separated by commas, "
            "semicolons or tabs; or a ROS 2 bag, which is a folder, .mcap or .db3 (needs the "
            "extra 'ros': pip install 'giajax[ros]', or in a checkout pip install '.[ros]').",
        ),
    ],
    to: ToRun,
    point: Annotated[
        Texts,
        "NAME=PART",
        "Assign a tracked point, sensor or joint of the file to link06, tip, mark01, imu06, "
        "joint01 or a channel.",
    ] = None,
    camera: Annotated[
        str | None, "NAME", "Name of the camera; required if there are several cameras."
    ] = None,
    frame_rate: Annotated[
        float | None,
        "HZ",
        "Frame rate of the film in frames per second, used instead of the times in the file.",
    ] = None,
    likelihood: Annotated[float, "P", "Treat points with a likelihood below P as missing."] = 0.6,
    unit: Annotated[
        str | None, "UNIT", "Unit of length if the file does not specify it: m, cm or mm."
    ] = None,
    origin: Annotated[
        str | None,
        "U,V",
        "Position of the coordinate origin in the image (px from the upper left corner), for "
        "pixel coordinates from Kinovea or Tracker with an upward vertical axis.",
    ] = None,
    axes: Annotated[
        str | None,
        "AXES",
        "Axes of the base frame that correspond to the coordinates in the file: x,z for a side "
        "view, x,y for a top view, x,z,-y for 3-D coordinates.",
    ] = None,
    flip: Annotated[
        Texts, "NAME", "Change the sign of an axis, such as z, or of a channel."
    ] = None,
    time_unit: Annotated[str, "UNIT", "Unit of time in a Kinovea file: s or ms."] = "s",
    offset: Annotated[float, "S", "Offset added to the times in the file."] = 0.0,
    from_time: Annotated[float | None, "S", "Omit rows before this time in the file."] = None,
    until: Annotated[float | None, "S", "Omit rows after this time in the file."] = None,
    rename: Renamed = None,
    only: Annotated[
        Texts, "NAME", "Read only this column or channel; tip* matches several columns."
    ] = None,
    ignore: Annotated[Texts, "NAME", "Skip this column or channel."] = None,
    command: Annotated[
        Path | None,
        "FILE",
        "Take commands, or points from another camera, from this run, recorded with the clock of "
        "the film.",
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Convert the output of a tracking or other program to a run.

    The program is recognised from the file. Each point becomes the channels of a link, of the tip
    or of a landmark, in pixels or in space. Commands sampled at another rate keep their own rows.
    """
    import numpy as np

    from ..recordings import (
        ImportSettings,
        channels_of,
        filmed_beside,
        parse_rename,
        read_beside,
        read_foreign,
        rows_kept,
        write_run,
    )

    place = None if origin is None else numbers(origin, 2)
    if origin is not None and place is None:
        raise InputError(
            f"--origin is {origin!r}: give two numbers separated by a comma, such as 0,1079"
        )
    how = ImportSettings(
        frame_rate=frame_rate,
        likelihood=likelihood,
        time_unit=time_unit,
        unit=unit,
        origin=None if place is None else (place[0], place[1]),
        axes=None if axes is None else tuple(axes.split(",")),
        rename=parse_rename(rename or []),
        only=only or (),
        ignore=ignore or (),
        flip=flip or (),
        offset=offset,
        from_time=-np.inf if from_time is None else from_time,
        until=np.inf if until is None else until,
    )
    table = read_foreign(file, how)
    values = channels_of(table, parse_rename(point or [], "--point"), camera, how)
    times, values = rows_kept(table, values, how)
    measured = {n: c for n, c in values.items() if c.dtype.kind == "f" and n not in table.channels}
    for name, column in measured.items():
        if not np.any(np.isfinite(column)):
            raise InputError(
                f"{name} was not found in any row of {file}: omit this point, or lower "
                "--likelihood if the file contains likelihoods"
            )
    # The coordinates of a point are missing or present together.
    found = {name.rpartition("_")[0]: np.isfinite(column) for name, column in measured.items()}
    count = len(next(iter(values.values())))
    if command is not None:
        if times is None:
            raise InputError(
                f"{file} contains no times: give the number of rows per second with --frame-rate"
            )
        beside = read_beside(command)
        # A command in a bag is held until the next message.
        times, values = filmed_beside(times, values, beside, held=table.merged)
    write_run(to, times, values, digits=9, force=force)
    if quiet:
        return
    what = f"{count} rows of {len(values)} channels"
    if found:
        seen = sum(int(each.sum()) for each in found.values())
        shown = {column.quantity for columns in table.things.values() for column in columns}
        rows, cells = ("pictures", "points") if shown & {"pixel", "length"} else ("rows", "values")
        what = f"{count} {rows}, {seen} of {len(found) * count} {cells} found"
    following = command_after("init", "--data", to)
    typer.echo(f"wrote {to}, from {table.program}: {what}; {following}")


_DATA = ("data/synthetic", "data/independent", "data/recorded")
_FOLDERS = ("fits", "missions", *_DATA)
_MANY = 5
_COPIED = (".csv", ".toml", ".md", ".txt", "")  # A licence has no suffix.


@command(
    """\b
Examples:
  giajax examples           list all examples
  giajax examples --copy work
                            copy all examples to a folder
  giajax fit work/fits/base_step.toml
                            fit one of the examples""",
    group="data",
)
def examples(
    copy: Annotated[Path | None, "DIR", "Copy all examples to this folder."] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """List the runs, fits and missions that ship with giajax.

    With --copy, copies all examples to a folder as a starting point.
    """
    check_quiet(quiet, written=copy, by="--copy DIR")
    root = examples_root()
    if copy is None:
        _show_examples(root)
        return
    from ..recordings import check_output_folder, make_folder, write_files

    contents = {copy / path.relative_to(root): path.read_bytes() for path in _files(root)}
    names = [path.relative_to(copy).as_posix() for path in contents]
    check_output_folder(copy, names, force=force)
    for folder in {path.parent for path in contents}:
        make_folder(folder)
    write_files(contents, force=force)
    if not quiet:
        following = command_after("fit", copy / "fits" / "base_step.toml")
        typer.echo(f"copied {len(names)} files to {copy}; {following}")


def examples_root() -> Path:
    """Return the folder that contains `fits/`, `missions/` and `data/`.

    In an installed package it is `giajax/_examples`. In a checkout (an editable install) it is the
    root of the repository.
    """
    from importlib import resources

    package = Path(str(resources.files("giajax")))
    checkout = package.parents[1]
    for root in (package / "_examples", checkout):
        if all((root / folder).is_dir() for folder in _FOLDERS):
            return root
    raise InputError(
        f"the examples are not part of this installation ({package}): reinstall giajax"
    )


def _show_examples(root: Path) -> None:
    from ..recordings import Definition

    fits = sorted((root / "fits").glob("*.toml"))
    print_table(
        ["fit definition", "parameters", "data"], [_fit(path, root) for path in fits], left=3
    )
    print()
    missions = []
    for path in sorted((root / "missions").glob("*.toml")):
        mission = Definition.load(path).mission
        missions.append((path.relative_to(root).as_posix(), mission and mission.opening))
    print_table(["mission", "opening"], missions, left=2)
    print()
    tables = [path for data in _DATA for path in sorted((root / data).rglob("*.csv"))]
    # A table without a sidecar is a source from which a run was made.
    runs = [path for path in tables if path.with_suffix(".toml").exists()]
    headings = ["run", "inputs", "rows", "duration s", "channels", "missing %"]
    print_table(headings, [_run(path, root) for path in runs], left=2)
    print(f"\nThe examples are in {root}; to copy them: giajax examples --copy DIR")


def _fit(path: Path, root: Path) -> list[str | None]:
    from ..recordings import Definition

    fit = Definition.load(path).fit
    names = [Path(name).name for name in fit.data or []]
    data = ", ".join(names) if len(names) < _MANY else f"{names[0]} and {len(names) - 1} others"
    free = "the default parameters" if fit.free is None else ", ".join(fit.free)
    return [path.relative_to(root).as_posix(), free, data]


def _run(path: Path, root: Path) -> list[str | int | float | None]:
    from ..recordings import describe, read_run
    from ..schema import KINDS

    facts = describe(read_run(path))
    measured = [channel for channel in facts["channels"] if channel["part"] == "measured"]
    gaps = sum(channel["missing_percent"] for channel in measured) / max(len(measured), 1)
    names = [name.removesuffix("_command") for name in (facts["command"] or {}).get("channels", [])]
    windy = [] if facts["wind"] is None else ["wind"]
    time = facts["time"]
    seconds = None if time is None else time["end_s"] - time["start_s"]
    unnamed = bool(KINDS[facts["model"]].uncommanded)
    driven = ", ".join([*names, *windy]) or (None if unnamed else facts["model"])
    return [path.relative_to(root).as_posix(), driven, facts["rows"], seconds, len(measured), gaps]


def _files(root: Path) -> Iterator[Path]:
    for folder in _FOLDERS:
        for path in sorted((root / folder).rglob("*")):
            if path.is_file() and path.suffix in _COPIED:
                yield path


@command(
    """\b
Examples:
  giajax cache              show path, contents and size of the cache
  giajax cache --clear      clear the cache; the next fit compiles again""",
    group="other",
)
def cache(clear: Annotated[bool, "Remove the compiled programs from the cache."] = False) -> None:
    """Show or clear the cache of compiled programs.

    Each command reuses the programs for its model and data. Damaged files and files from another
    version of giajax are not used. Only --clear removes files. The cache folder is giajax in the
    user's cache directory, unless the variable JAX_COMPILATION_CACHE_DIR specifies another folder.
    From this other folder, --clear removes only files that giajax wrote. A folder that other users
    can write to, or that belongs to another account, is not used, because programs from such a
    folder are not trusted.
    """
    from ..runtime.process import PROGRAMS, compilation_cache
    from ..runtime.programs import SUFFIX

    directory, stated = compilation_cache()
    if directory is None:
        typer.echo(
            "no folder is available for the cache, so compiled programs are not kept: set "
            "XDG_CACHE_HOME to a writable folder"
        )
        return
    traced = sorted((directory / PROGRAMS).glob(f"*{SUFFIX}"))
    compiled = sorted(directory.glob("*-cache"))
    if clear:
        removed = traced if stated else [*traced, *compiled]
        for path in removed:
            try:
                path.unlink(missing_ok=True)
            except OSError as error:
                raise InputError(
                    f"{path} cannot be removed ({error.strerror}): remove the folder manually"
                ) from None
        typer.echo(f"{directory}: removed {len(removed)} of {len(traced) + len(compiled)} programs")
        return
    typer.echo(str(directory))
    rows = []
    for name, paths in (("traced", traced), ("compiled", compiled)):
        # Another process may remove a file in the meantime.
        size = sum(path.stat().st_size for path in paths if path.exists())
        rows.append((name, len(paths), f"{size / 1e6:.1f}"))
    print_table(["", "programs", "size MB"], rows)
