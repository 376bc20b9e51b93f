"""What an explanation found: its steps and its parameters, as data."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

from ._refit import StudyRecord

ALL = "all of the data"
"""The change of a step that adds nothing: from here on nothing is kept to judge steps by."""

Ended = Literal["selected", "steps", "budget", "interrupted", "failed"]


@dataclasses.dataclass(frozen=True)
class ExplainedStep:
    """One fit of an explanation.

    Attributes:
        change: a path or a choice, `without` one, "-" for the first, or `ALL` for the same model
            fitted to more, which later steps are fitted to as well.
        kind: of the suspect, as of `giajax.fitting.Suspect`; "start" for the first, "data" for
            `ALL`.
        taken: whether it is a step, or was tried alone.
        p_value: of the test that asked for it, corrected for the number of tests.
        chi_square: with the white noise of the last step.
        parameters: number of fitted parameters.
        values: number of measured values.
        bic: Schwarz' criterion, with the same noise.
        held_out: root mean square error of what no step was fitted to, in units of the noise.
        estimates: value and standard error (SI) of the parameters that were asked for, by path.
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
    """A parameter that was asked for, with its errors (SI).

    Attributes:
        standard_error: conditional on the selected model.
        selection_error: how far the models that fit nearly as well are from it, as a root mean
            square with weights exp(-difference of BIC / 2) (Buckland and others 1997).
        spread: the difference between the largest and the smallest of their values.
        total_error: standard and selection error in quadrature.
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
    remedy="run giajax explain again",
):
    """What a run needs beyond the model that was assumed, step by step.

    Attributes:
        fit: key of the final fit.
        ended: what ended it: "selected", "steps", "budget", "interrupted", or "failed" where a
            model could not be fitted or asked.
        ending: one sentence on that.
        status, verdict: of the final fit; the sentences say what speaks against its model.
        loss: how residuals counted.
        outliers: cells that differ from both of their neighbours as no noise does.
        steps: the first is the fit that was begun from.
        tried: fits that were made and not taken.
        near: places among `tried` of those whose BIC is within `nearness` of that of the last step
            that was fitted to as many values (`behind`).
        parameters: those that were asked for.
        axes: whether the runs were recorded in other axes; what was fitted lies beside this file.
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
        """What the final model has beyond the first one."""
        kept: list[str] = []
        for step in self.steps[1:]:
            if step.kind == "data":
                continue
            path = step.change.removeprefix("without ")
            kept = [one for one in kept if one != path] if path != step.change else [*kept, path]
        return tuple(kept)


def behind(steps: Sequence[ExplainedStep], tried: ExplainedStep) -> tuple[float, ExplainedStep]:
    """How much higher the BIC of a fit is than that of the last step of as many values; which."""
    step = next((one for one in reversed(steps) if one.values == tried.values), steps[-1])
    return tried.bic - step.bic, step
