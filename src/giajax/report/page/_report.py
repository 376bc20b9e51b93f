"""Page of one result."""

import datetime
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...fitting import FitResult, in_column_units, matching_runs
from ...models import capabilities
from ...recordings import Run
from ...runtime.records import plain_data
from ...runtime.text import InputError, format_estimate
from ...studies import with_fitted_states
from ...tasks import repeatable
from .. import SUSPECT_HEADINGS, Table, first_suspects, sections, systematic_table
from .._suspects import significant
from .._text import WRONG_DERIVATIVES, strongest_correlation, summary_rows, worth_drawing
from ._plots import (
    Panel,
    can_have_bands,
    curve_item,
    panel,
    prediction_errors_of_parameters,
    worst_panels,
)
from ._render import Arm, animation, rendered, some_of
from ._tables import (
    correlation_cells,
    file_rows,
    held_out_table,
    noise_table,
    optima_table,
    own_table,
    parameter_rows,
    starts_table,
    validation_table,
)

# Sentences that a reader must know before any number: whether it can be trusted, and its
# limitations, in the order of importance. They contain nothing that is not in the result.

# A correlation above the first limit, an error above the second (relative to the value), and a
# prediction error of held-out data above the third (relative to the expected one) are reported.
_CORRELATED, _VAGUE, _FAR_OFF = 0.9, 0.1, 1.5

_NOTABLE = 0.5  # reported shift due to a held number or the tolerance, in standard errors

# Findings that the sentences on parameters here already contain.
_SAID = ("no_response", "correlated")


class Opening(NamedTuple):
    """The top of a page: a grade ("good", "doubtful" or "bad"), a sentence, and limitations.

    The most important limitation is the first one.
    """

    grade: str
    headline: str
    limits: list[str]


def opening(result: FitResult) -> Opening:
    """Return the verdict in plain words."""
    limits = [
        *_of_the_model(result),
        *_undetermined(result),
        *_held_numbers(result),
        *_precision(result),
        *_prediction(result),
        *_computation(result),
    ]
    fits = "The fit has converged and the model describes the data to within the noise, but "
    if result.status != "converged":
        grade, headline = "bad", f"Do not use the estimates yet: {result.message}"
    elif result.verdict.status == "inadequate":
        grade = "bad"
        headline = (
            "The fit has converged, but the model does not describe the data: the standard errors "
            "assume that the model is correct, and the true errors may be larger"
        )
    elif result.verdict.status == "doubtful":
        grade = "doubtful"
        headline = (
            "The fit has converged and its residuals are within the noise, but a fixed or omitted "
            "parameter is significant, and shifts estimates by more than their errors"
        )
    elif result.verdict.status == "not evaluated":
        grade = "doubtful"
        headline = "The fit has converged; the verdict on the model was not evaluated"
    elif _undetermined(result):
        grade, headline = "doubtful", f"{fits}the data do not determine all parameters"
    elif _has_wrong_derivatives(result):
        grade = "doubtful"
        headline = f"{fits}the derivatives of the model are wrong"
    else:
        grade = "good"
        headline = "The fit has converged, and the model describes the data to within the noise"
    return Opening(grade, headline, limits)


def _of_the_model(result: FitResult) -> list[str]:
    reasons = result.verdict.reasons if result.status == "converged" else ()
    said = [reason.sentence for reason in reasons]
    doubted = any(reason.code == "suspect" for reason in reasons)
    for row in [] if doubted else significant(result)[:1]:
        of_model = row.kind not in ("axes", "columns", "points", "outliers")
        held = ", which the model fixes or omits" * of_model
        said.append(f"the most significant suspect is {row.path}{held}")
    return said


def _undetermined(result: FitResult) -> list[str]:
    without = [path for path, one in result.free.items() if one.standard_error is None]
    if not without:
        return []
    return [f"the data do not determine {', '.join(without)}: do not use the fitted values"]


def _held_numbers(result: FitResult) -> list[str]:
    return [
        f"{error.path} is fixed, and {'its uncertainty' if error.stated else 'a change of 1 %'} "
        f"shifts {', '.join(error.decides)} by more than one standard error"
        for error in result.systematic
        if error.decides
    ]


def _precision(result: FitResult) -> list[str]:
    said = []
    known = {
        path: abs(one.standard_error / one.value)
        for path, one in result.free.items()
        if one.standard_error is not None and isinstance(one.value, float) and one.value
    }
    if known:
        worst = max(known, key=lambda path: known[path])
        if known[worst] > _VAGUE:
            one = in_column_units(result.free, result.model)[worst]
            value, error = format_estimate(one.value, one.standard_error)
            unit = f" {one.unit}" if one.unit else ""
            said.append(
                f"{worst} has the largest relative error: {value} \N{PLUS-MINUS SIGN} {error}{unit}"
            )
    correlation, path, other = strongest_correlation(result) or (0.0, "", "")
    if abs(correlation) > _CORRELATED:
        said.append(
            f"{path} and {other} are strongly correlated (correlation {correlation:+.3f}): do not "
            "interpret one without the other"
        )
    said += [one.sentence for one in result.findings if one.code not in _SAID]
    return said


def _prediction(result: FitResult) -> list[str]:
    channels = [channel for record in result.held_out for channel in record.channels.values()]
    sizes = [channel.size for channel in channels if channel.size is not None]
    if not channels and not result.validation:
        return ["no data were held out, so the prediction error is not tested"]
    if sizes and max(sizes) > _FAR_OFF:
        return [
            f"the held-out data are predicted with errors up to {max(sizes):.2g} times the errors "
            "expected from noise and parameter uncertainty"
        ]
    return []


def _computation(result: FitResult) -> list[str]:
    said = []
    if result.noise is not None and result.noise.estimated:
        said.append("the size of the noise was estimated from the residuals, at least in part")
    effect = result.tolerance_effect
    largest = None if effect is None else effect.largest_in_standard_errors
    if capabilities.refined(result.model, 1.0) is None:
        said.append("the effect of a smaller solver tolerance was not checked")
    if largest is not None and largest > _NOTABLE:
        said.append(
            f"a smaller tolerance of the solver would change an estimate by {largest:.2g} standard "
            "errors"
        )
    if _has_wrong_derivatives(result):
        said.append(
            "the derivatives of the model disagree with finite differences, so the fit may have "
            "ended away from the optimum"
        )
    return said


def _has_wrong_derivatives(result: FitResult) -> bool:
    check = result.gradient_check
    return check is not None and check.relative_difference > WRONG_DERIVATIVES


# Limits on the panels of all runs together, and on the numbers in them, about 3 MB.
_MOST_PANELS, _MOST_VALUES = 24, 420_000

_MOST_SUSPECTS = 8  # `giajax suspects` lists more


class _RunPart(NamedTuple):
    """The plots of a run on the page."""

    name: str
    panels: list[Panel]
    left_out: int
    arm: Arm | None
    over_time: bool
    held: bool

    @property
    def thinned(self) -> Panel | None:
        """A panel that does not draw all samples, or None."""
        return next((panel for panel in self.panels if panel.drawn < panel.samples), None)


def report_page(
    result: FitResult,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    source: Path | None = None,
) -> bytes:
    """Return the page of `giajax.report.report_page`."""
    # Predictions, bands and animation start from the fitted initial states.
    runs = with_fitted_states(result, matching_runs(result.runs, runs, whole=True))
    predictions = result.predictions or [result.predict(run) for run in runs]
    bands = can_have_bands(result)
    parts = _run_parts(result, runs, predictions, held_out, bands=bands)
    parameters = parameter_rows(result)
    return rendered(
        "report.html",
        plots=True,
        title=", ".join(some_of(run.name for run in result.runs)),
        result=result,
        opening=opening(result),
        parameters=parameters,
        places={row["path"]: index for index, row in enumerate(parameters, 1)},
        has_systematic=any(error.stated for error in result.systematic),
        has_sources=any(one.sources for one in result.free.values()),
        suspects=Table(list(SUSPECT_HEADINGS), first_suspects(result, _MOST_SUSPECTS), 1),
        systematic=Table(*systematic_table(result), 1) if result.systematic else None,
        parts=parts,
        bands=bands,
        hollow=any(part.held for part in parts),
        timed=any(run.times is not None for run in runs),
        cost=_cost(result),
        paths=result.correlation.parameters,
        correlations=correlation_cells(result),
        sections=sections(result, source),
        noise=noise_table(result),
        held_out=held_out_table(result),
        validation=validation_table(result),
        starts=starts_table(result),
        optima=optima_table(result),
        own=own_table(result),
        summary=summary_rows(result),
        files=file_rows(result),
        config=json.dumps(plain_data(result.config), indent=2),
        again=_again(source),
        dates=_dates(source),
        source=None if source is None else shlex.quote(str(source)),
    )


def _run_parts(
    result: FitResult,
    runs: Sequence[Run],
    predictions: Sequence[Mapping[str, np.ndarray]],
    held_out: Sequence[Run],
    *,
    bands: bool,
) -> list[_RunPart]:
    drawn = worth_drawing(result)
    held = {(run.name, run.sha256): run for run in held_out}
    chosen = {
        index: worst_panels(runs[index], result.runs[index], max(_MOST_PANELS // len(drawn), 1))
        for index in drawn
    }
    values = _MOST_VALUES // max(sum(len(panels) for panels, _ in chosen.values()), 1)
    parts: list[_RunPart] = []
    for index, (panels, left_out) in chosen.items():
        run, predicted, record = runs[index], predictions[index], result.runs[index]
        widths = prediction_errors_of_parameters(result, run, predicted) if bands else {}
        partly = held.get((run.name, run.sha256))
        drawn_names = {name for names in panels for name in names}
        hollow = partly is not None and not drawn_names.isdisjoint(partly.observations)
        shown = [
            panel(names, run, predicted, record, held=partly, bands=widths, values=values)
            for names in panels
        ]
        # Only one animation is included, because two would make the page too large for a phone.
        seen = any(part.arm for part in parts)
        arm = None if seen else animation(result, run, predicted)
        parts.append(_RunPart(run.name, shown, left_out, arm, run.drawn_over is None, hollow))
    return parts


def _cost(result: FitResult) -> str | None:
    known = [(one.number, one.cost) for one in result.history if one.cost is not None]
    if len(known) < 2:
        return None
    numbers, costs = zip(*known, strict=True)
    return curve_item("cost", numbers, costs, log=min(costs) > 0)


def _again(source: Path | None) -> tuple[str, str]:
    """Return the command that repeats the fit, or the reason why there is none."""
    if source is None:
        return "", "the result was not read from a file"
    try:
        repeatable(source)
    except InputError as error:
        return "", str(error)
    return f"giajax fit --again {shlex.quote(str(source))}", ""


def _dates(source: Path | None) -> list[tuple[str, str]]:
    dates = {"this page": datetime.datetime.now()}
    if source is not None and source.exists():
        written = datetime.datetime.fromtimestamp(source.stat().st_mtime)
        dates = {"result.json last changed": written, **dates}
    return [(name, f"{date.astimezone():%Y-%m-%d %H:%M %z}") for name, date in dates.items()]
