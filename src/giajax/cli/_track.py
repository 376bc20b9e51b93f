"""`giajax track`: motion of an arm, estimated from late and noisy measurements."""

import io
import json
import math
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure, go_on
from ..runtime.text import InputError, install_command
from ._commands import (
    Force,
    Json,
    OnlyChannels,
    Quiet,
    Renamed,
    RunModel,
    Texts,
    argument,
    check_quiet,
    command,
    command_after,
    print_table,
    say_progress,
    say_written,
    write_folder,
)
from ._model import definition_of, fit_or_model, is_result, say_doubts
from ._simulate import gust_numbers
from ._values import deviations, noise_section, plain_settings, velocity

if TYPE_CHECKING:
    from ..apps.tracking import Air, Bias, Track, TrackVerdict
    from ..recordings import Run

_STANDARD_INPUT = Path("-")
_HEARD = "recorded.csv"  # Copy of the rows from standard input.
_PATIENCE = 10.0  # Default waiting time for new rows, s.
_SHARE = 0.3  # Default standard deviation of a parameter, relative to its value.


@command(
    """\b
Examples:
  giajax track run.csv --model giajax-out/run --out tracked
                            use the fitted arm in still air
  giajax track run.csv --model giajax-out/run --wind 0,0.2,0 --out tracked
                            estimate an unknown gusty wind, roughly along y
  giajax track run.csv --latency 0.5 --bias position_m=0.05 --out tracked
                            use a delayed and shifted camera
  giajax track run.csv --model my_arm.toml \\
      --uncertain air.drag_coefficient=0.1 --out tracked
                            use a standard deviation of 0.1 for the drag
  giajax track run.csv --model my_arm.toml \\
      --free joints.pitch_stiffness --live 30 --out tracked
                            track while run.csv is being recorded

\b
MODEL is the folder of a fit, its result.json, or a TOML file with an [arm]
section. The standard errors of a fit are used as the uncertainty of its
parameters. The output files are estimate.csv (a run of the smoothed states),
bands.csv (their standard deviations), track.json, track.png and track.html.
The page needs the extra 'report': pip install 'giajax[report]', or
pip install '.[report]' in a checkout.

\b
With --live, or with - for standard input, a line is printed for each second
of the recording. The files are written at the end of the run or after Ctrl-C.""",
    group="plan",
    pictures=True,
    old={"--torque": "--torque-noise"},
)
def track(
    run: Annotated[Path, argument("RUN.csv", "A run with commands and measurements.")],
    out: Annotated[Path, "DIR", "Folder for the files."],
    model: RunModel = None,
    mean: Annotated[
        str | None,
        "X,Y,Z",
        "Estimate the wind from an approximate mean wind velocity (m/s). [default: known wind or "
        "still air]",
        "--wind",
    ] = None,
    gusts: Annotated[
        str | None, "I:L", "Intensity and length scale (m) of the gusts. [default: 0.3:5]"
    ] = None,
    coherence: Annotated[
        float | None,
        "DECAY",
        "Decay coefficient of the gust coherence with distance (12 in IEC 61400-1). [default: 12]",
    ] = None,
    places: Annotated[
        int | None,
        "N",
        "Number of positions along the arm at which gusts are estimated. [default: one for "
        "each 2.5 m]",
        1,
    ] = None,
    bias: Annotated[
        Texts,
        "KEY=SD",
        "Estimate a constant bias of a channel, with this prior standard deviation, such as "
        "tip_x_m=0.05.",
    ] = None,
    uncertain: Annotated[
        Texts,
        "PATH=SD",
        "Standard deviation of a parameter that is not estimated. [default: from the fit]",
    ] = None,
    free: Annotated[
        Texts,
        "PATH[=SD]",
        "Estimate a parameter and detect its changes. [default SD: 30 % of the value]",
    ] = None,
    live: Annotated[
        float | None,
        "S",
        "Track while the file is being written, and stop when it has not grown for this time.",
    ] = None,
    torque_noise: Annotated[
        float | None,
        "N_M",
        "Intensity of the unmodelled white-noise torque of a joint (N m root(s)). [default: from "
        "the stiffness]",
    ] = None,
    latency: Annotated[float, "S", "Delay between time stamp and arrival of a measurement."] = 0.0,
    gate: Annotated[
        float, "SD", "Reject measurements that deviate by more than SD standard deviations."
    ] = 5.0,
    truth: Annotated[
        Path | None, "TRUE.csv", "File with true angles or rates, to check the standard deviations."
    ] = None,
    no_judge: Annotated[bool, "Skip the search for causes of a misfit."] = False,
    channels: OnlyChannels = None,
    rename: Renamed = None,
    as_json: Json = False,
    quiet: Quiet = False,
    force: Force = False,
) -> None:
    """Estimate motion and wind of a recorded arm and their errors.

    A square-root extended Kalman filter and smoother estimate angles, rates, hysteresis states,
    actuator lag, biases, mean wind and gusts, based on the arm's equation of motion.
    """
    from ..recordings import (
        check_output_folder,
        observing,
        parse_rename,
        read_run,
        stored_result,
        write_run,
    )

    check_quiet(quiet, written=out, as_json=as_json, by="--out DIR or --json")
    followed = live is not None or run == _STANDARD_INPUT
    if live is not None and not 0 < live < math.inf:
        raise InputError(f"--live is {live:g}: give a positive number of seconds")
    parts, length_scale = gust_numbers(gusts or "0.3:5")
    if mean is None and any(each is not None for each in (gusts, coherence, places)):
        raise InputError("--gusts, --coherence and --places apply to an estimated wind: add --wind")
    flow = None if mean is None else velocity(mean, "--wind")
    if model is not None and is_result(model):
        stored_result(model)
    how_read: Any = {"definition": definition_of(model), "rename": parse_rename(rename or [])}

    def some(recorded: "Run") -> "Run":
        return observing(recorded, channels) if channels else recorded

    say_doubts(model, "the tracked motion", quiet=quiet)
    configure()
    from ..apps.tracking import (
        TRACK_FILES,
        Unknown,
        band_columns,
        estimate_columns,
        estimate_definition,
        judge,
        nees,
        track as tracked,
        track_facts,
        track_figure,
        unseen,
    )
    from ..report import study_page, to_png

    names = [*TRACK_FILES, TRACK_FILES.estimate.replace(".csv", ".toml"), _HEARD]
    check_output_folder(out, names, force=force)
    true = None if truth is None else _true(truth)
    considered = _numbers(uncertain, "--uncertain")

    def known_of(recorded: "Run") -> tuple[Any, Unknown]:
        source = fit_or_model(model, [recorded])
        decay = 12.0 if coherence is None else coherence
        estimated = _estimated(free, source)
        for path in estimated:
            if path in considered:
                raise InputError(
                    f"{path} is given with both --free and --uncertain: keep only --free to "
                    "estimate it, or only --uncertain otherwise"
                )
        return source, Unknown(
            air=None if flow is None else _air(source, flow, parts, length_scale, decay, places),
            biases=_biases(recorded, bias),
            considered=considered,
            estimated=estimated,
            torque=torque_noise,
        )

    if followed:
        recorded = _follow(
            run,
            out,
            live,
            how_read,
            some,
            known_of,
            gate=gate,
            latency=latency,
            as_json=as_json,
            quiet=quiet,
        )
    else:
        recorded = some(read_run(run, **how_read))
    source, unknown = known_of(recorded)
    say = say_progress(quiet)
    found = tracked(source, recorded, unknown=unknown, latency=latency, gate=gate, progress=say)
    hidden = unseen(source, recorded, unknown=found.unknown, start=found.start)
    verdict = judge(source, found, progress=say, look=not no_judge)
    facts = track_facts(found, verdict, hidden)
    said = None
    if true is not None:
        try:
            square, share = nees(found, true)
        except InputError as error:  # The tracked run is already written.
            said = f"note: {error}"
        else:
            facts["truth"] = {"nees_per_state": square, "within_95_percent": share}
            said = (
                f"comparison with the truth: NEES {square:.3g} per state, {share:.1%} within "
                "the 95 % bands"
            )
    text = json.dumps(facts, indent=2, allow_nan=False)
    picture = to_png(track_figure(found))
    contents = {
        TRACK_FILES.facts: f"{text}\n".encode(),
        TRACK_FILES.picture: picture,
        TRACK_FILES.bands: _table(band_columns(found)),
    }
    page = _page(found, verdict, hidden, picture, study_page)
    if page is not None:
        contents[TRACK_FILES.page] = page
    write_folder(out, contents, force=force)
    how: dict[str, Any] = {"definition": estimate_definition(found), "force": force}
    write_run(out / TRACK_FILES.estimate, found.times, estimate_columns(found), **how)
    if as_json:
        # For a run that was followed live, print one line, like the previous ones.
        typer.echo(json.dumps(facts, allow_nan=False) if followed else text)
    elif not quiet:
        _show(found, verdict, hidden)
        if said is not None:
            typer.echo(said)
        say_written(out, [*contents, TRACK_FILES.estimate])
        if page is None:
            typer.echo(
                f"note: {TRACK_FILES.page} needs the extra 'report', which is not installed: "
                f"{install_command('report')}"
            )
        typer.echo(command_after("view", out))


def _true(path: Path) -> "Run":
    """Read a run with true angles or rates of joints."""
    from ..recordings import read_run

    true = read_run(path)
    if not any(channel.kind in ("joint_angle", "joint_rate") for channel in true.channels.values()):
        raise InputError(
            f"{path} contains no true angle or rate of a joint: give columns such as "
            "joint01_angle_deg"
        )
    return true


def _follow(
    run: Path,
    out: Path,
    patience: float | None,
    how_read: "Mapping[str, Any]",
    some: Any,
    known_of: Any,
    *,
    gate: float,
    latency: float,
    as_json: bool,
    quiet: bool,
) -> "Run":
    """Track a run while it is recorded, and return the run of its rows."""
    from ..apps.tracking import LiveRows, followed_live, heard_facts, heard_line, lines_of
    from ..recordings import LineReader, make_folder

    copy = None
    if run == _STANDARD_INPUT:
        lines: Iterator[bytes] = iter(sys.stdin.buffer.readline, b"")
    elif not run.exists():
        raise InputError(f"{run} does not exist: give a file that is being recorded")
    elif run.is_dir():
        raise InputError(f"{run} is a folder: give a file that is being recorded")
    else:
        lines = lines_of(run, _PATIENCE if patience is None else patience)
    path = out / _HEARD if run == _STANDARD_INPUT else run
    reader = LineReader(path, **how_read)
    rows = LiveRows(lines, reader, some, lambda text: typer.echo(text, err=True))
    given: Any = {"latency": latency, "gate": gate}
    written = 0
    try:
        for heard in followed_live(rows, known_of, **given):
            if run == _STANDARD_INPUT:
                if copy is None:
                    make_folder(out)
                    copy = path.open("wb")
                written += copy.write(rows.kept[written:])
                copy.flush()
            if as_json:
                typer.echo(json.dumps(heard_facts(heard), allow_nan=False))
            elif not quiet:
                typer.echo(heard_line(heard))
    except KeyboardInterrupt:
        typer.echo("stopped: only the part read so far has been tracked", err=True)
        go_on()
    finally:
        if copy is not None:
            copy.write(rows.kept[written:])
            copy.close()
    return rows.run()


def _estimated(given: list[str] | None, source: Any) -> dict[str, float]:
    """Return deviations by path; those that are not given are a share of the value."""
    from ..fitting import arm_model_of
    from ..schema.parameters import find

    found: dict[str, float] = {}
    for each in given or []:
        path, stated, _ = each.partition("=")
        if stated:
            found |= _numbers([each], "--free")
            continue
        model = arm_model_of(source)
        value = find(model, path).value(model)
        if value is None or value.size != 1 or not float(value):
            raise InputError(
                f"--free {path} is not a single nonzero number, so a relative standard "
                f"deviation is not defined: give --free {path}=SD"
            )
        found[path] = _SHARE * abs(float(value))
    return found


def _air(
    source: Any,
    flow: list[float],
    parts: list[float],
    length_scale: float,
    coherence: float,
    places: int | None,
) -> "Air":
    from ..apps.tracking import Air, usual_places
    from ..apps.wind import first_guess
    from ..fitting import arm_model_of

    arm = arm_model_of(source)
    wind = first_guess(flow, parts if len(parts) == 3 else parts[0], length_scale, coherence)
    many = usual_places(arm) if places is None else places
    return Air(wind, mean_deviation=0.5 * wind.speed, places=many)


def _biases(run: "Run", given: list[str] | None) -> "tuple[Bias, ...]":
    """Return the biases of the channels.

    Positions and pixels of one axis of a camera share a bias. Each other channel has its own.
    """
    from ..apps.tracking import Bias

    section = noise_section(given, "--bias", positive=True)
    axes: dict[Any, list[str]] = {}
    for name, size in deviations(section, "--bias", [*run.observations]).items():
        channel = run.channels[name]
        shared = channel.quantity in ("length", "pixel")
        axes.setdefault(
            (size, *((channel.camera, channel.component) if shared else (name,))), []
        ).append(name)
    return tuple(Bias(tuple(names), key[0]) for key, names in axes.items())


def _numbers(given: list[str] | None, option: str) -> dict[str, float]:
    found: dict[str, float] = {}
    for path, value in plain_settings(given, option).items():
        if not isinstance(value, float) or not value > 0:
            raise InputError(
                f"{option} {path} needs a standard deviation: give one positive number"
            )
        found[path] = value
    return found


def _table(columns: "Mapping[str, Any]") -> bytes:
    import numpy as np

    text = io.StringIO()
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(text, table, fmt="%.8g", delimiter=",", header=",".join(columns), comments="")
    return text.getvalue().encode()


def _page(
    found: "Track", verdict: "TrackVerdict", hidden: Any, picture: bytes, page: Any
) -> bytes | None:
    from ..apps.tracking import track_sections
    from ..report import check_page

    try:
        check_page()
    except InputError:
        return None
    tables, words = track_sections(found, verdict, hidden)
    whole: bytes = page(
        title=f"{found.run.name}: tracked",
        kind="giajax track",
        grade="good" if verdict.adequate else "doubtful",
        headline=verdict.sentence[:1].upper() + verdict.sentence[1:],
        notes=words,
        tables=tables,
        pictures=[
            (
                "Over time",
                picture,
                "The tip, the wind and the innovations, with 95 % bands. For a correct model, 95 % "
                "of the innovations lie within the dotted lines.",
            )
        ],
    )
    return whole


def _show(found: "Track", verdict: "TrackVerdict", hidden: Any) -> None:
    from ..apps.tracking import TRACK_HEADINGS, track_notes, track_rows

    typer.echo(f"{verdict.sentence}\n")
    print_table(TRACK_HEADINGS, track_rows(found))
    typer.echo(
        f"\n{len(found.times)} time steps, {found.arm.size} states, "
        f"{1e3 * found.seconds:.2g} ms per time step; NIS {verdict.nis:.3f} "
        f"(expected: 1 +- {4 * verdict.nis_error:.3f})"
    )
    for note in track_notes(found, verdict, hidden):
        typer.echo(f"note: {note}")
