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

_ODD = 3  # with --strict


@command(
    """\b
Examples:
  giajax check --data run.csv
                            channels, samples, and what is odd
  giajax check --data camera.csv --rename t=time_s --rename "z 6"=link06_z_m
                            with other names of columns
  giajax check --data run.csv --strict --json
                            for a script

\b
What is odd comes first, as notes: units, signs, labels, lost cells, glitches
and constants, by their magnitudes; nothing is changed.
Exit status: 0; 2 bad input or usage; 3 with --strict, where something is odd.""",
    group="first",
    old_words="--data",
)
def check(
    data: Annotated[Path, "RUN.csv", "The run, a .csv or .parquet file."],
    rename: Renamed = None,
    as_json: Json = False,
    strict: Annotated[bool, "End with status 3 where something is odd."] = False,
) -> None:
    """Say what a run holds, and what of it is odd.

    Model, samples, commands, channels with their range and noise, what is rarely so in a right
    recording, and what is assumed because the sidecar does not state it.
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
                            writes run.toml; then edit it, and see:
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
    """Write a sidecar to fill in.

    It states what the file tells, and offers every other key that applies, with its unit and
    meaning, as a comment.
    """
    from ..recordings import parse_rename, sidecar_path, sidecar_template, write_files

    sidecar = sidecar_path(data)
    text = sidecar_template(data, parse_rename(rename or []))
    write_files({sidecar: text.encode()}, force=force)
    if not quiet:
        typer.echo(f"wrote {sidecar}: fill it in; {command_after('check', *_named(data, rename))}")


def _named(data: Path, rename: list[str] | None) -> list[str]:
    """A run as another command is given it."""
    return ["--data", str(data), *(word for pair in rename or [] for word in ("--rename", pair))]


@command(
    """\b
Examples:
  giajax import filmDLC_resnet50.csv --frame-rate 60 --camera side \\
      --point elbow=link03 --point tip=tip --command log.csv --to run.csv
                            points of DeepLabCut, with commands of a log
  giajax import tracker.txt --unit m --point mass_A=tip --to run.csv
                            a point of Tracker, in metres
  giajax import trajectories.csv --origin 0,1079 --camera side \\
      --point "Marker 1"=link03 --to run.csv
                            a point of Kinovea, in px
  giajax import take.csv --point Arm:tip=tip --from-time 2 --until 20 \\
      --to run.csv          a part of a take of OptiTrack Motive
  giajax import RawData.csv --point Gyroscope=imu01 --to run.csv
                            the gyroscope of a phone
  giajax import bag --point /joint_states/shoulder=joint01 --to run.csv \\
      --point "/commands/shoulder position=joint01_command"
                            a bag of ROS 2
  giajax import spreadsheet.csv --rename t=time_s --ignore "note*" \\
      --to run.csv          a table of known columns

\b
Then: giajax init --data run.csv, which offers each camera its section, and
giajax fit --data run.csv.""",
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
            "A table of DeepLabCut, SLEAP, anipose, Kinovea, Tracker, OptiTrack Motive or phyphox, "
            "or one whose columns giajax knows, with commas, semicolons or tabs between cells; or "
            "a bag of ROS 2, a folder, .mcap or .db3 (pip install 'giajax[ros]').",
        ),
    ],
    to: ToRun,
    point: Annotated[
        Texts,
        "NAME=PART",
        "What a tracked point, sensor or joint of the file is: link06, tip, mark01, imu06, "
        "joint01, or a channel.",
    ] = None,
    camera: Annotated[str | None, "NAME", "The camera; needed where there are several."] = None,
    frame_rate: Annotated[
        float | None,
        "HZ",
        "Pictures a second of the film; in place of the times of a file that has some.",
    ] = None,
    likelihood: Annotated[float, "P", "A less likely point is left empty."] = 0.6,
    unit: Annotated[
        str | None, "UNIT", "Of lengths in a file that does not say it: m, cm or mm."
    ] = None,
    origin: Annotated[
        str | None,
        "U,V",
        "Of coordinates that Kinovea or Tracker counts in px, upwards: where their origin is in "
        "the picture, from the upper left corner.",
    ] = None,
    axes: Annotated[
        str | None,
        "AXES",
        "The axes of the base that the coordinates of the file are, such as x,z of a film from the "
        "side, x,y of one from above, x,z,-y of space.",
    ] = None,
    flip: Annotated[Texts, "NAME", "Change the sign of an axis, such as z, or channel."] = None,
    time_unit: Annotated[str, "UNIT", "Of times in a file of Kinovea: s or ms."] = "s",
    offset: Annotated[float, "S", "Add so much to the times of the file."] = 0.0,
    from_time: Annotated[float | None, "S", "Leave out what is earlier, by these times."] = None,
    until: Annotated[float | None, "S", "Leave out what is later."] = None,
    rename: Renamed = None,
    only: Annotated[Texts, "NAME", "Only this of the file, or this channel; tip* for many."] = None,
    ignore: Annotated[Texts, "NAME", "Without this of the file, or this channel."] = None,
    command: Annotated[
        Path | None,
        "FILE",
        "A run with the commands, on the film's clock, or with the points of another camera.",
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Make a run of what another program tracked or measured.

    Which program it was is read from the file. Each point becomes the channels of a link, of the
    tip or of a landmark, in pixels or in space. Commands of another rate keep their own rows.
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
        raise InputError(f"--origin {origin!r} must be two numbers: write it like 0,1079")
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
                f"{file} has no row in which {name} was found: leave it out, or lower --likelihood "
                "where the program says how likely points are"
            )
    # Coordinates of a point are found together.
    found = {name.rpartition("_")[0]: np.isfinite(column) for name, column in measured.items()}
    count = len(next(iter(values.values())))
    if command is not None:
        if times is None:
            raise InputError(f"{file} has no times: give --frame-rate, the rows a second")
        beside = read_beside(command)
        # A command of a bag holds until the next message.
        times, values = filmed_beside(times, values, beside, held=table.merged)
    write_run(to, times, values, digits=9, force=force)
    if quiet:
        return
    what = f"{count} rows of {len(values)} channels"
    if found:
        seen = sum(int(each.sum()) for each in found.values())
        shown = {column.quantity for columns in table.things.values() for column in columns}
        rows, cells = ("pictures", "points") if shown & {"pixel", "length"} else ("rows", "values")
        what = f"{count} {rows}, {seen} {cells} found of {len(found) * count}"
    following = command_after("init", "--data", to)
    typer.echo(f"wrote {to}, from {table.program}: {what}; {following}")


_DATA = ("data/synthetic", "data/independent", "data/recorded")
_FOLDERS = ("fits", "missions", *_DATA)
_MANY = 5
_COPIED = (".csv", ".toml", ".md", ".txt", "")  # a licence has no suffix


@command(
    """\b
Examples:
  giajax examples           what there is
  giajax examples --copy work
                            copy it all to a folder
  giajax fit work/fits/base_step.toml
                            fit one of them""",
    group="data",
)
def examples(
    copy: Annotated[Path | None, "DIR", "Copy them all to this folder."] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """List the runs, fits and missions that ship with giajax.

    Or copy them to start from.
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
    """The folder that holds `fits/`, `missions/` and `data/`.

    In an installed package it is `giajax/_examples`; in a checkout (an editable install) the
    root of the repository.
    """
    from importlib import resources

    package = Path(str(resources.files("giajax")))
    checkout = package.parents[1]
    for root in (package / "_examples", checkout):
        if all((root / folder).is_dir() for folder in _FOLDERS):
            return root
    raise InputError(
        f"the examples are not part of this installation ({package}): install giajax again"
    )


def _show_examples(root: Path) -> None:
    from ..recordings import Definition

    fits = sorted((root / "fits").glob("*.toml"))
    print_table(["fit definition", "fits", "to"], [_fit(path, root) for path in fits], left=3)
    print()
    missions = []
    for path in sorted((root / "missions").glob("*.toml")):
        mission = Definition.load(path).mission
        missions.append((path.relative_to(root).as_posix(), mission and mission.opening))
    print_table(["mission", "through"], missions, left=2)
    print()
    tables = [path for data in _DATA for path in sorted((root / data).rglob("*.csv"))]
    # A table without a sidecar is something that a run was made from.
    runs = [path for path in tables if path.with_suffix(".toml").exists()]
    headings = ["run", "driven", "rows", "seconds", "channels", "missing %"]
    print_table(headings, [_run(path, root) for path in runs], left=2)
    print(f"\nThey are in {root}; to start from them: giajax examples --copy DIR")


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
  giajax cache              where it is, what it holds, and its size
  giajax cache --clear      removes it; the next fit compiles again""",
    group="other",
)
def cache(clear: Annotated[bool, "Remove what is there."] = False) -> None:
    """Show or clear the programs that are kept between commands.

    Each command finds those of its model and its data there. A file that is of another version of
    giajax, or was damaged, is not used; none is ever removed but by --clear. The folder is giajax
    in the user's cache directory, or what JAX_COMPILATION_CACHE_DIR says: of that, only what
    giajax alone wrote is removed. A folder that others can write, or that belongs to another
    account, is not used: programs from there may do anything.
    """
    from ..runtime.process import PROGRAMS, compilation_cache
    from ..runtime.programs import SUFFIX

    directory, stated = compilation_cache()
    if directory is None:
        typer.echo(
            "there is no folder for a cache, and nothing is kept: set XDG_CACHE_HOME to one that "
            "can be written"
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
                    f"{path} cannot be removed ({error.strerror}): remove the folder yourself"
                ) from None
        typer.echo(f"{directory}: removed {len(removed)} of {len(traced) + len(compiled)} programs")
        return
    typer.echo(str(directory))
    rows = []
    for name, paths in (("traced", traced), ("compiled", compiled)):
        # Another process may remove one meanwhile.
        size = sum(path.stat().st_size for path in paths if path.exists())
        rows.append((name, len(paths), f"{size / 1e6:.1f}"))
    print_table(["", "programs", "MB"], rows)
