"""`giajax profile`: how far each quantity of a fit can go."""

import dataclasses
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._errors import InputError
from .._signals import stopped_status
from ._many import ManyProgress, Scheduler, Workers
from ._options import Renamed
from ._registry import command

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..study import Profiles


_PICTURE = "profiles.png"


@command("""\b
Examples:
  giajax profile giajax-out/run
  giajax profile giajax-out/run air.drag_coefficient
  giajax profile giajax-out/run joints.damping --level 0.68 --force
  giajax profile giajax-out/run --workers 2

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. Each PATH, a free parameter or a derived quantity, is held at
values ever farther from its estimate while all others are fitted; without a
PATH, all free parameters of the model.
Writes profiles.json and profiles.png beside the result, where 'giajax report'
finds them. What is there of the same fit is kept: further paths are added, and
after Ctrl-C the same command goes on.""")
def profile(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A fit; see below.")],
    paths: Annotated[
        list[str] | None,
        typer.Argument(metavar="PATH", help="What to profile (all that was free)."),
    ] = None,
    level: Annotated[
        float, typer.Option(metavar="P", help="Level of the intervals, between 0 and 1.")
    ] = 0.95,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A fitted run, if it has moved. Repeatable."),
    ] = None,
    rename: Renamed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    tasks: Annotated[
        Path | None,
        typer.Option(
            "--folder",
            metavar="DIR",
            help="Keep each side there; what is there is not done again.",
        ),
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw profiles.png.")
    ] = True,
    force: Annotated[
        bool, typer.Option("--force", help="Profile again, and write over other profiles.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, and no table.")] = False,
) -> None:
    """Show how far each parameter can go until the fit is too bad.

    However much the other parameters help: the interval to believe where that of the standard
    error is doubtful, at bounds and in valleys that bend.
    """
    from ..runs import check_output_files, check_output_folder, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give one between 0 and 1, such as 0.95")
    renamed = parse_rename(rename or [])
    # What is no result is told before JAX is imported, which takes seconds.
    folder, _ = stored_result(result)
    check_output_folder(folder)
    from ._jax import configure

    configure()
    from ..execution import open_executor
    from ..fitting import load_result
    from ..report import profile_figure, to_png
    from ..study import PROFILES, profile as profile_of

    fitted = load_result(result)
    before = _before(folder / PROFILES, fitted, level, force=force)
    if figures and before is None:
        check_output_files([folder / _PICTURE], force=force)
    runs = fitted_runs(fitted, data or [], rename=renamed)
    said = None if quiet else ManyProgress("sides of profiles")
    if not quiet:
        typer.echo("compiling ...", err=True)
    with open_executor(workers, scheduler) as executor:
        found = profile_of(
            fitted,
            runs,
            paths or None,
            level=level,
            known=None if force else before,
            executor=executor,
            folder=tasks,
            progress=said,
        )
    whole = {name: one for name, one in found.profiles.items() if one.complete}
    stopped = len(whole) < len(found.profiles)
    kept = dataclasses.replace(
        found, profiles={**({} if before is None else before.profiles), **whole}
    )
    files = {folder / PROFILES: kept.to_json().encode()}
    if figures and not stopped:
        names = ", ".join(record.name for record in fitted.runs[:3])
        files[folder / _PICTURE] = to_png(profile_figure(kept, fitted, f"{names}: profiles"))
    write_files(files, force=True)
    if as_json:
        typer.echo(found.to_json(), nl=False)
    elif not quiet:
        _show(found, fitted)
        print(f"\nwrote {shlex.quote(str(folder))}: {', '.join(path.name for path in files)}")
    if stopped:
        typer.echo("giajax: what was found is kept, and the same command goes on", err=True)
        raise typer.Exit(stopped_status())


def _before(path: Path, result: "FitResult", level: float, *, force: bool) -> "Profiles | None":
    """The profiles that are there of this fit.

    Raises:
        InputError: those that are there are of another fit or level, and may not be written over.
    """
    from ..study import fit_key, load_profiles

    if not path.exists():
        return None
    try:
        before = load_profiles(path)
    except InputError:
        if force:
            return None
        raise
    if before.fit == fit_key(result) and before.level == level:
        return before
    if not force:
        what = "another fit" if before.level == level else f"the level {before.level:g}"
        raise InputError(f"{path} is of {what}: give --force to write over it")
    return None


def _show(found: "Profiles", result: "FitResult") -> None:
    from ..report import PROFILE_HEADINGS, profile_rows
    from ._output import print_table

    print_table(PROFILE_HEADINGS, profile_rows(found, result))
    print(f"\nintervals of {found.level:.3g}; 'open' where the data give no end")
