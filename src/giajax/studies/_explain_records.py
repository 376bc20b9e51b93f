"""Records of an explanation: its steps and its parameters."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from ._refit import StudyRecord

ALL = "all of the data"
"""Name of the step in which the held-out data are added to the fitted data."""

Ended = Literal["selected", "steps", "budget", "interrupted", "failed"]


@dataclasses.dataclass(frozen=True)
class ExplainedStep:
    """One fit of an explanation.

    Attributes:
        change: path of a parameter or name of a choice, preceded by `without` if it was removed;
            "-" for the first fit; or `ALL` if the same model was fitted to all data, as in all
            later steps.
        kind: kind of the suspect, as in `giajax.fitting.Suspect`; "start" for the first fit, "data"
            for `ALL`.
        taken: whether the fit was accepted as a step, rather than only tried.
        p_value: p-value of the test that suggested the change, corrected for the number of tests.
        chi_square: chi-square with the white noise of the last step.
        parameters: number of fitted parameters.
        values: number of measured values.
        bic: Schwarz's (Bayesian) information criterion, with the same noise.
        held_out: root mean square error on the data to which no step was fitted, divided by the
            noise.
        estimates: value and standard error (SI) of the requested parameters, by path.
    """

    change: str
    kind: str
    taken: bool
    p_value: float | None
    chi_square: float
    parameters: int
    values: int
    bic: float
    held_out: float | None
    estimates: dict[str, tuple[float, float | None]]


@dataclasses.dataclass(frozen=True)
class ExplainedParameter:
    """Requested parameter with its errors (SI).

    Attributes:
        path: path of the parameter.
        unit: SI unit.
        value: estimate of the final fit.
        standard_error: standard error conditional on the selected model.
        selection_error: root mean square difference of the models that fit nearly as well, with
            weights exp(-difference of BIC / 2) (Buckland et al. 1997).
        spread: difference between the largest and the smallest estimate among these models.
        total_error: square root of the sum of the squares of the standard error and the selection
            error.
    """

    path: str
    unit: str
    value: float
    standard_error: float | None
    selection_error: float
    spread: float
    total_error: float | None


@dataclasses.dataclass(frozen=True)
class Explanation(
    StudyRecord,
    file="explain.json",
    head={"explain_version": 1},
    remedy="run 'giajax explain' again",
):
    """Effects that a run requires beyond the assumed model, step by step.

    Attributes:
        fit: key of the final fit.
        ended: reason why the selection ended: "selected", "steps", "budget", "interrupted", or
            "failed" if a model could not be fitted or tested.
        ending: one sentence on this reason.
        status, verdict: status and verdict of the final fit.
        sentences: reasons of the verdict against the model.
        loss: loss function of the residuals.
        outliers: number of cells that differ from both neighbours by more than noise can explain.
        steps: accepted fits; the first is the initial fit.
        tried: fits that were not accepted.
        near: indices of the fits in `tried` whose BIC exceeds that of the last step with the same
            number of values (`behind`) by less than `nearness`.
        nearness: largest BIC difference from the selected model for a model that fits nearly as
            well as it.
        parameters: requested parameters.
        axes: whether the runs were recorded in other axes; the corrected runs are stored beside
            this file.
    """

    fit: str
    ended: Ended
    ending: str
    status: str
    verdict: str
    sentences: tuple[str, ...]
    loss: str
    outliers: int
    steps: tuple[ExplainedStep, ...]
    tried: tuple[ExplainedStep, ...]
    near: tuple[int, ...]
    nearness: float
    parameters: tuple[ExplainedParameter, ...]
    axes: bool = False

    @property
    def added(self) -> tuple[str, ...]:
        """Changes of the final model relative to the first one."""
        kept: list[str] = []
        for step in self.steps[1:]:
            if step.kind == "data":
                continue
            path = step.change.removeprefix("without ")
            kept = [one for one in kept if one != path] if path != step.change else [*kept, path]
        return tuple(kept)


def behind(steps: Sequence[ExplainedStep], tried: ExplainedStep) -> tuple[float, ExplainedStep]:
    """Return the excess of BIC of a fit over the last step with as many values, and that step."""
    step = next((one for one in reversed(steps) if one.values == tried.values), steps[-1])
    return tried.bic - step.bic, step
