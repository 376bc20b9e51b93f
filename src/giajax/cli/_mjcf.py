"""`giajax mjcf`: arms for MuJoCo, and from it."""

from pathlib import Path
from typing import Annotated

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import Force, argument, command, say_written, write_folder
from ._drive import driven_arm

_THEIRS = (".xml", ".mjcf", ".urdf")


@command("""\b
Examples:
  giajax mjcf robot.xml --out arm.toml
  giajax mjcf robot.urdf --diameter 0.05
  giajax mjcf arm.toml --out arm
  giajax mjcf giajax-out/run --out arm

\b
Of a file of MuJoCo it makes the [arm] of a sidecar; of an arm, or of a fit of one, it writes
  arm.xml                 the chain
  air.py, air.json        the air on it as passive forces; the text of air.py shows its use

Needs pip install 'giajax[mujoco]'.""")
def mjcf(
    source: Annotated[Path, argument("SOURCE", "MJCF, URDF, the TOML of an arm, or a fit.")],
    diameter: Annotated[float | None, "M", "Of the links of a file without geoms."] = None,
    out: Annotated[Path | None, "PATH", "Write the TOML, or the folder; else the text."] = None,
    force: Force = False,
) -> None:
    """Convert an arm from MJCF or URDF, or into MJCF with a Python file of the air.

    What is lost on the way is said.
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
        if out is None:
            typer.echo(text, nl=False)
        else:
            write_files({out: text.encode()}, force=force)
            typer.echo(f"wrote {out}")
    else:
        if out is None:
            raise InputError("three files are written: give --out FOLDER")
        if diameter is not None:
            raise InputError("--diameter is of a file of MuJoCo, and links have one: leave it out")
        arm = driven_arm(source, None, None)[1].arm
        files, lost = export_mjcf(arm)
        contents = {name: text.encode() for name, text in files.items()}
        write_folder(out, contents, force=force)
        say_written(out, files)
    for sentence in lost:
        typer.echo(f"note: {sentence}", err=True)
