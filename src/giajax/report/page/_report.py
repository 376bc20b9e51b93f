"""The page about one result."""

import datetime
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..._errors import InputError
from ...fitting import FitResult, matching_runs
from ...runs import Run
from ...study import begun_where_it_ended, profiles_beside
from ...tasks import repeatable
from .._suspects import SUSPECT_HEADINGS, first_suspects, systematic_table
from .._text import summary_rows
from .._worst import worth_drawing
from ._arm import Arm, animation
from ._band import can_have_bands, prediction_errors_of_parameters
from ._correlations import correlation_cells
from ._figures import curve_item
from ._opening import opening
from ._plots import Panel, panel, worst_panels
from ._posterior import posterior_part
from ._profiles import profile_part
from ._render import rendered, some_of
from ._repetitions import influence_part, repeated_part
from ._tables import (
    Table,
    file_rows,
    held_out_table,
    noise_table,
    optima_table,
    own_table,
    parameter_rows,
    starts_table,
    validation_table,
)

# Panels of all runs together, and numbers in all of them: some 3 MB.
_MOST_PANELS, _MOST_VALUES = 24, 420_000

# More suspects than this are a list to read with `giajax suspects`.
_MOST_SUSPECTS = 8


class _RunPart(NamedTuple):
    """What the page draws of a run."""

    name: str
    panels: list[Panel]
    left_out: int
    arm: Arm | None
    over_time: bool
    held: bool

    @property
    def thinned(self) -> Panel | None:
        """A panel that does not draw all samples."""
        return next((panel for panel in self.panels if panel.drawn < panel.samples), None)


def report_page(
    result: FitResult,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    source: Path | None = None,
) -> bytes:
    """A result as one HTML file that opens without a network.

    Arguments:
        result: the result of a fit.
        runs: the runs that were fitted, in the same order.
        held_out: what was held out of them.
        source: the `result.json`, from which the page says how to fit it again.

    Returns:
        The page, below 5 MB.

    Raises:
        InputError: other runs than those of the result.
    """
    runs = matching_runs(result.runs, runs, whole=True)
    # What is predicted here, the bands and the arm with it, begins where the fitted values do.
    runs = begun_where_it_ended(result, runs)
    predictions = result.predictions or [result.predict(run) for run in runs]
    bands = can_have_bands(result)
    parts = _run_parts(result, runs, predictions, held_out, bands=bands)
    parameters = parameter_rows(result)
    profiles = None if source is None else profiles_beside(result, source.parent)
    suspects = Table(list(SUSPECT_HEADINGS), first_suspects(result, _MOST_SUSPECTS), 1)
    return rendered(
        "report.html",
        plots=True,
        title=", ".join(some_of(run.name for run in result.runs)),
        result=result,
        opening=opening(result),
        parameters=parameters,
        places={row.path: index for index, row in enumerate(parameters, 1)},
        has_systematic=any(error.stated for error in result.systematic),
        has_sources=any(one.sources for one in result.free.values()),
        profiles=None if profiles is None else profile_part(profiles, result),
        suspects=suspects,
        systematic=Table(*systematic_table(result), 1) if result.systematic else None,
        parts=parts,
        bands=bands,
        hollow=any(part.held for part in parts),
        timed=any(run.times is not None for run in runs),
        cost=_cost(result),
        paths=result.correlation.parameters,
        correlations=correlation_cells(result),
        repeated=repeated_part(result, source),
        influence=influence_part(result, source),
        noise=noise_table(result),
        held_out=held_out_table(result),
        validation=validation_table(result),
        starts=starts_table(result),
        optima=optima_table(result),
        own=own_table(result),
        posterior=posterior_part(result, source),
        summary=summary_rows(result),
        files=file_rows(result),
        config=json.dumps(json.loads(result.to_json())["config"], indent=2),
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
        hollow = partly is not None and bool(drawn_names & partly.observations.keys())
        shown = [
            panel(names, run, predicted, record, held=partly, bands=widths, values=values)
            for names in panels
        ]
        # One arm that moves is enough; two are a page that no phone opens.
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
    """The command that fits it again, or why there is none."""
    if source is None:
        return "", "the result was not read from a file"
    try:
        repeatable(source)
    except InputError as error:
        return "", str(error)
    return f"giajax fit --again {shlex.quote(str(source))}", ""


def _dates(source: Path | None) -> list[tuple[str, str]]:
    now = datetime.datetime.now().astimezone()
    dates: list[tuple[str, Any]] = [("this page", now)]
    if source is not None and source.exists():
        written = datetime.datetime.fromtimestamp(source.stat().st_mtime).astimezone()
        dates.insert(0, ("result.json last changed", written))
    return [(name, date.strftime("%Y-%m-%d %H:%M %z")) for name, date in dates]
