"""`giajax unroll`: unrolling of a rolled arm by hand or by gas, and its filling."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.process import configure
from ._commands import (
    Force,
    Json,
    Quiet,
    Settings,
    argument,
    check_quiet,
    command,
    print_table,
    say_written,
    write_folder,
)
from ._fill import say_lift_off
from ._values import settings, with_settings

if TYPE_CHECKING:
    from ..apps.unrolling import Unrolled


@command(
    """\b
Examples:
  giajax unroll             unroll by hand, then fill, as in the paper
  giajax unroll --by-gas --out unrolled
                            unroll by gas, and write files and figures
  giajax unroll roll.toml --set film.peel=0.5 --json
                            use your roll with more adhesion, and print JSON

\b
With --out DIR, the command writes
  unrolling.json          times when the arm is unrolled, full and lifted off
  unrolling.csv           length, speed, forces and energies over time
  unrolling.png           the same data as a figure
  filling.*, inflation.toml
                          the files of giajax fill, from the start of filling

A definition is a TOML file with [arm], [filling] and [unrolling]
sections, such as

\b
  [unrolling]
  order = "by gas"           # or "roll first"
  roll_radius_mm = 90.0
  peel_force_N = 0.2""",
    group="arm",
    pictures=True,
)
def unroll(
    definition: Annotated[
        Path | None,
        argument("DEFINITION", "TOML file with [arm], [filling] and [unrolling] sections."),
    ] = None,
    pairs: Settings = None,
    by_gas: Annotated[bool, "Unroll the arm by gas instead of by hand."] = False,
    out: Annotated[Path | None, "DIR", "Folder for tables and figures."] = None,
    as_json: Json = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Unroll an arm of balloons by hand or by gas, and fill it.

    Computes the speed of the roll and the forces on it over time (the paper's fig. 14), and the
    times at which the arm is full and lifts itself.
    """
    from ..recordings import Definition, check_output_folder

    check_quiet(quiet, written=out, as_json=as_json, by="--out DIR or --json")
    sections = Definition() if definition is None else Definition.load(definition)
    values = settings(pairs)
    configure()
    from ..apps.filling import FILLING_FILES
    from ..apps.unrolling import (
        UNROLLING_FILES,
        unroll as unrolled_by,
        unrolling_files,
        unrolling_json,
    )
    from ..mechanics.inflation import Filling
    from ..mechanics.unrolling import Unrolling
    from ..models import arm_from_definition

    if out is not None:
        check_output_folder(out, (*UNROLLING_FILES, *FILLING_FILES), force=force)
    filling = Filling.from_section(sections.filling, arm_from_definition(sections))
    unrolling = Unrolling.from_section(sections.unrolling, filling)
    if by_gas:
        unrolling = dataclasses.replace(unrolling, order="by gas")
    unrolled = unrolled_by(with_settings(unrolling, values))
    if out is not None:
        files = unrolling_files(unrolled)
        write_folder(out, files, force=force)
    if as_json:
        typer.echo(unrolling_json(unrolled))
    if as_json or quiet:
        return
    _show(unrolled)
    if out is not None:
        say_written(out, tuple(files))


_SHOWN = 11
"""Number of table rows."""


def _show(unrolled: "Unrolled") -> None:
    """Print rows at evenly spaced times, and the results for the whole process."""
    import numpy as np

    wanted = np.linspace(0, unrolled.times[-1], _SHOWN)
    rows = []
    for k in np.unique(np.abs(unrolled.times[:, None] - wanted).argmin(axis=0)):
        forces = unrolled.forces
        rows.append(
            (
                f"{unrolled.times[k] / 60:.2f}",
                f"{unrolled.paid_out[k]:.2f}",
                f"{1e3 * unrolled.speed[k]:.2f}",
                f"{1e3 * unrolled.radius[k]:.1f}",
                f"{unrolled.pressure[k]:.2f}",
                f"{forces.gas[k] + unrolled.hand_force[k]:.3f}",
                f"{forces.weight[k]:.3f}",
            )
        )
    driven = "gas force N" if unrolled.unrolling.by_gas else "hand force N"
    headings = ["time min", "paid out m", "speed mm/s", "radius mm", "pressure Pa", driven]
    print_table([*headings, "weight N"], rows)
    if not unrolled.finished:
        why = "the supply is too weak or holds too little gas"
        if not unrolled.unrolling.by_gas:
            why = "the hand is too weak or too slow"
        at = f"{unrolled.times[-1] / 60:.0f} min (unrolled length {unrolled.paid_out[-1]:.2f} m)"
        typer.echo(f"\nthe arm is not fully unrolled after {at}: {why}")
        return
    typer.echo(f"\nthe arm is fully unrolled after {unrolled.handed_over / 60:.2f} min")
    full = unrolled.duration / 60
    typer.echo(
        "the arm is never full" if np.isnan(full) else f"the arm is full after {full:.2f} min"
    )
    say_lift_off(unrolled.arm_lift_off)
