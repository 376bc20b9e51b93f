"""`giajax view`: an arm in three dimensions, in a browser."""

import time
from pathlib import Path
from typing import Annotated

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import Paths, argument, command
from ._options import Browser, ForceFile, Host, Port, Renamed, say_served


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
    run: Annotated[str | None, "NAME", "Which run of a fit of several (the first)."] = None,
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
    from ..recordings import check_output_files, parse_rename, write_files

    if out is not None:
        check_output_files([out], force=force)
    renamed = parse_rename(rename or [])
    for path in what:
        if not path.exists():
            raise InputError(f"{path} does not exist: give a run, the folder of a fit, or an arm")
    configure()
    import numpy as np

    from ..apps.viewer import Posable, Viewer, check_viser, recording, shown

    check_viser()
    names: list[str | None] = [None] * len(what)
    if len({path.stem for path in what}) < len(what):
        names = [str(path) for path in what]
    found = [
        shown(path, data=data or [], rename=renamed, run=run, name=name)
        for path, name in zip(what, names, strict=True)
    ]
    if len(found) > 1 and any(isinstance(each, Posable) for each in found):
        raise InputError(
            "an arm without a motion is shown by itself: give one TOML file, or runs and fits"
        )
    if out is not None:
        shows = [
            each.show(np.zeros(each.arm.count)) if isinstance(each, Posable) else each
            for each in found
        ]
        page = recording(shows, overlay=overlay, dark=dark)
        write_files({out: page}, force=force)
        typer.echo(f"wrote {out} ({len(page) / 1e6:.1f} MB): open it in a browser")
        return
    viewer = Viewer(found, overlay=overlay, host=host, port=port)
    try:
        say_served(viewer, "sees the page", "ends it", browser=browser)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        typer.echo("ended")
    finally:
        viewer.close()
