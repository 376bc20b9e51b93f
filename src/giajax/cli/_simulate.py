"""`giajax simulate`: a run made by the model."""

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..models import ArmModel, Drive
    from ..runs import Definition, Run

EXAMPLES = """\b
Examples:
  giajax simulate --out run.csv --ramp 1=30
  giajax simulate --out run.csv --step 1=30@0.5 --step 1=0@10 --noise 0.02 --missing 10
  giajax simulate --out run.csv --command logged.csv --set air.drag_coefficient=1.0
  giajax simulate --out run.csv --arm my_arm.toml --ramp 2=-20@1:3 --channels all

\b
CHANNELS is link06 (its x, y and z), link06_z, tip, joint03_angle, joint03_rate,
'joints' (all angles) or 'all' (every link). A row is added at each corner of a
command that no sample falls on."""

_DURATION = 25.0
_START = 0.5
_RAMP_DURATION = 1.0
_DEFAULT_LINKS = (2, 6, 12, 20)

_NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
_MOVE = re.compile(
    rf"(?P<joint>[0-9]+)=(?P<angle>{_NUMBER})(?:@(?P<start>{_NUMBER})(?::(?P<duration>{_NUMBER}))?)?"
)


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
        float, typer.Option(metavar="M", help="Standard deviation of positions, m.")
    ] = 0.0,
    noise_angle: Annotated[
        float, typer.Option(metavar="DEG", help="Standard deviation of joint angles, deg.")
    ] = 0.0,
    missing: Annotated[
        float, typer.Option(metavar="PERCENT", help="Share of each channel that is left empty.")
    ] = 0.0,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the noise and the gaps.")] = 0,
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
    from ..runs import Definition

    _check_numbers(noise=noise, noise_angle=noise_angle, missing=missing, tolerance=tolerance)
    _check_free(out, force)
    stated = _definition(arm, links, wind)
    if command is not None and (step or ramp):
        raise _wrong("--command gives the commands, and so do --step and --ramp; give one of them")
    replayed = None if command is None else _replayed(command, stated)

    from ._jax import configure

    configure()

    from ..models import Drive, sampled, synthesise
    from ..simulation import SimulationError

    model, truth = _model(stated, settings or [], solver, tolerance)
    count = model.arm.count
    start, drives = 0.0, list[Drive]()
    if replayed is not None:
        start, length, drives = _drives_of(replayed, rate)
        duration = length if duration is None else duration
    duration = _DURATION if duration is None else duration
    if step or ramp:
        drives = [_moves(step or [], ramp or [], count, duration)]
    wanted = _channels(channels or [], count)
    deviations = _deviations(wanted, noise, noise_angle)
    facts = _facts(stated, replayed, drives, model)
    facts["origin"] = _origin(context)
    times, inputs = sampled(drives, start=start, duration=duration, rate=rate)
    try:
        run = synthesise(
            model,
            _as_written("time", times, max(digits, 12)),
            {name: _as_written(name, values, digits) for name, values in inputs.items()},
            wanted,
            noise=deviations,
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


def _wrong(sentence: str) -> Exception:
    from .._errors import InputError

    return InputError(sentence)


def _check_numbers(*, noise: float, noise_angle: float, missing: float, tolerance: float) -> None:
    for option, value in (("--noise", noise), ("--noise-angle", noise_angle)):
        if not 0 <= value < math.inf:
            raise _wrong(
                f"{option} is {value:g}, a standard deviation; give 0 or a positive number"
            )
    if not 0 <= missing < 100:
        raise _wrong(f"--missing is {missing:g} %; give at least 0 and less than 100")
    if not 0 < tolerance <= 0.1:
        raise _wrong(f"--tolerance is {tolerance:g}; give a positive number of at most 0.1")


def _check_free(out: Path, force: bool) -> None:
    # Also checked when the files are written; here so that nobody waits for a refusal.
    from ..runs import sidecar_path

    if out.suffix != ".csv":
        raise _wrong(f"--out is {out}; a run is written as .csv, so give such a name")
    if not out.parent.is_dir():
        raise _wrong(f"the folder {out.parent} of --out does not exist; make it or give another")
    for path in (out, sidecar_path(out)):
        if path.exists() and not force:
            raise _wrong(f"{path} exists and is not written over; give another name or --force")


def _definition(arm: Path | None, links: int | None, wind: str | None) -> "Definition":
    """What the arm file and the options say, the options on top."""
    from ..runs import Definition

    stated = Definition() if arm is None else Definition.load(arm)
    if stated.model not in (None, "arm"):
        raise _wrong(f"{arm} describes a {stated.model}; give the TOML file of an arm")
    if links is not None:
        if links < 1:
            raise _wrong(f"--links is {links}; an arm has at least 1 link")
        stated = stated.merged_with(Definition.parse({"arm": {"links": links}}))
    if wind is not None:
        velocity = [_number(part) for part in wind.split(",")]
        if len(velocity) != 3 or None in velocity:
            raise _wrong(f"--wind is {wind!r}; give three numbers in m/s, such as 0,0.2,0")
        stated = stated.merged_with(Definition.parse({"wind": {"velocity_m_per_s": velocity}}))
    return stated


def _number(text: str) -> float | None:
    text = text.strip()
    if not re.fullmatch(_NUMBER, text):
        return None
    return float(text) if math.isfinite(float(text)) else None


def _replayed(command: Path, stated: "Definition") -> "Run":
    """The run whose commands are used, with the arm file's word on what is between its rows."""
    from ..runs import Definition, read_run, read_sidecar

    # Which joints there are is told by the arm that recorded it, where the sidecar states one.
    recorded = bool(read_sidecar(command).arm.given())
    keys = ("command", "wind") if recorded else ("arm", "command", "wind")
    given = {key: item for key, item in stated.given().items() if key in keys}
    return read_run(command, definition=Definition.parse(given))


def _drives_of(run: "Run", rate: float) -> tuple[float, float, list["Drive"]]:
    """Start of a recorded run, its length in whole samples, its commands and wind."""
    from ..models import Drive

    if run.model != "arm" or run.times is None:
        raise _wrong(f"{run.path} is a run of the {run.model} model; give the run of an arm")
    length = float(run.times[-1] - run.times[0])
    if rate > 0:
        length = max(math.floor(length * rate + 1e-6), 1) / rate
    definition, drives = run.definition, []
    if run.commands:
        drives.append(Drive(run.times, run.commands, definition.command.interpolation))
    if run.winds:
        drives.append(Drive(run.times, run.winds, definition.wind.interpolation))
    return float(run.times[0]), length, drives


def _moves(step: Sequence[str], ramp: Sequence[str], count: int, duration: float) -> "Drive":
    from ..models import Move, joint_moves

    moves = []
    for option, texts in (("--step", step), ("--ramp", ramp)):
        for text in texts:
            match = _MOVE.fullmatch(text.replace(" ", ""))
            if match is None or (match["duration"] and option == "--step"):
                form = "JOINT=DEG[@T]" if option == "--step" else "JOINT=DEG[@START:DURATION]"
                raise _wrong(f"{option} {text!r} must be {form}, such as 1=30@0.5; correct it")
            length = float(match["duration"] or _RAMP_DURATION) if option == "--ramp" else 0.0
            if option == "--ramp" and length == 0:
                raise _wrong(f"{option} {text!r} has the duration 0; give a longer one, or --step")
            start = _START if match["start"] is None else float(match["start"])
            angle = math.radians(float(match["angle"]))
            moves.append(Move(int(match["joint"]), angle, start, length))
    return joint_moves(moves, joints=count, end=duration)


def _model(
    stated: "Definition", settings: Sequence[str], solver: str, tolerance: float
) -> tuple["ArmModel", dict[str, float]]:
    """The model with the parameters that were set, and the truth to state."""
    import jax.numpy as jnp

    from ..models import ArmModel, arm_from_definition
    from ..parameters import check_within_bounds, default_free, elements, get, replace

    model = ArmModel(arm_from_definition(stated), tolerance=jnp.asarray(tolerance), solver=solver)
    values: dict[str, float] = {}
    for setting in settings:
        path, _, text = setting.rpartition("=")
        path, value = path.strip(), _number(text)
        if not path or value is None:
            raise _wrong(
                f"--set {setting!r} must be PATH=VALUE with a number, such as "
                "air.drag_coefficient=1.0; correct it"
            )
        if path in values:
            raise _wrong(f"--set gives {path} twice; remove one")
        for element in elements(model, path):
            check_within_bounds(element, value, free=False)
        values[path] = value
    model = replace(model, values)
    truth = {
        path: float(get(model, path)) for path in default_free(model) if not get(model, path).ndim
    }
    return model, {**truth, **values}


def _channels(selections: Sequence[str], count: int) -> list[str]:
    """Channel names of what was asked for, each once, in the order of asking."""
    from ..runs import Channel

    if not selections:
        selections = [f"link{link:02d}" for link in _DEFAULT_LINKS if link <= count] + ["tip"]
    names: list[str] = []
    for selection in (part.strip() for item in selections for part in item.split(",")):
        if selection == "all":
            names += [f"link{i:02d}_{axis}" for i in range(1, count + 1) for axis in "xyz"]
        elif selection == "joints":
            names += [f"joint{i:02d}_angle" for i in range(1, count + 1)]
        elif re.fullmatch(r"tip|link[0-9]+", selection):
            names += [f"{selection}_{axis}" for axis in "xyz"]
        else:
            names.append(selection)
    for name in names:
        channel = Channel.named(name)
        if channel.kind not in ("joint_angle", "joint_rate", "link_position", "tip_position"):
            raise _wrong(
                f"--channels {name!r} is not something an arm is measured by; "
                "give link06, link06_z, tip, joint03_angle, joint03_rate, joints or all"
            )
        if (channel.index or 1) > count:
            part = "link" if channel.kind == "link_position" else "joint"
            raise _wrong(
                f"--channels {name!r} is of {part} {channel.index}, but the arm has {count} links; "
                "correct the number, or simulate a longer arm"
            )
    return list(dict.fromkeys(names))


def _deviations(channels: Sequence[str], noise: float, noise_angle: float) -> dict[str, float]:
    positions = any(name.startswith(("link", "tip")) for name in channels)
    angles = any(name.endswith("_angle") for name in channels)
    if noise and not positions:
        raise _wrong("--noise is that of positions, and no position is recorded; leave it out")
    if noise_angle and not angles:
        raise _wrong("--noise-angle is that of joint angles, and none is recorded; leave it out")
    stated = {"position": noise, "angle": math.radians(noise_angle)}
    return {quantity: deviation for quantity, deviation in stated.items() if deviation}


def _facts(
    stated: "Definition", replayed: "Run | None", drives: Sequence["Drive"], model: "ArmModel"
) -> dict[str, Any]:
    """The sections of the sidecar that say what moves the arm."""
    source = stated if replayed is None else replayed.definition
    driven = {name: drive for drive in drives for name in drive.values}
    facts: dict[str, Any] = {"schema_version": 1}
    initial = stated.initial.given()
    commanded = [drive for name, drive in driven.items() if name.startswith("joint")]
    winds = [drive for name, drive in driven.items() if name.startswith("wind")]
    velocity = source.wind.velocity_m_per_s
    if not (driven or initial or velocity or float(model.arm.gravity)):
        raise _wrong(
            "nothing moves the arm; give --step, --ramp, --command or --wind, or --arm with an "
            "[initial] state"
        )
    if not commanded:
        facts["free_motion"] = True
    if initial:
        facts["initial"] = initial
    if commanded:
        facts["command"] = {"interpolation": commanded[0].interpolation}
    if velocity is not None:
        facts["wind"] = {"velocity_m_per_s": velocity}
    elif winds:
        facts["wind"] = {"interpolation": winds[0].interpolation}
    return facts


def _as_written(name: str, values: Any, digits: int) -> Any:
    """Values as they are when the file is read again, which is what the arm is to follow."""
    from dataclasses import replace

    from ..runs import Channel

    channel = Channel.named(name)
    if channel.quantity == "angle":
        channel = replace(channel, unit="deg")
    return channel.to_si([float(f"{value:.{digits}g}") for value in channel.from_si(values)])


def _origin(context: typer.Context) -> str:
    """The command line without what only says where to write."""
    from importlib.metadata import version

    words = [f"giajax {version('giajax')} simulate"]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if (
            parameter.name in ("out", "force")
            or value in (None, [], ())
            or value == parameter.default
        ):
            continue
        given = value if isinstance(value, list | tuple) else [value]
        for item in given:
            shown = f"{item:.15g}" if isinstance(item, float) else str(item)
            words.append(f"{parameter.opts[0]} {shlex.quote(shown)}")
    return " ".join(words)
