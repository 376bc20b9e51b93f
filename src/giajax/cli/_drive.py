"""`giajax drive` and `view`: an arm in a browser, driven or shown, and what a pad did."""

import functools
import itertools
import os
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Browser,
    Force,
    Host,
    Links,
    Paths,
    Port,
    Quiet,
    Renamed,
    Texts,
    argument,
    command,
    origin,
    say_served,
)
from ._model import is_result
from ._simulate import channel_names, definition_from_options, gusts_of, write_and_say
from ._values import noise_section, settings, with_settings

if TYPE_CHECKING:
    import numpy as np

    from ..apps.driving import Session, TipCamera, Unfinished
    from ..apps.synthetic import Drive
    from ..models import ArmModel
    from ..recordings import Definition

# Rows of a drive are on the disk so often, s: a kill loses no more.
_KEPT_S = 0.5

# Of gusts, s; then they begin again. And how often their rows are.
_GUSTY, _GUST_RATE = 1800.0, 10.0


def driven_arm(
    what: Path | None, links: int | None, wind: str | None, *, quiet: bool
) -> "tuple[Definition, ArmModel]":
    """What a file and the options say, and the arm: of a fit, or of a file."""
    from ..models import ArmModel

    if what is None or not is_result(what):
        definition = definition_from_options(what, links, wind, quiet=quiet)
        return definition, ArmModel.stated_in(definition)
    if links is not None:
        raise InputError("--links applies to an arm from a file, but a fit is given: omit --links")
    from ..fitting import load_result
    from ..recordings import stored_result

    stored_result(what)
    model = load_result(what).model
    if model.kind != ArmModel.kind:
        raise InputError(
            f"{what} is a fit of the {model.kind} model, which cannot be driven: give a fit of "
            "an arm"
        )
    return definition_from_options(None, None, wind, quiet=quiet), cast("ArmModel", model)


def wind_of(
    gusts: str | None, definition: "Definition", model: "ArmModel", seed: int, *, quiet: bool
) -> "Drive | None":
    """Gusts about a mean wind, or that wind alone."""
    import numpy as np

    from ..apps.synthetic import Drive
    from ..schema import WindSection

    if gusts is not None:
        sampling = {"duration": _GUSTY, "rate": _GUST_RATE, "seed": seed}
        wind, left_out = gusts_of(gusts, definition, None, model.arm, coherence=None, **sampling)
        if not quiet:
            typer.echo(left_out)
        return wind
    mean = definition.section(WindSection).velocity_m_per_s
    if mean is None:
        return None
    names = ("wind_x", "wind_y", "wind_z")
    values = {name: np.full(2, part) for name, part in zip(names, mean, strict=True)}
    return Drive(np.array([0.0, _GUSTY]), values, "linear")


def replay_table(
    session: "Session",
    table: "Mapping[str, np.ndarray]",
    unfinished: "Unfinished",
    *,
    quiet: bool,
) -> None:
    """Drive by a table; says how far it is, if the output is shown."""
    from ..apps.driving import replay

    watched, said, kept = sys.stderr.isatty() and not quiet, -1, time.monotonic()

    def on_progress(done: float, whole: float) -> None:
        nonlocal said, kept
        if time.monotonic() - kept > _KEPT_S:
            unfinished.add()
            kept = time.monotonic()
        if watched and (percent := int(100 * done / whole)) > said:
            said = percent
            print(f"\rdriven {done:.0f} of {whole:.0f} s", end="", file=sys.stderr, flush=True)

    replay(session, table, on_progress=on_progress)
    if watched:
        print(file=sys.stderr)


def serve(
    session: "Session",
    camera: "TipCamera",
    unfinished: "Unfinished",
    *,
    host: str,
    port: int,
    browser: bool,
    quiet: bool,
) -> None:
    """Serve the page until Ctrl-C, or until the operator ends the drive."""
    from ..apps.driving import Cockpit

    cockpit = Cockpit(session, camera, host=host, port=port)
    try:
        ends = "ends the drive and saves it"
        say_served(cockpit, "can drive the arm", ends, browser=browser, quiet=quiet)
        while not cockpit.wait(_KEPT_S):
            unfinished.add()
        if not cockpit.finished:
            raise cockpit.failure or InputError(cockpit.error or "the drive has ended")
    except KeyboardInterrupt:
        if not quiet:
            typer.echo("\nsaving the drive")
    finally:
        cockpit.close()


def save(
    session: "Session",
    unfinished: "Unfinished",
    out: Path,
    channels: list[str],
    *,
    force: bool,
    quiet: bool,
    **how: Any,
) -> None:
    """Write the drive, and say what is in it; one in which nothing was moved is not written.

    `how` is as of `giajax.apps.driving.Record.run`.
    """
    try:
        run = session.record.run(channels, name=out.stem, **how)
        driven = f"{session.time:.1f} s driven, "
        write_and_say(out, run, 12, force=force, quiet=quiet, what=driven)
    except InputError as error:
        if session.record.is_still:
            typer.echo(f"giajax: {error}", err=True)
            unfinished.remove()
            return
        unfinished.add()
        raise InputError(
            f"{error}; the recorded part of the drive is in {unfinished.path}"
        ) from None
    unfinished.remove()
    if session.lost and not quiet:
        typer.echo(
            f"the simulation fell {session.lost:.1f} s behind real time, and this time was skipped"
        )


def _files(out: Path) -> tuple[Path, Path, Path]:
    """The files of a drive: its run, the sidecar, and what is there of it until it is saved."""
    return out, out.with_suffix(".toml"), out.with_name(f"{out.stem}-unfinished.csv")


@command(
    """\b
Examples:
  giajax drive              drive the paper's arm in a browser
  giajax drive giajax-out/run
                            drive the arm of a fit
  giajax drive my_arm.toml --gusts 0.3:5 --wind 0,0.2,0
                            drive your arm in gusts
  giajax drive my_arm.toml --pad my_pad.toml --to monday.csv
                            use your assignment of sticks and buttons
  giajax drive --replay pad.csv --to again.csv
                            replay pad inputs as fast as possible

WHAT is the folder of a fit, or the TOML file of an arm. Sticks bend the base and
the tip; sliders and presets move any joint. If the pad, the browser tab or the
connection is lost, the arm holds its position. Ctrl-C ends the drive and saves it
as a run that giajax fit can read. A pad file assigns sticks and buttons:

\b
  [pad]
  largest_rate_deg_per_s = 5.0
  axes = [{axis = 1, joints = [1, 3], rate_deg_per_s = -3.0}]
  buttons = [{button = 0, preset = "up"}, {button = 1, stop = true}]
  presets = [{name = "up", joints = [1], angles_deg = [20], others_deg = 0}]

\b
A table of pad inputs has the columns time_s, axis0 (axis1 and so on) and
button0 (button1 and so on). Each row applies until the time of the next row.""",
    group="plan",
    old={"--out": "--to"},
)
def drive(
    context: typer.Context,
    what: Annotated[Path | None, argument("WHAT", "See below.")] = None,
    pad: Annotated[
        Path | None, "FILE.toml", "File that assigns the sticks and buttons of the pad; see below."
    ] = None,
    replay: Annotated[
        Path | None, "PAD.csv", "Replay a table of pad inputs without opening a page."
    ] = None,
    links: Links = None,
    pairs: Annotated[Texts, "PATH=VALUE", "Value of a parameter.", "--set"] = None,
    wind: Annotated[str | None, "X,Y,Z", "Mean wind velocity (m/s)."] = None,
    gusts: Annotated[
        str | None, "I:L", "Intensity and length scale (m) of gusts about --wind."
    ] = None,
    compensate: Annotated[
        Path | None, "RESULT", "Fit of the hysteresis of a joint, used for compensation."
    ] = None,
    no_memory: Annotated[bool, "Simulate the joints without hysteresis."] = False,
    latency: Annotated[float, "S", "Delay of the image from the camera at the tip."] = 0.2,
    rate: Annotated[float, "HZ", "Number of poses per second."] = 30.0,
    steps: Annotated[int, "N", "Integration steps in each interval.", 1] = 1,
    to: Annotated[
        Path | None,
        "RUN.csv",
        "Output file for the run. [default: drive-N.csv with the next free N]",
    ] = None,
    channels: Annotated[Texts, "CHANNEL", "Channel to record, named as in giajax simulate."] = None,
    noise: Annotated[Texts, "KEY=VALUE", "Noise standard deviation for a key of [noise]."] = None,
    every: Annotated[int, "N", "Record every N-th row.", 1] = 3,
    seed: Annotated[int, "N", "Seed of noise and gusts.", 0] = 0,
    host: Host = "127.0.0.1",
    port: Port = 0,
    browser: Browser = True,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Drive an arm in a browser with a game pad or sliders.

    The simulation runs in real time.

    The page shows the image of a camera at the tip. Gusts are optional. Each drive is saved as a
    run.
    """
    from ..recordings import check_output_run, stored_result

    section = noise_section(noise, "--noise")
    if to is None:
        names = (Path(f"drive-{number}.csv") for number in itertools.count(1))
        to = next(n for n in names if not any(map(os.path.lexists, _files(n))))
    check_output_run(to, force=force)
    part = _files(to)[-1]
    check_output_run(part, force=force)
    values = settings(pairs)
    if what is not None and not what.exists():
        raise InputError(f"{what} does not exist: give the folder of a fit or the file of an arm")
    configure()
    import numpy as np

    from ..apps.control import compensator_for_model
    from ..apps.driving import (
        Compensation,
        PadMapping,
        Session,
        TipCamera,
        Unfinished,
        check_length,
        read_pad,
    )
    from ..fitting import load_result

    table = None if replay is None else read_pad(replay)
    definition, model = driven_arm(what, links, wind, quiet=quiet)
    model = with_settings(model, values)
    count = model.arm.count
    recorded = channel_names(channels or [], count)
    compensation = None
    if compensate is not None:
        stored_result(compensate)
        compensator = compensator_for_model(load_result(compensate).model)
        compensation = Compensation(compensator, count)
    session = Session(
        model,
        PadMapping.usual(count) if pad is None else PadMapping.load(pad, count),
        rate=rate,
        steps=steps,
        gusts=wind_of(gusts, definition, model, seed, quiet=quiet),
        compensation=compensation,
        memory=not no_memory,
    )
    if table is not None:
        check_length(float(np.ptp(table["time_s"])), session.interval)
    say = functools.partial(typer.echo, err=True)
    unfinished = Unfinished(session.record, part, origin=origin(context), complain=say)
    try:
        if table is not None:
            replay_table(session, table, unfinished, quiet=quiet)
        else:
            camera = TipCamera(model, latency)
            where: dict[str, Any] = {"host": host, "port": port, "browser": browser}
            serve(session, camera, unfinished, **where, quiet=quiet)
    finally:
        save(
            session, unfinished, to, recorded, noise=section, every=every, seed=seed,
            origin=origin(context), force=force, quiet=quiet,
        )  # fmt: skip


@command(
    """\b
Examples:
  giajax view giajax-out/run
                            show the fitted arm and the recorded markers
  giajax view giajax-out/a giajax-out/b
                            show two fits side by side
  giajax view run.csv --page run.html
                            write a page that plays without a server
  giajax view my_arm.toml   show an arm with a slider for each joint
  giajax view tracked --truth true.csv
                            show a tracked arm with uncertainty bands
  giajax view run.csv --no-browser --host 0.0.0.0 --port 8100
                            serve a browser on another machine

WHAT is a recorded or simulated run, the folder of a fit (or its result.json) or
of a track, or the TOML file of an arm. TRUE.csv needs a sidecar with an [arm] section.
The server listens on this machine only unless --host is given. The page opens only by
its full address, which contains a token.""",
    group="first",
    old={"--out": "--page"},
)
def view(
    what: Annotated[list[Path], argument("WHAT", "See below.")],
    data: Annotated[Paths, "RUN.csv", "New path of a fitted run whose file was moved."] = None,
    run: Annotated[
        str | None,
        "NAME",
        "Name of the run to show if the fit has several runs. [default: the first]",
    ] = None,
    rename: Renamed = None,
    truth: Annotated[
        Path | None, "TRUE.csv", "File with the true angles of all joints, drawn over the arm."
    ] = None,
    overlay: Annotated[bool, "Overlay the arms instead of placing them side by side."] = False,
    page: Annotated[Path | None, "FILE.html", "Write a page that plays without a server."] = None,
    dark: Annotated[bool, "Use a dark background for --page."] = False,
    host: Host = "127.0.0.1",
    port: Port = 0,
    browser: Browser = True,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show an arm in a browser: balloons, markers, forces.

    Shows obstacles, recorded and modelled markers, and a time bar.
    """
    from ..recordings import check_output_files, parse_rename, read_run, write_files

    if page is not None:
        check_output_files([page], force=force)
    renamed = parse_rename(rename or [])
    for path in what:
        if not path.exists():
            raise InputError(f"{path} does not exist: give a run, the folder of a fit, or an arm")
    true = None if truth is None else read_run(truth, rename=renamed)
    configure()
    import numpy as np

    from ..apps.viewer import Posable, Viewer, check_viser, posed, recording, shown

    check_viser()
    names: list[str | None] = [None] * len(what)
    if len({path.stem for path in what}) < len(what):
        names = [str(path) for path in what]
    found = [
        shown(path, data=data or [], rename=renamed, run=run, name=name)
        for path, name in zip(what, names, strict=True)
    ]
    if true is not None:
        found, overlay = [*found, posed(true, "truth")], True
    if len(found) > 1 and any(isinstance(each, Posable) for each in found):
        raise InputError(
            "a TOML file that states no motion must be the only argument: give one TOML file, or "
            "runs and fits"
        )
    if page is not None:
        shows = [
            each.show(np.zeros(each.arm.count)) if isinstance(each, Posable) else each
            for each in found
        ]
        content = recording(shows, overlay=overlay, dark=dark)
        write_files({page: content}, force=force)
        if not quiet:
            typer.echo(f"wrote {page} ({len(content) / 1e6:.1f} MB): open it in a browser")
        return
    viewer = Viewer(found, overlay=overlay, host=host, port=port)
    try:
        say_served(viewer, "can see the page", "stops the server", browser=browser, quiet=quiet)
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        if not quiet:
            typer.echo("ended")
    finally:
        viewer.close()
