"""Options of commands that simulate an arm, as definitions and drives.

Shared by `giajax simulate` and `giajax sensitivity`; JAX is imported where it is needed only.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._values import NUMBER, plain_settings, settings, velocity, with_settings

if TYPE_CHECKING:
    from ..models import ArmModel
    from ..runs import Definition, Run
    from ..synthetic import Drive

DURATION = 25.0
"""Length of a run, s, by default."""

_START = 0.5
_RAMP_DURATION = 1.0

_MOVE = re.compile(
    rf"(?P<joint>[0-9]{{1,9}})=(?P<angle>{NUMBER})"
    rf"(?:@(?P<start>{NUMBER})(?::(?P<duration>{NUMBER}))?)?"
)


def definition_from_options(arm: Path | None, links: int | None, wind: str | None) -> "Definition":
    """What the arm file and the options say, the options on top."""
    from ..kinds import ARM
    from ..runs import Definition

    definition = Definition() if arm is None else Definition.load(arm)
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
    """The run of --command, whose commands go between its rows as the arm file says; or None.

    Raises:
        InputError: there are moves of --step or --ramp beside it, or it is no run.
    """
    from ..kinds import ArmSection
    from ..runs import Definition, read_run, read_sidecar

    if command is None:
        return None
    if moves:
        raise InputError(
            "--command gives the commands, and so do --step and --ramp: give one of them"
        )
    # The arm that recorded the run says which joints there are, where the sidecar describes it.
    recorded = bool(read_sidecar(command).section(ArmSection).contents())
    keys = ("command", "wind") if recorded else ("arm", "command", "wind")
    section = {key: item for key, item in definition.contents().items() if key in keys}
    return read_run(command, definition=Definition.parse(section))


def drives_of(run: "Run", rate: float) -> tuple[float, float, list["Drive"]]:
    """Start of a recorded run, its length in whole samples, its commands and wind."""
    from ..kinds import ARM, CommandSection, WindSection
    from ..synthetic import Drive

    if run.model != ARM.name or run.times is None:
        raise InputError(f"{run.path} is a run of the {run.model} model: give the run of an arm")
    length = float(run.times[-1] - run.times[0])
    if rate > 0:
        length = max(math.floor(length * rate + 1e-6), 1) / rate
    wind = run.definition.section(WindSection)
    interpolation = run.definition.section(CommandSection).interpolation
    apart: dict[str, dict[str, Any]] = {}  # what is straight is told by the largest value
    for name, values in run.commands.items():
        apart.setdefault(run.channels[name].quantity, {})[name] = values
    drives = [Drive(run.times, rows, interpolation) for rows in apart.values()]
    drives += [Drive(run.times, run.winds, wind.interpolation)] if run.winds else []
    return float(run.times[0]), length, drives


def moves_of(step: Sequence[str], ramp: Sequence[str], count: int, duration: float) -> "Drive":
    """The commands of --step and --ramp, for an arm of `count` joints and a run of a length (s)."""
    from ..synthetic import Move, joint_moves

    moves = []
    for option, texts in (("--step", step), ("--ramp", ramp)):
        for text in texts:
            match = _MOVE.fullmatch(text.replace(" ", ""))
            if match is None or (match["duration"] and option == "--step"):
                form = "JOINT=DEG[@T]" if option == "--step" else "JOINT=DEG[@START:DURATION]"
                raise InputError(f"{option} {text!r} must be {form}, such as 1=30@0.5: correct it")
            length = float(match["duration"] or _RAMP_DURATION) if option == "--ramp" else 0.0
            if option == "--ramp" and length == 0:
                raise InputError(
                    f"{option} {text!r} has the duration 0: give a longer one, or --step"
                )
            start = _START if match["start"] is None else float(match["start"])
            angle = math.radians(float(match["angle"]))
            moves.append(Move(int(match["joint"]), angle, start, length))
    return joint_moves(moves, joints=count, end=duration)


def model_and_truth(
    definition: "Definition", pairs: Sequence[str], solver: str, tolerance: float
) -> tuple["ArmModel", dict[str, float | list[float]]]:
    """The model with the parameters of --set, and the truth to state."""
    import jax.numpy as jnp

    from ..models import ArmModel, arm_from_definition, sensors_from_definition
    from ..parameters import default_free, get

    model = ArmModel(
        arm_from_definition(definition),
        tolerance=jnp.asarray(tolerance),
        solver=solver,
        sensors=sensors_from_definition(definition),
    )
    model = with_settings(model, settings(pairs))
    truth = {
        path: float(get(model, path)) for path in default_free(model) if not get(model, path).ndim
    }
    return model, {**truth, **plain_settings(pairs, "--set")}


def facts_of(
    definition: "Definition", replayed: "Run | None", drives: Sequence["Drive"], model: "ArmModel"
) -> dict[str, Any]:
    """The sections of the sidecar that say what moves the arm."""
    from ..kinds import InitialSection, WindSection

    source = definition if replayed is None else replayed.definition
    driven = {name: drive for drive in drives for name in drive.values}
    facts: dict[str, Any] = {"schema_version": 1}
    initial = definition.section(InitialSection).contents()
    commanded = [drive for name, drive in driven.items() if name.startswith("joint")]
    winds = [drive for name, drive in driven.items() if "wind_" in name]
    velocity = source.section(WindSection).velocity_m_per_s
    if not (driven or initial or velocity or float(model.arm.gravity)):
        raise InputError(
            "nothing moves the arm: give --step, --ramp, --command or --wind, or --arm with an "
            "[initial] state"
        )
    if not commanded:
        facts["free_motion"] = True
    if initial:
        facts["initial"] = initial
    if commanded:
        facts["command"] = {"interpolation": commanded[0].interpolation}
    # Gusts have the mean wind in them.
    if winds:
        facts["wind"] = {"interpolation": winds[0].interpolation}
    elif velocity is not None:
        facts["wind"] = {"velocity_m_per_s": velocity}
    return facts
