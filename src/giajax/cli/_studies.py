"""`giajax profile`, `posterior`, `bootstrap`, `influence` and `suspects`: studies of a fit."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.process import is_stopped, stopped_status
from ..runtime.text import InputError
from ._commands import (
    Ended,
    ManyProgress,
    Paths,
    Texts,
    check_quiet,
    print_table,
    say_written,
    write_folder,
)
from ._on_result import OnResult, on_result, record_files, show
from ._values import plain_settings

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..recordings import Run
    from ..studies import Profiles, Step, StepwiseSelection, Suspects


@on_result(
    """\b
Examples:
  giajax profile giajax-out/run
                            profile all free parameters
  giajax profile giajax-out/run --parameter air.drag_coefficient
                            profile one parameter
  giajax profile giajax-out/run --level 0.68 --force
                            use another level
  giajax profile giajax-out/run --workers 2
                            use two processes

RESULT is the folder of a fit, or its result.json. The runs are read again from
their original paths. Each PATH, a free parameter or a derived quantity, is fixed at
increasing distances from its estimate while all other parameters are fitted.
Without a PATH, all free parameters are profiled.
The command writes profiles.json and profiles.png beside the result, where
`giajax report` finds them. Existing profiles of the same fit are kept, and profiles
of further paths are added. After Ctrl-C, repeat the command to continue. With --force, all
profiles are computed again.""",
    group="trust",
    workers=True,
    folder=True,
    figures=True,
    as_json=True,
    old_words="--parameter",
)
def profile(
    given: OnResult,
    parameter: Annotated[
        Texts, "PATH", "A parameter to profile. [default: all free parameters]"
    ] = None,
    level: Annotated[float, "P", "Confidence level of the intervals, between 0 and 1."] = 0.95,
) -> None:
    """Compute profile-likelihood intervals of parameters.

    All other parameters are fitted again at each value. Use these intervals where intervals from
    the standard error are doubtful: at bounds and for nonlinear correlations.
    """
    from ..recordings import check_output_files, check_output_folder

    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give a level between 0 and 1, such as 0.95")
    check_output_folder(given.home)
    fitted = given.fitted
    from ..studies import PROFILES, profile as profile_of

    path = given.home / PROFILES
    before = _before(path, fitted, level, force=given.force)
    if given.figures and before is None:
        check_output_files([path.with_suffix(".png")], force=given.force)
    if not given.quiet:
        typer.echo("compiling ...", err=True)
    known = None if given.force else before
    settings = {"paths": parameter or None, "level": level, "known": known}
    found = given.computed(profile_of, "sides of profiles", **settings)
    whole = {name: one for name, one in found.profiles.items() if one.complete}
    stopped = len(whole) < len(found.profiles)
    profiles = {**({} if before is None else before.profiles), **whole}
    kept = dataclasses.replace(found, profiles=profiles)
    files = record_files(kept, fitted, path, figures=given.figures and not stopped)
    given.finish(found, files, force=True)
    if stopped:
        typer.echo(
            "giajax: the results so far are kept: run the same command to continue", err=True
        )
        raise typer.Exit(stopped_status())


def _before(path: Path, result: "FitResult", level: float, *, force: bool) -> "Profiles | None":
    """Return existing profiles of this fit; others raise an error unless `force` is given."""
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
        raise InputError(f"{path} was computed for {what}: use --force to overwrite it")
    return None


@on_result(
    """\b
Examples:
  giajax posterior giajax-out/run
                            write the files beside the result
  giajax posterior giajax-out/run --draws 2000 --workers 4
                            use more draws and four processes
  giajax posterior giajax-out/run --chains 8 --force
                            use more chains
  giajax posterior giajax-out/run --out elsewhere
                            write the files to another folder

RESULT is the folder of a fit, or its result.json. The output files are
posterior.json, the draws for ArviZ (posterior.nc), figures, and uncertainty bands
of every channel as CSV. Each chain is stored in posterior_chains. After Ctrl-C, repeat
the command to continue. If --chains is increased, the existing chains are kept.
This command needs the extra 'posterior': pip install 'giajax[posterior]', or in a
checkout pip install '.[posterior]'.""",
    group="trust",
    pictures=True,
    workers=True,
    out="Output folder. [default: the folder of RESULT]",
    as_json=True,
)
def posterior(
    given: OnResult,
    chains: Annotated[int, "N", "Number of chains.", 1] = 4,
    draws: Annotated[int, "N", "Number of draws in each chain.", 8] = 500,
    warmup: Annotated[int, "N", "Number of warm-up transitions.", 0] = 200,
    seed: Annotated[int, "N", "Seed of the random numbers.", 0] = 0,
) -> None:
    """Sample the posterior of the parameters of a fit.

    The intervals of the posterior do not assume a linear model: use them near bounds, for nonlinear
    correlations and with priors.
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
    # Draws in the other format belong to an earlier call.
    for name in set(POSTERIOR_FILES) - contents.keys():
        (folder / name).unlink(missing_ok=True)
    if given.as_json:
        typer.echo(found.summary.to_json(), nl=False)
    elif not given.quiet:
        show(found.summary, fitted)
        given.say_written(folder, contents)
    if is_stopped():
        raise Ended(stopped_status())


def _is_unfinished(path: Path, result: "FitResult") -> bool:
    """Return whether a file is the posterior of this fit from an earlier, stopped call."""
    from ..studies import PosteriorSummary

    try:
        known = PosteriorSummary.of_json(read_bytes(path, RESULT_BYTES))
    except (OSError, InputError):
        return False
    return known.is_of(result) and known.chains < known.asked


# Repetitions of a self-test: the spread is known to 7 %, in about a minute for a fit of seconds.
_SELF_TEST = 96


@on_result(
    """\b
Examples:
  giajax bootstrap giajax-out/run
                            write the files beside the result
  giajax bootstrap giajax-out/run --size 400 --workers 2
                            use more repetitions and two processes
  giajax bootstrap giajax-out/run --block --out blocks
                            use blocks of residuals and another folder
  giajax bootstrap giajax-out/run --whole --size 100 --folder repetitions
                            repeat whole fits, and keep each in a folder

RESULT is the folder of a fit, or its result.json. The runs are read again from
their original paths. The command writes bootstrap.json and bootstrap.png beside
the result, where `giajax report` finds them. After Ctrl-C, a result is written from
the finished repetitions. With --folder DIR, repeat the command with
--force to compute the remaining repetitions.""",
    group="trust",
    workers=True,
    folder=True,
    out="Output folder for bootstrap.json. [default: the folder of RESULT]",
    figures=True,
    as_json=True,
    old={"--out FILE.json": "--out"},
)
def bootstrap(
    given: OnResult,
    size: Annotated[int, "N", "Number of repetitions.", 2] = 200,
    block: Annotated[bool, "Resample blocks of residuals instead of drawing noise."] = False,
    whole: Annotated[bool, "Repeat the whole fit, including noise estimation."] = False,
    seed: Annotated[int, "N", "Seed of the random numbers.", 0] = 0,
) -> None:
    """Check the standard errors of a fit by refits with new noise.

    Computes bias, spread and intervals of the repeated estimates, and the coverage of the 95 %
    intervals.
    """
    method = "block" if block else "parametric"
    given.record("bootstrap", size=size, method=method, whole=whole, seed=seed)


def self_test(
    result: "FitResult", runs: "Sequence[Run]", folder: Path, *, shown: bool
) -> list[Path]:
    """Repeat a completed fit, write the repetitions beside its result and show them.

    If nothing could be repeated, no files are written and a sentence says so.
    """
    from ..recordings import write_files
    from ..studies import bootstrap as repeat

    if shown:
        typer.echo("\nself-test: the fit is repeated with new noise", err=True)
    progress = ManyProgress("parts") if shown else None
    try:
        found = repeat(result, runs, size=_SELF_TEST, progress=progress)
    except InputError as error:
        typer.echo(f"giajax: the self-test is omitted: {error}", err=True)
        return []
    files = record_files(found, result, folder / "bootstrap.json", figures=True)
    write_files(files, force=True)
    if shown:
        print()
        show(found, result)
    return list(files)


@on_result(
    """\b
Examples:
  giajax influence giajax-out/run
                            estimate the influence by one step of the fit
  giajax influence giajax-out/both --exact --workers 2
                            repeat the fit without each part of the data
  giajax influence giajax-out/run --spans 20 --out spans
                            use shorter time spans and another folder

RESULT is the folder of a fit, or its result.json. The runs are read again from
their original paths. The command writes influence.json and influence.png beside
the result, where `giajax report` finds them.""",
    group="trust",
    workers=True,
    folder=True,
    out="Output folder for influence.json. [default: the folder of RESULT]",
    figures=True,
    as_json=True,
    old={"--most": "--rows", "--out FILE.json": "--out"},
)
def influence(
    given: OnResult,
    exact: Annotated[
        bool, "Also repeat the fit without each marker, channel and time span."
    ] = False,
    spans: Annotated[
        int, "N", "Number of time spans of each run. Use 1 to omit the time spans.", 1
    ] = 10,
    rows: Annotated[int, "N", "Number of table rows.", 1] = 20,
) -> None:
    """Show the influence of each part of the data on the estimates.

    Computes the change in each parameter and in its standard error if a run, a marker, a channel or
    a time span is left out.
    """
    given.record("influence", most=rows, exact=exact, spans=spans)


@on_result(
    """\b
Examples:
  giajax suspects giajax-out/run
                            test each suspect without a fit
  giajax suspects giajax-out/run --ladder
                            fit the best suspects, and test again
  giajax suspects giajax-out/run --ladder --tries 1
                            fit one suspect in each step
  giajax suspects giajax-out/run --ladder --validation other.csv
                            validate on another run
  giajax suspects giajax-out/run --systematic --uncertainty links.mass=0.002
                            show the effect of an uncertain mass
  giajax suspects giajax-out/run --json
                            print JSON

RESULT is the folder of a fit, or its result.json. The runs are read again from
their original paths. The suspect with the largest decrease in chi-square comes first.
--ladder fits the first few suspects, keeps the one with the lowest BIC, and
repeats this as long as BIC decreases. For a long arm, a ladder step can take several
minutes. It takes less time with --tries 1, which fits only the first suspect.""",
    group="trust",
    out="Output folder for suspects.json, which contains the result and the suspects.",
    as_json=True,
    old={
        "--held-out": "--validation",
        "--most": ("--rows", "--max-steps"),
        "--out FILE.json": "--out",
    },
)
def suspects(
    given: OnResult,
    each: Annotated[Texts, "PATH", "Also test each element of this array separately."] = None,
    systematic: Annotated[
        bool, "Show the effect of uncertain fixed parameters on the estimates."
    ] = False,
    uncertainty: Annotated[Texts, "PATH=VALUE", "Standard deviation of a fixed parameter."] = None,
    ladder: Annotated[bool, "Fit the most promising suspects in turn."] = False,
    validation: Annotated[Paths, "RUN.csv", "A run for validation."] = None,
    rows: Annotated[int, "N", "Number of table rows.", 1] = 8,
    max_steps: Annotated[int, "N", "Maximum number of steps.", 1] = 8,
    tries: Annotated[
        int | None, "N", "Number of suspects fitted in each step. [default: 3]", 1
    ] = None,
) -> None:
    """Test parameters that a fit fixed, switched off or omitted.

    For each of these parameters, estimates the decrease in chi-square and the value of the
    parameter after one step. The parameters describe added mass, camera delay, wind, friction,
    swapped axes and every other effect that the model supports.
    """
    from ..recordings import Definition, make_folder, read_runs, write_files
    from ..tasks import held_out_runs

    deviations = plain_settings(uncertainty, "--uncertainty")
    check_quiet(given.quiet, written=given.out, as_json=given.as_json, by="--out DIR or --json")
    path = None if given.out is None else given.checked("suspects")
    if validation and not ladder:
        raise typer.BadParameter("--validation applies to the fits of a ladder: add --ladder")
    if tries is not None and not ladder:
        raise typer.BadParameter("--tries applies to the steps of a ladder: add --ladder")
    fitted, runs = given.fitted, given.runs
    from ..report import (
        SUSPECT_HEADINGS,
        stepwise_table,
        suspect_rows,
        suspect_summary,
        systematic_table,
    )
    from ..studies import TRIES, ladder as selected, suspects as tested, with_systematic_errors

    others = read_runs(validation or [], Definition(), rename=given.renamed)
    found = tested(fitted, runs, each=each or [])
    fitted = dataclasses.replace(fitted, suspects=found.rows, verdict=found.judge(fitted))
    fitted = with_systematic_errors(fitted, runs, deviations or None)
    shown = not (given.as_json or given.quiet)
    if shown:
        if shown_rows := suspect_rows(found, rows):
            print_table(SUSPECT_HEADINGS, shown_rows)
            print()
        print("\n".join(suspect_summary(found)))
        if systematic or deviations:
            print("\neffect of uncertain fixed parameters on the estimates, in standard errors:")
            print_table(*systematic_table(fitted))
    steps = None
    if ladder:
        others += held_out_runs(fitted, given.data or [], rename=given.renamed, folder=given.home)
        said = None if given.quiet else _say
        steps = selected(
            fitted, runs, held_out=others, most=max_steps, tries=tries or TRIES, progress=said
        )
        if shown:
            print()
            print_table(*stepwise_table(steps))
            print("\n" + "\n".join([steps.ending, *steps.result.conditions]))
    if path is not None:
        make_folder(path.parent)
        write_files({path: fitted.to_json().encode()}, force=given.force)
        if shown:
            say_written(path.parent, [path.name])
    if given.as_json:
        from ..runtime.records import plain_data

        typer.echo(json.dumps(plain_data(_facts(fitted, found, steps)), indent=2))


def _say(step: "Step") -> None:
    added = "the fit" if step.suspect is None else step.change
    typer.echo(f"{added}: chi-square {step.chi_square:.5g}", err=True)


_STEP = ("removed", "chi_square", "aic", "bic", "held_out")


def _facts(
    result: "FitResult", found: "Suspects", steps: "StepwiseSelection | None"
) -> dict[str, Any]:
    """Return the data that `--json` prints."""
    facts: dict[str, Any] = {key: getattr(found, key) for key in ("chi_square", "values", "asked")}
    facts |= {"suspects": result.suspects, "systematic": result.systematic}
    if steps is not None:
        facts["ladder"] = {
            "ending": steps.ending,
            "rungs": [
                {
                    "path": None if step.suspect is None else step.suspect.path,
                    **{key: getattr(step, key) for key in _STEP},
                    "parameters": step.result.parameters,
                }
                for step in steps.steps
            ],
        }
    return facts
