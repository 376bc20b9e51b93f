"""Style of all pictures and their conversion to files, without global settings of matplotlib."""

import base64
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from ..fitting import FitResult
from ..models import Block, Scene
from ..runtime.pictures import CAPTION, FORMATS, SIGNATURE, Picture, caption_file, picture_formats

# Okabe and Ito's colours, which people with red-green colour blindness can distinguish.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY, LIGHT = "#222222", "#767676", "#E3E3E3"

MINUS = "\N{MINUS SIGN}"
DEGREE = "\N{DEGREE SIGN}"

_HEADERS: dict[str, dict[str, Any]] = {
    "png": {"Software": SIGNATURE},
    # Without a date, the same picture gives the same file.
    "svg": {"Creator": SIGNATURE, "Date": None},
    "pdf": {"Creator": SIGNATURE, "CreationDate": None},
}

_SETTINGS: Any = {
    # Text can be searched, read aloud and edited; a missing font is replaced.
    "svg.fonttype": "none",
    "svg.hashsalt": "giajax",
    # TrueType, because journals refuse Type 3 fonts.
    "pdf.fonttype": 42,
}


class CaptionedFigure(Figure):
    """Figure with a caption.

    Attributes:
        caption: sentences that explain panels, symbols, colours and units to a reader who does not
            know giajax. They are in the metadata of each file, and in a text file beside it if
            `pictures_as` selects a format or a resolution.
    """

    caption: str = ""


def new_figure(width: float, height: float, title: str, caption: str) -> CaptionedFigure:
    """Return an empty figure of this size (inches)."""
    # A Figure made without pyplot has no window and selects no backend.
    figure = CaptionedFigure(figsize=(width, height), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=10, color=INK, x=0.01, ha="left")
    figure.caption = caption
    return figure


def plain(axes: Axes, title: str = "", across: str = "", up: str = "") -> None:
    """Set a light grid, two spines and small text, with a title and labels if they are given."""
    axes.grid(True, color=LIGHT, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(labelsize=8, color=GREY, labelcolor=INK, length=3)
    if across:
        axes.set_xlabel(across)
    if up:
        axes.set_ylabel(up)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)
    if title:
        axes.set_title(title, fontsize=9, loc="left", color=INK)


def plain_colorbar(axes: Axes, image: Any, **place: Any) -> Any:
    """Add a colour bar with small text and without a frame."""
    bar = axes.figure.colorbar(image, ax=axes, **place)
    bar.ax.tick_params(labelsize=8, length=0, labelcolor=INK)
    bar.outline.set_visible(False)
    return bar


def unfinished(result: FitResult) -> str:
    """Return the part of a title on a fit that did not converge."""
    return "" if result.status == "converged" else f" ({result.status.replace('_', ' ')})"


def as_data(content: bytes) -> str:
    """Encode a PNG file as a data URL."""
    return "data:image/png;base64," + base64.b64encode(content).decode()


def to_png(figure: Figure) -> Picture:
    """Return the figure as a PNG file, with the other selected formats.

    Equal figures give equal bytes.
    """
    chosen = picture_formats()
    figure.set_dpi(chosen.dpi)
    if (engine := figure.get_layout_engine()) is not None:
        # Compute the layout once, because matplotlib draws a figure twice for it.
        engine.execute(figure)
        figure.set_layout_engine("none")
    with matplotlib.rc_context(_SETTINGS):
        wanted = [each for each in FORMATS if each in ("png", *chosen.beside)]
        files = {each: _saved(figure, each, chosen.dpi) for each in wanted}
    if CAPTION in chosen.beside:
        files[CAPTION] = caption_file(_caption(figure))
    return Picture(files.pop("png"), files)


def _caption(figure: Figure) -> str:
    """Return the title and the caption of a figure as one paragraph."""
    title = figure.get_suptitle().replace("\n", " ")
    parts = [title, figure.caption if isinstance(figure, CaptionedFigure) else ""]
    return ". ".join(filter(None, parts))


def _saved(figure: Figure, ending: str, dpi: int) -> bytes:
    buffer = io.BytesIO()
    caption = {"Subject" if ending == "pdf" else "Description": _caption(figure)}
    metadata = {**_HEADERS[ending], "Title": figure.get_suptitle(), **caption}
    figure.savefig(buffer, format=ending, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def new_plot(height: int, across: str, up: str, **more: Any) -> Any:
    """Return an empty plot for BokehJS with this height, as wide as its place on the page."""
    from bokeh.plotting import figure

    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        tools="xpan,box_zoom,reset",
        # The wheel must not zoom, because users scroll the page with it.
        active_drag="box_zoom",
        toolbar_location="above",
        x_axis_label=across,
        y_axis_label=up,
        **more,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.outline_line_color = None
    plot.grid.grid_line_alpha = 0.5
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = axis.major_label_text_font_size = "11px"
        axis.minor_tick_line_color = None
    plot.yaxis.ticker.desired_num_ticks = 6 if height > 180 else 4
    return plot


def small(values: np.ndarray) -> np.ndarray:
    """Round values to seven digits, which halves the size of a page without a visible effect."""
    return np.asarray(values, dtype=np.float32)


def columns_of(headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> dict[str, list[Any]]:
    """Return rows as columns by heading; the headings are present even without rows."""
    return {heading: [row[at] for row in rows] for at, heading in enumerate(headings)}


def embedded(plot: Any, renderer: Any, tips: list[tuple[str, str]]) -> str:
    """Return a plot as JSON for BokehJS; its renderer shows the tips."""
    from bokeh.embed import json_item
    from bokeh.models import HoverTool

    plot.add_tools(HoverTool(renderers=[renderer], tooltips=tips))
    return json.dumps(json_item(plot))


def grid_of(figure: Figure, count: int, across: int) -> Iterator[Axes]:
    """Yield this number of panels, row by row with at most `across` columns."""
    across = max(min(across, count), 1)
    for place in range(count):
        yield figure.add_subplot(-(-count // across), across, place + 1)


def to_csv(columns: Mapping[str, Iterable[Any]]) -> bytes:
    """Return words, numbers (nine digits) or truth values by heading as a CSV file."""
    rows = [",".join(map(_cell, row)) for row in zip(*columns.values(), strict=True)]
    return ("\n".join([",".join(columns), *rows]) + "\n").encode()


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value else value
    # numpy, and therefore float, treats a truth value as a number.
    return str(value).lower() if str(value) in ("True", "False") else f"{float(value) + 0.0:.9g}"


_SLACK = (0, (2, 2))
_AXIS = (0, (6, 3))


def draw_scene(
    panel: Axes,
    scene: Scene,
    sample: int,
    *,
    axes: str = "xz",
    colours: Mapping[str, str] | None = None,
    widths: Mapping[str, float] | None = None,
) -> None:
    """Draw one sample of a scene to scale: bodies in grey, threads, and markers as dots.

    Arguments:
        axes: the two visible coordinates: "xz" from the side, "xy" from above.
        colours: colours of lines by name; the default is grey for bodies and blue for threads.
        widths: widths of threads by name, points; the default is 1.4.
    """
    seen = ["xyz".index(name) for name in axes]
    for line in scene.lines:
        points = line.points[sample][:, seen]
        body = bool(np.any(line.radii > 0))
        colour = (colours or {}).get(line.name, GREY if body else BLUE)
        if body:
            outline = _outline(points, line.radii)
            panel.add_patch(Polygon(outline, closed=True, color=colour, alpha=0.22, linewidth=0))
            panel.plot(*points.T, color=colour, linewidth=0.7, linestyle=_AXIS)
            continue
        is_loose = line.loose is not None and bool(line.loose[sample])
        width = (widths or {}).get(line.name, 1.4)
        panel.plot(*points.T, color=colour, linewidth=width, linestyle=_SLACK if is_loose else "-")
    for marker in scene.markers.values():
        panel.plot(*marker[sample][seen], "o", color=INK, markersize=2.6, zorder=5)
    panel.set_aspect("equal")


def draw_blocks(panel: Axes, blocks: Sequence[Block], *, axes: str = "xz") -> None:
    """Draw the obstacles in the view of `draw_scene`, without a change of the limits."""
    seen, limits = ["xyz".index(name) for name in axes], (panel.get_xlim(), panel.get_ylim())
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    for block in blocks:
        corners = (block.centre + (signs * block.size) @ block.axes.T)[:, seen]
        outline = corners[ConvexHull(corners).vertices]
        panel.add_patch(
            Polygon(outline, closed=True, facecolor=LIGHT, edgecolor=GREY, linewidth=0.5, zorder=0)
        )
    panel.set_xlim(limits[0])
    panel.set_ylim(limits[1])


def _outline(points: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Return both edges of a round body about a polyline, shape (2 point, 2)."""
    steps = np.diff(points, axis=0)
    steps = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    # A body seen along its axis has no direction in the picture, so any direction is used.
    along = np.where(lengths > 0, steps / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0])
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) * radii[:, None]
    return np.concatenate([points + across, (points - across)[::-1]])
