"""`giajax joint` and `compensate`: one joint at rest, and compensation of its hysteresis."""

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Digits,
    Force,
    Quiet,
    Renamed,
    Settings,
    ToRun,
    argument,
    command,
    command_after,
    print_table,
    say_written,
    write_folder,
)
from ._values import Values, settings, with_settings

if TYPE_CHECKING:
    from ..recordings import Definition

_ANGLES = (60.0, 30.0, 10.0, 2.0, -2.0, -10.0, -30.0, -60.0)


@command(
    """\b
Examples:
  giajax joint --out joint  draw the preset joint, and write its tables
  giajax joint --out joint --torque 0.5 --angle 45 --angle 0 --angle -45
                            use another torque, and draw the joint at 3 angles
  giajax joint joint.toml --out joint --target-angle 30
                            use your joint and a target angle of 30 deg
  giajax joint --out joint --set alpha.offset=0.05 --force
                            use another parameter value
  giajax joint --out joint --set neck.radius=0.06 --force
                            add a film neck that bends and folds

\b
The command writes
  fig09.png, fig09.csv    muscle contraction and force, without corrections
  fig10.png, fig10.csv    the same, with the corrections alpha and beta
  corrections.png, .csv   alpha and beta, corrected and as in the paper
  joint.png, points.csv   the joint at a few angles, and its marked points
  equilibria.png, .csv    equilibria for two pressures, and their stiffness

DEFINITION is a TOML file with [joint] and [muscle] sections, such as the sidecar of a run.""",
    group="arm",
    pictures=True,
    old={"--definition": "DEFINITION", "--target": "--target-angle"},
)
def joint(
    out: Annotated[Path, "DIR", "Folder for figures and tables."],
    definition: Annotated[
        Path | None, argument("DEFINITION", "TOML file with [joint] and [muscle] sections.")
    ] = None,
    pairs: Settings = None,
    torque: Annotated[float | None, "N_M", "Torque on the joint. [default: 0.3]"] = None,
    angle: Annotated[list[float] | None, "DEG", "Draw the joint at this angle."] = None,
    target_angle: Annotated[
        float, "DEG", "Joint angle for which both muscle pressures are computed."
    ] = 20.0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Draw one joint at rest, its muscle forces and its equilibria.

    Draws the paper's figs 9 and 10, the joint at a few angles, and its equilibria for two
    pressures.
    """
    from ..recordings import Definition, check_output_folder

    sections = Definition() if definition is None else Definition.load(definition)
    angles = list(angle or _ANGLES)
    shown = (*(("--angle", value) for value in angles), ("--target-angle", target_angle))
    for option, value in shown:
        if not -60 <= value <= 60:
            raise InputError(f"{option} is {value:g}: give an angle from -60 to 60 deg")
    values = settings(pairs)
    configure()
    from ..apps.joint import JOINT_FILES, joint_files

    check_output_folder(out, JOINT_FILES, force=force)
    pair = _pair(sections, values, torque)
    if not quiet:
        typer.echo("drawing figures and computing all equilibria ...", err=True)
    write_folder(out, joint_files(pair, angles, target_angle), force=force)
    if not quiet:
        _show(pair, target_angle)
        say_written(out, JOINT_FILES)


def _pair(sections: "Definition", typed: Values, torque: float | None) -> Any:
    """Return the joint and muscle of the sections, with the given parameters."""
    from ..mechanics.joint import JointPair, check_geometry
    from ..models import MuscleModel, joint_from_section
    from ..schema import MuscleSection

    muscle = sections.section(MuscleSection)
    unused = {
        "length_m": "length" in muscle.values(),
        "friction": muscle.friction not in (None, "none"),
        "friction_pressures_kPa": muscle.friction_pressures_kPa is not None,
    }
    for key in (key for key, is_there in unused.items() if is_there):
        raise InputError(
            f"[muscle] {key} is not used here, because muscle_length_m of [joint] gives the length "
            "and the muscles of a pair have no friction: remove this key"
        )
    pair = JointPair(joint_from_section(sections), MuscleModel.from_section(muscle).muscle)
    if torque is not None and not 0 < torque < math.inf:
        raise InputError(f"--torque is {torque:g}: give a positive torque in N m")
    values = {} if torque is None else {"joint.torque": [torque]}
    for path, each in typed.items():
        # Paths of the joint itself need no prefix, as in a fit of a joint.
        values[path if path.startswith(("joint.", "muscle.", "neck.")) else f"joint.{path}"] = each
    pair = with_settings(pair, values)
    alone = next((path for path in typed if path.startswith("neck.")), None)
    if alone is not None and pair.neck.radius is None:
        raise InputError(
            f"--set {alone} has no effect on a joint without a neck: also set neck.radius"
        )
    check_geometry(pair.joint.geometry)
    return pair


def _show(pair: Any, target: float) -> None:
    """Print an overview: branches, pressures and all equilibria."""
    import numpy as np

    from ..mechanics.joint import branch_angles, equilibria, pair_command

    taut, wrapped = np.rad2deg(branch_angles(pair.joint.geometry))
    command = pair_command(pair, np.deg2rad(target))
    sides = {"first": command.first_pressure, "second": command.second_pressure}
    rows = [
        ("inner wire taut", "never" if np.isnan(taut) else f"above {taut:.2f} deg"),
        ("outer muscle wraps", "never" if np.isnan(wrapped) else f"below {wrapped + 0.0:.2f} deg"),
    ]
    for name, side in sides.items():
        shown = f"{float(side.pressure) / 1e3:.2f} kPa, {side.message()}"
        rows.append((f"{name} muscle", shown))
    print_table(["", f"for {target:g} deg"], rows, left=2)
    print()
    rests = equilibria(pair, command.pressures)
    headings = ["equilibrium (deg)", "", "stiffness (N m/rad)", "first muscle", "second muscle"]
    cells = []
    for one in rests.every:
        angle, word = np.rad2deg(one.angle) + 0.0, "stable" if one.stable else "unstable"
        cells.append((f"{angle:.2f}", word, f"{one.stiffness:.3g}", *one.branches))
    print_table(headings, cells, left=5)
    for end, is_there in ((-60, rests.at_lower_stop), (60, rests.at_upper_stop)):
        if is_there:
            print(f"the torque also drives the joint against its stop at {end} deg")
    if rests.indifferent:
        print(
            "no torque acts on the joint in a range of angles, so every angle in this range is an "
            "equilibrium"
        )


@command(
    """\b
Examples:
  giajax fit --data loop.csv --out loop
                            fit the model to invert
  giajax compensate loop --target target.csv --to command.csv
                            compute commands from the inverse of the fit
  giajax compensate --loop loop.csv --travel 40 --target target.csv \\
      --to command.csv      use a measured loop instead of a fit

target.csv has a column for the target angle (angle_deg) or output, and optionally a time
column. If a fit is used, the file of commands also contains the output that the fit
predicts.""",
    group="plan",
    old={"--model": "RESULT", "--out": "--to"},
)
def compensate(
    target: Annotated[Path, "RUN.csv", "A table of target outputs."],
    to: ToRun,
    result: Annotated[
        Path | None, argument("RESULT", "A fit (result.json or its folder) to invert.")
    ] = None,
    loop: Annotated[
        Path | None, "RUN.csv", "A measured loop for eq. (12) of the paper, instead of a fit."
    ] = None,
    travel: Annotated[
        float | None,
        "TRAVEL",
        "With --loop: travel over which the branch changes, in the unit of the target. [default: a "
        "third of the range of the loop]",
    ] = None,
    rename: Renamed = None,
    digits: Digits = 9,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compute the commands that reach target outputs.

    The fitted model is inverted. The inverse is exact for the Prandtl-Ishlinskii operator and its
    modified form. With --loop, eq. (12) of the paper is used.
    """
    if (result is None) == (loop is None):
        raise typer.BadParameter(
            "there must be exactly one source of commands: give either a fit, or --loop with a run"
        )
    if travel is not None and loop is None:
        raise typer.BadParameter(
            "--travel is only used with --loop: give both options, or omit --travel"
        )
    if travel is not None and not 0 < travel < math.inf:
        raise typer.BadParameter(f"--travel is {travel:g}: give a positive number")
    from ..recordings import Definition, Run, check_output_run, parse_rename, read_run, write_run
    from ..schema import HYSTERESIS

    check_output_run(to, force=force)
    renamed = parse_rename(rename or [])
    definition = Definition.parse({"model": HYSTERESIS.name})
    plan = read_run(target, rename=renamed, definition=definition)
    configure()
    from ..apps.control import compensator_for_loop, compensator_for_model, target_channel
    from ..fitting import load_result

    goal, fitted = target_channel(plan), None
    if result is not None:
        fitted = load_result(result).model
        compensator, how = compensator_for_model(fitted), f"inverse of {result}"
    else:
        assert loop is not None
        across = None if travel is None else float(goal.to_si(travel))
        compensator = compensator_for_loop(read_run(loop, rename=renamed), across)
        how = f"eq. (12) from {loop.name}"
    origin = f"commands for {target.name}, computed by giajax compensate ({how})"
    commands = compensator.commands_for(plan)
    channel = compensator.input_channel
    # Write the commands in the unit of the target if both are angles.
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
        origin += f"; {name} contains the prediction of the fitted model"
    definition = definition.merged_with(Definition.parse({"origin": origin}))
    write_run(
        to, plan.times, values, units=units, definition=definition, digits=digits, force=force
    )
    if quiet:
        return
    low, high = (float(channel.from_si(end)) for end in (commands.min(), commands.max()))
    typer.echo(
        f"wrote {to}: {len(commands)} commands from {low:.4g} to {high:.4g} {channel.unit}; "
        f"{command_after('check', '--data', to)}"
    )
