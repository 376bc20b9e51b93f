"""`giajax synth`: the recording that a run would be, if a model were true."""

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._errors import InputError
from ._drive import having, number

if TYPE_CHECKING:
    from ..runs import Run

EXAMPLES = """\b
Examples:
  giajax synth run.csv --out new.csv --noise position_m=0.01
  giajax synth run.csv --out new.csv --result giajax-out/run --correlated position_m=0.02
  giajax synth run.csv --out new.csv --set camera.rotation=0,0.087,0 --set camera.delay=0.05
  giajax synth run.csv --out new.csv --missing 5 --bursts 10 --burst-duration 2
  giajax synth run.csv --out new.csv --noise position_m=0.01 --outliers 1
                       --outlier-size position_m=0.5

\b
The run gives commands, times, columns and sidecar; any model will do. A truth of --set
stands in [truth] of the new sidecar alone, so that a fit has something to find.
KEY is one of the keys of [noise]: position_m, angle_deg, or a column such as link06_z_mm.
'giajax simulate' makes a first run from steps and ramps."""


def synth(
    run: Annotated[Path, typer.Argument(metavar="RUN.csv", help="The run to record again.")],
    out: Annotated[Path, typer.Option(metavar="NEW.csv", help="The run to write.")],
    result: Annotated[
        Path | None, typer.Option(metavar="DIR", help="A finished fit, whose model is true.")
    ] = None,
    settings: Annotated[
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
    from ..runs import read_run, sidecar_path, write_run

    if out.suffix != ".csv":
        raise InputError(f"--out is {out}; a run is written as .csv, so give such a name")
    for path in (out, sidecar_path(out)):
        if path.exists() and not force:
            raise InputError(f"{path} exists and is not written over; give another name or --force")
    recorded = read_run(run)

    from ._jax import configure

    configure()

    from ..fitting import load_result
    from ..models import model_for
    from ..simulation import SimulationError
    from ..synthetic import RecordingErrors, recorded_again

    model: Any = model_for([recorded]) if result is None else load_result(result).model
    model, paths = set_parameters(model, settings or [])
    errors = RecordingErrors(
        white=_deviations("--noise", noise, recorded, channels),
        correlated=_deviations("--correlated", correlated, recorded, channels),
        correlation_time=correlation_time,
        missing=missing / 100,
        bursts=bursts / 100,
        burst_duration=burst_duration,
        outliers=outliers / 100,
        outlier_size=_deviations("--outlier-size", outlier_size, recorded, channels),
    )
    try:
        new = recorded_again(
            model, recorded, errors, channels=channels, seed=seed, truth=paths, name=out.stem
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


def set_parameters(model: Any, settings: Sequence[str]) -> tuple[Any, list[str]]:
    """The model with the parameters that were set, and their paths."""
    paths = []
    for setting in settings:
        path, _, text = setting.rpartition("=")
        parts = text.split(",")
        values = [value for value in map(number, parts) if value is not None]
        if not path or len(values) < len(parts):
            raise InputError(
                f"--set {setting!r} must be PATH=VALUE with a number, or one for each element, "
                "such as camera.origin=0.1,0,0; correct it"
            )
        model = having(model, path, values, setting)
        paths.append(path.partition("[")[0])
    return model, list(dict.fromkeys(paths))


def _deviations(
    option: str, pairs: Sequence[str] | None, run: "Run", channels: Sequence[str] | None
) -> dict[str, float]:
    """What keys of [noise] say of each channel to record, SI."""
    from ..runs import Channel, Definition, stated_noise

    section: dict[str, float] = {}
    for pair in pairs or []:
        key, _, text = pair.partition("=")
        value = number(text)
        if not key or value is None:
            raise InputError(
                f"{option} {pair!r} must be KEY=VALUE, such as position_m=0.01; correct it"
            )
        section[key] = value
    if not section:
        return {}
    noise = Definition.parse({"noise": section}, option).noise
    names = channels or list(run.observations)
    found = {name: stated_noise(noise, Channel.named(name)) for name in names}
    deviations = {name: value for name, value in found.items() if value is not None}
    if not deviations:
        raise InputError(f"{option} is about none of the recorded channels; correct its key")
    return deviations
