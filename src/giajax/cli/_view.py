"""`giajax view`: an arm in three dimensions, in a browser."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.text import InputError
from ._commands import Paths, argument, command
from ._options import Browser, ForceFile, Host, Port, Renamed

if TYPE_CHECKING:
    from ..apps.viewer import Posable, Show


@command("""\b
Examples:
  giajax view giajax-out/run            a fit: the arm as fitted, and what was seen
  giajax view giajax-out/a giajax-out/b two fits, side by side
  giajax view run.csv --out run.html    a file that plays without a server
  giajax view my_arm.toml               an arm, with a slider for each joint
  giajax view run.csv --no-browser --host 0.0.0.0 --port 8100
                                        for a browser on another machine

\b
WHAT is a recorded or simulated run, the folder of a fit (or its result.json), or
the TOML file of an arm. The page listens on this machine alone unless --host says
otherwise, and opens only by its whole address, which has a token in it.""")
def view(
    what: Annotated[list[Path], argument("WHAT...", "See below.")],
    data: Annotated[Paths, "RUN.csv", "A fitted run, if it has moved."] = None,
    run: Annotated[
        str | None, "NAME", "Which run of a fit of several; the first by default."
    ] = None,
    rename: Renamed = None,
    overlay: Annotated[bool, "All in one place instead of side by side."] = False,
    out: Annotated[Path | None, "FILE.html", "Write a file that plays without a server."] = None,
    dark: Annotated[bool, "Of --out: light on dark."] = False,
    host: Host = "127.0.0.1",
    port: Port = 0,
    browser: Browser = True,
    force: ForceFile = False,
) -> None:
    """Show an arm in a browser: balloons, markers, forces, surroundings.

    Recorded markers beside those of the model, and a time bar.
    """
    from ..recordings import check_output_files, parse_rename

    if out is not None:
        check_output_files([out], force=force)
    renamed = parse_rename(rename or [])
    for path in what:
        if not path.exists():
            raise InputError(f"{path} does not exist: give a run, the folder of a fit, or an arm")
    from ..runtime.process import configure

    configure()
    from ..apps.viewer import check_viser, shown

    check_viser()
    names: list[str | None] = [None] * len(what)
    if len({path.stem for path in what}) < len(what):
        names = [str(path) for path in what]
    found = [
        shown(path, data=data or [], rename=renamed, run=run, name=name)
        for path, name in zip(what, names, strict=True)
    ]
    _check_together(found)
    if out is not None:
        _write(found, out, overlay=overlay, dark=dark, force=force)
    else:
        _serve(found, overlay=overlay, host=host, port=port, browser=browser)


def _check_together(found: "list[Show | Posable]") -> None:
    from ..apps.viewer import Posable

    if len(found) > 1 and any(isinstance(each, Posable) for each in found):
        raise InputError(
            "an arm without a motion is shown by itself: give one TOML file, or runs and fits"
        )


def _write(
    found: "list[Show | Posable]", out: Path, *, overlay: bool, dark: bool, force: bool
) -> None:
    import numpy as np

    from ..apps.viewer import Posable, recording
    from ..recordings import write_files

    shows = [
        each.show(np.zeros(each.arm.count)) if isinstance(each, Posable) else each for each in found
    ]
    page = recording(shows, overlay=overlay, dark=dark)
    write_files({out: page}, force=force)
    typer.echo(f"wrote {out} ({len(page) / 1e6:.1f} MB): open it in a browser")


def _serve(
    found: "list[Show | Posable]", *, overlay: bool, host: str, port: int, browser: bool
) -> None:
    from ..apps.viewer import Viewer, open_in_browser

    viewer = Viewer(found, overlay=overlay, host=host, port=port)
    try:
        typer.echo(f"open {viewer.address}")
        if viewer.is_open:
            typer.echo("whoever has this address sees the page, from other machines, too")
        typer.echo("Ctrl-C ends it")
        if browser:
            open_in_browser(viewer.address)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        typer.echo("ended")
    finally:
        viewer.close()
