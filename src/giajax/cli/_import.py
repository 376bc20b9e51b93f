"""`giajax import`: a run from points that another program tracked in a film."""

from pathlib import Path
from typing import Annotated

import typer
from ._registry import command


@command("""\b
Examples:
  giajax import filmDLC_resnet50.csv --rate 60 --camera side --out run.csv \\
         --point elbow=link03 --point tip=tip --commands log.csv
  giajax import trajectories.csv --kinovea-origin 0,1079 --camera side --out run.csv \\
         --point "Marker 1"=link03
Then: giajax init run.csv, which offers the camera's section, and giajax fit --data run.csv.""")
def import_(
    tracked: Annotated[
        Path, typer.Argument(metavar="FILE", help="A CSV file of DeepLabCut or of Kinovea.")
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="The run to write, a .csv file.")],
    point: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=PART", help="What a tracked point is: link06, tip or mark01. Repeatable."
        ),
    ] = None,
    camera: Annotated[
        str | None, typer.Option(metavar="NAME", help="The camera; needed where there are several.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="DeepLabCut: pictures a second of the film.")
    ] = None,
    likelihood: Annotated[
        float,
        typer.Option(metavar="P", help="DeepLabCut: a point that is less likely is left empty."),
    ] = 0.6,
    kinovea_origin: Annotated[
        str | None,
        typer.Option(
            metavar="U,V",
            help="Kinovea: where the origin of its coordinates is in the picture, px, from the "
            "upper left corner.",
        ),
    ] = None,
    time_unit: Annotated[
        str, typer.Option(metavar="UNIT", help="Kinovea: unit of its times, s or ms.")
    ] = "s",
    commands: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A run with the commands, on the film's clock, or with the points of another "
            "camera.",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a run.")] = False,
) -> None:
    """Make a run of points that DeepLabCut or Kinovea tracked in a film.

    Each point becomes the pixel channels of a link, of the tip or of a landmark. Commands of
    another rate keep their own rows.
    """
    import numpy as np

    from .._errors import InputError
    from ..runs import (
        filmed,
        filmed_beside,
        parse_rename,
        read_beside,
        read_deeplabcut,
        read_kinovea,
        write_run,
    )
    from ._values import number

    if (rate is None) == (kinovea_origin is None):
        raise InputError(
            "give --rate for a file of DeepLabCut, or --kinovea-origin for one of Kinovea"
        )
    if rate is not None:
        points = read_deeplabcut(tracked, rate=rate, likelihood=likelihood)
    else:
        place = [number(part) for part in (kinovea_origin or "").split(",")]
        if len(place) != 2 or place[0] is None or place[1] is None:
            raise InputError(
                f"--kinovea-origin {kinovea_origin!r} must be two numbers: write it like 0,1079"
            )
        points = read_kinovea(tracked, origin=(place[0], place[1]), time_unit=time_unit)
    values = filmed(points, parse_rename(point or [], "--point"), camera)
    seen = {name: int(np.isfinite(column).sum()) for name, column in values.items()}
    empty = [name for name, count in seen.items() if count == 0]
    if empty:
        raise InputError(
            f"{tracked} has no picture in which the point of {empty[0]} was found: leave it out, "
            "or lower --likelihood"
        )
    times, table = points.times, values
    if commands is not None:
        times, table = filmed_beside(times, values, read_beside(commands))
    write_run(out, times, table, digits=9, force=force)
    cells = sum(seen.values()) // 2
    typer.echo(
        f"wrote {out}: {len(points.times)} pictures, {cells} points found of "
        f"{len(values) // 2 * len(points.times)}; next: giajax init {out}"
    )
