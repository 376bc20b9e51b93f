"""`giajax drive`: the operator's page, or what a pad did, without one."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from ._channel_names import channel_names
from ._driving import (
    compensation_of,
    driven_arm,
    free_name,
    mapping_of,
    replay_table,
    save,
    serve,
    wind_of,
)
from ._origin import origin
from ._values import noise_section, settings, with_settings

EXAMPLES = """\b
Examples:
  giajax drive                          the paper's arm, in a browser
  giajax drive giajax-out/run           the arm of a fit
  giajax drive my_arm.toml --gusts 0.3:5 --wind 0,0.2,0
  giajax drive my_arm.toml --pad my_pad.toml --out monday.csv
  giajax drive --replay pad.csv --out again.csv
                                        what a pad did, as fast as it goes

\b
WHAT is the folder of a fit, or the TOML file of an arm. Sticks bend the base and
the tip, sliders and presets any joint; where the pad, the tab or its connection
is gone, the arm holds. The drive ends by Ctrl-C, and is saved as a run that
giajax fit reads. A pad file says what sticks and buttons do:

\b
  [pad]
  largest_rate_deg_per_s = 5.0
  axes = [{axis = 1, joints = [1, 3], rate_deg_per_s = -3.0}]
  buttons = [{button = 0, preset = "up"}, {button = 1, stop = true}]
  presets = [{name = "up", joints = [1], angles_deg = [20], others_deg = 0}]

\b
A table of a pad has the columns time_s, axis0, axis1, ..., button0, ...; a row
holds until the next one."""


def drive(
    context: typer.Context,
    what: Annotated[Path | None, typer.Argument(metavar="WHAT", help="See below.")] = None,
    pad: Annotated[
        Path | None, typer.Option(metavar="FILE.toml", help="What the pad does; see below.")
    ] = None,
    replay: Annotated[
        Path | None, typer.Option(metavar="PAD.csv", help="Drive by a table, without a page.")
    ] = None,
    links: Annotated[int | None, typer.Option(metavar="N", help="Number of links.")] = None,
    pairs: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="A parameter. Repeatable."),
    ] = None,
    wind: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Mean velocity of the air, m/s.")
    ] = None,
    gusts: Annotated[
        str | None,
        typer.Option(metavar="I:L", help="Gusts about --wind: intensity, and length scale, m."),
    ] = None,
    compensate: Annotated[
        Path | None,
        typer.Option(metavar="RESULT", help="A fit of a joint's hysteresis, to be undone."),
    ] = None,
    no_memory: Annotated[
        bool, typer.Option("--no-memory", help="Leave out what joints remember.")
    ] = False,
    latency: Annotated[
        float, typer.Option(metavar="S", help="Of the picture of the camera at the tip.")
    ] = 0.2,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Poses a second.")] = 30.0,
    steps: Annotated[
        int, typer.Option(metavar="N", min=1, help="Steps of the integrator in each.")
    ] = 1,
    out: Annotated[
        Path | None,
        typer.Option(metavar="RUN.csv", help="The run to write. [default: drive-1.csv, or -2 ...]"),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNELS", help="What is recorded, as of simulate. Repeatable."),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Standard deviation, by a key of [noise]."),
    ] = None,
    every: Annotated[
        int, typer.Option(metavar="N", min=1, help="One row in so many is recorded.")
    ] = 3,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of noise and gusts.")] = 0,
    host: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where to listen; 0.0.0.0: everywhere.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(metavar="N", help="Where to listen; 0 for a free one.")] = 0,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open a browser, or only say where.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="Write over a run.")] = False,
) -> None:
    """Drive an arm: with a game pad or sliders, in a browser, in real time.

    The picture of a camera at the tip, gusts, and every drive saved as a run.
    """
    from ..runs import check_output_run

    section = noise_section(noise, "--noise")
    out = free_name() if out is None else out
    check_output_run(out, force=force)
    values = settings(pairs)
    if what is not None and not what.exists():
        raise InputError(f"{what} does not exist: give the folder of a fit, or the file of an arm")

    from ._jax import configure

    configure()
    import numpy as np

    from ..driving import Session, TipCamera, check_length, read_pad

    table = None if replay is None else read_pad(replay)
    definition, model = driven_arm(what, links, wind)
    model = with_settings(model, values)
    count = model.arm.count
    recorded = channel_names(channels or [], count)
    session = Session(
        model,
        mapping_of(pad, count),
        rate=rate,
        steps=steps,
        gusts=wind_of(gusts, definition, model, seed),
        compensation=compensation_of(compensate, count),
        memory=not no_memory,
    )
    if table is not None:
        check_length(float(np.ptp(table["time_s"])), session.interval)
    try:
        if table is not None:
            replay_table(session, table)
        else:
            camera = TipCamera(model, latency)
            serve(session, camera, host=host, port=port, browser=browser)
    finally:
        save(
            session, out, recorded,
            noise=section, every=every, seed=seed, origin=origin(context), force=force,
        )  # fmt: skip
