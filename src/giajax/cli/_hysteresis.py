"""`giajax hysteresis`: the paper's experiment with one link, on a simulated joint."""

import math
from pathlib import Path
from typing import Annotated

import typer
from ._registry import command


@command("""\b
Examples:
  giajax hysteresis --out fig12
  giajax hysteresis --out fig12 --travel 20 --force
  giajax fit --data fig12/recording.csv
  giajax compensate --model fig12/result.json --target target.csv --out command.csv

The folder gets fig12.png, its numbers in fig12.csv, errors.csv, the recording that both
compensations were made from, and the fit of the inverse one.""")
def hysteresis(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")],
    travel: Annotated[
        float,
        typer.Option(metavar="DEG", help="Travel within which eq. (12) changes its branch."),
    ] = 40.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of all noise.")] = 0,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print the errors only.")] = False,
) -> None:
    """Follow angles with a hysteretic joint, without compensation and with two.

    The experiment of the paper's section IV.A and fig. 12 on a simulated joint: eq. (12) and the
    inverse of a modified Prandtl-Ishlinskii operator, judged on the paper's history and on
    another one with minor loops.
    """
    if not 0 < travel < math.inf:
        raise typer.BadParameter(f"--travel is {travel:g} deg: give a positive number")

    from ._jax import configure

    configure()
    from ..experiments import ONE_LINK_FILES, SimulatedJoint, one_link, write_one_link
    from ..runs import check_output_folder
    from ._output import print_table

    check_output_folder(out, ONE_LINK_FILES, force=force)
    progress = None if quiet else (lambda text: typer.echo(text, err=True))
    study = one_link(SimulatedJoint(seed=seed), travel=math.radians(travel), progress=progress)
    rows = []
    for trial in study.trials:
        none = study.trial(trial.history.name, "none")
        rows.append(
            [
                trial.history.name,
                trial.compensation,
                f"{trial.mean:.2f}",
                f"{trial.largest:.2f}",
                f"{trial.mean / none.mean:.0%}",
                f"{trial.largest / none.largest:.0%}",
            ]
        )
    headings = ["history", "compensation", "mean error deg", "largest deg", "of none", "of none"]
    print_table(headings, rows, left=2)
    files = write_one_link(study, out, force=force)
    if not quiet:
        print(f"\nwrote {out}: {', '.join(path.name for path in files)}")
