"""Templates, styles and scripts as one file that needs no other and no network."""

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

_MOST_FRAMES = 240  # as many as an eye follows; more make the page larger and no clearer
_GRID = 4095  # coordinates are integers of this range: an eye sees a thousandth


class Arm(NamedTuple):
    """A model that moves, as the JSON of the script, and how many markers were recorded.

    They are not drawn where the axes of the recording are not aligned with those of the model.
    """

    data: str
    recorded: int
    aligned: bool


def animation(result: FitResult, run: Run, predicted: Mapping[str, np.ndarray]) -> Arm | None:
    """What the arm of a fitted run looks like over time, with its recorded markers, as JSON.

    Lines with radii, fitted and recorded markers, on a grid of integers; None for a model of which
    nothing is seen, or that cannot be simulated there. `predicted` is SI, by channel.
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

_MOST_NAMES = 3  # more names than this are no title


def rendered(template: str, *, plots: bool, **facts: Any) -> bytes:
    """A template with the facts, escaped, and with all that it needs inside.

    With `plots` BokehJS goes in, 1.3 MB of it.
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
    """As of `giajax.report.study_page`."""
    return rendered("study.html", plots=False, **facts)


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
