"""`giajax plan`: fastest command to a target, or the command of least residual swing."""

import json
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
    Scenarios,
    Texts,
    argument,
    command,
    failed_simulation,
    origin,
    print_table,
    say_progress,
    say_written,
    write_folder,
)
from ._model import definition_of, is_result, say_doubts
from ._values import joint_angles, numbers

if TYPE_CHECKING:
    import numpy as np

    from ..apps.planning import AbstractTarget, Plan
    from ..models import ArmModel
    from ..recordings import Definition

_COMMAND, _PATH, _PAGE, _PICTURE = "command.csv", "path.csv", "plan.json", "plan.png"


@command(
    """\b
Examples:
  giajax plan giajax-out/run --pose 1=20 --pose 3=-10 --out planned
                            reach a pose as fast as the limits allow
  giajax plan my_arm.toml --tip 16,5,3 --out planned
                            bring the tip to a position (m)
  giajax plan my_arm.toml --pose 1=20 --duration 60 --out planned
                            move within 60 s with minimal swing
  giajax plan missions/naraha.toml --through housetop --out planned
                            move through an opening without contact
  giajax synth --data planned/command.csv --model giajax-out/run \\
      --channels tip_z --to rehearsal.csv
                            simulate the fitted arm with the plan

\b
MODEL is the folder of a fit, its result.json, or a TOML file with an [arm]
section. A pose is the equilibrium at the commanded angles. All other joints
are commanded to 0. The command writes
  command.csv, command.toml   the command for an operator
  path.csv                    expected path of the tip, with its uncertainty
  plan.json, plan.png         the result, compared with a direct command
The air is still, and the arm is initially at rest. The paper does not give
the maximum joint rate of its arm: the default of 2 deg/s is an assumption.""",
    group="plan",
    pictures=True,
    old={"--model": "MODEL", "--draws": "--scenarios"},
)
def plan(
    context: typer.Context,
    model: Annotated[Path, argument("MODEL", "The arm; see below.")],
    out: Annotated[Path, "DIR", "Folder for the files."],
    pose: Annotated[Texts, "JOINT=DEG", "Target: commanded angle of a joint."] = None,
    tip: Annotated[str | None, "X,Y,Z", "Target: position of the tip (m)."] = None,
    through: Annotated[
        str | None, "WALL", "Target: a position behind the opening of this wall."
    ] = None,
    begin: Annotated[Texts, "JOINT=DEG", "Initial commanded angle of a joint. [default: 0]"] = None,
    duration: Annotated[
        float | None,
        "S",
        "Duration of the command, for which the swing is minimised. [default: minimise the "
        "duration]",
    ] = None,
    max_angle: Annotated[float, "DEG", "Largest commanded angle of a joint."] = 60.0,
    max_angle_rate: Annotated[float, "DEG/S", "Largest rate of a commanded angle."] = 2.0,
    max_pressure: Annotated[float | None, "KPA", "Largest pressure in a muscle."] = None,
    clearance: Annotated[float, "M", "Minimum distance between links and obstacles."] = 0.2,
    within: Annotated[
        float, "PERCENT", "Settling band of the tip, as a percentage of its travel."
    ] = 2.0,
    knots: Annotated[int, "N", "Number of knots of each joint command after its start.", 2] = 10,
    scenarios: Scenarios = 20,
    as_json: Json = False,
    quiet: Quiet = False,
    force: Force = False,
) -> None:
    """Plan a command that brings the arm to rest at a target.

    Within limits on angle, rate, pressure and clearance, the command is as fast as possible, or has
    the least swing for a given duration. It is optimised with derivatives of the simulator.
    """
    from ..recordings import check_output_folder, write_run

    given = [name for name, each in (("--pose", pose), ("--tip", tip), ("--through", through))
             if each]  # fmt: skip
    if len(given) != 1:
        raise InputError(
            f"{len(given)} targets are given, but a plan has a single target: give exactly one of "
            "--pose, --tip and --through"
        )
    files = [_COMMAND, "command.toml", _PATH, _PAGE, _PICTURE]
    check_output_folder(out, files, force=force)
    place = None if tip is None else numbers(tip, 3)
    if tip is not None and place is None:
        raise InputError(
            f"--tip is '{tip}': give three numbers in m separated by commas, such as 16,5,3"
        )
    definition = definition_of(model)
    configure()
    import numpy as np

    from ..apps.planning import CommandLimits, path_columns, plan_command, plan_facts, plan_figure
    from ..fitting import arm_model_of, load_result
    from ..models import ArmModel
    from ..report import to_csv, to_png

    say_doubts(model, "the planned motion", quiet=quiet)
    source = load_result(model) if is_result(model) else ArmModel.stated_in(definition)
    joints = arm_model_of(source).arm.count
    target = _target(pose, place, through, joints, definition)
    limits = CommandLimits(
        angle=float(np.deg2rad(max_angle)),
        rate=float(np.deg2rad(max_angle_rate)),
        clearance=clearance,
        pressure=None if max_pressure is None else 1e3 * max_pressure,
    )
    with failed_simulation(""):
        found = plan_command(
            source,
            target,
            begin=_angles(begin, "--begin", joints),
            limits=limits,
            duration=duration,
            within=within / 100,
            knots=knots,
            draw_count=scenarios,
            progress=say_progress(quiet),
        )
    text = json.dumps(plan_facts(found), indent=2, allow_nan=False)
    contents = {
        _PATH: to_csv(path_columns(found)),
        _PAGE: f"{text}\n".encode(),
        _PICTURE: to_png(plan_figure(found)),
    }
    write_folder(out, contents, force=force)
    # The description of the arm in a file is copied unchanged.
    arm = definition.contents().get("arm") or _with_values(found.model)
    times, columns, stated = _run(found, arm, origin(context))
    write_run(out / _COMMAND, times, columns, definition=stated, force=force)
    if as_json:
        typer.echo(text)
    elif not quiet:
        _show(found)
        say_written(out, files)
        words = [shlex.quote(str(each)) for each in (out / _COMMAND, model)]
        axes = " ".join(f"--channels tip_{axis}" for axis in "xyz")
        typer.echo(
            f"next: giajax synth --data {words[0]} --model {words[1]} {axes} --to rehearsal.csv"
        )


def _angles(pairs: list[str] | None, option: str, joints: int) -> "np.ndarray":
    """Return the commanded angles of all joints, rad, from JOINT=DEG."""
    import numpy as np

    angles = np.zeros(joints)
    for name, angle in joint_angles(pairs, option).items():
        if not name.isdigit():
            raise InputError(f"{option} is '{name}=...': give JOINT=DEG, such as 1=20")
        if not 1 <= int(name) <= joints:
            raise InputError(
                f"{option} names joint {name}, but the arm has joints 1 to {joints}: correct the "
                "number"
            )
        angles[int(name) - 1] = np.deg2rad(angle)
    return angles


def _target(
    pose: list[str] | None,
    place: list[float] | None,
    through: str | None,
    joints: int,
    definition: "Definition",
) -> "AbstractTarget":
    from ..apps.mission import Operator
    from ..apps.planning import Pose, Through, Tip

    if pose:
        return Pose(_angles(pose, "--pose", joints))
    if place is not None:
        return Tip((place[0], place[1], place[2]))
    section, approach = definition.mission, None
    if section is not None:
        import numpy as np

        approach = np.asarray(Operator.from_section(section, joints).approach)
    return Through(through, approach=approach)


def _with_values(model: "ArmModel") -> dict[str, Any]:
    """Return the arm with its constants and the parameters of the fit, in the form of a file."""
    from ..models import preset_of

    found, constants = preset_of(model.arm), model.definition()["arm"]
    parameters = {**found["parameters"], **constants.get("parameters", {})}
    return {**found, **constants, "parameters": parameters}


def _run(found: "Plan", arm: Any, by: str) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the planned command as a run: times, columns and contents of the sidecar."""
    import numpy as np

    row = found.planned
    used = np.flatnonzero(np.any(np.abs(row.command.angles) > 1e-9, axis=0))
    columns = {f"joint{k + 1:02d}_command": row.command.angles[:, k] for k in used}
    stated: dict[str, Any] = {
        "model": "arm",
        "origin": by,
        "arm": arm,
        "command": {"interpolation": "linear"},
    }
    if np.any(np.abs(row.angles[0]) > 1e-9):
        stated["initial"] = {"angle_deg": np.rad2deg(row.angles[0]).round(9).tolist()}
    return row.command.times, columns, stated


def _show(found: "Plan") -> None:
    from ..apps.planning import PLAN_HEADINGS, plan_rows

    typer.echo(
        f"travel of the tip {found.travel:.3g} m, to "
        f"({', '.join(f'{each:.3g}' for each in found.goal)}) m; longest natural "
        f"period {found.period:.1f} s\n"
    )
    print_table(PLAN_HEADINGS, plan_rows(found))
    for note in found.notes:
        typer.echo(f"note: {note}")
