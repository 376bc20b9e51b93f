"""Plan of a sweep: one fit definition, and the settings that vary between fits. Imports no JAX."""

import dataclasses
import functools
import itertools
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..recordings import (
    Definition,
    FitSettings,
    fit_settings,
    infer_model,
    read_sidecar,
    read_table,
    sidecar_path,
)
from ..runtime.files import check_size, parse_toml, read_bytes, read_text
from ..runtime.limits import RUN_BYTES, TEXT_BYTES
from ..runtime.plugins import classes_of_others, plugins, sources_named
from ..runtime.tasks import Task
from ..runtime.text import InputError, one_of, shown
from ..schema import KINDS, flat
from ._fit_task import FitTask
from ._journal import checksums_of

TABLES = ("start", "fix", "priors", "bounds", "ties", "groups")
"""Keys of `[fit]` that are tables of values by parameter path."""

# Folder of a single result, and a computation that follows a single fit.
_NOT_HERE = ("out", "uncertainty")

RANGE = ("from", "to", "count", "log")
"""Keys of a range."""

DRAWS = {
    "uniform": "[low, high]",
    "log_uniform": "[low, high], both positive",
    "normal": "[mean, deviation]",
}
"""Distributions and the form of their arguments."""

# A table with one of these keys is a value, not part of a path. The first belongs to a prior.
_OF_VALUES = {"value", *RANGE, *DRAWS}

Case = Mapping[str, Any]
"""Values by column, such as `loss` or `fix.links.mass`."""

MOST = 100_000
"""Maximum number of fits of a plan."""


def columns_of(section: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the values of a section by column. Errors call the section `where`.

    Columns are the keys of `[fit]`, and for its tables the keys with a path.
    """
    known = [name for name in FitSettings.model_fields if name not in _NOT_HERE]
    columns = {}
    for name, value in section.items():
        if name not in known:
            if name == "uncertainty":
                raise InputError(f"{where}: {name} has no effect in a sweep: omit it")
            raise InputError(
                f"{where}: unknown key {shown(name)}: give a key of [fit], such as fix, start, "
                "loss or data"
            )
        if name not in TABLES:
            columns[name] = value
            continue
        if not isinstance(value, Mapping):
            raise InputError(
                f"{where}: {name} must be a table of parameter paths: write it as a table"
            )
        try:
            paths = flat(value, leaves=_OF_VALUES)
        except ValueError as error:
            raise InputError(f"{where}: {name} {error}") from None
        columns |= {f"{name}.{path}": item for path, item in paths.items()}
    return columns


def check_count(count: int, where: str) -> None:
    """Refuse more fits than a plan may have, before they are created."""
    if count > MOST:
        raise InputError(
            f"{where} has {count:,} fits, but at most {MOST:,} are allowed: reduce the number"
        )


_METHODS = ("sobol", "random")


def grid_cases(section: Mapping[str, Any], where: str) -> list[Case]:
    """Return every combination of the values of a grid. The last key varies fastest."""
    columns = columns_of(section, where)
    several = [_listed(value, f"{where}: {name}") for name, value in columns.items()]
    check_count(math.prod(map(len, several)), where)
    return [dict(zip(columns, values, strict=True)) for values in itertools.product(*several)]


def _listed(value: Any, where: str) -> list[Any]:
    """Return the values of a list or of a range."""
    if isinstance(value, list) and value:
        return value
    if not isinstance(value, Mapping) or not {"from", "to", "count"} <= set(value) <= set(RANGE):
        raise InputError(
            f"{where} is {shown(value)}: give a non-empty list, or a range such as "
            "{ from = 0.5, to = 1.5, count = 5 }"
        )
    low, high, count = value["from"], value["to"], value["count"]
    if type(count) is int:
        check_count(count, where)
    if not (_is_number(low) and _is_number(high) and type(count) is int and count > 0):
        raise InputError(f"{where} is not a valid range: give two numbers and a positive count")
    logarithmic = value.get("log", False)
    if logarithmic and not min(low, high) > 0:
        raise InputError(
            f"{where} is logarithmic, but not positive at both ends: give positive ends"
        )
    # Integers stay integers if all values are, because some keys require them.
    steps = max(count - 1, 1)
    if type(low) is type(high) is int and not logarithmic and (high - low) % steps == 0:
        return [low + (high - low) // steps * step for step in range(count)]
    with np.errstate(all="ignore"):
        spaced = (np.geomspace if logarithmic else np.linspace)(float(low), float(high), count)
    if not np.all(np.isfinite(spaced)):
        raise InputError(f"{where} is too wide a range: reduce the range")
    return [float(number) for number in spaced]


def sample_cases(section: Mapping[str, Any], where: str) -> list[Case]:
    """Draw initial values and held values from a Sobol sequence or at random."""
    rest = {name: item for name, item in section.items() if name in ("start", "fix")}
    count, seed = section.get("count"), section.get("seed", 0)
    method = section.get("method", "sobol")
    unknown = set(section) - {"start", "fix", "count", "seed", "method"}
    if unknown:
        raise InputError(
            f"{where}: unknown key {shown(min(unknown))}: correct or remove it (known keys: count, "
            "seed, method, start, fix)"
        )
    if type(count) is not int or count < 1:
        raise InputError(f"{where} has no valid count: give a positive number of draws, such as 64")
    check_count(count, where)
    if type(seed) is not int or seed < 0:
        raise InputError(f"{where} has no valid seed: give zero or a positive whole number")
    if method not in _METHODS:
        raise InputError(f"{where} has an unknown method: give {one_of(map(repr, _METHODS))}")
    columns = columns_of(rest, where)
    if not columns:
        raise InputError(f"{where} draws nothing: add fix or start with a distribution")
    # Points in the unit cube, shape (count, column), none of them on its faces.
    if method == "sobol":
        from ..runtime.arrays import sobol_points

        points = sobol_points(count, len(columns), seed)
    else:
        points = np.random.default_rng(seed).random((count, len(columns)))
        points = np.maximum(points, np.finfo(float).eps)
    drawn = [
        _drawn(value, points[:, at], f"{where}: {name}")
        for at, (name, value) in enumerate(columns.items())
    ]
    return [dict(zip(columns, row, strict=True)) for row in zip(*drawn, strict=True)]


def _drawn(value: Any, points: np.ndarray, where: str) -> Iterator[float]:
    """Return the values of a distribution at points of the unit interval."""
    kind = next(iter(value), None) if isinstance(value, Mapping) and len(value) == 1 else None
    ends = value[kind] if kind in DRAWS else None
    if not (isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends))):
        forms = one_of(f"{name} = {form}" for name, form in DRAWS.items())
        raise InputError(f"{where} is {shown(value)}: give a table of {forms}")
    low, high = map(float, ends)
    if kind == "normal":
        if not high > 0:
            raise InputError(
                f"{where} has the deviation {high:g}: give a positive standard deviation"
            )
        from scipy.special import ndtri

        return iter((low + high * ndtri(points)).tolist())
    if not low < high or (kind == "log_uniform" and low <= 0):
        raise InputError(
            f"{where} is {shown(value)}: give the lower end first, {DRAWS[kind or '']}"
        )
    if kind == "log_uniform":
        return iter(np.exp(math.log(low) + points * math.log(high / low)).tolist())
    return iter((low + points * (high - low)).tolist())


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def cases_of(data: Mapping[str, Any], source: str) -> list[Case]:
    """Return every combination of the list, the sample and the grid of a plan."""
    for name, kind in (("grid", dict), ("sample", dict), ("list", list)):
        if not isinstance(data.get(name, kind()), kind):
            what = "a list of tables, [[list]]" if kind is list else f"a table, [{name}]"
            raise InputError(f"{source}: {name} has the wrong type: give {what}")
    rows = data.get("list", [{}])
    if not rows or not all(isinstance(row, Mapping) for row in rows):
        raise InputError(
            f"{source}: list is empty or has other elements than tables: give a list of tables, "
            "[[list]]"
        )
    listed = [_row(row, f"{source}, [[list]]") for row in rows]
    drawn: list[Case] = [{}]
    if "sample" in data:
        drawn = sample_cases(data["sample"], f"{source}, [sample]")
    combined = grid_cases(data.get("grid", {}), f"{source}, [grid]")
    for one, other in ((listed, drawn), (listed, combined), (drawn, combined)):
        twice = {name for case in one for name in case} & {name for case in other for name in case}
        if twice:
            raise InputError(
                f"{source} has {min(twice)} in two of grid, list and sample: keep it in only one"
            )
    check_count(len(listed) * len(drawn) * len(combined), source)
    return [{**row, **draw, **case} for row in listed for draw in drawn for case in combined]


def _row(section: Mapping[str, Any], where: str) -> Case:
    """Return the values of one fit."""
    row = columns_of(section, where)
    for name, value in row.items():
        if isinstance(value, Mapping) and "value" not in value:
            raise InputError(
                f"{where}: {name} = {shown(value)} must be one value: put a range into [grid], and "
                "a distribution into [sample]"
            )
    return row


_KEYS = ("schema_version", "fit", "data", "out", "grid", "list", "sample")
_FILES = {"data", "validation"}
_OUT = Path("giajax-out")


@dataclasses.dataclass(frozen=True)
class Plan:
    """Fits of a sweep: `base`, with the settings of each case applied.

    Attributes:
        base: fit without the settings that vary.
        cases: for each fit, the values that vary, by column.
        out: folder of the table, or None if the plan does not specify it.
        source: file of the plan, or None for a plan given as data.

    Example:
        >>> from giajax import tasks as sweeping
        >>> plan = sweeping.Plan.parse({"data": ["run.csv"], "grid": {"loss": ["linear", "huber"]}})
        >>> plan.cases
        ({'loss': 'linear'}, {'loss': 'huber'})
    """

    base: FitTask
    cases: tuple[Case, ...]
    out: Path | None = None
    source: Path | None = None

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read the plan of a TOML file. Its file names are relative to the plan."""
        path = Path(path)
        text = read_text(path, TEXT_BYTES, "TOML", "the path of a plan")
        plan = cls.parse(parse_toml(text, path), path.parent, str(path))
        return dataclasses.replace(plan, source=path)

    @classmethod
    def parse(
        cls, data: Mapping[str, Any], folder: str | Path = "", source: str = "the plan"
    ) -> Self:
        """Return the plan from plain data.

        Arguments:
            data: data as `tomllib` reads a file (`docs/sweep.md`).
            folder: folder to which the paths are relative.
            source: name of the data in an error message.

        Raises:
            InputError: an invalid key or value, or too many fits.
        """
        check_size(data, source)
        folder = Path(folder)
        if unknown := [name for name in data if name not in _KEYS]:
            raise InputError(
                f"{source}: unknown key {shown(unknown[0])}: correct or remove it (known keys: "
                f"{', '.join(_KEYS)})"
            )
        if data.get("schema_version", 1) != 1:
            raise InputError(f"{source}: schema_version is not 1: set it to 1")
        if ("fit" in data) == ("data" in data):
            raise InputError(
                f"{source} must have either fit (a fit definition) or data (a list of runs): give "
                "one of them"
            )
        if "fit" in data:
            if not isinstance(data["fit"], str):
                raise InputError(
                    f"{source}: fit is not a string: give the name of a fit definition"
                )
            base = _base(folder / data["fit"])
        else:
            Definition.parse({"fit": {"data": data["data"]}}, source)
            base = FitTask.of([folder / name for name in data["data"]])
        out = data.get("out")
        if not isinstance(out, str | None):
            raise InputError(f"{source}: out is not a string: give the name of a folder")
        cases = cases_of(data, source)
        plan = cls(base, tuple(cases), None if out is None else Path(out))
        # Keys and types of values are checked before the first fit begins. Each fit checks whether
        # its model has the paths.
        for number, case in enumerate(cases, 1):
            plan.fit(case, f"{source}, fit {number}", folder)
        # File names become relative to the current folder.
        placed = [
            {
                name: [str(folder / file) for file in value] if name in _FILES else value
                for name, value in case.items()
            }
            for case in cases
        ]
        return dataclasses.replace(plan, cases=tuple(placed))

    @property
    def folder(self) -> Path:
        """Default folder of the table."""
        if self.out is not None:
            return self.out
        named = self.source or self.base.source
        return _OUT / ("sweep" if named is None else named.stem)

    @property
    def columns(self) -> list[str]:
        """Names of the settings that vary, in the order of the plan."""
        return list(dict.fromkeys(name for case in self.cases for name in case))

    def fit(self, case: Case, origin: str = "the plan", folder: Path = Path()) -> FitTask:
        """Return the fit of one of `cases`, with files from a folder. Errors call it `origin`."""
        settings: dict[str, Any] = {}
        for name, value in case.items():
            table, _, path = name.partition(".")
            if path:
                settings.setdefault(table, {})[path] = value
            else:
                settings[name] = value
        files: dict[str, Any] = {}
        for name in _FILES & settings.keys():
            said = fit_settings({name: settings.pop(name)}, origin)
            files[name] = [folder / file for file in getattr(said, name)]
        return self.base.on_top(fit_settings(settings, origin), **files, origin=origin)

    def tasks(self) -> list[Task]:
        """Return the fits as tasks, one for each case. Tasks with the same key are the same fit."""
        checksums = functools.cache(lambda path: tuple(checksums_of([path]).values()))
        sidecar = functools.cache(_said)
        uncertain = functools.cache(_may_be_uncertain)
        return [_task(self.fit(case), checksums, sidecar, uncertain) for case in self.cases]


def _base(path: Path) -> FitTask:
    """Return the fit of a definition, or of a result (file or folder) with changed settings."""
    if path.suffix == ".json" or path.is_dir():
        return dataclasses.replace(FitTask.again(path), resolved=None, earlier=None)
    return FitTask.load(path)


def _said(path: Path, rename: tuple[tuple[str, str], ...]) -> str:
    """Return the sidecar of a run, and registered models and sensors that its columns may use."""
    sidecar = sidecar_path(path)
    text = read_bytes(sidecar, RUN_BYTES).decode(errors="replace") if sidecar.exists() else ""
    try:
        stated = read_sidecar(path).model  # reading it registers the model of a package
        own = [kind for kind in KINDS.values() if not kind.model and stated is None]
        sensors = classes_of_others("sensor")
        if own or sensors:
            table = read_table(path, dict(rename))
            rows = frozenset(channel.kind for channel in table.channels.values())
            found = [kind.name for kind in own if kind.recognises(rows)]
            found += [name for name, each in sensors.items() if each.channel.name in rows]
            text = " ".join([text, *found])
    except InputError:
        pass  # The fit reports the error.
    return text


def _may_be_uncertain(path: Path, rename: tuple[tuple[str, str], ...]) -> bool:
    """Return whether a run may have uncertain devices, by its model and its sidecar."""
    from ..models import model_class

    try:
        said = read_sidecar(path)
        kind = said.model or infer_model(read_table(path, dict(rename)).channels.values())
    except InputError:  # The fit reports the error.
        return False
    known = said.uncertainty.defaults or bool(said.uncertainty.deviations)
    return known and kind is not None and hasattr(model_class(kind), "uncertain")


def _task(fit: FitTask, checksums: Any, sidecar: Any, uncertain: Any) -> Task:
    """Return a fit as a task that is identified by the content of its files, not by their paths."""
    if not fit.data:
        raise InputError("the plan gives no data: add runs to the plan or to its fit definition")
    definition = fit.definition.contents()
    settings = definition.pop("fit", {})
    for name in (*_FILES, "out"):
        settings.pop(name, None)
    for name in ("truth", "figures", "origin"):
        definition.pop(name, None)
    files = {"data": fit.data, "validation": fit.validation}
    runs = (sidecar(path, tuple(fit.rename.items())) for path in (*fit.data, *fit.validation))
    said = f"{definition} {settings} {' '.join(runs)}"
    doubted = any(uncertain(path, tuple(fit.rename.items())) for path in fit.data)
    added = {**sources_named(said), **{path.name: digest for path, digest in plugins().items()}}
    return Task(
        "giajax.tasks._sweep:fitted",
        {
            "definition": {**definition, "fit": settings},
            "inputs": {
                part: [[path.name, *checksums(path)] for path in paths]
                for part, paths in files.items()
            },
            "rename": dict(fit.rename),
            "begin": fit.begin,
            "added": added or None,
            "nuisances": (settings.get("nuisances", True) and doubted) or None,
        },
        aside={
            "paths": {
                part: [str(path.absolute()) for path in paths] for part, paths in files.items()
            }
        },
    )
