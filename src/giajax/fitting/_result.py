"""The result of a fit, as data: it can be written, read again, and it predicts."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from .._errors import InputError
from ..models import AbstractModel, build_model, parameter_values
from ..parameters import declared
from ..runs import Run
from ._predict import predict

Status = Literal["converged", "not_converged", "interrupted"]

SCHEMA_VERSION = 1


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter of a result.

    Attributes:
        value: fitted, or held; a list for an array that was not fitted element by element.
        standard_error: one standard deviation, in the unit of the value; None if there is none.
        unit: SI unit.
        lower, upper: bounds; None where there is none.
        free: whether the fit was allowed to move it.
        remark: what a reader must know before using the value; may be empty.
    """

    value: Any
    standard_error: float | None
    unit: str
    lower: float | None
    upper: float | None
    free: bool
    remark: str = ""


@dataclasses.dataclass(frozen=True)
class FitResult:
    """What a fit found; `result.model` is the fitted model.

    Attributes:
        status: "converged", "not_converged" or "interrupted".
        message: one sentence that says how it ended.
        model: the fitted model.
        parameters: `Estimate` by path: the free ones, element by element, then all others.
        correlation: {"parameters": paths, "matrix": rows} of the determined free parameters.
        runs: for each run {"name", "path", "sha256", "channels": {name: {unit, rmse, n, noise}},
            "parameters": {path: {value, standard_error}} of what was free in this run alone}.
        cost: half the sum of the loss over the weighted residuals.
        reduced_chi_square: squared weighted residuals per degree of freedom.
        iterations: trial steps after the evaluation of the start.
        gradient_check: derivatives by autodiff against central differences at the optimum.
        tolerance_effect: shift of the parameters when the solver tolerance is halved.
        conditions: sentences: what the values are conditional on.
        seconds: {"compile", "run"}.
        versions: of giajax and of the libraries that computed it.
        config: what was asked for, resolved; with the parameters it rebuilds the model.
        history: cost, step and parameters of each iteration.
        starts: where the fit was started (`giajax.multi_start`), each with its end: {"start",
            "status", "misfit", "parameters"}; empty for one start.
        validation: errors of prediction of runs that were not fitted, as `prediction_errors`.
        derived: `Estimate` by name of what follows from the parameters (`AbstractModel.derived`).
        predictions: predicted channels (SI) of each run, by name; empty after `load_result`.
    """

    status: Status
    message: str
    model: AbstractModel
    parameters: dict[str, Estimate]
    correlation: dict[str, Any]
    runs: list[dict[str, Any]]
    cost: float | None
    reduced_chi_square: float | None
    iterations: int
    gradient_check: dict[str, Any] | None
    tolerance_effect: dict[str, Any] | None
    conditions: list[str]
    seconds: dict[str, float]
    versions: dict[str, str]
    config: dict[str, Any]
    history: list[dict[str, Any]]
    starts: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    validation: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    derived: dict[str, Estimate] = dataclasses.field(default_factory=dict)
    predictions: list[dict[str, np.ndarray]] = dataclasses.field(default_factory=list, repr=False)

    @property
    def free(self) -> dict[str, Estimate]:
        """The parameters that the fit was allowed to move."""
        return {path: estimate for path, estimate in self.parameters.items() if estimate.free}

    def predict(self, run: Run, channels: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Channels (SI) that the fitted model predicts for a run; see `giajax.predict`."""
        return predict(self.model, run, channels)

    def to_json(self) -> str:
        """The result as JSON; what is not finite becomes null."""
        record = {
            field.name: getattr(self, field.name)
            for field in dataclasses.fields(self)
            if field.name not in ("model", "predictions")
        }
        for table in ("parameters", "derived"):
            record[table] = {
                name: dataclasses.asdict(estimate) for name, estimate in record[table].items()
            }
        record = {"schema_version": SCHEMA_VERSION, "model": self.model.kind, **record}
        return json.dumps(_finite(record), indent=2, allow_nan=False) + "\n"


def load_result(path: str | Path) -> FitResult:
    """Read a `result.json`, or the folder that holds one; its model predicts.

    Raises:
        InputError: no such file, or not a result of giajax.

    Example:
        >>> result = giajax.load_result("giajax-out/base_step")  # doctest: +SKIP
        >>> result.predict(giajax.read_run("other.csv"))  # doctest: +SKIP
    """
    path = Path(path)
    path = path / "result.json" if path.is_dir() else path
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        if record.pop("schema_version") != SCHEMA_VERSION:
            raise InputError(f"{path} was written by another version of giajax; run the fit again")
        kind = record.pop("model")
        estimates = {path: Estimate(**estimate) for path, estimate in record["parameters"].items()}
        model = build_model(
            kind,
            record["config"]["definition"],
            {name: estimate.value for name, estimate in estimates.items()},
        )
        derived = {name: Estimate(**item) for name, item in record.pop("derived", {}).items()}
        record["parameters"] = estimates
        return FitResult(model=model, derived=derived, **record)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist; give the folder of a finished fit") from None
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        raise InputError(f"{path} is not a result of giajax; give the folder of a fit") from None


def held_estimates(model: AbstractModel, free: Sequence[str]) -> dict[str, Estimate]:
    """The declared parameters that were not free, with their declarations."""
    known = declared(model)
    values = parameter_values(model)
    whole = {path for path in free if "[" not in path}
    estimates = {}
    for path, parameter in known.items():
        if path in whole:
            continue
        declaration = parameter.declaration
        estimates[path] = Estimate(
            value=values[path],
            standard_error=None,
            unit=declaration.unit,
            lower=finite_or_none(declaration.lower),
            upper=finite_or_none(declaration.upper),
            free=False,
            remark="held",
        )
    return estimates


def finite_or_none(value: float | None) -> float | None:
    """A finite number, or None."""
    return float(value) if value is not None and math.isfinite(value) else None


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return finite_or_none(float(value))
    return value
