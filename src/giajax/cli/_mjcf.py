"""`giajax mjcf`: conversion of arms to and from MuJoCo files."""

from pathlib import Path
from typing import Annotated

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import Force, Quiet, argument, command, say_written, write_folder
from ._drive import driven_arm

_THEIRS = (".xml", ".mjcf", ".urdf")


@command(
    """\b
Examples:
  giajax mjcf robot.xml --to arm.toml
                            convert the arm of a MuJoCo file
  giajax mjcf robot.urdf --diameter 0.05
                            print the arm of a URDF file without geoms
  giajax mjcf arm.toml --to arm
                            write an arm for MuJoCo to the folder arm
  giajax mjcf giajax-out/run --to arm
                            convert the arm of a fit

A MuJoCo file is converted to the [arm] section of a sidecar. An arm, or a fit
of an arm, is converted to a folder with the files

\b
  arm.xml                 the chain of links
  air.py, air.json        the air forces as passive forces; see air.py

This command needs the extra 'mujoco': pip install 'giajax[mujoco]', or in a checkout
pip install '.[mujoco]'.""",
    group="arm",
    old={"--out": "--to"},
)
def mjcf(
    source: Annotated[
        Path, argument("SOURCE", "MJCF or URDF file, TOML file of an arm, or fit of an arm.")
    ],
    diameter: Annotated[float | None, "M", "Link diameter for a file without geoms."] = None,
    to: Annotated[
        Path | None, "PATH", "Output file (TOML) or folder. [default: standard output]"
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Convert an arm from MJCF or URDF, or to MJCF.

    MJCF output includes a Python file for the air forces. Features that are lost are reported.
    """
    if not source.exists():
        raise InputError(
            f"{source} does not exist: give an MJCF or URDF file, the TOML file of an arm, or a fit"
        )
    configure()
    from ..apps.mjcf import export_mjcf, read_mjcf
    from ..models import arm_to_definition, parameter_values
    from ..recordings import to_toml, write_files

    if source.suffix.lower() in _THEIRS:
        read = read_mjcf(source, diameter=diameter)
        section = {"preset": "chain", **arm_to_definition(read.arm)}
        values = parameter_values(read.arm)
        stated = {path: value for path, value in values.items() if path in read.stated}
        section["parameters"] = {**section.get("parameters", {}), **stated}
        lost, text = read.lost, to_toml({"arm": section})
        if to is None:
            typer.echo(text, nl=False)
        else:
            write_files({to: text.encode()}, force=force)
            if not quiet:
                typer.echo(f"wrote {to}")
    else:
        if to is None:
            raise InputError(
                "the conversion writes three files: give a folder for them (--to FOLDER)"
            )
        if diameter is not None:
            raise InputError("--diameter applies to MuJoCo files only: omit --diameter")
        arm = driven_arm(source, None, None, quiet=quiet)[1].arm
        files, lost = export_mjcf(arm)
        contents = {name: text.encode() for name, text in files.items()}
        write_folder(to, contents, force=force)
        if not quiet:
            say_written(to, files)
    for sentence in () if quiet else lost:
        typer.echo(f"note: {sentence}", err=True)
