"""The result of a fit, as data: it can be written, read again, and it predicts."""

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
    EstimateRow,
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
    estimate_rows,
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
    """How a fit integrated its model.

    Attributes:
        solver: one of `giajax.simulation.SOLVERS`.
        tolerance: relative and absolute tolerance of a step, where the fit ended.
        chosen: whether the fit chose the tolerance; otherwise it was stated.
    """

    solver: str
    tolerance: float
    chosen: bool


def integration_of(state: FitState) -> IntegrationFit | None:
    """Solver and tolerance in use; None of a model without them."""
    integration = capabilities.integration(state.problem.model)
    if integration is None or integration.tolerance is None:
        return None
    chosen = state.setup.chooses_tolerance
    return IntegrationFit(integration.solver, integration.tolerance, chosen)


def _drawn(function: str, *arguments: object) -> "Figure":
    """A picture by the room `report`, which is above this one and so is named in text alone.

    It is the one room that is bound late, so that a notebook draws what it holds.
    """
    figure: Figure = getattr(importlib.import_module("giajax.report"), function)(*arguments)
    return figure


class PredictedRun(dict[str, np.ndarray]):
    """Channels that a model predicts for a run: arrays in SI units of shape (sample,), by name.

    Attributes:
        run: the run.
    """

    def __init__(self, run: Run, channels: Mapping[str, np.ndarray]) -> None:
        super().__init__(channels)
        self.run = run

    def plot(self) -> "Figure":
        """The picture of what is predicted, and of what the run recorded of it, in its units.

        Raises:
            InputError: no channel is predicted.
        """
        return _drawn("prediction_figure", self)


def _flattened(predicted: PredictedRun) -> tuple[list[tuple[Any, Any]], tuple[str, ...]]:
    names = tuple(sorted(predicted))
    return [(jax.tree_util.DictKey(name), predicted[name]) for name in names], names


def _plain_dict(names: tuple[str, ...], values: Iterable[Any]) -> Any:
    """What is computed from a prediction, which is that of no run."""
    return dict(zip(names, values, strict=True))


jax.tree_util.register_pytree_with_keys(PredictedRun, _flattened, _plain_dict)


def predict(
    model: AbstractModel,
    run: Run,
    channels: Sequence[str] | None = None,
    *,
    without: Sequence[str] = (),
) -> PredictedRun:
    """Channels that a model predicts for a run.

    Arguments:
        model: the model.
        run: gives times, commands and wind; its recorded channels are not used.
        channels: names without unit (`link06_z`); those that the run recorded by default.
        without: of what of the model the run has another one, such as `camera` or `wind`: it is
            then as the sidecar of the run states, or left out. A path, the name of a group of
            parameters, or the end of a path.

    Returns:
        Arrays in SI units of shape (sample,) by channel name; infinite or NaN where the
        simulation did not arrive. Their `plot()` is the picture of them and the run.

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
    """How far a prediction is from what a run recorded, in the unit of the recording.

    Its initial state is as its definition says; errors are infinite where the simulation failed.

    Raises:
        InputError: as `predict`.
    """
    names = list(run.observations if channels is None else channels)
    return errors_of(run, predict(model, run, names, without=without))


def errors_of(run: Run, predicted: Mapping[str, np.ndarray]) -> PredictionErrors:
    """How far predicted channels (SI) are from a run's, in the unit of the recording."""
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
    """What a fit found; `result.model` is the fitted model.

    It prints as a table of its parameters, and a notebook shows it as one.

    Attributes:
        status: "converged", "not_converged" or "interrupted".
        message: one sentence that says how it ended.
        model: the fitted model.
        parameters: `Estimate` by path: the free ones, element by element, then all others.
        correlation: of the determined free parameters.
        runs: the fitted runs, with the errors of their channels.
        cost: half the sum of the loss over the weighted residuals.
        reduced_chi_square: squared weighted residuals per degree of freedom.
        iterations: trial steps after the evaluation of the start.
        gradient_check: derivatives by autodiff against differences at the optimum.
        tolerance_effect: shift of the parameters with a finer solver tolerance.
        conditions: sentences on what the values are conditional on.
        seconds: wall time, compiling apart.
        versions: of giajax and of the libraries that computed it.
        config: the settings of the fit, resolved; with the parameters it rebuilds the model.
        history: the start and each iteration.
        starts: where the fit was started (`giajax.multi_start`), each with its end; empty for
            one start.
        validation: errors of prediction of runs that were not fitted.
        held_out: what was held out of the fit (`FitTask.on_top(hold_out=)`), and how well it is
            predicted.
        noise: what was taken for noise; None from a file without it.
        integration: how the model was integrated; None of one without a solver to choose, and
            from a file without it.
        verdict: whether the model describes the data, apart from convergence.
        derived: `Estimate` by name of what follows from the free parameters: the tied ones, and
            what the model derives (`AbstractModel.derived`).
        findings: what the data cannot tell, each with advice (`docs/findings.md`).
        suspects: what the residuals suggest (`giajax.suspects`), the most promising first; empty
            where that was not asked.
        systematic: what held numbers do to the fitted ones (`giajax.systematic_errors`); likewise.
        task: how `giajax.FitTask.again` fits it again: files with their checksums, and settings;
            empty for a fit of runs without a task.
        predictions: what is predicted of each run (SI), by name; empty after `load_result`.
        held_predictions: those of each of `held_out`, likewise.
        reason: what ended the fit: "optimum"; "iterations" or "budget", which were used up;
            "rough" (no step lowers a cost that is not smooth), "wall" (the model cannot be
            evaluated beyond), "crawl" (the cost hardly falls any more), "cannot_fit" (the model
            describes the data hardly better than a constant), "no_response" (of any channel to
            what is free); "interrupted"; empty in a file of an earlier version.
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
        """How a large residual counted."""
        return loss_of(self.config.get("loss", "linear"))

    @property
    def free(self) -> dict[str, Estimate]:
        """The parameters that the fit was allowed to move."""
        return {path: estimate for path, estimate in self.parameters.items() if estimate.free}

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Paths of what was free because it is always uncertain, and not because it was asked."""
        return tuple(self.config.get("nuisances", ()))

    @property
    def asked(self) -> tuple[str, ...]:
        """Paths of what was free because it was asked."""
        return tuple(path for path in self.free if path not in self.nuisances)

    @property
    def shown(self) -> dict[str, Estimate]:
        """The free parameters, what follows from them, and those that the settings fix.

        Of what has a value for each group of runs, these values follow their mean, if they are few.
        """
        chosen = [path.partition("[")[0] for path in self.config.get("fix", {})]
        held = {path: self.parameters[path] for path in chosen if path in self.parameters}
        free, nuisances = self.free, set(self.nuisances)
        asked = {path: one for path, one in free.items() if path not in nuisances}
        others = {path: one for path, one in free.items() if path in nuisances}
        # What follows from these alone is shown by them.
        follows = {path.partition("[")[0] for path in nuisances}
        derived = {p: one for p, one in self.derived.items() if p.partition("[")[0] not in follows}
        return {**asked, **rows_of_runs(self.runs, asked), **derived, **held, **others}

    def plot(self, run: Run | None = None) -> "Figure":
        """The picture of what a fitted run recorded and of what the fit predicts of it.

        Arguments:
            run: one of those that were fitted; not needed where it was one alone, which a result
                that was loaded reads again from its file.

        Raises:
            InputError: as `giajax.report.plot`.
        """
        return _drawn("plot", self, run)

    def predict(
        self, run: Run, channels: Sequence[str] | None = None, *, without: Sequence[str] = ()
    ) -> PredictedRun:
        """Channels that the fitted model predicts for a run.

        Arguments, results and errors are those of `giajax.predict`.
        """
        return predict(self.model_of(run), run, channels, without=without)

    def model_of(self, run: Run) -> AbstractModel:
        """The fitted model as it is for a run: of one that was fitted, with its own values."""
        return model_of_run(self.model, self.runs, run, self.config.get("ties", {}))

    def to_frame(self) -> "pl.DataFrame":
        """The parameters that are shown, in SI units, as a frame of Polars: a row for each.

        `low` and `high` hold the value by 95 %.
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
        """The result as JSON; what is not finite becomes null."""
        record = {name: getattr(self, name) for name in _STORED.__annotations__}
        return json_text(record, {"schema_version": SCHEMA_VERSION, "model": self.model.kind})

    def __repr__(self) -> str:
        free = f"{len(self.free)} free parameters"
        return f"<FitResult: {self.model.kind} model, {free}, {self.status}>"

    def __str__(self) -> str:
        return f"{self.headline}\n\n{estimate_table(in_column_units(self.shown, self.model))}"

    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        rows = estimate_rows(in_column_units(self.shown, self.model))
        return self.headline, EstimateRow._fields, rows

    @property
    def headline(self) -> str:
        """The message; before it "NOT CONVERGED", or what is wrong with the model."""
        message, reasons = self.message, self.verdict.reasons
        if self.status != "converged":
            # Its verdict is that of no optimum, and stands beside it.
            return f"NOT CONVERGED: {message}" if self.status == "not_converged" else message
        if self.verdict.status == "inadequate":
            return (
                f"INADEQUATE MODEL: {reasons[0].sentence}; {message}; the standard errors are "
                "conditional on a model that does not describe the data"
            )
        if reasons and reasons[0].code in ("suspect", "prior", "vanished"):
            # What to do about it stands in the verdict.
            return f"DOUBTFUL MODEL: {reasons[0].sentence.partition(': ')[0]}; {message}"
        return message


# What of a result its file holds; the model is built from the configuration and the parameters.
_STORED = dataclasses.make_dataclass(
    "_STORED",
    [
        (one.name, one.type, field(default=one.default, default_factory=one.default_factory))
        for one in dataclasses.fields(FitResult)
        if one.name not in ("model", "predictions", "held_predictions")
    ],
)


def arm_model_of(model: AbstractModel | FitResult) -> ArmModel:
    """The model of an arm, fitted or not (`InputError`: it is another model)."""
    stated = model.model if isinstance(model, FitResult) else model
    if stated.kind != ARM.name:
        raise InputError(
            f"the model is a {stated.kind} model, but an arm is required: give a fit of an arm, or "
            "its file"
        )
    return cast("ArmModel", stated)


def load_result(path: str | Path) -> FitResult:
    """Read a `result.json`, or the folder that holds one; its model predicts.

    Raises:
        InputError: no such file, or not a result of giajax; with the first key that is wrong.

    Example:
        >>> result = giajax.load_result("giajax-out/base_step")  # doctest: +SKIP
        >>> result.predict(giajax.read_run("other.csv"))  # doctest: +SKIP
    """
    folder, record = stored_result(path)
    what = f"{folder / 'result.json' if Path(path).is_dir() else path} is not a result of giajax"
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
    """A result from what `FitResult.to_json` of this version gave, and its fitted model."""
    record = json.loads(text)
    del record["model"]
    return _of(_fields(record, "the text is not a result of giajax"), model)


_REMEDY = "give the folder of a fit"


def _fields(record: dict[str, Any], what: str) -> Mapping[str, Any]:
    """The fields of a stored result, which earlier versions lack some of; without its model."""
    del record["schema_version"]
    fields = vars(from_plain(_STORED, record, what, _REMEDY))
    # A parameter that follows from others has a standard error, and no start of its own.
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
