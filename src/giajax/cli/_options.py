"""Options that many commands have, said once."""

from typing import Annotated

import typer

from .._cores import CORES_VARIABLE

Renamed = Annotated[
    list[str] | None,
    typer.Option(metavar="OLD=NEW", help="Read column OLD of the files as NEW. Repeatable."),
]

Cores = Annotated[
    int | None,
    typer.Option(
        metavar="N", min=1, envvar=CORES_VARIABLE, help="Compute on so many cores (all of them)."
    ),
]
