"""`giajax profile` and `giajax posterior`: what is known of a fit beyond its standard errors."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.signals import is_stopped, stopped_status
from ..runtime.text import InputError
from ._commands import Ended, Texts, argument
from ._on_result import OnResult, on_result, record_files, show
from ._options import ManyProgress, say_written, write_folder

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..studies import Profiles


@on_result(
    """\b
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
after Ctrl-C the same command goes on.""",
    workers=True,
    folder="Keep each side there; what is there is not done again.",
    figures="Draw profiles.png.",
    force="Profile again, and write over other profiles.",
    as_json="Print JSON instead of a table.",
    quiet="No progress, and no table.",
)
def profile(
    given: OnResult,
    paths: Annotated[Texts, argument("PATH", "What to profile (all that was free).")] = None,
    level: Annotated[float, "P", "Level of the intervals, between 0 and 1."] = 0.95,
) -> None:
    """Show how far each parameter can go until the fit is too bad.

    However much the other parameters help: the interval to believe where that of the standard
    error is doubtful, at bounds and in valleys that bend.
    """
    from ..recordings import check_output_files, check_output_folder

    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give one between 0 and 1, such as 0.95")
    check_output_folder(given.home)
    fitted = given.fitted
    from ..studies import PROFILES, profile as profile_of

    path = given.home / PROFILES
    before = _before(path, fitted, level, force=given.force)
    if given.figures and before is None:
        check_output_files([path.with_suffix(".png")], force=given.force)
    if not given.quiet:
        typer.echo("compiling ...", err=True)
    settings = {"paths": paths or None, "level": level, "known": None if given.force else before}
    found = given.computed(profile_of, "sides of profiles", **settings)
    whole = {name: one for name, one in found.profiles.items() if one.complete}
    stopped = len(whole) < len(found.profiles)
    profiles = {**({} if before is None else before.profiles), **whole}
    kept = dataclasses.replace(found, profiles=profiles)
    files = record_files(kept, fitted, path, figures=given.figures and not stopped)
    given.finish(found, files, force=True)
    if stopped:
        typer.echo("giajax: what was found is kept, and the same command goes on", err=True)
        raise typer.Exit(stopped_status())


def _before(path: Path, result: "FitResult", level: float, *, force: bool) -> "Profiles | None":
    """The profiles that are there of this fit; others are refused unless they may be lost."""
    from ..studies import load_profiles

    if not path.exists():
        return None
    try:
        before = load_profiles(path)
    except InputError:
        if force:
            return None
        raise
    if before.is_of(result) and before.level == level:
        return before
    if not force:
        what = "another fit" if before.level == level else f"the level {before.level:g}"
        raise InputError(f"{path} is of {what}: give --force to write over it")
    return None


@on_result(
    """\b
Examples:
  giajax posterior giajax-out/run
  giajax posterior giajax-out/run --draws 2000 --workers 4
  giajax posterior giajax-out/run --chains 8 --force
  giajax posterior giajax-out/run --out elsewhere

\b
RESULT is the folder of a fit, or its result.json. Writes posterior.json, the
draws for ArviZ (posterior.nc), pictures, and bands of every channel as CSV.
Each chain has a file in posterior_chains: the same command goes on after Ctrl-C,
and with more --chains keeps those that are there. Needs pip install 'giajax[posterior]'.""",
    workers=True,
    out=("DIR", "Folder for files (that of the result)."),
    as_json="Print JSON instead of a table.",
    quiet="No progress.",
)
def posterior(
    given: OnResult,
    chains: Annotated[int, "N", "Chains.", 1] = 4,
    draws: Annotated[int, "N", "Draws of each chain.", 8] = 1000,
    warmup: Annotated[int, "N", "Transitions before them, to adapt.", 0] = 500,
    seed: Annotated[int, "N", "Of the random numbers.", 0] = 0,
) -> None:
    """Draw from the posterior of the parameters of a fit.

    Intervals that need no straight line: near a bound, along a bent valley, with priors.
    """
    from ..recordings import check_output_folder, make_folder

    fitted = given.fitted
    from ..report import POSTERIOR, POSTERIOR_FILES, posterior_files
    from ..studies import check_posterior, posterior as draw

    folder = given.home if given.out is None else given.out
    check_posterior(chains=chains, draws=draws, warmup=warmup)
    force = given.force or _is_unfinished(folder / POSTERIOR, fitted)
    check_output_folder(folder, POSTERIOR_FILES, force=force)
    runs = given.runs
    make_folder(folder)
    settings: dict[str, Any] = {"chains": chains, "draws": draws, "warmup": warmup, "seed": seed}
    settings |= {"folder": folder / "posterior_chains", "progress": None}
    if not given.quiet:
        typer.echo("compiling ...", err=True)
        settings["progress"] = ManyProgress("transitions").after
    found = given.computed(draw, "chains", **settings)
    contents = posterior_files(found, fitted, runs)
    write_folder(folder, contents, force=True)
    # Draws in the other format are those of an earlier call.
    for name in set(POSTERIOR_FILES) - contents.keys():
        (folder / name).unlink(missing_ok=True)
    if given.as_json:
        typer.echo(found.summary.to_json(), nl=False)
    else:
        show(found.summary, fitted)
        say_written(folder, contents)
    if is_stopped():
        raise Ended(stopped_status())


def _is_unfinished(path: Path, result: "FitResult") -> bool:
    """Whether a file is the posterior of this fit, of an earlier call that was stopped."""
    from ..studies import PosteriorSummary

    try:
        known = PosteriorSummary.of_json(read_bytes(path, RESULT_BYTES))
    except (OSError, InputError):
        return False
    return known.is_of(result) and known.chains < known.asked
