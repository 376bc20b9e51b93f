"""What repetitions of a fit add to its page, where their files are beside the result."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from bokeh.embed import json_item
from bokeh.models import HoverTool, Span

from ..._errors import InputError
from ..._files import read_bytes
from ..._limits import RESULT_BYTES
from ...fitting import FitResult
from ...repetitions import Bootstrap, Influence, Repeated
from .._bootstrap import BOOTSTRAP, bootstrap_summary, bootstrap_table
from .._influence import INFLUENCE, influence_summary, influence_table
from .._style import BLUE, LIGHT, VERMILLION
from ._figures import new_plot
from ._tables import Table

Found = TypeVar("Found", Bootstrap, Influence)

# Histograms of more parameters than these are in bootstrap.png.
_MOST = 6


class RepeatedPart(NamedTuple):
    """The section on a bootstrap.

    Attributes:
        table: of the parameters.
        sentences: beside it.
        plots: a title and what BokehJS embeds, of each histogram.
    """

    table: Table
    sentences: list[str]
    plots: list[tuple[str, str]]


def repeated_part(result: FitResult, source: Path | None) -> RepeatedPart | None:
    """The section on the bootstrap of a result; None where there is none, or of another fit.

    Arguments:
        result: that the page is about.
        source: its `result.json`.
    """
    found = _beside(result, source, BOOTSTRAP, Bootstrap.of_json)
    if found is None:
        return None
    drawn = [(path, one) for path, one in found.parameters.items() if len(one.values) > 1]
    plots = [(path, _histogram(one)) for path, one in drawn[:_MOST]]
    return RepeatedPart(Table(*bootstrap_table(found)), bootstrap_summary(found), plots)


def influence_part(result: FitResult, source: Path | None) -> tuple[Table, list[str]] | None:
    """The table and the sentences on the influence of the data; None as of `repeated_part`.

    Arguments:
        result: that the page is about.
        source: its `result.json`.
    """
    found = _beside(result, source, INFLUENCE, Influence.of_json)
    if found is None:
        return None
    return Table(*influence_table(found), 2), influence_summary(found)


def is_of(fitted: dict[str, float], result: FitResult) -> bool:
    """Whether values of free parameters are those of a result."""
    return fitted == {path: float(estimate.value) for path, estimate in result.free.items()}


def _beside(
    result: FitResult, source: Path | None, name: str, read: Callable[[bytes], Found]
) -> Found | None:
    """What a file beside a result holds; None where there is none, or one of another fit."""
    if source is None:
        return None
    try:
        found = read(read_bytes(source.parent / name, RESULT_BYTES))
    except (OSError, InputError):
        return None
    return found if is_of(found.fitted, result) else None


def _histogram(one: Repeated) -> str:
    values = np.asarray(one.values)
    counts, edges = np.histogram(values, bins=int(np.clip(np.sqrt(len(values)) * 1.5, 8, 40)))
    plot: Any = new_plot(180, one.unit or "value", "repetitions")
    bars = plot.quad(
        top=counts, bottom=0, left=edges[:-1], right=edges[1:], fill_color=LIGHT, line_color=BLUE
    )
    for end in one.percentile or ():
        plot.add_layout(Span(location=end, dimension="height", line_color=VERMILLION))
    plot.add_layout(
        Span(location=one.value, dimension="height", line_color=BLUE, line_dash="dashed")
    )
    tips = [("from", "@left"), ("to", "@right"), ("repetitions", "@top")]
    plot.add_tools(HoverTool(renderers=[bars], tooltips=tips))
    return json.dumps(json_item(plot))
