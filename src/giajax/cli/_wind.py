"""`giajax wind`: the wind acting on a resting arm, estimated from its motion."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from ..runtime.process import configure
from ..runtime.text import InputError, format_estimate
from ._commands import (
    Force,
    Json,
    OnlyChannels,
    Quiet,
    Renamed,
    Texts,
    argument,
    check_quiet,
    command,
    print_table,
    say_progress,
    say_written,
    write_folder,
)
from ._model import definition_of, model_of
from ._simulate import gust_numbers
from ._values import velocity

if TYPE_CHECKING:
    from ..apps.wind import WindFit
    from ..models import ArmModel

_FILES = ("wind.json", "wind.png")


@command(
    """\b
Examples:
  giajax wind --data resting.csv --wind 0,0.2,0
                            use an initial mean flow along y
  giajax wind giajax-out/run --data resting.csv --out wind
                            use the fitted arm, and write files
  giajax wind --data resting.csv --wind 0,0.2,0 --free decay --skip 60 --json
                            also fit the decay, and omit the first minute

MODEL is the folder of a fit, its result.json, or a TOML file with an [arm] section.
The default is the arm of the sidecar. NAME is speed, deviation or length_scale
(which are free by default), or decay, heading or climb (which are fixed by default).""",
    group="plan",
    pictures=True,
    old={"--model": "MODEL"},
)
def wind(
    data: Annotated[Path, "RUN.csv", "A run with constant commands."],
    model: Annotated[Path | None, argument("MODEL", "The arm; see below.")] = None,
    mean: Annotated[
        str | None,
        "X,Y,Z",
        "Initial mean wind velocity (m/s), whose direction is fixed by default. [default: from the "
        "run or the arm]",
        "--wind",
    ] = None,
    gusts: Annotated[str, "I:L", "Initial intensity and length scale (m) of the gusts."] = "0.2:5",
    coherence: Annotated[
        float, "DECAY", "Decay coefficient of the gust coherence with distance (12 in IEC 61400-1)."
    ] = 12.0,
    free: Annotated[Texts, "NAME", "Also fit this parameter of the wind."] = None,
    hold: Annotated[Texts, "NAME", "Fix this parameter of the wind."] = None,
    no_mean: Annotated[
        bool, "Use only the motion about the mean position, not the mean position itself."
    ] = False,
    skip: Annotated[
        float | None, "S", "Omit the first S seconds. [default: until the arm is at rest]"
    ] = None,
    highest: Annotated[
        float | None,
        "HZ",
        "Highest frequency that is fitted. [default: half the Nyquist frequency]",
    ] = None,
    channels: OnlyChannels = None,
    rename: Renamed = None,
    out: Annotated[Path | None, "DIR", "Folder for wind.json and wind.png."] = None,
    as_json: Json = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Fit mean flow and gusts to the recording of a resting arm.

    The arm is linearised about its equilibrium, and its spectra and means in von Karman gusts are
    fitted to those of the recorded channels. The gusts over time are not estimated.
    """
    from ..recordings import check_output_folder, observing, parse_rename, read_run

    check_quiet(quiet, written=out, as_json=as_json, by="--out DIR or --json")
    if out is not None:
        check_output_folder(out, _FILES, force=force)
    parts, length_scale = gust_numbers(gusts)
    begin = None if mean is None else velocity(mean, "--wind")
    run = read_run(data, definition=definition_of(model), rename=parse_rename(rename or []))
    if channels:
        run = observing(run, channels)
    configure()
    from ..apps.wind import USUALLY, fit_wind, wind_figure, wind_json
    from ..report import to_png
    from ..schema import ARM

    stated = model_of(model, [run])
    if stated.kind != ARM.name:
        raise InputError(
            f"the {stated.kind} model is not the model of an arm: give the model of an arm"
        )
    arm = cast("ArmModel", stated)
    names = [name for name in (*USUALLY, *(free or [])) if name not in (hold or [])]
    found = fit_wind(
        arm,
        run,
        mean=begin,
        intensity=parts if len(parts) == 3 else parts[0],
        length_scale=length_scale,
        decay=coherence,
        free=names,
        use_mean=not no_mean,
        skip=skip,
        highest=highest,
        progress=say_progress(quiet),
    )
    text = wind_json(found, run)
    if out is not None:
        picture = to_png(
            wind_figure(
                found, f"{run.name}: measured spectra at rest and spectra in the fitted wind"
            )
        )
        contents = {"wind.json": f"{text}\n".encode(), "wind.png": picture}
        write_folder(out, contents, force=force)
    if as_json:
        typer.echo(text)
    if as_json or quiet:
        return
    _show(found)
    if run.winds:
        typer.echo("note: the wind columns of the run were not used")
    if out is not None:
        say_written(out, _FILES)


def _show(found: "WindFit") -> None:
    rows = []
    for name, one in found.numbers.items():
        error = one.standard_error
        word = "not determined" if one.free else "fixed"
        value, digits = format_estimate(one.value, error)
        known = error is not None and math.isfinite(error)
        rows.append([name, value, digits if known else word, one.unit or None])
    print_table(["parameter", "value", "standard error", "unit"], rows)
    flow = ", ".join(f"{part:.4g}" for part in found.wind.mean)
    typer.echo(f"\nmean flow ({flow}) m/s; {len(found.channels)} channels")
    typer.echo(
        f"mean ratio of measured to expected spectra {found.misfit[0]:.3f} "
        f"(expected: 1 +- {found.misfit[1]:.3f})"
    )
    for note in found.notes:
        typer.echo(f"note: {note}")
