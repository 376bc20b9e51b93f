"""`giajax synth`: the recording that a run would be, if a model were true."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from ._model import definition_of, model_of
from ._values import deviations, noise_section, settings, with_settings
from ._registry import command


@command("""\b
Examples:
  giajax synth run.csv --out new.csv --noise position_m=0.01
  giajax synth run.csv --out new.csv --model giajax-out/run --correlated position_m=0.02
  giajax synth run.csv --out new.csv --set camera.rotation=0,0.087,0 --set camera.delay=0.05
  giajax synth run.csv --out new.csv --missing 5 --bursts 10 --burst-duration 2
  giajax synth run.csv --out new.csv --noise position_m=0.01 --outliers 1
                       --outlier-size position_m=0.5

\b
The run gives commands, times, columns and sidecar; any model will do. A truth of --set
stands in [truth] of the new sidecar alone, so that a fit has something to find.
KEY is one of the keys of [noise]: position_m, angle_deg, or a column such as link06_z_mm.
MODEL is the folder of a fit, its result.json, or a TOML file whose [arm] (or other
section) states a model with all its parameters.
'giajax simulate' makes a first run from steps and ramps.""")
def synth(
    run: Annotated[Path, typer.Argument(metavar="RUN.csv", help="The run to record again.")],
    out: Annotated[Path, typer.Option(metavar="NEW.csv", help="The run to write.")],
    model: Annotated[
        Path | None,
        typer.Option(metavar="MODEL", help="What is true; see below. [the run's own model]"),
    ] = None,
    pairs: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="PATH=VALUE", help="A parameter of the truth. Repeatable."),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL", help="A channel to record. [those of the run]"),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Standard deviation of white noise. Repeatable."),
    ] = None,
    correlated: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Standard deviation of drifting noise. Repeatable."),
    ] = None,
    correlation_time: Annotated[
        float, typer.Option(metavar="S", help="How long a drift lasts, s.")
    ] = 0.5,
    missing: Annotated[
        float, typer.Option(metavar="PERCENT", help="Cells that are empty here and there.")
    ] = 0.0,
    bursts: Annotated[
        float, typer.Option(metavar="PERCENT", help="Samples of a link or joint lost in stretches.")
    ] = 0.0,
    burst_duration: Annotated[
        float, typer.Option(metavar="S", help="Length of such a stretch, s.")
    ] = 1.0,
    outliers: Annotated[
        float, typer.Option(metavar="PERCENT", help="Cells that are far off.")
    ] = 0.0,
    outlier_size: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="How far. Repeatable.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of all errors.")] = 0,
    digits: Annotated[
        int, typer.Option(metavar="N", min=3, max=17, help="Significant digits that are written.")
    ] = 9,
    force: Annotated[bool, typer.Option("--force", help="Write over a run.")] = False,
) -> None:
    """Record a run again, as its model or a fit predicts it, with errors of your choice.

    For a run of any model. Tests what a fit makes of noise, gaps, outliers and a frame that is
    off, before the experiment does.
    """
    from ..runs import check_output_run, read_run, sidecar_path, write_run

    check_output_run(out, force=force)
    values = settings(pairs)
    sections = {
        "white": noise_section(noise, "--noise"),
        "correlated": noise_section(correlated, "--correlated"),
        "outlier_size": noise_section(outlier_size, "--outlier-size"),
    }
    recorded = read_run(run, definition=definition_of(model))

    from ._jax import configure

    configure()

    from ..simulation import SimulationError
    from ..synthetic import RecordingErrors, recorded_again

    truth = with_settings(model_of(model, [recorded]), values)
    names = channels or list(recorded.observations)
    errors = RecordingErrors(
        white=deviations(sections["white"], "--noise", names),
        correlated=deviations(sections["correlated"], "--correlated", names),
        correlation_time=correlation_time,
        missing=missing / 100,
        bursts=bursts / 100,
        burst_duration=burst_duration,
        outliers=outliers / 100,
        outlier_size=deviations(sections["outlier_size"], "--outlier-size", names),
    )
    paths = list(dict.fromkeys(path.partition("[")[0] for path in values))
    try:
        new = recorded_again(
            truth, recorded, errors, channels=channels, seed=seed, truth=paths, name=out.stem
        )
    except SimulationError as error:
        typer.echo(f"giajax: {error}", err=True)
        raise typer.Exit(1) from None
    write_run(out, new.times, new.values, definition=new.definition, digits=digits, force=force)
    rows = len(next(iter(new.values.values())))
    typer.echo(
        f"wrote {out} and {sidecar_path(out)}: {rows} rows, {len(new.observations)} channels; "
        f"see: giajax check {shlex.quote(str(out))}"
    )
