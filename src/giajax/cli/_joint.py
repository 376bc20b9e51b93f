"""`giajax joint`: one joint at rest, in pictures and numbers."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._errors import InputError
from ._values import Values, settings, with_settings
from ._registry import command

if TYPE_CHECKING:
    from ..runs import Definition


_ANGLES = (60.0, 30.0, 10.0, 2.0, -2.0, -10.0, -30.0, -60.0)


@command("""\b
Examples:
  giajax joint --out joint
  giajax joint --out joint --torque 0.5 --angle 45 --angle 0 --angle -45
  giajax joint --out joint --definition joint.toml --target 30
  giajax joint --out joint --set alpha.offset=0.05 --force

\b
It writes
  fig09.png, fig09.csv    contraction and force against angle, without corrections
  fig10.png, fig10.csv    the same with alpha and beta
  corrections.png, .csv   alpha and beta, as read and as printed (an erratum)
  joint.png, points.csv   the joint itself at a few angles, and its lettered points
  equilibria.png, .csv    where the pressures for an angle hold the joint, and how stiffly

A definition is a TOML file with [joint] and [muscle] sections, such as the sidecar of a run.""")
def joint(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for pictures and numbers.")],
    definition: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="[joint] and [muscle] to use.")
    ] = None,
    pairs: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="PATH=VALUE", help="A parameter of joint or muscle, SI. Repeatable."
        ),
    ] = None,
    torque: Annotated[
        float | None, typer.Option(metavar="N_M", help="Torque on the joint. [default: 0.3]")
    ] = None,
    angle: Annotated[
        list[float] | None,
        typer.Option(metavar="DEG", help="Draw the joint at this angle. Repeatable."),
    ] = None,
    target: Annotated[
        float, typer.Option(metavar="DEG", help="Angle whose two pressures are shown.")
    ] = 20.0,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
) -> None:
    """Draw one joint at rest: paths, forces, corrections and equilibria.

    The paper's figs 9 and 10, the joint itself at a few angles, and where two pressures hold it.
    """
    from ..runs import Definition, check_output_folder, make_folder, write_files

    sections = Definition() if definition is None else Definition.load(definition)
    angles = list(angle or _ANGLES)
    for option, degrees in (("--angle", angles), ("--target", [target])):
        for value in degrees:
            if not -60 <= value <= 60:
                raise InputError(f"{option} is {value:g}: give an angle from -60 to 60 deg")
    values = settings(pairs)

    from ._jax import configure

    configure()
    from ..report import JOINT_FILES, joint_files

    check_output_folder(out, JOINT_FILES, force=force)
    pair = _pair(sections, values, torque)
    typer.echo("drawing, and solving for every equilibrium ...", err=True)
    contents = joint_files(pair, angles, target)
    make_folder(out)
    write_files({out / name: contents[name] for name in JOINT_FILES}, force=force)
    _show(pair, target)
    typer.echo(f"\nwrote {out}: {', '.join(JOINT_FILES)}")


def _pair(sections: "Definition", typed: Values, torque: float | None) -> Any:
    """The joint and muscle of the sections, with the parameters that were set."""
    from ..joint import JointPair, check_geometry
    from ..kinds import MuscleSection
    from ..models import MuscleModel, joint_from_section

    _refuse_unused(sections)
    muscle = MuscleModel.from_section(sections.section(MuscleSection)).muscle
    pair = JointPair(joint_from_section(sections), muscle)
    if torque is not None and not 0 < torque < math.inf:
        raise InputError(f"--torque is {torque:g}: give a positive number of N m")
    values = {} if torque is None else {"joint.torque": [torque]}
    for path, each in typed.items():
        # The joint's own paths need no prefix, as in a fit of a joint.
        values[path if path.startswith(("joint.", "muscle.")) else f"joint.{path}"] = each
    pair = with_settings(pair, values)
    check_geometry(pair.joint.geometry)
    return pair


def _refuse_unused(sections: "Definition") -> None:
    """Refuse what a [muscle] section says and a joint does not use."""
    from ..kinds import MuscleSection

    muscle = sections.section(MuscleSection)
    unused = {
        "length_m": "length" in muscle.values(),
        "friction": muscle.friction not in (None, "none"),
        "friction_pressures_kPa": muscle.friction_pressures_kPa is not None,
    }
    for key, is_there in unused.items():
        if is_there:
            raise InputError(
                f"[muscle] {key} is not used here: the length is muscle_length_m of [joint], and "
                "a pair has no friction: remove it"
            )


def _show(pair: Any, target: float) -> None:
    """What a person wants to know first: branches, pressures and every equilibrium."""
    import numpy as np

    from ..joint import branch_angles, equilibria, pair_command
    from ._output import print_table

    taut, wrapped = np.rad2deg(branch_angles(pair.joint.geometry))
    command = pair_command(pair, np.deg2rad(target))
    sides = {"first": command.first_pressure, "second": command.second_pressure}
    rows = [
        ("inner wire taut", "never" if np.isnan(taut) else f"above {taut:.2f} deg"),
        ("outer muscle wraps", "never" if np.isnan(wrapped) else f"below {wrapped + 0.0:.2f} deg"),
    ]
    for name, answer in sides.items():
        rows.append(
            (f"{name} muscle", f"{float(answer.pressure) / 1e3:.2f} kPa, {answer.message()}")
        )
    print_table(["", f"for {target:g} deg"], rows, left=2)
    print()
    rests = equilibria(pair, command.pressures)
    headings = ["equilibrium (deg)", "", "stiffness (N m/rad)", "first muscle", "second muscle"]
    cells = [
        (
            f"{np.rad2deg(item.angle) + 0.0:.2f}",
            "stable" if item.stable else "unstable",
            f"{item.stiffness:.3g}",
            *item.branches,
        )
        for item in rests.every
    ]
    print_table(headings, cells, left=5)
    notes = {
        "the torque also drives the joint against its stop at -60 deg": rests.at_lower_stop,
        "the torque also drives the joint against its stop at 60 deg": rests.at_upper_stop,
        "in a range of angles nothing acts on the joint: it rests at any of them": (
            rests.indifferent
        ),
    }
    for note, holds in notes.items():
        if holds:
            print(note)
