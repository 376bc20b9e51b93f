"""`giajax simulate`: a run made by the model.

The file is longer than 200 lines because it declares each option with its help.
"""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._errors import InputError
from ._channel_names import channel_names
from ._driven import (
    DURATION,
    definition_from_options,
    drives_of,
    facts_of,
    model_and_truth,
    moves_of,
    replayed_run,
)
from ._gusts import gusts_of
from ._origin import origin
from ._values import deviations, noise_section
from ._registry import command

if TYPE_CHECKING:
    from ..runs import Run


@command("""\b
Examples:
  giajax simulate --out run.csv --ramp 1=30
  giajax simulate --out run.csv --step 1=30@0.5 --step 1=0@10 --missing 10
                  --noise position_m=0.02 --noise angle_deg=0.5
  giajax simulate --out run.csv --command logged.csv --set air.drag_coefficient=1.0
  giajax simulate --out run.csv --arm my_arm.toml --ramp 2=-20@1:3 --channels all
                  --set camera.origin=0.1,0,0
  giajax simulate --out run.csv --wind 0,0.2,0 --gusts 0.3:5 --coherence 12

\b
CHANNELS is link06 (its x, y and z), link06_z, tip, joint03_angle, joint03_rate,
'joints' (all angles) or 'all' (every link). A row is added at each corner of a
command that no sample falls on.""")
def simulate(
    context: typer.Context,
    out: Annotated[Path, typer.Option(metavar="RUN.csv", help="The run to write.")],
    arm: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.toml",
            help="The arm: [arm], [initial], [command] and [wind] of this file.",
        ),
    ] = None,
    links: Annotated[int | None, typer.Option(metavar="N", help="Number of links.")] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="PATH=VALUE", help="A parameter ('giajax parameters'). Repeatable."
        ),
    ] = None,
    step: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=DEG[@T]", help="Step of a command, at 0.5 s by default. Repeatable."
        ),
    ] = None,
    ramp: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT=DEG[@START:DURATION]",
            help="Linear change of a command, by default from 0.5 s for 1 s. Repeatable.",
        ),
    ] = None,
    command: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="A run whose commands and wind are used instead."),
    ] = None,
    wind: Annotated[
        str | None, typer.Option(metavar="X,Y,Z", help="Constant velocity of the air, m/s.")
    ] = None,
    gusts: Annotated[
        str | None,
        typer.Option(
            metavar="I:L", help="Gusts about --wind: turbulence intensity and length scale, m."
        ),
    ] = None,
    coherence: Annotated[
        float | None,
        typer.Option(
            metavar="DECAY",
            help="Gusts of each link, coherent over distances with this decay (IEC 61400-1: 12); "
            "else they are the same along the whole arm.",
        ),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", help="Length of the run, s. [default: 25, or that of --command]"),
    ] = None,
    rate: Annotated[float, typer.Option(metavar="HZ", help="Samples per second.")] = 10.0,
    channels: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CHANNELS",
            help="What is recorded, see below. Repeatable. [default: links 2, 6, 12, 20 and tip]",
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE", help="Standard deviation, by a key of [noise]. Repeatable."
        ),
    ] = None,
    missing: Annotated[
        float, typer.Option(metavar="PERCENT", help="Share of each channel that is left empty.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of noise, gaps and gusts.")] = 0,
    solver: Annotated[
        str, typer.Option(metavar="NAME", help="Integration method, such as tsit5, springs5.")
    ] = "tsit5",
    tolerance: Annotated[
        float, typer.Option(metavar="TOL", help="Tolerance of the integration.")
    ] = 1e-7,
    digits: Annotated[
        int, typer.Option(metavar="N", min=3, max=17, help="Significant digits that are written.")
    ] = 9,
    force: Annotated[bool, typer.Option("--force", help="Write over a run.")] = False,
) -> None:
    """Simulate an arm and write a run that `giajax fit` reads.

    The sidecar beside it states the arm, the noise, the truth and this command line.
    """
    from ..runs import Definition, check_output_run

    _check_numbers(missing=missing, tolerance=tolerance)
    section = noise_section(noise, "--noise")
    check_output_run(out, force=force)
    definition = definition_from_options(arm, links, wind)
    replayed = replayed_run(command, definition, step or ramp)

    from ._jax import configure

    configure()

    from ..simulation import SimulationError
    from ..synthetic import Drive, sampled, synthesise

    model, truth = model_and_truth(definition, settings or [], solver, tolerance)
    count = model.arm.count
    start, drives = 0.0, list[Drive]()
    if replayed is not None:
        start, length, drives = drives_of(replayed, rate)
        duration = length if duration is None else duration
    duration = DURATION if duration is None else duration
    if step or ramp:
        drives = [moves_of(step or [], ramp or [], count, duration)]
    if coherence is not None and gusts is None:
        raise InputError("--coherence is of gusts, and there are none: give --gusts, too")
    left_out = ""
    if gusts is not None:
        sampling: dict[str, Any] = {"start": start, "duration": duration, "rate": rate}
        sampling |= {"coherence": coherence, "seed": seed}
        wind_rows, left_out = gusts_of(gusts, definition, replayed, model.arm, **sampling)
        drives.append(wind_rows)
        typer.echo(f"{left_out} (option --rate)")
    recorded = channel_names(channels or [], count)
    deviations(section, "--noise", recorded)
    facts = facts_of(definition, replayed, drives, model)
    # What follows is a comment to a shell; [truth] has parameters only.
    facts["origin"] = origin(context) + (f"  # {left_out}" if left_out else "")
    facts["noise"] = {key: deviation for key, deviation in section.items() if deviation}
    times, inputs = sampled(drives, start=start, duration=duration, rate=rate)
    try:
        run = synthesise(
            model,
            _as_written("time", times, max(digits, 12)),
            {name: _as_written(name, values, digits) for name, values in inputs.items()},
            recorded,
            missing=missing / 100,
            seed=seed,
            definition=Definition.parse({**facts, "truth": truth}, "simulate"),
            name=out.stem,
        )
    except SimulationError as error:
        typer.echo(f"giajax: {error} (options --tolerance, --solver, --set)", err=True)
        raise typer.Exit(1) from None
    _write(out, run, digits, force)


def _write(out: Path, run: "Run", digits: int, force: bool) -> None:
    from ..runs import sidecar_path, write_run

    write_run(out, run.times, run.values, definition=run.definition, digits=digits, force=force)
    rows = 0 if run.times is None else len(run.times)
    typer.echo(
        f"wrote {out} and {sidecar_path(out)}: {rows} rows, {len(run.observations)} channels; "
        f"see: giajax check {shlex.quote(str(out))}"
    )


def _check_numbers(*, missing: float, tolerance: float) -> None:
    if not 0 <= missing < 100:
        raise InputError(f"--missing is {missing:g} %: give at least 0 and less than 100")
    if not 0 < tolerance <= 0.1:
        raise InputError(f"--tolerance is {tolerance:g}: give a positive number of at most 0.1")


def _as_written(name: str, values: Any, digits: int) -> Any:
    """Values as they are when the file is read again, which is what the arm is to follow."""
    from dataclasses import replace

    from ..runs import Channel

    channel = Channel.named(name)
    if channel.quantity == "angle":
        channel = replace(channel, unit="deg")
    return channel.to_si([float(f"{value:.{digits}g}") for value in channel.from_si(values)])
