"""What a page says of the posterior that lies beside a result."""

import base64
from pathlib import Path
from typing import NamedTuple

from ..._errors import InputError
from ..._files import read_bytes
from ..._limits import RESULT_BYTES
from ...fitting import FitResult
from ...study import PosteriorSummary
from .._posterior import BANDS, CORNER, POSTERIOR, POSTERIOR_HEADINGS, posterior_rows
from ._tables import Table

# A page stays below 5 MB; a larger picture is left in its file.
_MOST_BYTES = 600_000


class PosteriorPart(NamedTuple):
    """What the page shows of a posterior.

    Attributes:
        summary: of the draws.
        table: of the parameters.
        within: the least share of recorded cells within their 95 % band, and of which channel;
            empty where nothing was recorded.
        pictures: as data of a browser, each with what it shows.
    """

    summary: PosteriorSummary
    table: Table
    within: str
    pictures: list[tuple[str, str]]


def posterior_part(result: FitResult, source: Path | None) -> PosteriorPart | None:
    """The posterior in the folder of a result.

    Arguments:
        result: of the fit.
        source: its `result.json`.

    Returns:
        What is shown of it; None where there is none, or it is of another fit.
    """
    if source is None:
        return None
    folder = source.parent
    try:
        text = read_bytes(folder / POSTERIOR, RESULT_BYTES).decode()
        summary = PosteriorSummary.from_json(text)
    except (OSError, UnicodeError, InputError):
        return None
    if not summary.is_of(result):
        return None
    shares = [
        (share, f"{channel} of {run}")
        for run, by_channel in summary.within.items()
        for channel, share in by_channel.items()
        if share is not None
    ]
    within = ""
    if shares:
        least, where = min(shares)
        within = f"{least:.1%} in the channel with the fewest, {where}"
    pictures = [
        (data, words)
        for name, words in (
            (CORNER, "pairs of parameters"),
            (BANDS, "channels with the bands of the posterior"),
        )
        if (data := _picture(folder / name)) is not None
    ]
    table = Table(POSTERIOR_HEADINGS, posterior_rows(summary, result), 2)
    return PosteriorPart(summary, table, within, pictures)


def _picture(path: Path) -> str | None:
    try:
        content = read_bytes(path, _MOST_BYTES)
    except (OSError, InputError):
        return None
    return "data:image/png;base64," + base64.b64encode(content).decode()
