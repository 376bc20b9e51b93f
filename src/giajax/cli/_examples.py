"""`giajax examples`: the runs, fit definitions and missions that ship with giajax."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from ._registry import command


_DATA = ("data/synthetic", "data/independent", "data/recorded")
_FOLDERS = ("fits", "missions", *_DATA)
_MANY = 5
# A licence has no suffix.
_COPIED = (".csv", ".toml", ".md", "")


@command("""\b
Examples:
  giajax examples
  giajax examples --copy work
  giajax fit work/fits/base_step.toml""")
def examples(
    copy: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Copy them all to this folder.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
) -> None:
    """List the runs, fits and missions that ship with giajax, or copy them to start from."""
    root = examples_root()
    if copy is None:
        _show(root)
        return
    files = list(_files(root))
    _copy(root, files, copy, force)
    typer.echo(f"copied {len(files)} files to {copy}; see: giajax fit {copy}/fits/base_step.toml")


def examples_root() -> Path:
    """The folder that holds `fits/`, `missions/` and `data/`.

    In an installed package it is `giajax/_examples`; in a checkout (an editable install) the
    root of the repository.

    Raises:
        InputError: neither is there.
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


def _show(root: Path) -> None:
    from ._output import print_table

    fits = sorted((root / "fits").glob("*.toml"))
    print_table(["fit definition", "fits", "to"], [_fit(path, root) for path in fits], left=3)
    print()
    missions = sorted((root / "missions").glob("*.toml"))
    print_table(["mission", "through"], [_mission(path, root) for path in missions], left=2)
    print()
    tables = [path for data in _DATA for path in sorted((root / data).rglob("*.csv"))]
    # A table without a sidecar is something that a run was made from.
    runs = [path for path in tables if path.with_suffix(".toml").exists()]
    headings = ["run", "driven", "rows", "seconds", "channels", "missing %"]
    print_table(headings, [_run(path, root) for path in runs], left=2)
    print(f"\nThey are in {root}; to start from them: giajax examples --copy DIR")


def _fit(path: Path, root: Path) -> list[str | None]:
    from ..runs import Definition

    fit = Definition.load(path).fit
    names = [Path(name).name for name in fit.data or []]
    data = ", ".join(names) if len(names) < _MANY else f"{names[0]} and {len(names) - 1} others"
    free = "the default parameters" if fit.free is None else ", ".join(fit.free)
    return [path.relative_to(root).as_posix(), free, data]


def _mission(path: Path, root: Path) -> list[str | None]:
    from ..runs import Definition

    mission = Definition.load(path).mission
    return [path.relative_to(root).as_posix(), None if mission is None else mission.opening]


def _run(path: Path, root: Path) -> list[str | int | float | None]:
    from ..kinds import KINDS
    from ..runs import describe, read_run

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


def _copy(root: Path, files: list[Path], target: Path, force: bool) -> None:
    from ..runs import check_output_folder, make_folder, write_files

    contents = {target / path.relative_to(root): path.read_bytes() for path in files}
    names = [path.relative_to(target).as_posix() for path in contents]
    check_output_folder(target, names, force=force)
    for folder in {path.parent for path in contents}:
        make_folder(folder)
    write_files(contents, force=force)
