"""`giajax parameters`: what can be fitted, set and held."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._errors import InputError
from ._registry import command

if TYPE_CHECKING:
    from ..parameters import Parameter

# An array of more elements is shown by its range.
_FEW = 3


@command("""\b
Examples:
  giajax parameters
  giajax parameters joint.csv
  giajax parameters --preset takeichi_20m_full
  giajax parameters --arm my_arm.toml
  giajax parameters --json
  giajax fit --data run.csv --free air.drag_coefficient --free "links.mass[19]"

\b
value: what the preset, the file or the sidecar of the run says, or else the default.
'off': left out of the model, at no cost; --start or --free of a fit switches it on,
with the value listed.
An array has one element for each link or joint; links.mass[0] is its first one.
'assumed': the paper gives no figure, and a fit should find one.""")
def parameters(
    run: Annotated[
        Path | None,
        typer.Argument(metavar="[RUN]", help="List those of the model of this run. [the arm]"),
    ] = None,
    arm: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="The arm, and its sensors, of this file."),
    ] = None,
    preset: Annotated[
        str | None, typer.Option(metavar="NAME", help="Preset of the arm. [takeichi_20m]")
    ] = None,
    links: Annotated[
        int | None, typer.Option(metavar="N", help="Number of links of the arm.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """List every parameter of the arm, or of a run's model.

    Path, unit, value, bounds and meaning of each.
    """
    from ..runs import Definition, read_run

    if run is not None and (arm or preset or links is not None):
        raise InputError("a run says which model it is of: leave out --arm, --preset and --links")
    recorded = None if run is None else read_run(run)
    definition = Definition() if arm is None else Definition.load(arm)
    options = {"preset": preset, "links": links}
    section = {key: value for key, value in options.items() if value is not None}
    definition = definition.merged_with(Definition.parse({"arm": section}, "the command line"))

    from ._jax import configure

    configure()

    from ..fitting import units_in_si
    from ..models import (
        AbstractModel,
        ArmModel,
        arm_from_definition,
        model_for,
        sensors_from_definition,
    )
    from ..parameters import declared, left_out

    model: AbstractModel
    if recorded is not None:
        model = model_for([recorded])
    else:
        model = ArmModel(
            arm_from_definition(definition), sensors=sensors_from_definition(definition)
        )
    known = [*declared(model).values(), *left_out(model).values()]
    units = units_in_si(model)
    facts = [_facts(parameter, units[parameter.path], model) for parameter in known]
    if as_json:
        import json

        typer.echo(json.dumps(facts, indent=2, allow_nan=False))
    else:
        _show(facts)


def _facts(parameter: "Parameter", unit: str, model: Any) -> dict[str, Any]:
    declaration = parameter.declaration
    on = parameter.is_on(model)
    value = parameter.value(model) if on else None
    shape = declaration.shape if value is None else value.shape
    return {
        "path": parameter.path,
        "unit": unit,
        "value": None if value is None else value.tolist(),
        "default": declaration.default,
        "lower": _finite(declaration.lower),
        "upper": _finite(declaration.upper),
        "on": on,
        "free": on and not declaration.frozen,
        "assumed": declaration.assumed,
        "elements": shape[0] if shape else None,
        "meaning": declaration.meaning,
        "source": declaration.source or None,
        "key": None if declaration.key is None else declaration.key.name,
    }


def _finite(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def _show(facts: list[dict[str, Any]]) -> None:
    from ._output import print_table

    headings = ["parameter", "unit", "value", "bounds", "in a fit", "elements", "", "meaning"]
    print_table(headings, [_row(fact) for fact in facts], left=len(headings))


def _row(fact: dict[str, Any]) -> list[Any]:
    return [
        fact["path"],
        fact["unit"] or None,
        _value(fact),
        _bounds(fact["lower"], fact["upper"]),
        ("free" if fact["free"] else "held") if fact["on"] else "off",
        fact["elements"],
        "assumed" if fact["assumed"] else "",
        fact["meaning"],
    ]


def _value(fact: dict[str, Any]) -> str:
    """Of an array the one number that all elements share, or a few, or else their range."""
    value, default = fact["value"], fact["default"]
    elements = value if isinstance(value, list) else [default if value is None else value]
    # A value is converted and computed, and shows it in its last digits; a default does not.
    shown = {number: f"{number:.{10 if number == default else 7}g}" for number in elements}
    if len(shown) == 1:
        return shown[elements[0]]
    if len(elements) <= _FEW:
        return ", ".join(shown[number] for number in elements)
    return f"{shown[min(elements)]} to {shown[max(elements)]}"


def _bounds(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return "any"
    if lower is None:
        return f"below {upper:g}"
    if upper is None:
        return f"above {lower:g}"
    return f"{lower:g} to {upper:g}"
