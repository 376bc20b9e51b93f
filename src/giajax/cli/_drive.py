"""`giajax drive` and `view`: an arm in a browser, to drive it or to show recorded motion."""

import functools
import itertools
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
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
    Noise,
    Paths,
    Port,
    Quiet,
    Renamed,
    Settings,
    Texts,
    Wind,
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

    from ..apps.driving import Record, Session, TipCamera, Unfinished
    from ..apps.synthetic import Drive
    from ..models import ArmModel
    from ..recordings import Definition

# Interval at which rows of a drive are written, s: at most this much is lost in a crash.
_KEPT_S = 0.5

# Duration of the gusts, s, after which they repeat, and their rows per second.
_GUSTY, _GUST_RATE = 1800.0, 10.0


def driven_arm(
    what: Path | None, links: int | None, wind: str | None, *, quiet: bool
) -> "tuple[Definition, ArmModel]":
    """Return the definition from file and options, and the arm of the fit or of the file."""
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
    """Return gusts about a mean wind, or only the wind of the definition."""
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
    drives: "Drives",
    *,
    quiet: bool,
) -> None:
    """Drive the arm by a table of commands; print the progress if the output is shown."""
    from ..apps.driving import replay

    watched, said, kept = sys.stderr.isatty() and not quiet, -1, time.monotonic()

    def on_progress(done: float, whole: float) -> None:
        nonlocal said, kept
        if time.monotonic() - kept > _KEPT_S:
            drives.keep(deque())
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
    drives: "Drives",
    *,
    host: str,
    port: int,
    browser: bool,
    quiet: bool,
) -> None:
    """Serve the page until Ctrl-C, or until the operator ends the session."""
    from ..apps.driving import Cockpit

    cockpit = Cockpit(session, camera, host=host, port=port)
    try:
        ends = "ends the drive and saves it"
        say_served(cockpit, "can drive the arm", ends, browser=browser, quiet=quiet)
        while not cockpit.wait(_KEPT_S):
            drives.keep(cockpit.driven)
        if not cockpit.finished:
            raise cockpit.failure or InputError(cockpit.error or "the drive has ended")
    except KeyboardInterrupt:
        if not quiet:
            typer.echo("\nsaving the drive")
    finally:
        cockpit.close()
        drives.keep(cockpit.driven)


class Drives:
    """The drives of a session as files, each under its own name.

    The file of an unfinished drive is removed only after its run was written.

    Arguments:
        names: paths of the runs. The first one may be overwritten; each of the others must be new.
        complain: called with a sentence if a drive cannot be stored.
        how: arguments of `giajax.apps.driving.Record.run` after its channels.
    """

    def __init__(
        self,
        session: "Session",
        names: Iterator[Path],
        channels: list[str],
        *,
        force: bool,
        quiet: bool,
        complain: Callable[[str], None],
        **how: Any,
    ) -> None:
        self._session, self._names, self._channels = session, names, channels
        self._force, self._quiet, self._complain, self._how = force, quiet, complain, how
        self._begun: dict[Record, tuple[Path, Unfinished]] = {}
        self._failed = False
        self._files_of(session.record)

    def _files_of(self, record: "Record") -> "tuple[Path, Unfinished]":
        """Return the path of the run of a drive, and its unfinished run."""
        from ..apps.driving import Unfinished

        if record not in self._begun:
            out = next(self._names)
            kept = {"origin": self._how["origin"], "complain": self._complain}
            self._begun[record] = out, Unfinished(record, _files(out)[-1], **kept)
        return self._begun[record]

    def keep(self, driven: "deque[Record]") -> None:
        """Write the finished drives, and the rows of the current one since the last call."""
        while driven:
            # A drive stays in the queue until it is written, so that Ctrl-C does not lose it.
            try:
                self._save(driven[0])
            except InputError as error:
                self._failed = True
                self._complain(f"giajax: {error}")
            driven.popleft()
        try:
            _, unfinished = self._files_of(self._session.record)
        except InputError as error:
            self._failed = True
            self._complain(f"giajax: {error}")
        else:
            unfinished.add()

    def end(self) -> None:
        """Write the current drive.

        Raises:
            InputError: this drive or an earlier one could not be written.
        """
        self._save(self._session.record)
        if self._failed:
            raise InputError("not all drives of this session could be saved: see above")

    def _save(self, record: "Record") -> None:
        """Write a drive and describe it; a drive without motion is not written."""
        out, unfinished = self._files_of(record)
        try:
            run = record.run(self._channels, name=out.stem, **self._how)
            driven = f"{record.duration:.1f} s driven, "
            write_and_say(out, run, 12, force=self._force, quiet=self._quiet, what=driven)
        except InputError as error:
            if not record.is_still:
                unfinished.add()
                raise InputError(
                    f"{error}; the recorded part of the drive is in {unfinished.path}"
                ) from None
            typer.echo(f"giajax: {error}", err=True)
        unfinished.remove()
        del self._begun[record]
        if record.lost and not self._quiet:
            typer.echo(
                f"the simulation fell {record.lost:.1f} s behind real time, and did not catch up"
            )


def _free_names(to: Path | None) -> Iterator[Path]:
    """Yield paths of runs: first `to`, whether it exists or not, then paths that do not exist."""
    numbered = (
        (Path(f"drive-{number}.csv") for number in itertools.count(1))
        if to is None
        else (to.with_name(f"{to.stem}-{number}{to.suffix}") for number in itertools.count(2))
    )
    if to is not None:
        yield to
    yield from (name for name in numbered if not any(map(os.path.lexists, _files(name))))


def _files(out: Path) -> tuple[Path, Path, Path]:
    """Return the files of a drive: its run, its sidecar, and its unfinished run."""
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
the tip. Sliders and presets move any joint. If the pad or the connection is lost
or the browser tab is closed, the arm holds its position. Ctrl-C ends the drive and
saves it as a run that `giajax fit` can read. A pad file assigns sticks and buttons:

\b
  [pad]
  largest_rate_deg_per_s = 5.0
  axes = [{axis = 1, joints = [1, 3], rate_deg_per_s = -3.0}]
  buttons = [{button = 0, preset = "up"}, {button = 1, stop = true}]
  presets = [{name = "up", joints = [1], angles_deg = [20], others_deg = 0}]

\b
A table of pad inputs has the column time_s, one column for each axis (axis0,
axis1 and so on) and one for each button (button0, button1 and so on).
Each row applies until the time of the next row.""",
    group="plan",
    old={"--out": "--to", "--latency": "--image-delay", "--rate": "--pose-rate"},
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
    pairs: Settings = None,
    wind: Wind = None,
    gusts: Annotated[str | None, "I:L", "Intensity and length scale (m) of the gusts."] = None,
    compensate: Annotated[
        Path | None, "RESULT", "Fit of a hysteresis model, used to compensate for joint hysteresis."
    ] = None,
    no_memory: Annotated[bool, "Simulate the joints without hysteresis."] = False,
    image_delay: Annotated[float, "S", "Delay of the image from the camera at the tip."] = 0.2,
    pose_rate: Annotated[float, "HZ", "Number of poses per second."] = 30.0,
    steps: Annotated[int, "N", "Number of integration steps between successive poses.", 1] = 1,
    to: Annotated[
        Path | None,
        "RUN.csv",
        "Output file for the run. [default: drive-N.csv with the first unused N]",
    ] = None,
    channels: Annotated[
        Texts, "CHANNEL", "Channel to record, named as in 'giajax simulate'."
    ] = None,
    noise: Noise = None,
    every: Annotated[int, "N", "Record every N-th row.", 1] = 3,
    seed: Annotated[int, "N", "Seed of the random numbers for noise and gusts.", 0] = 0,
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
    names = _free_names(to)
    first = next(names)
    for path in (first, _files(first)[-1]):
        check_output_run(path, force=force)
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
        rate=pose_rate,
        steps=steps,
        gusts=wind_of(gusts, definition, model, seed, quiet=quiet),
        compensation=compensation,
        memory=not no_memory,
    )
    if table is not None:
        check_length(float(np.ptp(table["time_s"])), session.interval)
    drives = Drives(
        session, itertools.chain([first], names), recorded, force=force, quiet=quiet,
        complain=functools.partial(typer.echo, err=True),
        noise=section, every=every, seed=seed, origin=origin(context),
    )  # fmt: skip
    try:
        if table is not None:
            replay_table(session, table, drives, quiet=quiet)
        else:
            camera = TipCamera(model, image_delay)
            where: dict[str, Any] = {"host": host, "port": port, "browser": browser}
            serve(session, camera, drives, **where, quiet=quiet)
    finally:
        drives.end()


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

WHAT is a recorded or simulated run, the folder of a fit (or its result.json), the
output folder of giajax track, or the TOML file of an arm. TRUE.csv needs a sidecar
with an [arm] section.
The server listens on this machine only unless --host is given. The page opens only with
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
        Path | None, "TRUE.csv", "File with the true angles of all joints, shown as an overlay."
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
    """Show an arm in a browser, with balloons, markers and forces.

    The page also shows obstacles, recorded and modelled markers, and a time bar.
    """
    from ..recordings import check_output_files, parse_rename, read_run, write_files

    if page is not None:
        check_output_files([page], force=force)
    renamed = parse_rename(rename or [])
    for path in what:
        if not path.exists():
            raise InputError(
                f"{path} does not exist: give a run, the folder of a fit, or the "
                "TOML file of an arm"
            )
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
            "the TOML file of an arm contains no motion, so it must be the only argument: give one "
            "TOML file, or runs and fits"
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
