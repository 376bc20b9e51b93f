"""`giajax mjcf`: arms for MuJoCo, and from it."""

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
                            the arm of a file of MuJoCo
  giajax mjcf robot.urdf --diameter 0.05
                            that of a URDF without geoms, as text
  giajax mjcf arm.toml --to arm
                            an arm for MuJoCo, into the folder arm
  giajax mjcf giajax-out/run --to arm
                            the arm of a fit

Of a file of MuJoCo it makes the [arm] of a sidecar; of an arm, or of a fit of one, a folder:

\b
  arm.xml                 the chain
  air.py, air.json        the air on it as passive forces; air.py shows how

Needs pip install 'giajax[mujoco]'.""",
    group="arm",
    old={"--out": "--to"},
)
def mjcf(
    source: Annotated[Path, argument("SOURCE", "MJCF, URDF, the TOML of an arm, or a fit.")],
    diameter: Annotated[float | None, "M", "Of the links of a file without geoms."] = None,
    to: Annotated[Path | None, "PATH", "Write the TOML, or the folder; else the text."] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Convert an arm from MJCF or URDF, or into MJCF.

    With a Python file of the air. What is lost on the way is said.
    """
    if not source.exists():
        raise InputError(f"{source} does not exist: give MJCF, URDF, an arm's TOML, or a fit")
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
            raise InputError("three files are written: give --to FOLDER")
        if diameter is not None:
            raise InputError("--diameter is of a file of MuJoCo, and links have one: leave it out")
        arm = driven_arm(source, None, None, quiet=quiet)[1].arm
        files, lost = export_mjcf(arm)
        contents = {name: text.encode() for name, text in files.items()}
        write_folder(to, contents, force=force)
        if not quiet:
            say_written(to, files)
    for sentence in () if quiet else lost:
        typer.echo(f"note: {sentence}", err=True)
