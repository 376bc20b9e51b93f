"""`giajax sensitivity`: how well a recording would determine parameters."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import Texts, argument, command
from ._options import (
    Force,
    Links,
    Replayed,
    Settings,
    Wind,
    failed_simulation,
    print_table,
    say_written,
    write_folder,
)
from ._simulate import (
    DURATION,
    channel_names,
    definition_from_options,
    drives_of,
    facts_of,
    model_and_truth,
    moves_of,
    replayed_run,
)
from ._values import deviations, noise_section, settings, with_settings

if TYPE_CHECKING:
    import numpy as np

    from ..models import AbstractModel
    from ..recordings import Run
    from ..studies import Sensitivity

_RATE = 10.0
# Of what is recorded, SI, by the beginning of its quantity; "angle" has a rate, too.
_NOISE = {"length": 0.01, "ang": math.radians(0.5), "pixel": 2.0}
_DEFAULT_RAMP = "1=30"
_FILES = ("sensitivity.png", "sensitivity.csv", "information.csv")


@command("""\b
Examples:
  giajax sensitivity --parameter air.drag_coefficient --out drag
  giajax sensitivity --parameter air.drag_coefficient --parameter joints.pitch_stiffness
                     --ramp 1=20 --ramp 9=-15@3:2 --noise position_m=0.02 --out both
  giajax sensitivity --parameter camera.origin --arm my_arm.toml --channels tip --out camera
  giajax sensitivity run.csv --parameter joints.damping --out recorded

\b
Without a run: the base joint to 30 deg within a second, all links filmed.
Writes sensitivity.png, sensitivity.csv (derivatives over time) and information.csv
(share of each link, and the standard error with it alone).""")
def sensitivity(
    parameter: Annotated[list[str], "PATH", "A parameter ('giajax parameters')."],
    out: Annotated[Path, "DIR", "Folder for picture and tables."],
    run: Annotated[Path | None, argument("[RUN.csv]", "A run of any model, as recorded.")] = None,
    arm: Annotated[Path | None, "FILE.toml", "The arm: [arm] of this file."] = None,
    links: Links = None,
    pairs: Settings = None,
    step: Annotated[Texts, "JOINT=DEG[@T]", "Step of a command."] = None,
    ramp: Annotated[Texts, "JOINT=DEG[@START:DURATION]", "Linear change of a command."] = None,
    command: Replayed = None,
    wind: Wind = None,
    duration: Annotated[float | None, "S", "Length of the run, s. [25]"] = None,
    rate: Annotated[float | None, "HZ", "Samples per second. [10]"] = None,
    channels: Annotated[Texts, "CHANNELS", "Recorded: link06, tip, joints, all. [all]"] = None,
    noise: Annotated[
        Texts,
        "KEY=VALUE",
        "Standard deviation, by a key of [noise]. [the run's, or "
        "position_m=0.01, angle_deg=0.5, pixel_px=2]",
    ] = None,
    force: Force = False,
) -> None:
    """Show how strongly, when and where a motion responds to parameters.

    And what that is worth: the standard errors to expect of a fit, before anything is recorded.
    """
    from ..recordings import check_output_folder, read_run

    section = noise_section(noise, "--noise", positive=True)
    check_output_folder(out, _FILES, force=force)
    typed = settings(pairs)
    again = (arm, step, ramp, command, wind, links, duration, rate)
    if run is not None and any(value is not None and value != [] for value in again):
        raise InputError("a run brings its own arm and motion: leave out the options for them")
    recorded = None if run is None else read_run(run)
    sections = definition_from_options(arm, links, wind)
    replayed = replayed_run(command, sections, step or ramp)
    configure()
    from ..apps.synthetic import Drive, planned, sampled
    from ..models import model_for, parameter_values
    from ..recordings import Definition
    from ..report import information_shares, sensitivity_figure, sensitivity_files, to_png
    from ..schema import InitialSection
    from ..schema.parameters import replace
    from ..studies import sensitivity as along

    model: AbstractModel
    names: list[str] | None
    if recorded is not None:
        model = with_settings(model_for([recorded]), typed)
        names = channels
    else:
        arm_model, _ = model_and_truth(sections, typed, "tsit5", 1e-8)
        count, drives = arm_model.arm.count, list[Drive]()
        start, length = 0.0, DURATION
        if replayed is not None:
            start, length, drives = drives_of(replayed, rate or _RATE)
        else:
            still = bool(wind or sections.section(InitialSection).contents())
            moves = ramp or ([] if step or still else [_DEFAULT_RAMP])
            if moves or step:
                drives = [moves_of(step or [], moves, count, duration or length)]
        facts = facts_of(sections, replayed, drives, arm_model)
        times, inputs = sampled(
            drives, start=start, duration=duration or length, rate=rate or _RATE
        )
        names = channel_names(channels or ["all"], count)
        for name in ("arm", "sensors", "camera", "landmark"):
            facts[name] = sections.contents().get(name)
        definition = Definition.parse({k: v for k, v in facts.items() if v}, "sensitivity")
        recorded = planned(
            times, inputs, links=count, channels=names, definition=definition.contents()
        )
        model = replace(model_for([recorded]), parameter_values(arm_model))
    with failed_simulation(" (option --set)"):
        sensitivities = along(model, recorded, parameter, names)
    noises = _noise_of(recorded, sensitivities.channels, section)
    files = {name: text.encode() for name, text in sensitivity_files(sensitivities, noises).items()}
    title = f"{recorded.name}: sensitivity, and the information in each body"
    files["sensitivity.png"] = to_png(sensitivity_figure(sensitivities, noises, title))
    write_folder(out, files, force=force)
    _show(sensitivities, noises, information_shares(sensitivities, noises))
    say_written(out, _FILES)


def _noise_of(run: "Run", channels: tuple[str, ...], section: dict[str, float]) -> list[float]:
    """What the options say of the noise, else what the run states, else the usual; SI."""
    from ..recordings import Channel

    noises, options = [], deviations(section, "--noise", channels)
    for name in channels:
        quantity = Channel.named(name).quantity
        usual = (size for start, size in _NOISE.items() if quantity.startswith(start))
        stated = run.noise(name) if name in run.channels else None
        known = (one for one in (options.get(name), stated, *usual) if one is not None)
        if (deviation := next(known, None)) is None:
            raise InputError(
                f"the noise of {name} is not stated: state it in [noise] of the run, or by --noise"
            )
        noises.append(deviation)
    return noises


def _show(sensitivities: "Sensitivity", noises: list[float], shares: "np.ndarray") -> None:
    bodies = list(sensitivities.bodies())
    rows: list[list[Any]] = []
    for index, path in enumerate(sensitivities.parameters):
        error = float(sensitivities.standard_errors(noises)[index])
        most = int(shares[:, index].argmax())
        unit, share = sensitivities.units[index] or None, shares[most, index]
        found = [error, unit, f"{bodies[most]} ({100 * share:.0f} %)"]
        cells = found if error < math.inf else ["not determined", unit, None]
        rows.append([path, float(sensitivities.values[index]), *cells])
    print_table(["parameter", "value", "expected error", "unit", "most informative"], rows)
