"""`giajax posterior`: what is known of the parameters of a fit, by draws from their posterior."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._signals import is_stopped, stopped_status
from .._text import time_in_words
from ._errors import Ended
from ._many import Scheduler, Workers
from ._options import Renamed
from ._registry import command

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..study import PosteriorSummary


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
    from ..execution import open_executor
    from ..runs import check_output_folder, make_folder, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    folder = stored_result(result)[0] if out is None else out
    renamed = parse_rename(rename or [])
    from ._jax import configure

    configure()
    from ..fitting import load_result
    from ..report import POSTERIOR, POSTERIOR_FILES, posterior_files
    from ..study import check_posterior, posterior as draw

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
        _show(found.summary, fitted)
        typer.echo(f"\nwrote {folder}: {', '.join(files)}")
    if is_stopped():
        raise Ended(stopped_status())


def _is_unfinished(path: Path, result: "FitResult") -> bool:
    """Whether a file is the posterior of this fit, of an earlier call that was stopped."""
    from .._errors import InputError
    from ..study import PosteriorSummary

    try:
        known = PosteriorSummary.from_json(path.read_text("utf-8"))
    except (OSError, UnicodeError, InputError):
        return False
    return known.is_of(result) and known.chains < known.asked


def _show(summary: "PosteriorSummary", result: "FitResult") -> None:
    from ..report import POSTERIOR_HEADINGS, posterior_rows
    from ._output import print_table

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
