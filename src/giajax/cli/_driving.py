"""The parts of `giajax drive`: what is driven, by what, and what is saved."""

import shlex
import sys
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, cast

import typer

from .._errors import InputError
from ._driven import definition_from_options
from ._gusts import gusts_of
from ._model import is_result

if TYPE_CHECKING:
    import numpy as np

    from ..driving import Compensation, PadMapping, Session, TipCamera
    from ..models import ArmModel
    from ..runs import Definition
    from ..synthetic import Drive

# Of gusts, s; then they begin again. And how often their rows are.
_GUSTY, _GUST_RATE = 1800.0, 10.0


def free_name() -> Path:
    """A name that no drive has yet."""
    number = 1
    while (path := Path(f"drive-{number}.csv")).exists() or path.with_suffix(".toml").exists():
        number += 1
    return path


def driven_arm(
    what: Path | None, links: int | None, wind: str | None
) -> "tuple[Definition, ArmModel]":
    """What a file and the options say, and the arm: of a fit, or of a file."""
    from ..models import ArmModel, arm_from_definition, sensors_from_definition

    if what is None or not is_result(what):
        definition = definition_from_options(what, links, wind)
        arm, sensors = arm_from_definition(definition), sensors_from_definition(definition)
        return definition, ArmModel(arm, sensors=sensors)
    if links is not None:
        raise InputError("--links is of an arm from a file, and this one was fitted: leave it out")
    from ..fitting import load_result
    from ..tasks import stored_result

    stored_result(what)
    model = load_result(what).model
    if model.kind != ArmModel.kind:
        raise InputError(f"{what} is a fit of a {model.kind}, which nobody drives: give an arm's")
    return definition_from_options(None, None, wind), cast("ArmModel", model)


def mapping_of(pad: Path | None, joints: int) -> "PadMapping":
    from ..driving import PadMapping

    return PadMapping.usual(joints) if pad is None else PadMapping.load(pad, joints)


def wind_of(
    gusts: str | None, definition: "Definition", model: "ArmModel", seed: int
) -> "Drive | None":
    """Gusts about a mean wind, or that wind alone."""
    import numpy as np

    from ..kinds import WindSection
    from ..synthetic import Drive

    if gusts is not None:
        sampling = {"duration": _GUSTY, "rate": _GUST_RATE, "seed": seed}
        wind, left_out = gusts_of(gusts, definition, None, model.arm, coherence=None, **sampling)
        typer.echo(left_out)
        return wind
    mean = definition.section(WindSection).velocity_m_per_s
    if mean is None:
        return None
    names = ("wind_x", "wind_y", "wind_z")
    values = {name: np.full(2, part) for name, part in zip(names, mean, strict=True)}
    return Drive(np.array([0.0, _GUSTY]), values, "linear")


def compensation_of(result: Path | None, joints: int) -> "Compensation | None":
    if result is None:
        return None
    from ..control import compensator_for_model
    from ..driving import Compensation
    from ..fitting import load_result
    from ..tasks import stored_result

    stored_result(result)
    return Compensation(compensator_for_model(load_result(result).model), joints)


def replay_table(session: "Session", table: "Mapping[str, np.ndarray]") -> None:
    """Drive by a table; says how far it is, where somebody watches."""
    from ..driving import replay

    watched, said = sys.stderr.isatty(), -1

    def on_progress(done: float, whole: float) -> None:
        nonlocal said
        if watched and (percent := int(100 * done / whole)) > said:
            said = percent
            print(f"\rdriven {done:.0f} of {whole:.0f} s", end="", file=sys.stderr, flush=True)

    replay(session, table, on_progress=on_progress)
    if watched:
        print(file=sys.stderr)


def serve(session: "Session", camera: "TipCamera", *, host: str, port: int, browser: bool) -> None:
    """Serve the page until Ctrl-C."""
    from ..driving import Cockpit

    cockpit = Cockpit(session, camera, host=host, port=port)
    try:
        typer.echo(f"open {cockpit.address}")
        if cockpit.is_open:
            typer.echo("whoever has this address drives the arm, from other machines, too")
        typer.echo("Ctrl-C ends the drive and saves it")
        if browser:
            webbrowser.open(cockpit.address)
        while not cockpit.wait(1.0):
            pass
        raise InputError(cockpit.error or "the drive is over")
    except KeyboardInterrupt:
        typer.echo("\nsaving the drive")
    finally:
        cockpit.close()


def save(
    session: "Session",
    out: Path,
    channels: list[str],
    *,
    force: bool,
    noise: dict[str, float],
    every: int,
    seed: int,
    origin: str,
) -> None:
    """Write the drive, and say what is in it; one in which nothing was moved is not written."""
    from ..runs import sidecar_path, write_run

    record = session.record
    try:
        run = record.run(
            channels, name=out.stem, noise=noise, every=every, seed=seed, origin=origin
        )
    except InputError as error:
        typer.echo(f"giajax: {error}", err=True)
        return
    write_run(out, run.times, run.values, definition=run.definition, digits=12, force=force)
    typer.echo(
        f"wrote {out} and {sidecar_path(out)}: {session.time:.1f} s driven, {len(record)} rows, "
        f"{len(run.observations)} channels; see: giajax check {shlex.quote(str(out))}"
    )
    if session.lost:
        typer.echo(f"the simulation was {session.lost:.1f} s behind the clock, which were left out")
