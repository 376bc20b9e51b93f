"""A plan: one fit definition, and what differs between the fits of it. Imports no JAX."""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

from .._errors import InputError
from .._files import read_bytes
from .._limits import TEXT_BYTES
from .._syntax import check_size, parse_toml
from .._text import shown
from ..execution import Task
from ..runs import Definition
from ..tasks import FitTask, checksums_of
from ._cases import cases_of
from ._columns import Case

_KEYS = ("schema_version", "fit", "data", "out", "grid", "list", "sample")
_OUT = Path("giajax-out")


@dataclasses.dataclass(frozen=True)
class Plan:
    """What to fit: `base`, with the settings of each case put on top.

    Attributes:
        base: the fit without anything that differs.
        cases: of each fit the values that differ, by column.
        out: where the table goes; None where the plan does not say.
        source: its file; None for a plan as data.

    Example:
        >>> from giajax import sweeping
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
        """The plan of a TOML file; the files that it names are relative to it.

        Raises:
            InputError: the file is missing, is no TOML, or as `parse`.
        """
        path = Path(path)
        try:
            text = read_bytes(path, TEXT_BYTES).decode("utf-8-sig")
        except FileNotFoundError:
            raise InputError(f"{path} does not exist: give the path of a plan") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not text: it must be TOML in UTF-8") from None
        except OSError as error:
            raise InputError(f"{path} cannot be read ({error.strerror}): give a plan") from None
        plan = cls.parse(parse_toml(text, path), path.parent, str(path))
        return dataclasses.replace(plan, source=path)

    @classmethod
    def parse(
        cls, data: Mapping[str, Any], folder: str | Path = "", source: str = "the plan"
    ) -> Self:
        """The plan that plain data state.

        Arguments:
            data: as `tomllib` reads a file of it; see `docs/sweep.md`.
            folder: where the paths in it begin.
            source: what errors call it.

        Raises:
            InputError: a key or a value that it may not have, or too many fits.
        """
        check_size(data, source)
        folder = Path(folder)
        for name in data:
            if name not in _KEYS:
                raise InputError(
                    f"{source}: unknown key {shown(name)}: correct or remove it (known here: "
                    f"{', '.join(_KEYS)})"
                )
        if data.get("schema_version", 1) != 1:
            raise InputError(f"{source}: schema_version must be 1: correct it")
        if ("fit" in data) == ("data" in data):
            raise InputError(
                f"{source} must have one of fit, a fit definition, and data, a list of runs: give "
                "one"
            )
        if "fit" in data:
            if not isinstance(data["fit"], str):
                raise InputError(f"{source}: fit must be the name of a fit definition: correct it")
            base = FitTask.load(folder / data["fit"])
        else:
            Definition.parse({"fit": {"data": data["data"]}}, source)
            base = FitTask.of([folder / name for name in data["data"]])
        out = data.get("out")
        if not isinstance(out, str | None):
            raise InputError(f"{source}: out must be the name of a folder: correct it")
        cases = cases_of(data, source)
        plan = cls(base, tuple(cases), None if out is None else Path(out))
        # Keys and kinds of values are told before the first fit begins; whether its model has a
        # path, by each fit.
        for number, case in enumerate(cases, 1):
            plan.fit(case, f"{source}, fit {number}", folder)
        return dataclasses.replace(plan, cases=tuple(_placed(case, folder) for case in cases))

    @property
    def folder(self) -> Path:
        """Where the table goes by default."""
        if self.out is not None:
            return self.out
        named = self.source or self.base.source
        return _OUT / ("sweep" if named is None else named.stem)

    @property
    def columns(self) -> list[str]:
        """What differs, in the order of the plan."""
        return list(dict.fromkeys(name for case in self.cases for name in case))

    def fit(self, case: Case, origin: str = "the plan", folder: Path = Path()) -> FitTask:
        """The fit of a case.

        Arguments:
            case: one of `cases`.
            origin: what an error calls it.
            folder: where the files of `data` and `validation` in it begin.

        Raises:
            InputError: a value that its key may not have.
        """
        settings: dict[str, Any] = {}
        for name, value in case.items():
            table, _, path = name.partition(".")
            if path:
                settings.setdefault(table, {})[path] = value
            else:
                settings[name] = value
        told = Definition.parse({"fit": settings}, origin).fit
        words = {name: getattr(told, name) for name in told.model_fields_set}
        if "priors" in words:
            words["priors"] = {path: entry.prior() for path, entry in words["priors"].items()}
        for name in {"data", "validation"} & set(words):
            words[name] = [folder / file for file in words[name]]
        return self.base.on_top(**words, origin=origin)

    def tasks(self) -> list[Task]:
        """The fits as tasks, one for each case: two with the same key are the same fit.

        Raises:
            InputError: a file cannot be read.
        """
        checksums = functools.cache(lambda path: tuple(checksums_of([path]).values()))
        return [_task(self.fit(case), checksums) for case in self.cases]


def _placed(case: Case, folder: Path) -> Case:
    """A case whose files are found from here."""
    files = {
        name: [str(folder / file) for file in case[name]]
        for name in ("data", "validation")
        if name in case
    }
    return {**case, **files}


def _task(fit: FitTask, checksums: Any) -> Task:
    """A fit by the content of its files, which are then wherever they are."""
    if not fit.data:
        raise InputError("the plan has no data: give runs in it, or in its fit definition")
    definition = fit.definition.contents()
    settings = definition.pop("fit", {})
    for name in ("data", "validation", "out"):
        settings.pop(name, None)
    for name in ("truth", "figures", "origin"):
        definition.pop(name, None)
    files = {"data": fit.data, "validation": fit.validation}
    return Task(
        "giajax.sweeping._fit:fitted",
        {
            "definition": {**definition, "fit": settings},
            "inputs": {
                part: [[path.name, *checksums(path)] for path in paths]
                for part, paths in files.items()
            },
            "rename": dict(fit.rename),
            "begin": fit.begin,
        },
        aside={
            "paths": {
                part: [str(path.absolute()) for path in paths] for part, paths in files.items()
            }
        },
    )
