"""Combine templates, styles and scripts into one file that needs no network connection."""

import functools
import json
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import Any, NamedTuple

import bokeh
import numpy as np
from bokeh.resources import Resources
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from ...fitting import FitResult
from ...models import capabilities, recorded_markers
from ...recordings import Run
from ...runtime.page_policy import with_policy
from ...simulation import SimulationError

_MOST_FRAMES = 240  # enough for a smooth animation; more only make the page larger
_GRID = 4095  # coordinates are integers up to this value, which is finer than visible


class Arm(NamedTuple):
    """An animated model as JSON for the script, and the number of recorded markers.

    Recorded markers are not drawn if the axes of the recording differ from those of the model.
    """

    data: str
    recorded: int
    aligned: bool


def animation(result: FitResult, run: Run, predicted: Mapping[str, np.ndarray]) -> Arm | None:
    """Return an animation of the model of a fitted run with its recorded markers, as JSON.

    It contains lines with radii, and fitted and recorded markers, on a grid of integers. It is None
    for a model without visible parts, or one that cannot be simulated here. `predicted` contains
    channels in SI.
    """
    try:
        scene = capabilities.scene(result.model_of(run), run)
    except SimulationError:
        return None
    if scene is None:
        return None
    frames = np.unique(np.linspace(0, scene.samples - 1, _MOST_FRAMES).round().astype(int))
    low, high = scene.extent()
    found = recorded_markers(scene, run, predicted)
    recorded, aligned = found or {}, found is not None
    for points in recorded.values():
        if np.any(np.isfinite(points)):
            low = np.fmin(low, np.nanmin(points, axis=0))
            high = np.fmax(high, np.nanmax(points, axis=0))
    step = float(np.max(high - low)) / _GRID or 1.0

    def grid(points: np.ndarray) -> list[Any]:
        cells = np.round((points[frames] - low) / step)
        flat = cells.reshape(len(frames), -1)
        return [[None if np.isnan(v) else int(v) for v in row] for row in flat]

    facts = {
        "low": low.tolist(),
        "step": step,
        "size": ((high - low) / step).tolist(),
        "times": None if scene.times is None else np.round(scene.times[frames], 4).tolist(),
        "frames": (frames + 1).tolist(),
        "lines": [
            {
                "points": grid(line.points),
                "radii": np.round(line.radii / step, 1).tolist(),
                "loose": None if line.loose is None else line.loose[frames].astype(int).tolist(),
            }
            for line in scene.lines
        ],
        "markers": [grid(points) for name, points in scene.markers.items() if name in recorded],
        "recorded": [grid(points) for points in recorded.values()],
    }
    return Arm(json.dumps(facts, separators=(",", ":")), len(recorded), aligned)


_FOLDER = files(__package__) / "templates"

_MOST_NAMES = 3  # more names than this are too long for a title


def rendered(template: str, *, plots: bool, **facts: Any) -> bytes:
    """Render a template with escaped facts, including all styles and scripts that it needs.

    With `plots`, BokehJS is included, which is 1.3 MB.
    """
    environment = Environment(
        loader=FunctionLoader(_text), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    page = environment.get_template(template).render(
        style=Markup(_text("page.css")),
        script=Markup((_bundle() if plots else "") + "\n" + _text("page.js")),
        bokeh=bokeh.__version__ if plots else "",
        data=_data,
        **facts,
    )
    return with_policy(page.encode())


def study_page(**facts: Any) -> bytes:
    """Return the page of `giajax.report.study_page`."""
    return rendered("study.html", plots=False, **facts)


def some_of(names: Iterable[str]) -> list[str]:
    """Return the first different names for a title, and the number of others."""
    different = list(dict.fromkeys(names))
    more = len(different) - _MOST_NAMES
    return different if more <= 0 else [*different[:_MOST_NAMES], f"and {more} more"]


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")


@functools.cache
def _bundle() -> str:
    """Return BokehJS, with the end tag of a script escaped inside it."""
    (script,) = Resources(mode="inline", components=["bokeh"]).js_raw[:1]
    return script.replace("</script", "<\\/script")


def _data(text: str) -> Markup:
    """Escape JSON for a script element, so the name of a run cannot end the element."""
    escaped = text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return Markup(escaped)
