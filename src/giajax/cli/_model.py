"""`giajax parameters` and `predict`, and the model that any command is given."""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure
from ..runtime.text import InputError
from ._commands import (
    Force,
    Json,
    Links,
    OnlyChannels,
    Quiet,
    Renamed,
    Texts,
    argument,
    check_quiet,
    command,
    print_table,
)

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..models import AbstractModel
    from ..recordings import Definition, Run
    from ..schema.parameters import Parameter


def is_result(path: Path) -> bool:
    """Return whether the path is a fit: its folder or its result.json."""
    return path.is_dir() or path.suffix == ".json"


def definition_of(path: Path | None) -> "Definition":
    """Return what a model file adds to the sidecars; empty for a fit."""
    from ..recordings import Definition, stored_result

    if path is None:
        return Definition()
    if not path.exists():
        raise InputError(
            f"{path} does not exist: give the folder of a fit, its result.json, or a TOML file "
            "that defines a model"
        )
    if is_result(path):
        # Reject files that are not results before JAX is imported, which takes seconds.
        stored_result(path)
        return Definition()
    return Definition.load(path)


DOUBTED = ("inadequate", "doubtful")
"""Verdicts that mark the estimates of a fit as unreliable."""


def say_doubts(path: Path | None, what: str, *, quiet: bool) -> None:
    """Print a warning if `what` depends on a fit with an unreliable verdict."""
    from ..recordings import stored_result

    if quiet or path is None or not is_result(path):
        return
    verdict = stored_result(path)[1].get("verdict") or {}
    if verdict.get("status") in DOUBTED:
        typer.echo(
            f"note: according to its verdict, the fit {path} is {verdict['status']}, so "
            f"{what} may be wrong: see giajax report {shlex.quote(str(path))}",
            err=True,
        )


def model_of(path: Path | None, runs: Sequence["Run"]) -> "AbstractModel":
    """Return the model of a fit, else that of the runs read with `definition_of` the file."""
    from ..fitting import FitResult

    found = fit_or_model(path, runs)
    return found.model if isinstance(found, FitResult) else found


def fit_or_model(path: Path | None, runs: Sequence["Run"]) -> "FitResult | AbstractModel":
    """Return the fit itself, else the model of the runs."""
    from ..fitting import load_result
    from ..models import model_for

    return model_for(runs) if path is None or not is_result(path) else load_result(path)


def arm_of(path: Path | None, preset: str | None = None, *, quiet: bool = False) -> "Definition":
    """Return the definition of an arm file; say so if neither it nor an option names a preset."""
    from ..recordings import Definition
    from ..schema import ARM, ArmSection, from_default_preset, preset_sentence

    if path is None:
        return Definition()
    definition = Definition.load(path)
    taken = from_default_preset(definition.section(ArmSection))
    if taken and not quiet and preset is None and definition.model in (None, ARM.name):
        typer.echo(f"note: {path}: {preset_sentence(taken)}", err=True)
    return definition


_FEW = 3  # An array with more different elements is shown by its range.


@command(
    """\b
Examples:
  giajax parameters         list the parameters of the paper's arm
  giajax parameters --data joint.csv
                            use the model of a run
  giajax parameters --preset takeichi_20m_full
                            use another preset
  giajax parameters --arm my_arm.toml
                            use your own arm
  giajax parameters --json  print JSON
  giajax fit --data run.csv --free joints.damping --free "links.mass[19]"
                            fit some of the parameters

Each value is taken from the preset, the file or the sidecar of the run, or is the
default. Parameters marked 'off' are omitted from the model. The options --start
and --free of `giajax fit` switch such a parameter on at the listed value. An
array has one element for each link or joint. For example, links.mass[0] is the
first element of links.mass. For parameters marked 'assumed', the paper gives no
value: estimate these parameters by a fit.""",
    group="data",
    old_words="--data",
)
def parameters(
    data: Annotated[
        Path | None, "RUN.csv", "List the parameters of this run's model. [default: the arm model]"
    ] = None,
    arm: Annotated[Path | None, "FILE.toml", "TOML file with an [arm] section."] = None,
    preset: Annotated[str | None, "NAME", "Preset of the arm. [default: takeichi_20m]"] = None,
    links: Links = None,
    as_json: Json = False,
) -> None:
    """List every parameter of the arm, or of a run's model.

    Prints path, unit, value, bounds and meaning of each parameter.
    """
    from ..recordings import Definition, read_run

    if data is not None and (arm or preset or links is not None):
        raise InputError(
            "the run given with --data determines the model: omit --arm, --preset and --links"
        )
    recorded = None if data is None else read_run(data)
    definition = arm_of(arm, preset)
    options = {"preset": preset, "links": links}
    section = {key: value for key, value in options.items() if value is not None}
    definition = definition.merged_with(Definition.parse({"arm": section}, "the command line"))
    configure()
    from ..fitting import units_in_si
    from ..models import ArmModel, model_for
    from ..schema.parameters import declared, left_out

    model = ArmModel.stated_in(definition) if recorded is None else model_for([recorded])
    known = [*declared(model).values(), *left_out(model).values()]
    units = units_in_si(model)
    facts = [_facts(parameter, units[parameter.path], model) for parameter in known]
    if as_json:
        typer.echo(json.dumps(facts, indent=2, allow_nan=False))
        return
    headings = ["parameter", "unit", "value", "bounds", "in a fit", "elements", "", "meaning"]
    print_table(headings, [_row(fact) for fact in facts], left=len(headings))


def _facts(parameter: "Parameter", unit: str, model: Any) -> dict[str, Any]:
    from ..runtime.records import finite_or_none

    declaration = parameter.declaration
    on = parameter.is_on(model)
    value = parameter.value(model) if on else None
    shape = declaration.shape if value is None else value.shape
    return {
        "path": parameter.path,
        "unit": unit,
        "value": None if value is None else value.tolist(),
        "default": declaration.default,
        "lower": finite_or_none(declaration.lower),
        "upper": finite_or_none(declaration.upper),
        "on": on,
        "free": on and not declaration.frozen,
        "assumed": declaration.assumed,
        "elements": shape[0] if shape else None,
        "meaning": declaration.meaning,
        "source": declaration.source or None,
        "key": None if declaration.key is None else declaration.key.name,
    }


def _row(fact: dict[str, Any]) -> list[Any]:
    return [
        fact["path"],
        fact["unit"] or None,
        _value(fact),
        _bounds(fact["lower"], fact["upper"]),
        ("free" if fact["free"] else "held") if fact["on"] else "off",
        fact["elements"],
        "assumed" if fact["assumed"] else "",
        fact["meaning"],
    ]


def _value(fact: dict[str, Any]) -> str:
    """Format a value.

    An array is shown as the one number that all elements share, as a few numbers, or as a range.
    """
    value, default = fact["value"], fact["default"]
    elements = value if isinstance(value, list) else [default if value is None else value]
    # Unit conversion and computation affect the last digits of a value, but not those of a default.
    shown = {number: f"{number:.{10 if number == default else 7}g}" for number in elements}
    if len(shown) == 1:
        return shown[elements[0]]
    if len(elements) <= _FEW:
        return ", ".join(shown[number] for number in elements)
    return f"{shown[min(elements)]} to {shown[max(elements)]}"


def _bounds(lower: float | None, upper: float | None) -> str:
    if lower is not None and upper is not None:
        return f"{lower:g} to {upper:g}"
    above = "any" if lower is None else f"above {lower:g}"
    return above if upper is None else f"below {upper:g}"


def _as_fitted(stored: dict[str, Any], data: Sequence[Path]) -> dict[str, str]:
    """Return the renamed columns of a fit that also occur in these files.

    A name that has its own meaning may be correct in files other than those that were fitted.
    """
    from ..recordings import column_names, parse_column
    from ..tasks import checksums_of

    there = set.intersection(*(set(column_names(path)) for path in data))
    renamed = (stored.get("task") or {}).get("rename", {})
    renamed = {old: new for old, new in renamed.items() if old in there}
    if not renamed:
        return {}
    known = (*stored["runs"], *stored.get("held_out", ()))
    fitted = {run.get("sha256") for run in known}
    if all(checksums_of([path])[str(path)] in fitted for path in data):
        return renamed

    def has_meaning(name: str) -> bool:
        try:
            return bool(parse_column(name))
        except InputError:
            return False

    return {old: new for old, new in renamed.items() if not has_meaning(old)}


@command(
    """\b
Examples:
  giajax predict giajax-out/run --data other.csv
                            evaluate how well a fit predicts another run
  giajax predict giajax-out/triple_pendulum --against published.toml \\
      --data validation_01.csv --data validation_02.csv
                            predict two runs, and compare with another model
  giajax predict my_arm.toml --data run.csv --refit-initial --to errors.csv
                            fit the initial state first, and write a table
  giajax predict giajax-out/run --data other.csv --without camera,wind
                            predict a run with a different camera and wind

MODEL is the folder of a fit, its result.json, or a TOML file in which the [arm]
section (or the section of another model) describes a model with all its
parameters. --without lists parameters that are not taken from MODEL. These
parameters are taken from the sidecar of the run, or omitted if the sidecar does
not specify them.
A NAME is a group of parameters (camera, encoder, marker), a path, or the last
part of a path.""",
    group="fit",
    old={"--model": "MODEL", "--out": "--to"},
)
def predict(
    model: Annotated[Path, argument("MODEL", "Model; see below.")],
    data: Annotated[list[Path], "RUN.csv", "A recorded run."],
    against: Annotated[
        Path | None, "MODEL", "Compare the prediction errors with those of this model."
    ] = None,
    config: Annotated[
        Path | None,
        "FILE.toml",
        "A fit definition with [initial], [wind] and channels for the runs.",
    ] = None,
    channels: OnlyChannels = None,
    rename: Renamed = None,
    refit_initial: Annotated[bool, "First fit the initial state of each run."] = False,
    without: Annotated[
        Texts, "NAME,NAME", "Take this parameter from the run instead of the fit."
    ] = None,
    to: Annotated[Path | None, "TABLE.csv", "Output file for the table."] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Predict runs, and print the RMSE of each channel.

    The sidecars or the fit definition specify the initial state. With first_row = true in
    [initial], it is taken from the first row.
    """
    check_quiet(quiet, written=to, by="--to TABLE.csv")
    from ..recordings import (
        Definition,
        check_output_files,
        parse_rename,
        read_runs,
        run_keys,
        stored_result,
        write_files,
    )

    if to is not None:
        check_output_files([to], force=force)
    if without and not is_result(model):
        raise InputError(
            f"{model} is not a fit, and --without applies only to fits: omit --without"
        )
    sections = {} if config is None else Definition.load(config).contents()
    # The parts that describe the model come from the fit, which `model` already gives.
    about = ("model", *run_keys(model=False), "fit")
    sections = {key: value for key, value in sections.items() if key in about}
    if channels:
        sections["fit"] = {**sections.get("fit", {}), "channels": channels}
    settings = Definition.parse(sections, "the command line")
    configure()
    from ..studies import compare

    renamed = parse_rename(rename or [])
    if not rename and is_result(model) and model.exists():
        renamed = _as_fitted(stored_result(model)[1], data)
        if renamed:
            said = ", ".join(f"{old} as {new}" for old, new in renamed.items())
            if not quiet:
                typer.echo(f"columns are read as in the fit: {said}", err=True)

    def runs_for(source: Path) -> "list[Run]":
        return read_runs(data, definition_of(source).merged_with(settings), rename=renamed)

    runs = runs_for(model)
    ours = model_of(model, runs)
    other = None if against is None else model_of(against, runs_for(against))
    headings = ["run", "channel", "unit", "values", "RMSE", "largest", "RMSE of the other", "ratio"]
    keys = ["run", "channel", "unit", "n", "rmse", "largest", "reference_rmse", "ratio"]
    names = [name.strip() for words in without or [] for name in words.split(",")]
    compared = compare(ours, runs, other, refit_initial=refit_initial, without=names)
    if against is None:
        headings, keys = headings[:-2], keys[:-2]
    rows = [[getattr(one, key) for key in keys] for one in compared]
    if not quiet:
        print_table(headings, rows, left=3)
    if to is not None:
        lines = [",".join(str(cell) for cell in row) for row in [keys, *rows]]
        write_files({to: ("\n".join(lines) + "\n").encode()}, force=force)
