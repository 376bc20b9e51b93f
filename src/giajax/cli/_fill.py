"""`giajax fill`: filling of an arm of balloons with helium."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.limits import FILLING_S
from ..runtime.process import configure
from ..runtime.text import InputError
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
from ._values import settings, with_settings

if TYPE_CHECKING:
    from ..apps.filling import Filled, FillingCurve


@command(
    """\b
Examples:
  giajax fill               fill the preset arm, and print tables
  giajax fill --out filling
                            also write files and figures
  giajax fill filling.toml --minutes 30 --out filling --force
                            use your definition and a filling time of 30 min
  giajax fill --set ports.diameter=0.008 --no-curve --json
                            use another port diameter, and print JSON

\b
With --out DIR, the command writes
  filling.json            times at which each link is full and lifts itself
  filling.csv             fill level, pressure, lift and stiffness over time
  filling.png             the same data as a figure
  inflation.toml          the filled arm, with the pressure of each link
  curve.csv, curve.png    ports and supplies that fill the arm in 23 min

A definition is a TOML file with [arm] and [filling] sections, such as

\b
  [filling]
  supply = "regulator"       # or "flow", or "bottle"
  supply_pressure_bar = 2.0
  port_diameter_mm = 8.0
  shared = [[1, 2], [3, 4]]  # links without a weld between them""",
    group="arm",
    pictures=True,
)
def fill(
    definition: Annotated[
        Path | None, argument("DEFINITION", "TOML file with [arm] and [filling] sections.")
    ] = None,
    pairs: Settings = None,
    minutes: Annotated[
        float, "MIN", "Filling time for the curve of supply versus port diameter."
    ] = 23.0,
    no_curve: Annotated[bool, "Do not compute the curve of supply versus port diameter."] = False,
    out: Annotated[Path | None, "DIR", "Folder for tables and figures."] = None,
    as_json: Json = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Fill an arm of balloons with helium, link by link.

    Computes the state of each link over time. The bags form a row with ports between them, and the
    gas is supplied at the base (the paper's fig. 15). Also computes the combinations of port
    diameter and gas supply for which filling takes 23 minutes, as in the paper.
    """
    from ..recordings import Definition, check_output_folder

    check_quiet(quiet, written=out, as_json=as_json, by="--out DIR or --json")
    if not 0 < minutes <= FILLING_S / 60:
        raise InputError(
            f"--minutes is {minutes:g}: give a positive number of at most {FILLING_S / 60:.0f}"
        )
    sections = Definition() if definition is None else Definition.load(definition)
    values = settings(pairs)
    configure()
    from ..apps.filling import (
        CURVE_FILES,
        FILLING_FILES,
        fill as filled_by,
        filling_curve,
        filling_files,
        filling_json,
    )
    from ..mechanics.inflation import Filling
    from ..models import arm_from_definition

    names = FILLING_FILES if no_curve else (*FILLING_FILES, *CURVE_FILES)
    if out is not None:
        check_output_folder(out, names, force=force)
    filling = Filling.from_section(sections.filling, arm_from_definition(sections))
    filling = with_settings(filling, values)
    filled = filled_by(filling)
    curve = None if no_curve else filling_curve(filling, duration=60 * minutes)
    if out is not None:
        write_folder(out, filling_files(filled, curve), force=force)
    if as_json:
        typer.echo(filling_json(filled, curve))
    if as_json or quiet:
        return
    _show(filled)
    if curve is not None:
        _show_curve(curve)
    if out is not None:
        say_written(out, names)


def _show(filled: "Filled") -> None:
    """Print a row for each link, and the results for the whole arm."""
    import numpy as np

    def minutes(seconds: float) -> str | None:
        return None if np.isnan(seconds) else f"{seconds / 60:.2f}"

    rows = []
    for link, (full, lifts) in enumerate(zip(filled.full, filled.lift_off, strict=True)):
        most, lift = filled.pressure[:, link].max(), 1e3 * filled.net_lift[-1, link]
        numbers = (f"{filled.fullness[-1, link]:.3f}", f"{most:.1f}", f"{lift:.1f}")
        stiffness = f"{filled.stiffness[-1, link]:.1f}"
        rows.append((str(link + 1), minutes(full), minutes(lifts), *numbers, stiffness))
    headings = [
        *("link", "fill time min", "lift-off min", "fullness", "max pressure Pa"),
        *("net lift g", "stiffness N m^2"),
    ]
    print_table(headings, rows)
    if filled.finished:
        typer.echo(f"\nthe arm is full after {filled.duration / 60:.2f} min")
    else:
        why = "the supply is too weak or holds too little gas"
        typer.echo(f"\nthe arm is not full after {filled.times[-1] / 60:.0f} min: {why}")
    say_lift_off(filled.arm_lift_off)
    if filled.collapse is not None:
        typer.echo(f"note: {filled.collapse}")


def say_lift_off(seconds: float) -> None:
    """Print the time at which an arm lifts itself; NaN means that it never does."""
    said = "the lift is too small to carry the arm"
    if not math.isnan(seconds):
        said = f"the arm lifts itself after {seconds / 60:.2f} min"
    typer.echo(said)


def _show_curve(curve: "FillingCurve") -> None:
    import numpy as np

    from ..schema import SUPPLY

    unit = next(each.unit for each in SUPPLY if each.path == curve.path)
    typer.echo(f"\nports and supplies for a filling time of {curve.duration / 60:g} min:")
    columns = (curve.diameters, curve.flows, curve.strengths, curve.pressures)
    rows = []
    for diameter, flow, strength, pressure in zip(*columns, strict=True):
        cells = (f"{6e4 * flow:.2f}", f"{strength:.5g}", f"{pressure:.0f}")
        rows.append((f"{1e3 * diameter:g}", *((None,) * 3 if np.isnan(flow) else cells)))
    headings = ["port diameter mm", "flow l/min", f"{curve.path} {unit}", "max pressure Pa"]
    print_table(headings, rows)
