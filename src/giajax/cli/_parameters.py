"""`giajax parameters`: what can be fitted, set and held."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..parameters import Parameter

EXAMPLES = """\b
Examples:
  giajax parameters
  giajax parameters joint.csv
  giajax parameters --json
  giajax fit --data run.csv --free air.drag_coefficient --free "links.mass[19]"

\b
An array has one element for each link or joint; links.mass[0] is its first one.
'assumed': the paper gives no figure, and a fit should find one."""


def parameters(
    run: Annotated[
        Path | None,
        typer.Argument(metavar="[RUN]", help="List those of the model of this run. [the arm]"),
    ] = None,
    links: Annotated[int, typer.Option(metavar="N", help="Number of links of the arm.")] = 20,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """List every parameter of the arm, or of a run's model.

    Path, unit, default, bounds and meaning of each.
    """
    from ..runs import read_run

    recorded = None if run is None else read_run(run)

    from ._jax import configure

    configure()

    from ..arm import takeichi_20m
    from ..models import ArmModel, model_for
    from ..parameters import declared

    model = ArmModel(takeichi_20m(links)) if recorded is None else model_for([recorded])
    facts = [_facts(parameter, model) for parameter in declared(model).values()]
    if as_json:
        import json

        typer.echo(json.dumps(facts, indent=2, allow_nan=False))
    else:
        _show(facts)


def _facts(parameter: "Parameter", model: Any) -> dict[str, Any]:
    declaration = parameter.declaration
    shape = parameter.value(model).shape
    return {
        "path": parameter.path,
        "unit": declaration.unit,
        "default": declaration.default,
        "lower": _finite(declaration.lower),
        "upper": _finite(declaration.upper),
        "free": not declaration.frozen,
        "assumed": declaration.assumed,
        "elements": shape[0] if shape else None,
        "meaning": declaration.doc,
    }


def _finite(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def _show(facts: list[dict[str, Any]]) -> None:
    from ._output import print_table

    headings = ["parameter", "unit", "default", "bounds", "in a fit", "elements", "", "meaning"]
    print_table(headings, [_row(fact) for fact in facts], left=len(headings))


def _row(fact: dict[str, Any]) -> list[Any]:
    return [
        fact["path"],
        fact["unit"] or None,
        f"{fact['default']:.10g}",
        _bounds(fact["lower"], fact["upper"]),
        "free" if fact["free"] else "held",
        fact["elements"],
        "assumed" if fact["assumed"] else "",
        fact["meaning"],
    ]


def _bounds(lower: float | None, upper: float | None) -> str:
    if lower is None or upper is None:
        return "any" if lower is None else f"above {lower:g}"
    return f"{lower:g} to {upper:g}"
