"""`giajax sensitivity` and `design`: expected accuracy of an experiment, and its design."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure, stop_if_asked, stopped_status
from ..runtime.text import InputError
from ._commands import (
    Force,
    Json,
    Links,
    Quiet,
    Ramp,
    Replayed,
    Settings,
    Solver,
    Step,
    Texts,
    Tolerance,
    Wind,
    argument,
    command,
    failed_simulation,
    print_table,
    say_written,
    write_folder,
)
from ._model import is_result
from ._simulate import (
    DURATION,
    channel_names,
    check_tolerance,
    definition_from_options,
    drives_of,
    facts_of,
    model_and_truth,
    moves_of,
    replayed_run,
)
from ._values import Values, deviations, noise_section, settings, with_settings

if TYPE_CHECKING:
    import numpy as np

    from ..apps.design import Design, Evaluation
    from ..fitting import FitResult
    from ..models import AbstractModel, ArmModel
    from ..recordings import FitSettings, Run
    from ..studies import Sensitivity

_RATE = 10.0
# Default noise, SI, by the beginning of the quantity; "ang" includes angular rates.
_NOISE = {"length": 0.01, "ang": math.radians(0.5), "pixel": 2.0}
_DEFAULT_RAMP = "1=30"
_SENSITIVITY_FILES = ("sensitivity.png", "sensitivity.csv", "information.csv")


@command(
    """\b
Examples:
  giajax sensitivity --parameter air.drag_coefficient --out drag
                            analyse the paper's arm
  giajax sensitivity --parameter air.drag_coefficient \\
      --parameter joints.pitch_stiffness --ramp 1=20 --ramp 9=-15@3:2 \\
      --noise position_m=0.02 --out both
                            analyse two parameters and another motion
  giajax sensitivity --parameter camera.origin --arm my_arm.toml \\
      --channels tip --out camera
                            analyse your arm with a filmed tip
  giajax sensitivity --data run.csv --parameter joints.damping --out recorded
                            analyse a recorded run

By default, the base joint moves to 30 deg within 1 s, and all links are filmed.
The output files are sensitivity.png, sensitivity.csv (derivatives of the channels
with respect to the parameters, over time) and information.csv (share of each link
in the information, and the standard error obtained from that link alone).""",
    group="plan",
    pictures=True,
    old_words="--data",
)
def sensitivity(
    parameter: Annotated[list[str], "PATH", "A parameter, as listed by 'giajax parameters'."],
    out: Annotated[Path, "DIR", "Folder for figure and tables."],
    data: Annotated[Path | None, "RUN.csv", "A recorded run of any model."] = None,
    arm: Annotated[Path | None, "FILE.toml", "TOML file with an [arm] section."] = None,
    links: Links = None,
    pairs: Settings = None,
    step: Step = None,
    ramp: Ramp = None,
    command: Replayed = None,
    wind: Wind = None,
    duration: Annotated[float | None, "S", "Duration of the run. [default: 25]"] = None,
    rate: Annotated[float | None, "HZ", "Samples per second. [default: 10]"] = None,
    channels: Annotated[
        Texts, "CHANNEL", "Recorded channels, such as link06, tip or joints. [default: all]"
    ] = None,
    noise: Annotated[
        Texts,
        "KEY=VALUE",
        "Standard deviation of the white noise for KEY, a key of [noise]. [default: from the run, "
        "otherwise position_m=0.01, angle_deg=0.5, pixel_px=2]",
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show when and where a motion is sensitive to parameters.

    Computes sensitivities and, before a recording exists, the standard errors to expect from a fit.
    """
    from ..recordings import check_output_folder, read_run

    section = noise_section(noise, "--noise", positive=True)
    check_output_folder(out, _SENSITIVITY_FILES, force=force)
    typed = settings(pairs)
    again = (arm, step, ramp, command, wind, links, duration, rate)
    if data is not None and any(value is not None and value != [] for value in again):
        raise InputError(
            "the run given with --data determines the arm and the motion: omit the options that "
            "specify them"
        )
    recorded = None if data is None else read_run(data)
    sections = definition_from_options(arm, links, wind, quiet=quiet)
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
    title = f"{recorded.name}: sensitivity and information from each body"
    files["sensitivity.png"] = to_png(sensitivity_figure(sensitivities, noises, title))
    write_folder(out, files, force=force)
    if not quiet:
        _show_sensitivity(sensitivities, noises, information_shares(sensitivities, noises))
        say_written(out, _SENSITIVITY_FILES)


def _noise_of(run: "Run", channels: tuple[str, ...], section: dict[str, float]) -> list[float]:
    """Return the noise as given by options, else as in the run, else by default; SI."""
    from ..recordings import Channel

    noises, options = [], deviations(section, "--noise", channels)
    for name in channels:
        quantity = Channel.named(name).quantity
        usual = (size for start, size in _NOISE.items() if quantity.startswith(start))
        stated = run.noise(name) if name in run.channels else None
        known = (one for one in (options.get(name), stated, *usual) if one is not None)
        if (deviation := next(known, None)) is None:
            raise InputError(
                f"the noise of {name} is unknown: give it in [noise] of the sidecar, or with "
                "--noise"
            )
        noises.append(deviation)
    return noises


def _show_sensitivity(
    sensitivities: "Sensitivity", noises: list[float], shares: "np.ndarray"
) -> None:
    bodies = list(sensitivities.bodies())
    rows: list[list[Any]] = []
    for index, path in enumerate(sensitivities.parameters):
        error = float(sensitivities.standard_errors(noises)[index])
        most = int(shares[:, index].argmax())
        unit, share = sensitivities.units[index] or None, shares[most, index]
        found = [f"{error:.2g}", unit, f"{bodies[most]} ({100 * share:.0f} %)"]
        cells = found if error < math.inf else ["not determined", unit, None]
        rows.append([path, float(sensitivities.values[index]), *cells])
    print_table(["parameter", "value", "expected error", "unit", "most informative body"], rows)


_KEPT = ("initial", "wind", "noise")  # Sections of a file that are kept in addition to the arm.


def source_of(
    source: Path | None,
    links: int | None,
    changed: Values,
    free: list[str],
    solver: str,
    tolerance: float,
    *,
    quiet: bool = False,
) -> tuple["ArmModel | FitResult", dict[str, Any]]:
    """Return the arm or the fit, and the file's free parameters, priors, ties and initial state.

    The options --links, --set and --free override the file.
    """
    if source is not None and is_result(source):
        from ..fitting import load_result
        from ..models import capabilities

        if links is not None or changed:
            raise InputError("the fit determines the arm: omit --links and --set")
        fitted = load_result(source)
        model = capabilities.with_integration(fitted.model, solver=solver, tolerance=tolerance)
        # The same as in the definition of the fit, except for noise, which the fit contains.
        first = {**fitted.config["runs"][0], "noise": None}
        known = dict.fromkeys(("free", "priors", "ties"))
        return dataclasses.replace(fitted, model=model), {**known, "definition": _kept(first)}
    from ..recordings import read_sidecar

    definition = definition_from_options(source, links, None, quiet=quiet)
    fit = definition.fit
    if source is not None and fit.data:
        # Properties of the arm that a fit definition does not contain come from its first run.
        definition = read_sidecar(source.parent / fit.data[0]).merged_with(definition)
    kept = {path: value for path, value in {**fit.start, **fit.fix}.items() if path not in changed}
    started = {path: value if isinstance(value, list) else [value] for path, value in kept.items()}
    model, _ = model_and_truth(definition, {**started, **changed}, solver, tolerance)
    return model, {
        "free": _free(model, fit),
        "priors": fit.known,
        "ties": {path: text for path, text in fit.ties.items() if path not in {*changed, *free}},
        "definition": _kept(definition.contents()),
    }


def _kept(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return initial state, wind and noise of a file, without what only a recording has."""
    kept = {key: dict(stated[key]) for key in _KEPT if stated.get(key) is not None}
    # A planned experiment has no first row.
    kept.get("initial", {}).pop("first_row", None)
    return {key: section for key, section in kept.items() if section}


def _free(model: "ArmModel", fit: "FitSettings") -> list[str] | None:
    """Return the elements that the fit of a definition estimates; None without a fit."""
    from ..schema.parameters import default_free, elements, switched_on

    if not fit.contents():
        return None
    apart = (*fit.per_run, *fit.groups)
    held = (*fit.fix, *fit.ties)
    model = switched_on(model, (*fit.start, *(fit.free or ()), *apart, *held))
    named = default_free(model, fit.start) if fit.free is None else fit.free
    without = {element.path for path in held for element in elements(model, path)}
    free = [element.path for path in (*named, *apart) for element in elements(model, path)]
    return [path for path in free if path not in without]


_DESIGN_FILES = ("command.csv", "command.toml", "design.json", "design.png")
_DIGITS = 12


@command(
    """\b
Examples:
  giajax design giajax-out/run --parameter air.drag_coefficient --out next
                            design an experiment after a fit
  giajax design --parameter air.drag_coefficient --joints 1,3 --max-angle 30 \\
      --max-angle-rate 30 --duration 25 --markers 3 --out next
                            use the paper's arm within limits
  giajax design fits/base_step.toml --parameter air.drag_coefficient \\
      --parameter joints.pitch_stiffness --criterion D \\
      --channels link06_z,link20_z --out next
                            use two parameters of a fit definition
  giajax simulate --command next/command.csv --to rehearsal.csv
                            simulate the designed experiment

SOURCE is the folder of a fit or its result.json, a fit definition, or a TOML
file with an [arm] section. The default is the preset. The output files are
command.csv (the command for an operator) with its sidecar, design.json and
design.png.""",
    group="plan",
    pictures=True,
    old={
        "--for": "--parameter",
        "--uncertainty": "--relative-uncertainty",
        "--angle": "--max-angle",
        "--angle-rate": "--max-angle-rate",
        "--iterations": "--max-iterations",
        "--starts": "--candidates",
        "--draws": "--scenarios",
    },
)
def design(
    parameter: Annotated[list[str], "PATH", "A parameter to estimate."],
    out: Annotated[Path, "DIR", "Folder for the files."],
    source: Annotated[
        Path | None, argument("SOURCE", "The arm or a fit of the arm; see below.")
    ] = None,
    links: Links = None,
    pairs: Settings = None,
    free: Annotated[
        Texts, "PATH", "Further free parameters of the future fit. [default: as in the source]"
    ] = None,
    criterion: Annotated[
        str | None,
        "c|A|D",
        "Criterion: error of one parameter (c), or trace (A) or determinant (D) of the covariance. "
        "[default: c for one parameter, otherwise A]",
    ] = None,
    joints: Annotated[str, "N,N", "Joints that may be commanded."] = "1",
    max_angle: Annotated[float, "DEG", "Largest commanded angle of a joint."] = 30.0,
    max_angle_rate: Annotated[float, "DEG/S", "Largest rate of a commanded angle."] = 30.0,
    duration: Annotated[float, "S", "Duration of the run."] = 25.0,
    rate: Annotated[float, "HZ", "Samples per second."] = 10.0,
    channels: Annotated[
        Texts,
        "CHANNEL",
        "Channels that may be recorded, such as link06 or link20_z. [default: all]",
    ] = None,
    markers: Annotated[int | None, "N", "Maximum number of filmed links. [default: all]"] = None,
    noise: Annotated[
        Texts,
        "KEY=VALUE",
        "Standard deviation of the white noise for KEY, a key of [noise]. [default: from the fit, "
        "otherwise position_m=0.01, angle_deg=0.5, pixel_px=2]",
    ] = None,
    relative_uncertainty: Annotated[
        float | None,
        "SHARE",
        "Relative uncertainty of the free parameters. [default: from the fit, otherwise 0.2]",
    ] = None,
    scenarios: Annotated[int, "N", "Number of random draws of the uncertain parameters.", 1] = 4,
    worst: Annotated[
        bool, "Minimise the largest error of all draws instead of their mean error."
    ] = False,
    knots: Annotated[
        int | None,
        "N",
        "Number of knots of each joint command after its start. [default: 15, or 30 for all "
        "joints]",
    ] = None,
    candidates: Annotated[int, "N", "Number of commands compared before the optimisation.", 1] = 6,
    follow: Annotated[int, "N", "Number of compared commands that are then optimised.", 1] = 2,
    max_iterations: Annotated[
        int, "N", "Maximum number of optimiser steps for each command.", 1
    ] = 25,
    solver: Solver = "springs5",
    tolerance: Tolerance = 1e-6,
    as_json: Json = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Design the next experiment: its command and its markers.

    Minimises the standard error of chosen parameters within limits on angle, rate and time. The
    error is averaged over the current uncertainty of these parameters. After Ctrl-C, the best
    result so far is kept.
    """
    from ..recordings import check_output_folder, stored_result, write_run

    check_tolerance(tolerance)
    section = noise_section(noise, "--noise", positive=True)
    moving, values = _numbers(joints), settings(pairs)
    check_output_folder(out, _DESIGN_FILES, force=force)
    if source is not None and is_result(source):
        # Reject files that are not results before JAX is imported, which takes seconds.
        stored_result(source)
    configure()
    from ..apps.design import Limits, design_experiment, design_figure, design_json, joint_count
    from ..report import to_png

    largest = (math.radians(max_angle), math.radians(max_angle_rate))
    limits = Limits(moving, *largest, duration, rate)
    given, known = source_of(source, links, values, free or [], solver, tolerance, quiet=quiet)
    names = channel_names(channels or ["all"], joint_count(given))
    found = design_experiment(
        given,
        parameter,
        limits,
        criterion=criterion or ("c" if len(parameter) == 1 else "A"),
        channels=names,
        markers=markers,
        noise=deviations(section, "--noise", names),
        uncertainty=relative_uncertainty,
        over="worst" if worst else "mean",
        draw_count=scenarios,
        knots=knots,
        starts=candidates,
        follow=follow,
        iterations=max_iterations,
        progress=stop_if_asked if quiet else _Progress(),
        **known | ({"free": free} if free else {}),
    )
    text = design_json(found)
    run = found.designed.run
    picture = to_png(design_figure(found, f"{', '.join(found.wanted)}: the next experiment"))
    contents = {"design.json": f"{text}\n".encode(), "design.png": picture}
    write_folder(out, contents, force=force)
    how: dict[str, Any] = {"definition": run.definition, "digits": _DIGITS, "force": force}
    write_run(out / "command.csv", run.times, run.commands, **how)
    if as_json:
        typer.echo(text)
    elif not quiet:
        _show_design(found)
        say_written(out, _DESIGN_FILES)
    if found.status == "interrupted":
        typer.echo("giajax: stopped: the best command found so far is shown", err=True)
        raise typer.Exit(stopped_status())


def _numbers(joints: str) -> tuple[int, ...]:
    words = [word.strip() for word in joints.split(",")]
    if not all(word.isascii() and word.isdigit() and len(word) < 9 for word in words):
        raise InputError(f"--joints is {joints!r}: give numbers separated by commas, such as 1,3")
    return tuple(int(word) for word in words)


class _Progress:
    """One line per evaluation on standard error, with the error relative to the first command."""

    def __init__(self) -> None:
        typer.echo("compiling ...", err=True)
        self._first = math.nan

    def __call__(self, evaluation: "Evaluation") -> None:
        if evaluation.number == 1:
            self._first = evaluation.value
            typer.echo("   n  start    error   best  (relative to the base step)", err=True)
        start = evaluation.start or "-"
        shares = [math.exp(v - self._first) for v in (evaluation.value, evaluation.best)]
        typer.echo(
            f"{evaluation.number:4d}  {start:>5}  {shares[0]:7.3f}  {shares[1]:5.3f}", err=True
        )
        stop_if_asked(evaluation)


def _show_design(found: "Design") -> None:
    from ..apps.design import DESIGN_HEADINGS, design_rows

    typer.echo("expected standard errors:")
    print_table(DESIGN_HEADINGS, design_rows(found))
    limits = found.limits
    numbers = ", ".join(str(joint) for joint in limits.joints)
    typer.echo(
        f"\njoints to move: {numbers}, at most {math.degrees(limits.angle):g} deg and "
        f"{math.degrees(limits.rate):g} deg/s, for {limits.duration:g} s\n"
        f"markers to film: {', '.join(found.designed.markers)}"
    )
    typer.echo(f"criterion {found.criterion}: {found.summary()}")
    if found.designed.criterion is None:
        typer.echo("record more data, free fewer parameters, or add priors")
    else:
        low, high = found.spread
        within = f"{low:.2f} to {high:.2f} times the predicted error"
        typer.echo(f"for {found.draws} draws of the uncertain parameters, the error is {within}")
    if found.status == "iteration limit":
        typer.echo("stopped at the iteration limit: increase --max-iterations")
