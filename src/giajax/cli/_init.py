"""`giajax init`: a sidecar to fill in."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import Renamed
from ._registry import command


@command("""\b
Example:
  giajax init run.csv       writes run.toml; then edit it, and: giajax check run.csv""")
def init(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="The run, a .csv or .parquet file.")],
    rename: Renamed = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a sidecar.")] = False,
) -> None:
    """Write a sidecar to fill in.

    It states what the file tells, and offers every other key that applies, with its unit and
    meaning, as a comment.
    """
    from ..runs import parse_rename, sidecar_path, sidecar_template, write_files

    sidecar = sidecar_path(run)
    text = sidecar_template(run, parse_rename(rename or []))
    write_files({sidecar: text.encode()}, force=force)
    typer.echo(f"wrote {sidecar}: fill it in, then see: giajax check {run}")
