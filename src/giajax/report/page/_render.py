"""Templates, styles and scripts as one file that needs no other and no network."""

import functools
from collections.abc import Iterable
from importlib.resources import files
from typing import Any

import bokeh
from bokeh.resources import Resources
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from ..._policy import with_policy

_FOLDER = files(__package__) / "templates"

# More names than this are no title.
_MOST_NAMES = 3


def rendered(template: str, *, plots: bool, **facts: Any) -> bytes:
    """A template with the facts, escaped, and with all that it needs inside.

    Arguments:
        template: name of the file.
        plots: whether BokehJS goes in, 1.3 MB of it.
        facts: what the template shows.

    Returns:
        The page, encoded.
    """
    environment = Environment(
        loader=FunctionLoader(_text), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    bundle = _bundle() if plots else ""
    page = environment.get_template(template).render(
        style=Markup(_text("page.css")),
        script=Markup(bundle + "\n" + _text("page.js")),
        bokeh=bokeh.__version__ if plots else "",
        data=_data,
        **facts,
    )
    return with_policy(page.encode())


def some_of(names: Iterable[str]) -> list[str]:
    """The first different names for a title, and how many more there are."""
    different = list(dict.fromkeys(names))
    more = len(different) - _MOST_NAMES
    return different if more <= 0 else [*different[:_MOST_NAMES], f"and {more} more"]


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


@functools.cache
def _bundle() -> str:
    """BokehJS; no end of a script may stand within a script."""
    (script,) = Resources(mode="inline", components=["bokeh"]).js_raw[:1]
    return script.replace("</script", "<\\/script")


def _data(text: str) -> Markup:
    """JSON as it may stand in a script of data: a name of a run ends no element."""
    escaped = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(escaped)
