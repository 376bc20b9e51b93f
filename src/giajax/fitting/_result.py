"""Result of a fit as data, which can be stored, loaded and used for predictions."""

import dataclasses
import importlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import jax
import numpy as np

from ..models import (
    AbstractModel,
    ArmModel,
    as_stated,
    build_model,
    capabilities,
    predicted_channels,
)
from ..noise import Verdict
from ..recordings import SCHEMA_VERSION, Run, stored_result
from ..runtime.plugins import check_sources, hint
from ..runtime.records import from_plain, json_text
from ..runtime.text import InputError, ShownAsTable
from ..schema import ARM
from ._derived import in_column_units
from ._estimates import Finding
from ._losses import AbstractLoss, loss_of
from ._records import (
    ChannelErrors,
    Correlation,
    Estimate,
    GradientCheck,
    HeldOut,
    Iteration,
    NoiseFit,
    PredictionErrors,
    RunFit,
    Seconds,
    Start,
    Status,
    Suspect,
    SystematicError,
    ToleranceEffect,
    estimate_cells,
    estimate_table,
    model_of_run,
    rows_of_runs,
)
from ._steps import FitState, Reason

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True)
class IntegrationFit:
    """Integration of the model in a fit.

    Attributes:
        solver: one of `giajax.simulation.SOLVERS`.
        tolerance: relative and absolute tolerance of a step at the end of the fit.
        chosen: whether the fit chose the tolerance. Otherwise it was specified.
    """

    solver: str
    tolerance: float
    chosen: bool


def integration_of(state: FitState) -> IntegrationFit | None:
    """Return the solver and the tolerance in use, or None for a model without them."""
    integration = capabilities.integration(state.problem.model)
    if integration is None or integration.tolerance is None:
        return None
    chosen = state.setup.chooses_tolerance
    return IntegrationFit(integration.solver, integration.tolerance, chosen)


def _drawn(function: str, *arguments: object) -> "Figure":
    """Return a picture from the package `report`.

    That package is above this one, so it is imported late and named as text. It is the only package
    that is imported in this way, so that objects can draw themselves in a notebook.
    """
    figure: Figure = getattr(importlib.import_module("giajax.report"), function)(*arguments)
    return figure


class PredictedRun(dict[str, np.ndarray]):
    """Channels that a model predicts for a run.

    The dictionary contains arrays in SI units of shape (sample,), by name.

    Attributes:
        run: run for which the channels are predicted.
    """

    def __init__(self, run: Run, channels: Mapping[str, np.ndarray]) -> None:
        super().__init__(channels)
        self.run = run

    def plot(self) -> "Figure":
        """Return a picture of the predictions and of the recorded values, in the units of the run.

        Raises:
            InputError: no channel is predicted.
        """
        return _drawn("prediction_figure", self)


def _flattened(predicted: PredictedRun) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
    names = tuple(sorted(predicted))
    return [(jax.tree_util.DictKey(name), predicted[name]) for name in names], names


def _plain_dict(names: tuple[str, ...], values: Iterable[Any]) -> Any:
    """Return values that were computed from a prediction, which belong to no run."""
    return dict(zip(names, values, strict=True))


jax.tree_util.register_pytree_with_keys(PredictedRun, _flattened, _plain_dict)


def predict(
    model: AbstractModel,
    run: Run,
    channels: Sequence[str] | None = None,
    *,
    without: Sequence[str] = (),
) -> PredictedRun:
    """Predict channels of a run with a model.

    Arguments:
        model: model.
        run: run that provides times, commands and wind. Its recorded channels are not used.
        channels: names without unit (`link06_z`). The default is the recorded channels of the run.
        without: parts of the model that differ in this run, such as `camera` or `wind`. They are
            taken from the sidecar of the run, or omitted. Each is a path, the name of a group of
            parameters, or the end of a path.

    Returns:
        Arrays in SI units of shape (sample,) by channel name. Values are infinite or NaN where the
        simulation failed. The method `plot()` returns a picture of them and of the run.

    Raises:
        InputError: an unknown channel or name, or a run of another model.
    """
    model = as_stated(model, run, without)
    names = tuple(run.observations if channels is None else channels)
    return PredictedRun(run, predicted_channels(model, model.prepare(run), names, run)[0])


def prediction_errors(
    model: AbstractModel,
    run: Run,
    channels: Sequence[str] | None = None,
    *,
    without: Sequence[str] = (),
) -> PredictionErrors:
    """Compute the errors of a prediction in the unit of the recording.

    The initial state is that of the definition of the run. Errors are infinite if the simulation
    failed.

    Raises:
        InputError: as in `predict`.
    """
    names = list(run.observations if channels is None else channels)
    return errors_of(run, predict(model, run, names, without=without))


def errors_of(run: Run, predicted: Mapping[str, np.ndarray]) -> PredictionErrors:
    """Return the errors of predicted channels (SI units) in the unit of the recording."""
    errors = {}
    for name, values in predicted.items():
        channel, recorded = run.channels[name], run.observations[name]
        difference = (values - recorded)[~np.isnan(recorded)]
        difference = np.where(np.isnan(difference), np.inf, difference)
        errors[name] = ChannelErrors(
            unit=channel.unit,
            rmse=float(channel.from_si(np.sqrt(np.mean(difference**2)))),
            largest=float(channel.from_si(np.max(np.abs(difference)))),
            n=len(difference),
        )
    return PredictionErrors(run.name, None if run.path is None else str(run.path), errors)


@dataclasses.dataclass(frozen=True, repr=False)
class FitResult(ShownAsTable):
    """Result of a fit. `result.model` is the fitted model.

    It is printed as a table of its parameters, in a notebook as well.

    Attributes:
        status: "converged", "not_converged" or "interrupted".
        message: one sentence on how the fit ended.
        model: fitted model.
        parameters: `Estimate` by path: first the free parameters, by element, then all others.
        correlation: correlations of the determined free parameters.
        runs: fitted runs, with the errors of their channels.
        cost: half the sum of the losses of the weighted residuals.
        reduced_chi_square: sum of squared weighted residuals per degree of freedom.
        iterations: number of trial steps after the evaluation of the initial guess.
        gradient_check: comparison of automatic derivatives with differences at the optimum.
        tolerance_effect: shift of the parameters at a finer solver tolerance.
        conditions: sentences on held values on which the estimates depend.
        seconds: wall-clock time, with compilation listed separately.
        versions: versions of giajax and of the numerical libraries.
        config: resolved settings of the fit. With the parameters, they rebuild the model.
        history: initial guess and each iteration.
        starts: initial guesses of the fit (`giajax.multi_start`), each with its result. Empty for a
            single initial guess.
        validation: prediction errors of runs that were not fitted.
        held_out: held-out data (`FitTask.on_top(hold_out=)`) and their prediction errors.
        noise: noise of the fit, or None if a file does not contain it.
        integration: integration of the model, or None if the model has no solver to choose, or if a
            file does not contain it.
        verdict: whether the model describes the data, independent of convergence.
        derived: `Estimate` by name of the quantities that depend on the free parameters: tied
            parameters, and derived quantities of the model (`AbstractModel.derived`).
        findings: quantities that the data cannot determine, each with advice (`docs/findings.md`).
        suspects: effects that the residuals suggest (`giajax.suspects`), the most promising first.
            Empty if the test was not requested.
        systematic: effects of held values on the fitted ones (`giajax.systematic_errors`). Empty if
            they were not requested.
        task: data with which `giajax.FitTask.again` repeats the fit: files with their checksums,
            and settings. Empty for a fit of runs without a task.
        predictions: predictions for each run (SI units), by name. Empty after `load_result`.
        held_predictions: predictions for each of `held_out`. Empty after `load_result`.
        reason: reason for the end of the fit: "optimum"; "iterations" or "budget" (the limit was
            reached); "rough" (no step lowers a cost that is not smooth); "wall" (the model cannot
            be evaluated beyond the point); "crawl" (the cost hardly decreases); "cannot_fit" (the
            model describes the data hardly better than a constant); "no_response" (no channel
            depends on the free parameters); "interrupted". Empty in a file of an earlier version.
    """

    status: Status
    message: str
    model: AbstractModel
    parameters: dict[str, Estimate]
    correlation: Correlation
    runs: tuple[RunFit, ...]
    cost: float | None
    reduced_chi_square: float | None
    iterations: int
    gradient_check: GradientCheck | None
    tolerance_effect: ToleranceEffect | None
    conditions: tuple[str, ...]
    seconds: Seconds
    versions: dict[str, str]
    config: dict[str, Any]
    history: tuple[Iteration, ...]
    starts: tuple[Start, ...] = ()
    validation: tuple[PredictionErrors, ...] = ()
    held_out: tuple[HeldOut, ...] = ()
    noise: NoiseFit | None = None
    integration: IntegrationFit | None = None
    verdict: Verdict = field(default_factory=Verdict.missing)
    derived: dict[str, Estimate] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    suspects: tuple[Suspect, ...] = ()
    systematic: tuple[SystematicError, ...] = ()
    task: dict[str, Any] = field(default_factory=dict)
    predictions: tuple[PredictedRun, ...] = ()
    held_predictions: tuple[PredictedRun, ...] = ()
    reason: Reason = ""
    _most_rows = None

    @property
    def loss(self) -> AbstractLoss:
        """Loss function of the fit."""
        return loss_of(self.config.get("loss", "linear"))

    @property
    def free(self) -> dict[str, Estimate]:
        """Parameters that the fit could change."""
        return {path: estimate for path, estimate in self.parameters.items() if estimate.free}

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Paths of the parameters that were free as nuisance parameters, not by request."""
        return tuple(self.config.get("nuisances", ()))

    @property
    def asked(self) -> tuple[str, ...]:
        """Paths of the parameters that were free by request."""
        return tuple(path for path in self.free if path not in self.nuisances)

    @property
    def shown(self) -> dict[str, Estimate]:
        """Free parameters, derived quantities, and parameters that the settings fix.

        The mean of a parameter with a value for each group of runs is followed by these values, if
        they are few.
        """
        chosen = [path.partition("[")[0] for path in self.config.get("fix", {})]
        held = {path: self.parameters[path] for path in chosen if path in self.parameters}
        free, nuisances = self.free, set(self.nuisances)
        asked = {path: one for path, one in free.items() if path not in nuisances}
        others = {path: one for path, one in free.items() if path in nuisances}
        # Quantities that are derived from nuisance parameters alone are represented by them.
        follows = {path.partition("[")[0] for path in nuisances}
        derived = {p: one for p, one in self.derived.items() if p.partition("[")[0] not in follows}
        return {**asked, **rows_of_runs(self.runs, asked), **derived, **held, **others}

    def plot(self, run: Run | None = None) -> "Figure":
        """Return a picture of a fitted run, with its recorded and predicted values.

        Arguments:
            run: one of the fitted runs. It is optional if there is only one. A loaded result then
                reads it from its file.

        Raises:
            InputError: as in `giajax.report.plot`.
        """
        return _drawn("plot", self, run)

    def predict(
        self, run: Run, channels: Sequence[str] | None = None, *, without: Sequence[str] = ()
    ) -> PredictedRun:
        """Predict channels of a run with the fitted model.

        Arguments, results and errors are those of `giajax.predict`.
        """
        return predict(self.model_of(run), run, channels, without=without)

    def model_of(self, run: Run) -> AbstractModel:
        """Return the fitted model for a run, with its own values if the run was fitted."""
        return model_of_run(self.model, self.runs, run, self.config.get("ties", {}))

    def to_frame(self) -> "pl.DataFrame":
        """Return the displayed parameters as a Polars frame with one row each, in SI units.

        `low` and `high` are the limits of the 95 % interval.
        """
        import polars as pl

        rows = [
            {
                "parameter": path,
                "value": value,
                "standard_error": one.standard_error,
                "low": None if one.interval is None else one.interval[0],
                "high": None if one.interval is None else one.interval[1],
                "unit": one.unit,
                "free": one.free,
                "remark": one.remark,
            }
            for path, one in self.shown.items()
            for value in np.ravel(one.value)
        ]
        return pl.DataFrame(rows, infer_schema_length=None)

    def to_json(self) -> str:
        """Return the result as JSON. Numbers that are not finite become null."""
        record = {name: getattr(self, name) for name in _STORED.__annotations__}
        return json_text(record, {"schema_version": SCHEMA_VERSION, "model": self.model.kind})

    def __repr__(self) -> str:
        free = f"{len(self.free)} free parameters"
        return f"<FitResult: {self.model.kind} model, {free}, {self.status}>"

    def __str__(self) -> str:
        return f"{self.headline}\n\n{estimate_table(in_column_units(self.shown, self.model))}"

    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        return self.headline, *estimate_cells(in_column_units(self.shown, self.model))

    @property
    def headline(self) -> str:
        """The message, preceded by "NOT CONVERGED" or by the problem of the model."""
        message, reasons = self.message, self.verdict.reasons
        if self.status != "converged":
            # The verdict does not refer to an optimum, and is displayed separately.
            return f"NOT CONVERGED: {message}" if self.status == "not_converged" else message
        if self.verdict.status == "inadequate":
            return (
                f"INADEQUATE MODEL: {reasons[0].sentence}; {message}; the standard errors are "
                "conditional on a model that does not describe the data"
            )
        if reasons and reasons[0].code in ("suspect", "prior", "vanished"):
            # The verdict contains the advice.
            return f"DOUBTFUL MODEL: {reasons[0].sentence.partition(': ')[0]}; {message}"
        return message


# Fields of a result that its file contains. The model is built from the configuration and the
# parameters.
_STORED = dataclasses.make_dataclass(
    "_STORED",
    [
        (one.name, one.type, field(default=one.default, default_factory=one.default_factory))
        for one in dataclasses.fields(FitResult)
        if one.name not in ("model", "predictions", "held_predictions")
    ],
)


def arm_model_of(model: AbstractModel | FitResult) -> ArmModel:
    """Return the model of an arm, fitted or not (`InputError` for any other model)."""
    stated = model.model if isinstance(model, FitResult) else model
    if stated.kind != ARM.name:
        raise InputError(
            f"the model is a {stated.kind} model, but an arm model is required: give a fit of an "
            "arm, or its file"
        )
    return cast("ArmModel", stated)


def load_result(path: str | Path) -> FitResult:
    """Read a `result.json`, or the folder that contains one. Its model can predict.

    Raises:
        InputError: the file does not exist, or is not a giajax result. The message gives the first
            wrong key.

    Example:
        >>> result = giajax.load_result("giajax-out/base_step")  # doctest: +SKIP
        >>> result.predict(giajax.read_run("other.csv"))  # doctest: +SKIP
    """
    folder, record = stored_result(path)
    what = f"{folder / 'result.json' if Path(path).is_dir() else path} is not a giajax result"
    kind = record.pop("model")
    fields = _fields(record, what)
    values = {path: estimate.value for path, estimate in fields["parameters"].items()}
    check_sources(fields["versions"], f"{kind} {fields['config']}")
    try:
        loss_of(fields["config"].get("loss", "linear"))
        return _of(fields, build_model(kind, fields["config"]["definition"], values))
    except InputError as error:
        raise InputError(f"{error}{hint(fields['versions'])}") from None
    except (ValueError, LookupError, ArithmeticError, TypeError, AttributeError):
        raise InputError(f"{what} (its parameters do not match its model): {_REMEDY}") from None


def parse_result(text: str, model: AbstractModel) -> FitResult:
    """Return a result from the output of `FitResult.to_json` of this version and its model."""
    record = json.loads(text)
    del record["model"]
    return _of(_fields(record, "the text is not a giajax result"), model)


_REMEDY = "give the folder of a fit"


def _fields(record: dict[str, Any], what: str) -> Mapping[str, Any]:
    """Return the fields of a stored result without its model. Earlier versions lack some fields."""
    del record["schema_version"]
    fields = vars(from_plain(_STORED, record, what, _REMEDY))
    # A tied parameter has a standard error, but no initial value of its own.
    known = [
        path
        for path, one in fields["parameters"].items()
        if one.free and one.standard_error is not None
    ]
    for number, start in enumerate(fields["starts"]):
        for path in known if start.misfit is not None else ():
            if (start.parameters or {}).get(path) is None:
                raise InputError(f"{what} (starts[{number}] has no {path}): {_REMEDY}")
    return fields


def _of(fields: Mapping[str, Any], model: AbstractModel) -> FitResult:
    if (integration := fields["integration"]) is not None:
        model = capabilities.with_integration(model, solver=None, tolerance=integration.tolerance)
    return FitResult(model=model, **fields)
