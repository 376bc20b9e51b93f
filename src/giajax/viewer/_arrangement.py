"""Several shows on one page: where each stands, and where one looks from."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .._typing import Float
from ._pieces import bounds, ends, scale_of
from ._show import Show
from ._stage import Stage

if TYPE_CHECKING:
    from viser import ViserServer

# Between two shows, in extents of the widest; and how far off one looks from.
_GAP, _DISTANCE = 0.25, 1.0

# Vertical angle of view, rad.
_FIELD = 0.75


def offsets(shows: Sequence[Show], *, overlay: bool) -> Float[np.ndarray, "show 3"]:
    """Where the base of each show stands, m: beside the last one, or all in one place."""
    places = np.zeros((len(shows), 3))
    if overlay:
        return places
    low, high = bounds(shows)
    # Across the arm, to the right, as one reads.
    width = float(high[1] - low[1]) + _GAP * float(np.max(high - low))
    places[:, 1] = -width * np.arange(len(shows))
    return places


def stages(server: "ViserServer", shows: Sequence[Show], *, overlay: bool = False) -> list[Stage]:
    """Draw shows, with a grid below them, and look at them from the side.

    Arguments:
        server: of viser.
        shows: at least one.
        overlay: all in one place instead of side by side.
    """
    scale = scale_of(shows)
    places = offsets(shows, overlay=overlay)
    drawn = [
        Stage(server.scene, show, scale, index=index, offset=place)
        for index, (show, place) in enumerate(zip(shows, places, strict=True))
    ]
    low, high = bounds(shows)
    low, high = low + places.min(axis=0), high + places.max(axis=0)
    _grid(server, low, high)
    look_from_the_side(server.initial_camera, *_with_building(shows, low, high))
    return drawn


def _with_building(
    shows: Sequence[Show], low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A box about what moves, and about what stands around and has an end."""
    extent = float(np.max(high - low))
    blocks = [ends(block, extent) for show in shows for block in show.scene.blocks]
    corners = np.concatenate([[low, high], *(each for each in blocks if each is not None)])
    return np.min(corners, axis=0), np.max(corners, axis=0)


def look_from_the_side(camera: Any, low: np.ndarray, high: np.ndarray) -> None:
    """Put a camera of viser where it sees a box from the right, a little from above."""
    middle, size = (low + high) / 2, float(np.linalg.norm(high - low)) or 1.0
    ahead = np.array([0.25, -1.0, 0.3])
    camera.look_at = tuple(middle)
    camera.position = tuple(middle + ahead / np.linalg.norm(ahead) * size * _DISTANCE)
    camera.up = (0.0, 0.0, 1.0)
    camera.fov = _FIELD


def _grid(server: "ViserServer", low: np.ndarray, high: np.ndarray) -> None:
    """A floor of metres below everything that moves."""
    size, middle = high - low, (low + high) / 2
    step = 1.0 if np.max(size) > 3 else 0.1
    across = np.ceil((size[:2] + 2 * step) / step / 2) * 2 * step
    server.scene.add_grid(
        "/grid",
        width=float(across[0]),
        height=float(across[1]),
        plane="xy",
        cell_size=step,
        section_size=5 * step,
        position=(float(middle[0]), float(middle[1]), float(low[2]) - 1e-3 * float(np.max(size))),
    )
