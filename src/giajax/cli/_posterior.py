"""`giajax posterior`: what is known of the parameters of a fit, by draws from their posterior."""

import dataclasses
import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.signals import is_stopped, stopped_status
from ..runtime.text import InputError, time_in_words
from ._commands import Ended, command
from ._options import ManyProgress, Renamed, Scheduler, Workers

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..studies import PosteriorSummary, Profiles

# `giajax profile`: how far each quantity of a fit can go.

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
    from ..recordings import check_output_files, check_output_folder, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give one between 0 and 1, such as 0.95")
    renamed = parse_rename(rename or [])
    # What is no result is told before JAX is imported, which takes seconds.
    folder, _ = stored_result(result)
    check_output_folder(folder)
    from ..runtime.process import configure

    configure()
    from ..fitting import load_result
    from ..report import profile_figure, to_png
    from ..runtime.execution import open_executor
    from ..studies import PROFILES, profile as profile_of

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
        _show_profiles(found, fitted)
        print(f"\nwrote {shlex.quote(str(folder))}: {', '.join(path.name for path in files)}")
    if stopped:
        typer.echo("giajax: what was found is kept, and the same command goes on", err=True)
        raise typer.Exit(stopped_status())


def _before(path: Path, result: "FitResult", level: float, *, force: bool) -> "Profiles | None":
    """The profiles that are there of this fit.

    Raises:
        InputError: those that are there are of another fit or level, and may not be written over.
    """
    from ..studies import fit_key, load_profiles

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


def _show_profiles(found: "Profiles", result: "FitResult") -> None:
    from ..report import PROFILE_HEADINGS, profile_rows
    from ._options import print_table

    print_table(PROFILE_HEADINGS, profile_rows(found, result))
    print(f"\nintervals of {found.level:.3g}; 'open' where the data give no end")


_BETWEEN_S = 5.0


@command("""\b
Examples:
  giajax posterior giajax-out/run
  giajax posterior giajax-out/run --draws 2000 --workers 4
  giajax posterior giajax-out/run --chains 8 --force
  giajax posterior giajax-out/run --out elsewhere

\b
RESULT is the folder of a fit, or its result.json. Writes posterior.json, the
draws for ArviZ (posterior.nc), pictures, and bands of every channel as CSV.
Each chain has a file in posterior_chains: the same command goes on after Ctrl-C,
and with more --chains keeps those that are there. Needs pip install 'giajax[posterior]'.""")
def posterior(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A fit; see below.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A fitted run, if it has moved. Repeatable."),
    ] = None,
    rename: Renamed = None,
    chains: Annotated[int, typer.Option(metavar="N", min=1, help="Chains.")] = 4,
    draws: Annotated[int, typer.Option(metavar="N", min=8, help="Draws of each chain.")] = 1000,
    warmup: Annotated[
        int, typer.Option(metavar="N", min=0, help="Transitions before them, to adapt.")
    ] = 500,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the random numbers.")] = 0,
    workers: Workers = None,
    scheduler: Scheduler = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder for files (that of the result).")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Draw from the posterior of the parameters of a fit.

    Intervals that need no straight line: near a bound, along a bent valley, with priors.
    """
    from ..recordings import check_output_folder, make_folder, parse_rename, write_files
    from ..runtime.execution import open_executor
    from ..tasks import fitted_runs, stored_result

    folder = stored_result(result)[0] if out is None else out
    renamed = parse_rename(rename or [])
    from ..runtime.process import configure

    configure()
    from ..fitting import load_result
    from ..report import POSTERIOR, POSTERIOR_FILES, posterior_files
    from ..studies import check_posterior, posterior as draw

    check_posterior(chains=chains, draws=draws, warmup=warmup)
    fitted = load_result(result)
    unfinished = _is_unfinished(folder / POSTERIOR, fitted)
    check_output_folder(folder, POSTERIOR_FILES, force=force or unfinished)
    runs = fitted_runs(fitted, data or [], rename=renamed)
    make_folder(folder)
    with open_executor(workers, scheduler) as executor:
        found = draw(
            fitted,
            runs,
            chains=chains,
            draws=draws,
            warmup=warmup,
            seed=seed,
            executor=executor,
            folder=folder / "posterior_chains",
            progress=None if quiet else _Progress(),
        )
    files = posterior_files(found, fitted, runs)
    write_files({folder / name: data for name, data in files.items()}, force=True)
    # Draws in the other format are those of an earlier call.
    for name in set(POSTERIOR_FILES) - files.keys():
        (folder / name).unlink(missing_ok=True)
    if as_json:
        typer.echo(found.summary.to_json(), nl=False)
    else:
        _show_posterior(found.summary, fitted)
        typer.echo(f"\nwrote {folder}: {', '.join(files)}")
    if is_stopped():
        raise Ended(stopped_status())


def _is_unfinished(path: Path, result: "FitResult") -> bool:
    """Whether a file is the posterior of this fit, of an earlier call that was stopped."""
    from ..runtime.text import InputError
    from ..studies import PosteriorSummary

    try:
        known = PosteriorSummary.from_json(path.read_text("utf-8"))
    except (OSError, UnicodeError, InputError):
        return False
    return known.is_of(result) and known.chains < known.asked


def _show_posterior(summary: "PosteriorSummary", result: "FitResult") -> None:
    from ..report import POSTERIOR_HEADINGS, posterior_rows
    from ._options import print_table

    print_table(POSTERIOR_HEADINGS, posterior_rows(summary, result), left=2)
    print(f"\n{summary.chains} chains of {summary.draws} draws, {summary.divergences} diverged")
    if summary.held:
        print(f"held, because no channel responds: {', '.join(summary.held)}")
    for sentence in summary.warnings:
        print(f"warning: {sentence}")


class _Progress:
    """A line on standard error now and then, with how long it still takes."""

    def __init__(self) -> None:
        self._began = self._said = time.monotonic()
        self._first: tuple[int, float] | None = None
        self._ended = False
        typer.echo("compiling ...", err=True)

    def __call__(self, done: int, total: int) -> None:
        now = time.monotonic()
        if self._first is None:
            # The program is compiled by then, and chains of an earlier call are there.
            self._first = done, now
        if self._ended or (done < total and now - self._said < _BETWEEN_S):
            return
        self._said, self._ended = now, done == total
        words = f"{done} of {total} transitions done"
        first, began = self._first
        if done == total:
            words += f", in {time_in_words(now - self._began)}"
        elif done > first:
            left = (now - began) / (done - first) * (total - done)
            words += f", about {time_in_words(left)} left"
        typer.echo(words, err=True)
