"""`giajax shape`: command with reduced residual swing of the arm."""

import json
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Force,
    Json,
    Quiet,
    Renamed,
    RunModel,
    Scenarios,
    Texts,
    argument,
    command,
    failed_simulation,
    print_table,
    say_progress,
    say_written,
    write_folder,
)
from ._model import definition_of, fit_or_model, is_result, say_doubts

if TYPE_CHECKING:
    from ..apps.shaping import Command, Shaped, Shaping
    from ..recordings import Run

_PAGE, _PICTURE = "shape.json", "shape.png"


@command(
    """\b
Examples:
  giajax shape command.csv --model giajax-out/run --out shaped
                            compute ZV, ZVD and EI commands for a fitted arm
  giajax shape command.csv --model my_arm.toml --shaper ZVD --out shaped
                            use one shaper and an arm from a file
  giajax synth --data shaped/command_zvd.csv --model giajax-out/run \\
      --channels tip_z --to rehearsal.csv
                            simulate the fitted arm with a shaped command

\b
MODEL is the folder of a fit, its result.json, or a TOML file with an [arm]
section. The output files are
command_zv.csv, command_zvd.csv and command_ei.csv (commands for an operator),
shape.json and shape.png. The residual is the largest distance between the tip
and its final position at any time after the end of the command, in still air.""",
    group="plan",
    pictures=True,
    old={"--draws": "--scenarios"},
)
def shape(
    run: Annotated[Path, argument("COMMAND.csv", "A run with the commands to shape.")],
    out: Annotated[Path, "DIR", "Folder for the files."],
    model: RunModel = None,
    shaper: Annotated[Texts, "NAME", "Shaper: ZV, ZVD or EI. [default: all]"] = None,
    tune: Annotated[bool, "Optimise the period and damping of the shapers by simulation."] = True,
    scenarios: Scenarios = 20,
    rename: Renamed = None,
    as_json: Json = False,
    quiet: Quiet = False,
    force: Force = False,
) -> None:
    """Shape a command to reduce the residual swing.

    The command is convolved with a few impulses. The times and amplitudes of the impulses follow
    from the period and the damping of the arm's modes at the final pose, including the damping by
    air.
    """
    from ..recordings import check_output_folder, parse_rename, read_run, stored_result, write_run

    names = list(dict.fromkeys(name.upper() for name in shaper or ["ZV", "ZVD", "EI"]))
    files = [_PAGE, _PICTURE, *(_file(name) for name in names)]
    sidecars = [_file(name).replace(".csv", ".toml") for name in names]
    check_output_folder(out, [*files, *sidecars], force=force)
    if model is not None and is_result(model):
        stored_result(model)
    recorded = read_run(run, definition=definition_of(model), rename=parse_rename(rename or []))
    configure()
    from ..apps.shaping import shape_command, shaping_facts, shaping_figure
    from ..report import to_png

    say_doubts(model, "the predicted swing", quiet=quiet)
    source = fit_or_model(model, [recorded])
    given = _command(recorded, source)
    with failed_simulation(""):
        found = shape_command(
            source,
            given,
            shapers=names,
            tuned=tune,
            draw_count=scenarios,
            progress=say_progress(quiet),
        )
    text = json.dumps(shaping_facts(found), indent=2, allow_nan=False)
    picture = to_png(shaping_figure(found, f"{recorded.name}: unshaped and shaped"))
    write_folder(out, {_PAGE: f"{text}\n".encode(), _PICTURE: picture}, force=force)
    for row in found.rows[1:]:
        times, columns = _rows(recorded, row.command)
        how: dict[str, Any] = {"definition": recorded.definition, "force": force}
        write_run(out / _file(row.name), times, columns, **how)
    if as_json:
        typer.echo(text)
    elif not quiet:
        _show(found)
        say_written(out, files)
        best = min(found.rows[1:], key=_soonest)
        paths = [out / _file(best.name), *([] if model is None else [model])]
        data, *stated = (shlex.quote(str(path)) for path in paths)
        by = "".join(f" --model {path}" for path in stated)
        tip = " ".join(f"--channels tip_{axis}" for axis in "xyz")
        typer.echo(f"next: giajax synth --data {data}{by} {tip} --to rehearsal.csv")


def _soonest(row: "Shaped") -> tuple[float, float]:
    return math.inf if row.settled is None else row.settled, row.residual


def _file(name: str) -> str:
    return f"command_{name.lower()}.csv"


def _command(run: "Run", source: Any) -> "Command":
    """Return the commands of all joints at their corners, from 0 s on."""
    import numpy as np

    from ..apps.shaping import Command
    from ..fitting import arm_model_of
    from ..schema import CommandSection
    from ..simulation import logged

    count = arm_model_of(source).arm.count
    if run.times is None or not run.commands:
        raise InputError(
            f"{run.path} contains no commands over time: give columns such as joint01_command_deg"
        )
    interpolation = run.definition.section(CommandSection).interpolation
    angles = np.zeros((len(run.times), count))
    for name, values in run.commands.items():
        joint = run.channels[name].index or 0
        if not 1 <= joint <= count:
            raise InputError(
                f"{name} names joint {joint}, but the arm has joints 1 to {count}: correct the "
                "column, or give another arm"
            )
        angles[:, joint - 1] = values
    corners = logged(run.times - run.times[0], angles, interpolation)
    times, rows = np.asarray(corners.times), np.asarray(corners.values)
    return Command(times, rows, interpolation == "zoh")


def _rows(run: "Run", shaped: "Command") -> tuple[Any, dict[str, Any]]:
    """Return the rows of a shaped command for the same joints, at the rate of the run."""
    import numpy as np

    assert run.times is not None
    step = float(np.median(np.diff(run.times)))
    regular = step * np.arange(int(shaped.times[-1] / step) + 1)
    apart = np.min(np.abs(shaped.times[:, None] - regular), axis=1) > 1e-6 * step
    times = np.sort(np.concatenate([regular, shaped.times[apart]]))
    angles = shaped.at(times)
    columns = {name: angles[:, (run.channels[name].index or 1) - 1] for name in run.commands}
    return run.times[0] + times, columns


def _show(found: "Shaping") -> None:
    from ..apps.shaping import SHAPING_HEADINGS, shaping_rows

    for mode in found.modes:
        typer.echo(
            f"mode with a period of {mode.period:.1f} s and a damping ratio of {mode.damping:.2f} "
            "at the amplitude excited by the command"
        )
    typer.echo(f"travel of the tip {found.travel:.3g} m\n")
    print_table(SHAPING_HEADINGS, shaping_rows(found))
    for note in found.notes:
        typer.echo(f"note: {note}")
