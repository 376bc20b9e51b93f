"""`giajax paper` and `hysteresis`: the paper's figures and tables, and a 1-link experiment."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from ..runtime.pictures import all_pictures
from ..runtime.process import configure, is_stopped, stopped_status
from ..runtime.text import InputError
from ._commands import (
    Ended,
    Force,
    Quiet,
    argument,
    command,
    print_table,
    say_progress,
    say_written,
    write_folder,
)

# The same names as in `giajax.apps.paper`, whose import would load JAX for a help text.
NAMES = ("fig5", "fig6", "fig9", "fig10", "fig12", "fig19", "table3")
_ALL = "all"
INVERSE = "table3_inverse"
_PAGE = "index.html"


@command(
    """\b
Examples:
  giajax paper fig5 --out paper
                            write one figure, its data and their provenance
  giajax paper all --out paper
                            write everything and index.html; repeat the
                            command to continue after an interruption
  giajax paper table3 --inverse --out paper
                            search for arms that reproduce the table

\b
NAME is
  fig5      links 6, 12 and 20 after a step of the base, with and without air
  fig6      the whole arm with its controller, with muscles and with springs
  fig9      contraction and force of a muscle in a joint, without corrections
  fig10     the same, with the corrections alpha and beta
  fig12     one link with hysteresis, without and with compensation
  fig19     links 2, 6, 12 and 20 in the models and in a simulated experiment
  table3    concordance of the models with the experiment of fig19, with and
            without air; --inverse searches for arms that give the values
            printed in the paper (this takes many minutes)

Each figure or table is written to NAME.png, NAME.csv and NAME.json. The JSON file
records which values are printed in the paper, assumed or reconstructed.""",
    group="paper",
    pictures=True,
)
def paper(
    name: Annotated[str, argument("NAME", "A figure or table (see below), or 'all'.")],
    out: Annotated[Path, "DIR", "Folder for figures and tables."],
    inverse: Annotated[
        bool, "For table3: search for arms that reproduce the printed values."
    ] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Reproduce a figure or a table of the paper.

    Uses public functions of giajax, which you can also apply to your own arm.
    """
    from ..recordings import check_output_folder

    if name not in (*NAMES, _ALL):
        raise InputError(
            f"the figure '{name}' does not exist: use one of {', '.join(NAMES)}, {_ALL}"
        )
    if inverse and name != "table3":
        raise InputError(
            f"--inverse applies to table3 only, not to {name}: omit --inverse, or give table3"
        )
    names: tuple[str, ...] = (INVERSE,) if inverse else NAMES if name == _ALL else (name,)
    if name != _ALL:
        check_output_folder(out, _files(names), force=force)
    configure()
    from ..apps.paper import is_reproduction_page, reproduction_page, stored_record

    kept, own_page = {}, False
    if name == _ALL and not force:
        kept = {each: record for each in names if (record := stored_record(out, each))}
        names = tuple(each for each in names if each not in kept)
        # An existing page may be overwritten only if this command wrote it.
        own_page = bool(kept) and is_reproduction_page(out / _PAGE)
        check_output_folder(out, [*_files(names), *([] if own_page else [_PAGE])])
        if kept and not quiet:
            text = f"already complete: {', '.join(kept)} (use --force to compute them again)"
            typer.echo(text, err=True)
    made = _made(names, out, force=force, quiet=quiet)
    written = _files(names)
    if name == _ALL:
        from ..recordings import write_files

        records = {**kept, **made}
        page = reproduction_page(records[each] for each in NAMES)
        write_files({out / _PAGE: page}, force=force or own_page)
        written = [_PAGE, *written]
    if not quiet:
        print(f"wrote {out}: {', '.join(written)}")
    if is_stopped():
        raise Ended(stopped_status())


def _files(names: Iterable[str]) -> list[str]:
    endings = ("png", "csv", "json")
    return all_pictures(f"{each}.{ending}" for each in names for ending in endings)


def _made(
    names: Sequence[str], out: Path, *, force: bool, quiet: bool
) -> dict[str, dict[str, Any]]:
    """Make figures, write each one at once, and return their records by name."""
    from ..apps.paper import reproduce, reproduced_files, reproduced_record
    from ._data import examples_root

    made = {}
    recordings = examples_root() / "data" / "paper"
    for each, shown in reproduce(names, recordings, progress=say_progress(quiet)):
        write_folder(out, reproduced_files(each, shown), force=force)
        made[each] = reproduced_record(each, shown)
        if quiet:
            continue
        print(shown.title)
        print_table(shown.headings, shown.rows)
        print()
    return made


@command(
    """\b
Examples:
  giajax hysteresis --out fig12
                            run the experiment, and write its files
  giajax hysteresis --out fig12 --travel 20 --force
                            use a different travel
  giajax fit --data fig12/recording.csv
                            repeat the fit for the inverse compensation
  giajax compensate fig12/result.json --target target.csv --to command.csv
                            compute commands for your own target

The folder contains fig12.png, its data in fig12.csv, errors.csv, the recording on which both
compensations are based, and the fit for the inverse compensation.""",
    group="arm",
    pictures=True,
)
def hysteresis(
    out: Annotated[Path, "DIR", "Folder for the files."],
    travel: Annotated[
        float, "TRAVEL", "Travel (deg) over which the branch changes in eq. (12)."
    ] = 40.0,
    seed: Annotated[int, "N", "Seed of the random numbers for the noise.", 0] = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Test hysteresis compensation on a joint that tracks angles.

    Simulates the experiment of the paper's section IV.A and fig. 12 on one joint. Eq. (12) and the
    inverse of a modified Prandtl-Ishlinskii operator are compared on the paper's angle history and
    on another history with minor loops.
    """
    if not 0 < travel < math.inf:
        raise typer.BadParameter(f"--travel is {travel:g} deg: give a positive number")
    configure()
    from ..apps.experiments import ONE_LINK_FILES, SimulatedJoint, one_link, write_one_link
    from ..recordings import check_output_folder

    check_output_folder(out, ONE_LINK_FILES, force=force)
    joint, progress = SimulatedJoint(seed=seed), say_progress(quiet)
    study = one_link(joint, travel=math.radians(travel), progress=progress)
    rows = []
    for trial in study.trials:
        none = study.trial(trial.history.name, "none")
        errors = [f"{trial.mean:.2f}", f"{trial.largest:.2f}"]
        shares = [f"{trial.mean / none.mean:.0%}", f"{trial.largest / none.largest:.0%}"]
        rows.append([trial.history.name, trial.compensation, *errors, *shares])
    headings = [
        "history",
        "compensation",
        "mean error deg",
        "largest error deg",
        "mean / none",
        "largest / none",
    ]
    if not quiet:
        print_table(headings, rows, left=2)
    files = write_one_link(study, out, force=force)
    if not quiet:
        say_written(out, [path.name for path in files])
