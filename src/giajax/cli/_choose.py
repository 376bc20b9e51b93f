"""`giajax choose`: which hysteresis model describes a recording."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import Renamed
from ._registry import command


_ENDS = {"not_converged": "NOT CONVERGED"}


@command("""\b
Examples:
  giajax choose --data loops.csv
  giajax choose --data loops.csv --held-out other.csv
  giajax choose --data loops.csv --only preisach --only modified_prandtl_ishlinskii

The best model on the held-out loops comes first; fits that did not converge come last,
whatever their errors. AIC and BIC are of the fitted part, each less
that of the best; a large difference on the held-out part and a small one here means a model that
describes what it saw and no more.""")
def choose(
    data: Annotated[
        list[Path], typer.Option(metavar="RUN.csv", help="A run to fit to. Repeatable.")
    ],
    held_out: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A run to judge by. Repeatable."),
    ] = None,
    fraction: Annotated[
        float,
        typer.Option(metavar="F", help="Without --held-out: last part of each run to judge by."),
    ] = 0.3,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Compare only these. Repeatable.")
    ] = None,
    rename: Renamed = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress.")] = False,
) -> None:
    """Fit several hysteresis models and compare them on loops that they were not fitted to."""
    from ..runs import parse_rename, read_run

    renamed = parse_rename(rename or [])
    runs = [read_run(path, rename=renamed) for path in data]
    others = [read_run(path, rename=renamed) for path in held_out or []]

    from ._jax import configure

    configure()
    from ..study import choose_hysteresis

    say = None if quiet else (lambda name: typer.echo(f"fitting {name} ...", err=True))
    choice = choose_hysteresis(runs, others, fraction=fraction, candidates=only, progress=say)
    ended = [one for one in choice.candidates if one.converged] or choice.candidates
    least_aic = min(candidate.aic for candidate in ended)
    least_bic = min(candidate.bic for candidate in ended)
    facts = [
        {
            "model": candidate.name,
            "parameters": candidate.parameters,
            "held_out_rmse": candidate.held_out_rmse,
            "rmse": candidate.rmse,
            "delta_aic": candidate.aic - least_aic,
            "delta_bic": candidate.bic - least_bic,
            "status": candidate.status,
        }
        for candidate in choice.candidates
    ]
    if as_json:
        import json

        typer.echo(json.dumps({"unit": choice.unit, "candidates": facts}, indent=2))
        return
    from ._output import print_table

    unit = f" {choice.unit}" if choice.unit else ""
    headings = ["model", "parameters", f"held out{unit}", f"fitted{unit}", "AIC", "BIC", "fit"]
    rows = [
        [
            fact["model"],
            fact["parameters"],
            f"{fact['held_out_rmse']:.3g}",
            f"{fact['rmse']:.3g}",
            f"{fact['delta_aic']:+.1f}",
            f"{fact['delta_bic']:+.1f}",
            _ENDS.get(str(fact["status"]), fact["status"]),
        ]
        for fact in facts
    ]
    print_table(headings, rows)
