"""Files of the reproduced figures and tables: PNG, CSV, JSON, and an HTML page of all."""

import functools
import html
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from ...report import to_csv, to_png
from ...runtime.page_policy import with_policy
from ...runtime.pictures import all_pictures
from ...runtime.records import plain_data
from ...runtime.text import InputError, __version__
from ._arm_figures import fig05, fig19, table3
from ._contenders import Fits, Reproduced, stand_in
from ._inverse import table3_inverse
from ._joint_figures import fig06, fig09_or_10, fig12

Say = Callable[[str], None]

FIGURES: dict[str, Callable[[Say, Callable[[], Fits]], Reproduced]] = {
    "fig5": lambda say, fits: fig05(),
    "fig6": lambda say, fits: fig06(),
    "fig9": lambda say, fits: fig09_or_10(9),
    "fig10": lambda say, fits: fig09_or_10(10),
    "fig12": lambda say, fits: fig12(say),
    "fig19": lambda say, fits: fig19(fits()),
    "table3": lambda say, fits: table3(fits()),
    "table3_inverse": lambda say, fits: table3_inverse(say),
}
"""Figures and tables by the names of their files. Only `table3 --inverse` makes the last one."""


def reproduce(
    names: Sequence[str], recordings: Path, *, progress: Say | None = None
) -> Iterator[tuple[str, Reproduced]]:
    """Reproduce figures and tables of the paper, by the names of `FIGURES`.

    The folder of recordings contains the runs that stand in for the paper's (`data/paper` of a
    checkout).

    Raises:
        InputError: an unknown name, or a folder without these runs.
    """
    for name in names:
        if name not in FIGURES:
            raise InputError(f"the figure '{name}' does not exist: use one of {', '.join(FIGURES)}")
    say = progress or (lambda text: None)
    # Fig. 19 and table 3 share the same fits, and most figures need no fit.
    fits = functools.cache(lambda: Fits(stand_in(recordings), say))
    return ((name, FIGURES[name](say, fits)) for name in names)


_STYLE = """\
body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 62rem; margin: 2rem auto;
       padding: 0 1rem; }
h2 { margin-top: 3rem; }
img { max-width: 100%; height: auto; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; }
th, td { padding: 0.2rem 0.9rem 0.2rem 0; text-align: right; border-bottom: 1px solid #e3e3e3; }
th:first-child, td:first-child { text-align: left; }
dt { font-weight: 600; }
dd { margin: 0 0 0.4rem 0; }
"""

_HEAD = """\
<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The paper's figures, reproduced by giajax</title>
"""

_PNG_END = b"IEND\xaeB`\x82"  # Last bytes of every complete PNG file.


def reproduced_names(name: str) -> tuple[str, str, str]:
    """Return the file names of a figure: PNG, CSV and JSON."""
    return f"{name}.png", f"{name}.csv", f"{name}.json"


def reproduced_record(name: str, shown: Reproduced) -> dict[str, Any]:
    """Return the contents of the JSON file of a figure."""
    record = {
        "name": name,
        "title": shown.title,
        "giajax": __version__,
        "sources": {
            word.lower().replace(" ", "_"): text for word, text in shown.sources.by_word().items()
        },
        "table": {"headings": list(shown.headings), "rows": [list(row) for row in shown.rows]},
        "columns": {heading: list(column) for heading, column in shown.columns.items()},
        **shown.facts,
    }
    return cast("dict[str, Any]", _rounded(plain_data(record)))


def reproduced_files(name: str, shown: Reproduced) -> dict[str, bytes]:
    """Return the PNG, CSV and JSON files of a figure, by file name."""
    record = reproduced_record(name, shown)
    text = json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False)
    contents = to_png(shown.figure), to_csv(shown.columns), f"{text}\n".encode()
    return dict(zip(reproduced_names(name), contents, strict=True))


def stored_record(folder: Path, name: str) -> dict[str, Any] | None:
    """Read the contents of the JSON file of a figure in a folder.

    Returns None if one of the files is missing, incomplete, or of another version.
    """
    picture, table, record = (folder / file for file in reproduced_names(name))
    try:
        stored = json.loads(record.read_bytes())
        whole = picture.read_bytes().endswith(_PNG_END) and table.stat().st_size > 0
        whole &= all(Path(each).exists() for each in all_pictures([picture]))
        same = (stored["name"], stored["giajax"]) == (name, __version__)
        missing = {"title", "sources", "table"} - stored.keys()
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return None
    return stored if whole and same and not missing else None


def reproduction_page(records: Iterable[Mapping[str, Any]]) -> bytes:
    """Return an HTML page of figures, from their records; their files are in the same folder."""
    parts = []
    for shown in records:
        name, title = shown["name"], html.escape(shown["title"])
        picture, table, record = reproduced_names(name)
        sources = "".join(
            f"<dt>{word.replace('_', ' ').capitalize()}</dt><dd>{html.escape(text)}</dd>"
            for word, text in shown["sources"].items()
        )
        parts.append(
            f'<h2 id="{name}">{title}</h2>\n'
            f'<img src="{picture}" alt="{title}">\n'
            f'<div class="wide">{_table(shown["table"])}</div>\n<dl>{sources}</dl>\n'
            f'<p>Numbers: <a href="{table}">{table}</a>, <a href="{record}">{record}</a></p>\n'
        )
    page = (
        f"{_HEAD}<style>\n{_STYLE}</style></head>\n<body>\n"
        "<h1>The paper's figures, reproduced by giajax</h1>\n<p>Figures and tables that Takeichi, "
        "Suzumori, Endo and Nabae (<i>Development of a 20-m-long Giacometti arm with balloon body "
        "based on kinematic model with air resistance</i>) derive from their models, reproduced by "
        f"giajax {__version__}. The text below each figure lists what is printed in the paper, "
        "what is assumed, and what is reconstructed.</p>\n" + "".join(parts) + "</body></html>\n"
    )
    return with_policy(page.encode())


def is_reproduction_page(path: Path) -> bool:
    """Return whether a file is a page that `reproduction_page` wrote."""
    try:
        return path.read_bytes().startswith(_HEAD.encode())
    except OSError:
        return False


def _table(table: Mapping[str, Any]) -> str:
    heads = "".join(f"<th>{html.escape(heading)}</th>" for heading in table["headings"])
    rows = ""
    for row in table["rows"]:
        cells = (f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in row)
        rows += "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells) + "</tr>\n"
    return f"<table><tr>{heads}</tr>\n{rows}</table>"


def _rounded(data: Any) -> Any:
    """Round all numbers of plain data to nine digits."""
    if isinstance(data, dict):
        return {key: _rounded(each) for key, each in data.items()}
    if isinstance(data, list):
        return [_rounded(each) for each in data]
    return float(f"{data + 0.0:.9g}") if isinstance(data, float) else data
