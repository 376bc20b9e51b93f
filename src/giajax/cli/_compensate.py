"""`giajax compensate`: commands that take a hysteretic joint to its targets."""

import dataclasses
import math
import shlex
from pathlib import Path
from typing import Annotated

import typer

from ._options import Renamed
from ._registry import command


@command("""\b
Examples:
  giajax fit --data loop.csv --out loop
  giajax compensate --model loop/result.json --target target.csv --out command.csv
  giajax compensate --loop loop.csv --travel 40 --target target.csv --out command.csv

target.csv has one column, the angle (angle_deg) or output that is the target, and the time if
there is one. What the fitted model predicts for the commands is written beside them.""")
def compensate(
    target: Annotated[Path, typer.Option(metavar="RUN.csv", help="The target outputs.")],
    out: Annotated[Path, typer.Option(metavar="RUN.csv", help="The commands to write.")],
    model: Annotated[
        Path | None,
        typer.Option(metavar="RESULT", help="A fit (result.json or its folder) to invert."),
    ] = None,
    loop: Annotated[
        Path | None,
        typer.Option(metavar="RUN.csv", help="A measured loop for eq. (12), instead of a fit."),
    ] = None,
    travel: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="With --loop: travel from branch to branch, in the unit of the target. "
            "[default: a third of the range]",
        ),
    ] = None,
    rename: Renamed = None,
    digits: Annotated[
        int, typer.Option(metavar="N", min=3, max=17, help="Significant digits that are written.")
    ] = 9,
    force: Annotated[bool, typer.Option("--force", help="Write over a run.")] = False,
) -> None:
    """Turn target outputs into the commands that reach them.

    With --model by the inverse of the fitted operator, exact for Prandtl-Ishlinskii and its
    modified form; with --loop by eq. (12) of the paper.
    """
    if (model is None) == (loop is None):
        raise typer.BadParameter(
            "commands need one source: give --model with a fit, or --loop with a run, and not both"
        )
    if travel is not None and loop is None:
        raise typer.BadParameter("--travel goes with --loop: give both, or leave it out")
    if travel is not None and not 0 < travel < math.inf:
        raise typer.BadParameter(f"--travel is {travel:g}: give a positive number")
    from ..kinds import HYSTERESIS
    from ..runs import Definition, Run, check_output_run, parse_rename, read_run, write_run

    check_output_run(out, force=force)
    renamed = parse_rename(rename or [])
    definition = Definition.parse({"model": HYSTERESIS.name})
    plan = read_run(target, rename=renamed, definition=definition)

    from ._jax import configure

    configure()
    from ..control import compensator_for_loop, compensator_for_model, target_channel
    from ..fitting import load_result

    goal = target_channel(plan)
    if model is not None:
        fitted = load_result(model).model
        compensator = compensator_for_model(fitted)
        origin = f"commands by giajax compensate, inverse of {model}, for {target.name}"
    else:
        assert loop is not None
        if travel is not None:
            travel = float(goal.to_si(travel))
        compensator = compensator_for_loop(read_run(loop, rename=renamed), travel)
        fitted = None
        origin = f"commands by giajax compensate, eq. (12) from {loop.name}, for {target.name}"
    commands = compensator.commands_for(plan)
    channel = compensator.input_channel
    # Commands in the unit of the target, where both are angles.
    if goal.quantity == channel.quantity:
        channel = dataclasses.replace(channel, unit=goal.unit)
    values, units = {channel.name: commands}, {channel.name: channel.unit}
    if fitted is not None:
        from ..fitting import predict

        name = goal.name
        blank = {channel.name: commands, name: plan.values[name]}
        run = Run.from_arrays(plan.times, blank, definition=definition)
        values[name] = predict(fitted, run)[name]
        units[name] = goal.unit
        origin += f"; {name} is what the fitted model predicts"
    definition = definition.merged_with(Definition.parse({"origin": origin}))
    write_run(
        out, plan.times, values, units=units, definition=definition, digits=digits, force=force
    )
    low, high = (float(channel.from_si(end)) for end in (commands.min(), commands.max()))
    typer.echo(
        f"wrote {out}: {len(commands)} commands from {low:.4g} to {high:.4g} {channel.unit}; "
        f"see: giajax check {shlex.quote(str(out))}"
    )
