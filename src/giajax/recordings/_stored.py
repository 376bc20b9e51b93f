"""Keys and types of the fit configuration in stored results and journals.

Keys that a newer version adds are ignored here. Does not import JAX, so a file that is not a result
is refused before a model is built.
"""

import dataclasses
from pathlib import Path
from typing import Any, Literal

from pydantic import ConfigDict

from ..runtime.files import check_path, parse_json, read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.records import Numbers, from_plain
from ..runtime.text import InputError

SCHEMA_VERSION = 1

_OTHERS = ConfigDict(extra="ignore")


@dataclasses.dataclass(frozen=True)
class _Run:
    """A run in the configuration of a fit, without the contents of its sidecar."""

    __pydantic_config__ = _OTHERS
    model: str | None = None
    from_s: float | None = None
    rows: int | None = None
    channels: list[str] = dataclasses.field(default_factory=list)
    held_from: dict[str, int] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class _Prior:
    value: float
    deviation: float | None = None
    factor: float | None = None


@dataclasses.dataclass(frozen=True)
class StoredConfig:
    """The resolved settings of a fit: `config` of a result."""

    __pydantic_config__ = _OTHERS
    definition: dict[str, Any]
    runs: list[_Run]
    free: list[str]
    start: dict[str, Numbers]
    fix: dict[str, Numbers]
    loss: str | dict[str, Any]
    max_iterations: int | None = None
    noise_model: Literal["correlated", "white"] = "correlated"
    noise_per_run: bool = False
    solver: str | None = None
    tolerance: float | None = None
    starts: int = 1
    spread: float = 0.0
    seed: int = 0
    budget_s: float | None = None
    priors: dict[str, _Prior] = dataclasses.field(default_factory=dict)
    bounds: dict[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    ties: dict[str, str] = dataclasses.field(default_factory=dict)
    groups: dict[str, list[list[str]]] = dataclasses.field(default_factory=dict)
    uncertainty: dict[str, Any] = dataclasses.field(default_factory=dict)
    hold_out: list[_Run] = dataclasses.field(default_factory=list)


@dataclasses.dataclass(frozen=True)
class _WarmStart:
    model: str
    values: dict[str, Numbers]
    own: dict[str, dict[str, float]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class StoredTask:
    """The inputs of a fit and the checksums of its files: `task` of a result."""

    __pydantic_config__ = _OTHERS
    definition: dict[str, Any]
    data: list[str]
    validation: list[str]
    rename: dict[str, str]
    source: str | None
    out: str
    begin: _WarmStart | None
    inputs: dict[str, str | None]


@dataclasses.dataclass(frozen=True)
class _Estimate:
    __pydantic_config__ = _OTHERS
    value: Numbers
    free: bool


@dataclasses.dataclass(frozen=True)
class _OwnEstimate:
    __pydantic_config__ = _OTHERS
    value: float


@dataclasses.dataclass(frozen=True)
class _FittedRun:
    __pydantic_config__ = _OTHERS
    name: str
    sha256: str | None
    channels: dict[str, Any]
    parameters: dict[str, _OwnEstimate] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class _Result:
    """The parts of a result that are used without its model."""

    __pydantic_config__ = _OTHERS
    schema_version: int
    model: str
    status: str
    parameters: dict[str, _Estimate]
    runs: list[_FittedRun]
    config: StoredConfig
    cost: float | None
    reduced_chi_square: float | None
    correlation: dict[str, Any]
    history: list[dict[str, Any]]
    held_out: list[_FittedRun] = dataclasses.field(default_factory=list)
    versions: dict[str, str] = dataclasses.field(default_factory=dict)


def stored_result(path: str | Path) -> tuple[Path, dict[str, Any]]:
    """Read a `result.json` or the one in a folder; return its folder and its contents.

    Raises:
        InputError: the file does not exist, or is not a result of this version.
    """
    path = Path(path)
    check_path(path)
    path = path / "result.json" if path.is_dir() else path
    what, remedy = f"{path} is not a giajax result", "give the folder of a fit"
    try:
        record = parse_json(read_bytes(path, RESULT_BYTES).decode(), path)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give the folder of a finished fit") from None
    except InputError:
        raise
    except (OSError, ValueError):
        raise InputError(f"{what}: {remedy}") from None
    if isinstance(record, dict) and record.get("schema_version", SCHEMA_VERSION) != SCHEMA_VERSION:
        raise InputError(f"{path} was written by another version of giajax: run the fit again")
    from_plain(_Result, record, what, remedy)
    if record.get("task"):
        from_plain(StoredTask, record["task"], f"{path} has a damaged task", "fit its data again")
    return path.parent, record
