"""`giajax predict`: how well a model predicts runs that it was not fitted to."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ._model import definition_of, model_of
from ._options import Renamed
from ._registry import command

if TYPE_CHECKING:
    from ..runs import Run


@command("""\b
Examples:
  giajax predict --model giajax-out/run --data other.csv
  giajax predict --model giajax-out/triple_pendulum --against published.toml
      --data validation_01.csv --data validation_02.csv
  giajax predict --model my_arm.toml --data run.csv --refit-initial --out errors.csv

\b
MODEL is the folder of a fit, its result.json, or a TOML file whose [arm] (or
other section) states a model with all its parameters.""")
def predict(
    model: Annotated[
        Path, typer.Option(metavar="MODEL", help="What predicts; see below.", show_default=False)
    ],
    data: Annotated[
        list[Path], typer.Option(metavar="RUN.csv", help="A recorded run. Repeatable.")
    ],
    against: Annotated[
        Path | None,
        typer.Option(metavar="MODEL", help="Another model, and the ratio of their errors."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="A fit definition whose [initial], [wind] and channels hold for the runs, too.",
        ),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Only this channel, without its unit. Repeatable."),
    ] = None,
    rename: Renamed = None,
    refit_initial: Annotated[
        bool,
        typer.Option("--refit-initial", help="Fit the initial state of each run first."),
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Write the table there.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Predict runs, and print the RMSE of each channel.

    The runs start as their sidecars, or the fit definition, say: with first_row = true in
    [initial] as in their first row.
    """
    from ..runs import (
        Definition,
        check_output_files,
        parse_rename,
        read_runs,
        run_keys,
        write_files,
    )

    if out is not None:
        check_output_files([out], force=force)
    sections = {} if config is None else Definition.load(config).contents()
    # What it says of the model is that of the fit, which `model` states already.
    about = ("model", *run_keys(model=False), "fit")
    sections = {key: value for key, value in sections.items() if key in about}
    if channels:
        sections["fit"] = {**sections.get("fit", {}), "channels": channels}
    settings = Definition.parse(sections, "the command line")

    from ._jax import configure

    configure()
    from ..study import compare
    from ._output import print_table

    renamed = parse_rename(rename or [])

    def runs_for(source: Path) -> "list[Run]":
        return read_runs(data, definition_of(source).merged_with(settings), rename=renamed)

    runs = runs_for(model)
    ours = model_of(model, runs)
    other = None if against is None else model_of(against, runs_for(against))
    headings = ["run", "channel", "unit", "values", "RMSE", "largest"]
    if against is not None:
        headings += ["RMSE of the other", "ratio"]
    rows: list[list[Any]] = [
        [one.run, one.channel, one.unit, one.n, one.rmse, one.largest]
        + ([] if against is None else [one.reference_rmse, one.ratio])
        for one in compare(ours, runs, other, refit_initial=refit_initial)
    ]
    print_table(headings, rows, left=3)
    if out is not None:
        lines = [",".join(str(cell) for cell in row) for row in [headings, *rows]]
        write_files({out: ("\n".join(lines) + "\n").encode()}, force=force)
