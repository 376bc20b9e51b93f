"""Contents of a page besides its scene: points for the camera, a legend, and plots."""

import functools
import json
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ...models import Scene
from ...recordings import Channel
from ...runtime.arrays import Float
from ...schema import QUANTITIES
from ._show import Show, frames
from ._stage import (
    AIR,
    BUILDING,
    CONTACT,
    EMPTY,
    FULL,
    INK,
    LAYERS,
    RECORDED,
    VIEWED_FROM,
    Colour,
    Stage,
    grid_step,
    marker_colour,
)

# Directions along which the farthest points are sought, evenly distributed over the sphere (a
# Fibonacci lattice).
_COUNT = 240
_TURN = np.pi * (1 + np.sqrt(5)) * np.arange(_COUNT)
_UP = 1 - (2 * np.arange(_COUNT) + 1) / _COUNT
_DIRECTIONS = np.stack(
    [np.cos(_TURN) * np.sqrt(1 - _UP**2), np.sin(_TURN) * np.sqrt(1 - _UP**2), _UP], axis=1
)


# Longer motions are thinned to at least this number of samples, which keeps a page quick to make.
_MOST_SAMPLES = 1500


def outline(scene: Scene) -> Float[np.ndarray, "direction 3"]:
    """Return the farthest points of all bodies over all samples in many directions, m.

    A picture that contains these points contains the arm at every sample. Of a motion with more
    than 3,000 samples, only 1,500 to 3,000 evenly spaced samples are used.
    """
    found = []
    for line in scene.lines:
        reach = (
            line.radii if line.swelling is None else line.radii * np.max(line.swelling, initial=0)
        )
        each = slice(None, None, max(len(line.points) // _MOST_SAMPLES, 1))
        surface = np.broadcast_to(reach, line.points.shape[:2])[each].reshape(-1, 1)
        points = line.points[each].reshape(-1, 3)
        seen = np.isfinite(points).all(axis=1)
        points, surface = points[seen], surface[seen]
        if len(points):
            farthest = np.argmax(points @ _DIRECTIONS.T + surface, axis=0)
            found.append(points[farthest] + surface[farthest] * _DIRECTIONS)
    return _farthest(np.concatenate(found))


def _farthest(points: Float[np.ndarray, "point 3"]) -> Float[np.ndarray, "direction 3"]:
    """Return the points that are the farthest in any direction."""
    points = points[np.isfinite(points).all(axis=1)]
    return points[np.unique(np.argmax(points @ _DIRECTIONS.T, axis=0))] if len(points) else points


def about(stages: Sequence[Stage], *, live: bool = False, dark: bool = False) -> dict[str, Any]:
    """Return the data of a page for everything that it draws besides the scene of its stages."""
    shows = [stage.show for stage in stages]
    places = [stage.offset for stage in stages]
    points = np.concatenate(
        [
            _farthest(np.concatenate([outline(show.scene), *show.recorded.values()])) + place
            for show, place in zip(shows, places, strict=True)
        ]
    )
    times = frames(shows, 30.0, 300)
    return {
        "points": points.round(4).tolist(),
        "from": VIEWED_FROM.tolist(),
        "title": "giajax: " + ", ".join(show.name for show in shows),
        "legend": _legend(stages),
        "first": float(times[0]),
        "times": times.round(4).tolist(),
        "plots": _plots(shows, times) if len(times) > 1 else [],
        "live": live,
        "dark": dark,
    }


def _legend(stages: Sequence[Stage]) -> list[tuple[str, str]]:
    """Return each colour with its description, which gives the scale and its unit if any."""
    rows: list[tuple[Colour, str]] = []
    layers = {layer for stage in stages for layer in stage.layers()}
    scale = stages[0].scale
    for stage in stages:
        rows.append((stage.colour, f"balloons of {stage.show.name}"))
        if "markers" in stage.layers():
            rows.append((marker_colour(stage.colour), LAYERS["markers"]))
    rows.append((INK, "joints"))
    if "muscles" in layers and scale.pressure > 0:
        rows.append((EMPTY, "muscle at 0 bar"))
        rows.append((FULL, f"muscle at {scale.pressure / 1e5:.3g} bar"))
    elif "muscles" in layers:
        rows.append((INK, "muscles"))
    if "recorded" in layers:
        rows.append((RECORDED, LAYERS["recorded"]))
    if "bands" in layers:
        rows.append((stages[0].colour, LAYERS["bands"]))
    for name, colour in (("air", AIR), ("contact", CONTACT)):
        units = {each.unit for stage in stages for each in stage.show.scene.arrows}
        if name in layers:
            rows.append((colour, f"{LAYERS[name]}: longest arrow {scale.force:.2g} {units.pop()}"))
    if "surroundings" in layers:
        rows.append((BUILDING, LAYERS["surroundings"]))
    rows.append(((200, 200, 200), f"grid of {grid_step(scale.extent):g} m"))
    return [(f"rgb({red}, {green}, {blue})", text) for (red, green, blue), text in rows]


# Largest numbers of plotted markers and of curves in one plot, per show: all joint angles and
# commands of an arm of thirty joints. A curve has at most 300 samples, about 2 kB.
_MOST_MARKERS, _MOST_CURVES = 20, 60


def _plots(shows: Sequence[Show], times: np.ndarray) -> list[dict[str, Any]]:
    """Return plots versus time: the tip, channels, the largest force and pressure, markers."""
    found = []
    for show in shows:
        scene, samples = show.scene, [show.sample_at(float(time)) for time in times]
        of = f"{show.name}: " if len(shows) > 1 else ""
        names = sorted(scene.markers, key=lambda name: (name != "tip", name not in show.recorded))
        markers = [_position(show, name, samples, of) for name in names[:_MOST_MARKERS]]
        tip = int("tip" in scene.markers)
        found += [*markers[:tip], *_channels(show, samples, of)]
        for arrows in scene.arrows:
            if np.any(arrows.vectors):
                largest = np.max(np.linalg.norm(arrows.vectors[samples], axis=-1), axis=1)
                title = f"{of}{LAYERS.get(arrows.name, arrows.name)}, largest value, {arrows.unit}"
                found.append(_plot(title, f"force, {arrows.unit}", [_curve("largest", largest)]))
        pressures = [line.pressure for line in scene.lines if line.pressure is not None]
        if pressures:
            highest = np.max(np.stack(pressures)[:, samples], axis=0) / 1e5
            title = f"{of}highest pressure of any muscle, bar"
            found.append(_plot(title, "pressure, bar", [_curve("highest", highest)]))
        found += markers[tip:]
    return found


def _position(show: Show, name: str, samples: list[int], of: str) -> dict[str, Any]:
    points, recorded = show.scene.markers[name], show.recorded.get(name)
    curves = [
        _curve(
            axis, points[samples, k], None if recorded is None else _seen(recorded[:, k], samples)
        )
        for k, axis in enumerate("xyz")
    ]
    return _plot(f"{of}position of {name}, m", "position, m", curves)


def _channels(show: Show, samples: list[int], of: str) -> list[dict[str, Any]]:
    """Return one plot for each quantity of the channels; joint angles and commands share one."""
    quantities: dict[str, dict[str, Channel]] = {}
    for name in sorted({*show.scene.channels, *show.measured}):
        quantity = Channel.named(name).quantity
        channel = Channel.named(name, next(iter(QUANTITIES[quantity].suffixes)))
        quantities.setdefault(quantity, {})[name] = channel
    return [_quantity(show, samples, of, *each) for each in quantities.items()]


def _quantity(
    show: Show, samples: list[int], of: str, quantity: str, channels: dict[str, Channel]
) -> dict[str, Any]:
    """Return the plot of the channels of one quantity, with the curves that change most."""
    spread, curves = {}, {}
    for name, channel in channels.items():
        line, dot = show.scene.channels.get(name), show.measured.get(name)
        line = None if line is None else channel.from_si(line)[samples]
        dot = None if dot is None else _seen(channel.from_si(dot), samples)
        known = np.concatenate([each for each in (line, dot) if each is not None])
        known = known[np.isfinite(known)]
        spread[name] = float(np.ptp(known)) if len(known) else 0.0
        curves[name] = _curve(name, line, dot)
    most = sorted(spread, key=lambda name: -spread[name])[:_MOST_CURVES]
    # The plot initially shows the joint or link with the largest change: its angle and command.
    for name in curves:
        curves[name]["chosen"] = channels[name].index == channels[most[0]].index
    kinds = dict.fromkeys(channel.kind.replace("_", " ") for channel in channels.values())
    unit = next(iter(QUANTITIES[quantity].suffixes.values()))
    end = f", {unit}" if unit else ""
    some = f" ({len(most)} of {len(curves)} channels)" if len(most) < len(curves) else ""
    most.sort(key=lambda name: (channels[name].index or 0, name))
    axis = quantity.replace("_", " ") + end
    title = f"{of}{' and '.join(kinds)}{end}{some}"
    return _plot(title, axis, [curves[name] for name in most])


def _seen(values: np.ndarray, samples: list[int]) -> np.ndarray:
    """Return the last recorded value of a channel since the previous of the samples, or NaN.

    The rows between samples are not plotted, and a slow sensor may have its values only there.
    """
    rows = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), -1))[samples]
    return np.where(rows > np.array([-1, *samples[:-1]]), values[rows], np.nan)


def _plot(title: str, axis: str, curves: list[dict[str, Any]]) -> dict[str, Any]:
    return {"title": title, "axis": axis, "curves": curves}


def _curve(name: str, values: np.ndarray | None, dots: np.ndarray | None = None) -> dict[str, Any]:
    return {"name": name, "values": _numbers(values), "dots": _numbers(dots), "chosen": True}


def _numbers(values: np.ndarray | None) -> list[float | None]:
    """Return values with five digits; constant values, such as those of a command, only once."""
    if values is None:
        return []
    if np.all(values == values[0]):
        values = values[:1]
    return [float(f"{value:.5g}") if np.isfinite(value) else None for value in values]


def beside(page: bytes, facts: dict[str, Any]) -> bytes:
    """Return a viser page with the contents besides its scene added."""
    # The name of a run must not end the script element that contains it.
    data = json.dumps(facts, separators=(",", ":")).replace("<", "\\u003c")
    style, script = (
        files(__package__).joinpath(f"page.{kind}").read_text() for kind in ("css", "js")
    )
    added = (
        f'<style>{style}</style><script type="application/json" id="about">{data}</script>'
        f"<script>{script}</script>"
    )
    head = page.index(b"</head>")
    return page[:head] + added.encode() + page[head:]


@functools.cache
def viser_page() -> bytes:
    """Return the page that viser serves."""
    import viser

    return Path(viser.__file__).parent.joinpath("client", "build", "index.html").read_bytes()
