"""`giajax simulate` and `synth`: simulation of a run, and synthetic copy of a recorded run."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Digits,
    Force,
    Links,
    Missing,
    Noise,
    Quiet,
    Ramp,
    Replayed,
    RunModel,
    Settings,
    Solver,
    Step,
    Texts,
    Tolerance,
    ToRun,
    Wind,
    command,
    command_after,
    failed_simulation,
    origin,
)
from ._model import arm_of, definition_of, model_of
from ._values import (
    NUMBER,
    Values,
    deviations,
    noise_section,
    plain,
    settings,
    velocity,
    with_settings,
)

if TYPE_CHECKING:
    from ..apps.synthetic import Drive
    from ..mechanics.arm import Arm
    from ..models import ArmModel
    from ..recordings import Definition, Run

_GUSTS = re.compile(rf"(?P<intensity>{NUMBER}(?:,{NUMBER},{NUMBER})?):(?P<length>{NUMBER})")


def gusts_of(
    text: str,
    definition: "Definition",
    replayed: "Run | None",
    arm: "Arm",
    *,
    coherence: float | None,
    rate: float,
    **sampling: Any,
) -> tuple["Drive", str]:
    """Return the wind of --gusts about the mean wind, and the share of variance that is left out.

    With --coherence each link has its own wind, at its position in the straight arm. `sampling`
    contains arguments of `giajax.gusts`.
    """
    import jax.numpy as jnp
    import numpy as np

    from ..apps.synthetic import gusts, gusts_left_out
    from ..mechanics.arm import link_centres
    from ..schema import WindSection

    parts, length_scale = gust_numbers(text)
    source = definition if replayed is None else replayed.definition
    mean = source.section(WindSection).velocity_m_per_s
    if replayed is not None and replayed.winds:
        raise InputError(f"'{replayed.name}' has a recorded wind: omit --gusts")
    if mean is None:
        raise InputError("--gusts needs a constant wind, but none is given: add --wind X,Y,Z")
    if coherence is not None and not 0 <= coherence < math.inf:
        raise InputError(
            f"--coherence is {coherence:g}: give a non-negative decay coefficient, such as 12"
        )
    intensity = parts if len(parts) == 3 else parts[0]
    scales: dict[str, Any] = {"interval": 1 / rate if rate else 0.0, "length_scale": length_scale}
    if coherence is not None:
        places = np.asarray(link_centres(arm, jnp.zeros(arm.count)))
        sampling |= {"places": places, "decay": coherence}
    wind = gusts(mean, intensity=intensity, **scales, **sampling)
    along, across = gusts_left_out(math.hypot(*mean), **scales)
    # A direction without gusts has no omitted variance.
    shares = [f"{along:.1%} along"] * (parts[0] > 0) + [f"{across:.1%} across"] * any(parts[-2:])
    return wind, (
        f"gusts with periods below {4 * scales['interval']:g} s are omitted, which removes this "
        f"share of the variance: {' and '.join(shares)} the mean wind"
    )


def gust_numbers(text: str) -> tuple[list[float], float]:
    """Return the intensity (one number or three) and the length scale (m) of --gusts."""
    match = _GUSTS.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InputError(
            f"--gusts is {text!r}: give one intensity or three, and the length scale in "
            "m, such as 0.3:5 or 0.3,0.2,0.1:5"
        )
    return [float(part) for part in match["intensity"].split(",")], float(match["length"])


_DEFAULT_LINKS = (2, 6, 12, 20)
_MEASURED = ("joint_angle", "joint_rate", "link_position", "tip_position")


def channel_names(selections: Sequence[str], count: int) -> list[str]:
    """Return the names of the channels to record, each once, in the order of the options."""
    from ..recordings import Channel

    if not selections:
        selections = [f"link{link:02d}" for link in _DEFAULT_LINKS if link <= count] + ["tip"]
    names: list[str] = []
    for selection in (part.strip() for item in selections for part in item.split(",")):
        if selection == "all":
            names += [f"link{i:02d}_{axis}" for i in range(1, count + 1) for axis in "xyz"]
        elif selection == "joints":
            names += [f"joint{i:02d}_angle" for i in range(1, count + 1)]
        elif re.fullmatch(r"(\w+\.(tip|link[0-9]+|mark[0-9]+))|mark[0-9]+", selection):
            names += [f"{selection}_{axis}" for axis in "uv"]
        elif re.fullmatch(r"tip|link[0-9]+", selection):
            names += [f"{selection}_{axis}" for axis in "xyz"]
        else:
            names.append(selection)
    for name in names:
        channel = Channel.named(name)
        if channel.kind not in _MEASURED and channel.quantity != "pixel":
            raise InputError(
                f"--channels {name!r} is not a channel of an arm: give link06, link06_z, "
                "tip, joint03_angle, joint03_rate, joints or all, or side.tip for a camera"
            )
        if channel.kind != "mark_pixel" and (channel.index or 1) > count:
            part = "joint" if channel.kind.startswith("joint") else "link"
            raise InputError(
                f"--channels {name!r} names {part} {channel.index}, but the arm has {count} links: "
                "correct the number, or simulate an arm with more links"
            )
    return list(dict.fromkeys(names))


# Options of commands that simulate an arm, as definitions and drives.

DURATION = 25.0  # Default length of a run, s.
_START = 0.5
_RAMP_DURATION = 1.0

_MOVE = re.compile(
    rf"(?P<joint>[0-9]{{1,9}})=(?P<angle>{NUMBER})"
    rf"(?:@(?P<start>{NUMBER})(?::(?P<duration>{NUMBER}))?)?"
)


def definition_from_options(
    arm: Path | None, links: int | None, wind: str | None, *, quiet: bool
) -> "Definition":
    """Return the definition from the arm file and the options, which override the file."""
    from ..recordings import Definition
    from ..schema import ARM

    definition = arm_of(arm, quiet=quiet)
    if definition.model not in (None, ARM.name):
        raise InputError(f"{arm} describes a {definition.model}: give the TOML file of an arm")
    if links is not None:
        if links < 1:
            raise InputError(f"--links is {links}: give at least 1 link")
        definition = definition.merged_with(Definition.parse({"arm": {"links": links}}))
    if wind is not None:
        stated = {"velocity_m_per_s": velocity(wind, "--wind")}
        definition = definition.merged_with(Definition.parse({"wind": stated}))
    return definition


def replayed_run(
    command: Path | None, definition: "Definition", moves: Sequence[str] | None
) -> "Run | None":
    """Return the run given with --command, interpolated as in the arm file; None without one."""
    from ..recordings import Definition, read_run, read_sidecar
    from ..schema import ArmSection

    if command is None:
        return None
    if moves:
        raise InputError(
            "--command is given together with --step or --ramp: give only one source of commands"
        )
    # If the sidecar describes the arm that recorded the run, it determines the joints.
    recorded = bool(read_sidecar(command).section(ArmSection).contents())
    keys = ("command", "wind") if recorded else ("arm", "command", "wind")
    section = {key: item for key, item in definition.contents().items() if key in keys}
    return read_run(command, definition=Definition.parse(section))


def drives_of(run: "Run", rate: float) -> tuple[float, float, list["Drive"]]:
    """Return the start of a recorded run, its length in whole samples, its commands and wind."""
    from ..apps.synthetic import Drive
    from ..schema import ARM, CommandSection, WindSection

    if run.model != ARM.name or run.times is None:
        raise InputError(f"{run.path} is a run of the {run.model} model: give the run of an arm")
    length = float(run.times[-1] - run.times[0])
    if rate > 0:
        length = max(math.floor(length * rate + 1e-6), 1) / rate
    wind = run.definition.section(WindSection)
    interpolation = run.definition.section(CommandSection).interpolation
    # One drive per quantity, because corners are detected relative to the largest value of a drive.
    apart: dict[str, dict[str, Any]] = {}
    for name, values in run.commands.items():
        apart.setdefault(run.channels[name].quantity, {})[name] = values
    drives = [Drive(run.times, rows, interpolation) for rows in apart.values()]
    drives += [Drive(run.times, run.winds, wind.interpolation)] if run.winds else []
    return float(run.times[0]), length, drives


def moves_of(step: Sequence[str], ramp: Sequence[str], count: int, duration: float) -> "Drive":
    """Return the commands of --step and --ramp for `count` joints and a run of a duration (s)."""
    from ..apps.synthetic import Move, joint_moves

    moves = []
    for option, texts in (("--step", step), ("--ramp", ramp)):
        for text in texts:
            match = _MOVE.fullmatch(text.replace(" ", ""))
            at_once = option == "--step"
            if match is None or (match["duration"] and at_once):
                form = "JOINT=DEG[@T]" if at_once else "JOINT=DEG[@START:DURATION]"
                raise InputError(f"{option} is {text!r}: give {form}, such as 1=30@0.5")
            length = 0.0 if at_once else float(match["duration"] or _RAMP_DURATION)
            if length == 0 and not at_once:
                raise InputError(
                    f"{option} {text!r} has a duration of 0: give a positive duration, or use "
                    "--step"
                )
            start = _START if match["start"] is None else float(match["start"])
            angle = math.radians(float(match["angle"]))
            moves.append(Move(int(match["joint"]), angle, start, length))
    return joint_moves(moves, joints=count, end=duration)


def model_and_truth(
    definition: "Definition", values: Values, solver: str, tolerance: float
) -> tuple["ArmModel", dict[str, float | list[float]]]:
    """Return the model with the parameters of --set, and the true values for the sidecar."""
    import jax.numpy as jnp

    from ..models import ArmModel
    from ..schema.parameters import default_free, get

    model = ArmModel.stated_in(definition, tolerance=jnp.asarray(tolerance), solver=solver)
    model = with_settings(model, values)
    truth = {
        path: float(get(model, path)) for path in default_free(model) if not get(model, path).ndim
    }
    return model, {**truth, **plain(values)}


def facts_of(
    definition: "Definition", replayed: "Run | None", drives: Sequence["Drive"], model: "ArmModel"
) -> dict[str, Any]:
    """Return the sections of the sidecar that describe the inputs of the arm."""
    from ..models import preset_of
    from ..schema import InitialSection, WindSection

    source = definition if replayed is None else replayed.definition
    driven = {name: drive for drive in drives for name in drive.values}
    facts: dict[str, Any] = {"schema_version": 1, "arm": preset_of(definition)}
    initial = definition.section(InitialSection).contents()
    commanded = [drive for name, drive in driven.items() if name.startswith("joint")]
    winds = [drive for name, drive in driven.items() if "wind_" in name]
    velocity = source.section(WindSection).velocity_m_per_s
    blown = velocity or model.arm.air.wind_field is not None
    if not (driven or initial or blown or float(model.arm.gravity)):
        raise InputError(
            "the arm does not move: give --step, --ramp, --command or --wind, or --arm with an "
            "[initial] state"
        )
    if initial:
        facts["initial"] = initial
    if commanded:
        facts["command"] = {"interpolation": commanded[0].interpolation}
    else:
        facts["free_motion"] = True
    # Gusts include the mean wind.
    if winds:
        facts["wind"] = {"interpolation": winds[0].interpolation}
    elif velocity is not None:
        facts["wind"] = {"velocity_m_per_s": velocity}
    return facts


@command(
    """\b
Examples:
  giajax simulate --ramp 1=30 --to run.csv
                            move the base joint to 30 deg
  giajax simulate --step 1=30@0.5 --step 1=0@10 --missing 10 \\
      --noise position_m=0.02 --noise angle_deg=0.5 --to run.csv
                            move there and back, with noise and gaps
  giajax simulate --command logged.csv --set joints.damping=0.1 --to run.csv
                            use the commands of a recording
  giajax simulate --arm my_arm.toml --ramp 2=-20@1:3 --channels all \\
      --set camera.origin=0.1,0,0 --to run.csv
                            use your arm, and record all links
  giajax simulate --wind 0,0.2,0 --gusts 0.3:5 --coherence 12 --to run.csv
                            simulate gusts without commands

`giajax parameters` lists the parameters.
CHANNEL is link06 (its x, y and z), link06_z, tip, joint03_angle, joint03_rate,
'joints' (all angles) or 'all' (every link). A row is added for each corner of a
command between two samples.""",
    group="data",
    old={"--out": "--to"},
)
def simulate(
    context: typer.Context,
    to: ToRun,
    arm: Annotated[
        Path | None, "FILE.toml", "TOML file with [arm], [initial], [command] and [wind] sections."
    ] = None,
    links: Links = None,
    pairs: Settings = None,
    step: Step = None,
    ramp: Ramp = None,
    command: Replayed = None,
    wind: Wind = None,
    gusts: Annotated[str | None, "I:L", "Intensity and length scale (m) of the gusts."] = None,
    coherence: Annotated[
        float | None,
        "DECAY",
        "Decay coefficient of the gust coherence with distance (12 in IEC 61400-1). [default: the "
        "same gusts along the whole arm]",
    ] = None,
    duration: Annotated[
        float | None, "S", "Duration of the run. [default: that of --command, otherwise 25]"
    ] = None,
    rate: Annotated[float, "HZ", "Samples per second."] = 10.0,
    channels: Annotated[
        Texts, "CHANNEL", "Channels to record; see below. [default: links 2, 6, 12, 20 and tip]"
    ] = None,
    noise: Noise = None,
    missing: Missing = 0.0,
    seed: Annotated[int, "N", "Seed of the random numbers for noise, gaps and gusts.", 0] = 0,
    solver: Solver = "springs5",
    tolerance: Tolerance = 1e-7,
    digits: Digits = 9,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate an arm and write a run that `giajax fit` reads.

    The sidecar of the run contains the arm, the noise, the true values and the command line.
    """
    from ..recordings import Definition, check_output_run

    if not 0 <= missing < 100:
        raise InputError(
            f"--missing is {missing:g} %: give a percentage of at least 0 and less than 100"
        )
    check_tolerance(tolerance)
    section = noise_section(noise, "--noise")
    check_output_run(to, force=force)
    definition = definition_from_options(arm, links, wind, quiet=quiet)
    replayed = replayed_run(command, definition, step or ramp)
    configure()
    from ..apps.synthetic import Drive, sampled, synthesise

    model, truth = model_and_truth(definition, settings(pairs), solver, tolerance)
    count = model.arm.count
    start, length, drives = 0.0, DURATION, list[Drive]()
    if replayed is not None:
        start, length, drives = drives_of(replayed, rate)
    duration = length if duration is None else duration
    if step or ramp:
        drives = [moves_of(step or [], ramp or [], count, duration)]
    if coherence is not None and gusts is None:
        raise InputError("--coherence applies to gusts, but none are given: add --gusts")
    left_out = ""
    if gusts is not None:
        sampling: dict[str, Any] = {"start": start, "duration": duration, "rate": rate}
        sampling |= {"coherence": coherence, "seed": seed}
        wind_rows, left_out = gusts_of(gusts, definition, replayed, model.arm, **sampling)
        drives.append(wind_rows)
        if not quiet:
            typer.echo(f"{left_out} (see --rate)")
    recorded = channel_names(channels or [], count)
    deviations(section, "--noise", recorded)
    facts = facts_of(definition, replayed, drives, model)
    # The text after # is a comment to a shell; [truth] may contain only parameters.
    facts["origin"] = origin(context) + (f"  # {left_out}" if left_out else "")
    facts["noise"] = {key: deviation for key, deviation in section.items() if deviation}
    times, inputs = sampled(drives, start=start, duration=duration, rate=rate)
    with failed_simulation(" (options --tolerance, --solver, --set)"):
        run = synthesise(
            model,
            _as_written("time", times, max(digits, 12)),
            {name: _as_written(name, values, digits) for name, values in inputs.items()},
            recorded,
            missing=missing / 100,
            seed=seed,
            definition=Definition.parse({**facts, "truth": truth}, "simulate"),
            name=to.stem,
        )
    write_and_say(to, run, digits, force=force, quiet=quiet)


def write_and_say(
    out: Path, run: "Run", digits: int, *, force: bool, quiet: bool, what: str = ""
) -> None:
    """Write a run and print its size, after the text `what`."""
    from ..recordings import sidecar_path, write_run

    write_run(out, run.times, run.values, definition=run.definition, digits=digits, force=force)
    if quiet:
        return
    rows = len(next(iter(run.values.values())))
    typer.echo(
        f"wrote {out} and {sidecar_path(out)}: {what}{rows} rows, "
        f"{len(run.observations)} channels; {command_after('check', '--data', out)}"
    )


def check_tolerance(tolerance: float) -> None:
    """Raise an error for an invalid --tolerance."""
    if not 0 < tolerance <= 0.1:
        raise InputError(f"--tolerance is {tolerance:g}: give a positive number of at most 0.1")


def _as_written(name: str, values: Any, digits: int) -> Any:
    """Round values as in the written file, so that the arm follows the values of the file."""
    from dataclasses import replace

    from ..recordings import Channel

    channel = Channel.named(name)
    if channel.quantity == "angle":
        channel = replace(channel, unit="deg")
    return channel.to_si([float(f"{value:.{digits}g}") for value in channel.from_si(values)])


@command(
    """\b
Examples:
  giajax synth --data run.csv --noise position_m=0.01 --to new.csv
                            add white noise
  giajax synth --data run.csv --model giajax-out/run \\
      --correlated position_m=0.02 --to new.csv
                            use a fit, and add correlated noise
  giajax synth --data run.csv --set camera.rotation=0,0.087,0 \\
      --set camera.delay=0.05 --to new.csv
                            simulate a rotated and delayed camera
  giajax synth --data run.csv --missing 5 --bursts 10 --burst-duration 2 \\
      --to new.csv          add gaps
  giajax synth --data run.csv --noise position_m=0.01 --outliers 1 \\
      --outlier-size position_m=0.5 --to new.csv
                            add outliers

Commands, times, columns and sidecar are taken from the run. A true value
from --set is written only to [truth] of the new sidecar, so that a fit can
estimate it. KEY is one of the keys of [noise]: position_m, angle_deg, or a column
such as link06_z_mm. MODEL is the folder of a fit, its result.json, or a TOML
file whose [arm] (or other section) describes a model with all its parameters.
'giajax simulate' creates a first run from steps and ramps.""",
    group="data",
    old={"--out": "--to"},
    old_words="--data",
)
def synth(
    data: Annotated[Path, "RUN.csv", "The run to simulate again."],
    to: ToRun,
    model: RunModel = None,
    pairs: Settings = None,
    channels: Annotated[
        Texts, "CHANNEL", "A channel to record. [default: the channels of the run]"
    ] = None,
    noise: Noise = None,
    correlated: Annotated[Texts, "KEY=VALUE", "Standard deviation of correlated noise."] = None,
    correlation_time: Annotated[float, "S", "Correlation time of the correlated noise."] = 0.5,
    missing: Missing = 0.0,
    bursts: Annotated[float, "PERCENT", "Percentage of samples missing in bursts."] = 0.0,
    burst_duration: Annotated[float, "S", "Duration of a burst."] = 1.0,
    outliers: Annotated[float, "PERCENT", "Percentage of cells that are outliers."] = 0.0,
    outlier_size: Annotated[Texts, "KEY=VALUE", "Size of the outliers."] = None,
    seed: Annotated[int, "N", "Seed of the random numbers for all errors.", 0] = 0,
    digits: Digits = 9,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a run again, with measurement errors of your choice.

    The true model is that of the run or of a fit, and may be any model. Before the experiment, you
    can thus test how noise, gaps, outliers and a misaligned frame affect a fit.
    """
    from ..recordings import check_output_run, read_run

    check_output_run(to, force=force)
    values = settings(pairs)
    typed = {"--noise": noise, "--correlated": correlated, "--outlier-size": outlier_size}
    sections = {option: noise_section(pairs, option) for option, pairs in typed.items()}
    recorded = read_run(data, definition=definition_of(model))
    configure()
    from ..apps.synthetic import RecordingErrors, recorded_again

    truth = with_settings(model_of(model, [recorded]), values)
    names = channels or list(recorded.observations)
    white, drifting, far = (deviations(part, option, names) for option, part in sections.items())
    errors = RecordingErrors(
        white=white,
        correlated=drifting,
        outlier_size=far,
        correlation_time=correlation_time,
        missing=missing / 100,
        bursts=bursts / 100,
        burst_duration=burst_duration,
        outliers=outliers / 100,
    )
    paths = list(dict.fromkeys(path.partition("[")[0] for path in values))
    with failed_simulation(""):
        new = recorded_again(
            truth, recorded, errors, channels=channels, seed=seed, truth=paths, name=to.stem
        )
    write_and_say(to, new, digits, force=force, quiet=quiet)
