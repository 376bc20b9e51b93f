"""Options that many commands have, said once."""

from typing import Annotated

import typer

Renamed = Annotated[
    list[str] | None,
    typer.Option(metavar="OLD=NEW", help="Read column OLD of the files as NEW. Repeatable."),
]
